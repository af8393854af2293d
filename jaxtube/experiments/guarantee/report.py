"""The report of `guarantee`: the claims of two designs side by side, and the laps of each under
every law."""

from __future__ import annotations

import textwrap
from collections.abc import Collection

from jaxtube.experiments.guarantee.claims import (
    CLAIMS,
    CONFIDENCE,
    VIOLATIONS,
    Claim,
    Count,
    Tested,
    bound,
    judge,
    steps,
    violating,
)
from jaxtube.experiments.run.table import Column, format_table, left

WIDTH = 110
"""Columns of all text."""
SHOWN = tuple(VIOLATIONS)[:-1]


def cells(claim: Claim, design: Tested) -> tuple[str, str, str]:
    """Return in words what a design claims, what is certified of it, and what was seen."""
    verdict = judge(claim, design)
    claimed = "no" if not verdict.claimed else f"yes: {verdict.scope}" if verdict.scope else "yes"
    return claimed, verdict.proof, _seen(verdict.seen) if verdict.seen else ""


def _seen(count: Count) -> str:
    text = f"{count.seen:,} of {count.of:,} {count.unit}"
    return (
        f"{text}; most: {_percent(count.seen_there / count.of_there)}, {count.worst}"
        if count.seen
        else text
    )


def _percent(share: float) -> str:
    return f"{100 * share:.3g}%"


def totals(design: Tested) -> tuple[str, ...]:
    """Return in words the cells of TOTALS."""
    laws = design.laws
    worst = max(laws, key=lambda name: bound(laws[name]))
    return (
        f"{sum(law['laps'] for law in laws.values()):,} in {sum(map(steps, laws.values())):,} steps",
        _total(laws, tuple(VIOLATIONS)),
        _total(laws, [name for name in VIOLATIONS if name != "w_outside_W"]),
        f"{_percent(bound(laws[worst]))} ({worst})",
    )


def _total(laws: dict[str, dict], events: Collection[str]) -> str:
    least, most = (sum(violating(law, events)[i] for law in laws.values()) for i in range(2))
    return f"{least:,}" if least == most else f"{least:,} to {most:,}"


TOTALS = (
    "laps tried",
    "laps that violate any of it",
    "laps that violate more than W",
    f"violating share, worst law, at most ({CONFIDENCE:.0%})",
)
HEADINGS = ("claimed", "proved", "seen")


def text(tested: list[Tested]) -> str:
    """Return the report as text of at most 110 columns."""
    parts = [verdict(design) for design in tested]
    parts.append(claim_table(tested))
    parts += [law_table(design) for design in tested]
    parts += [legend(), *(design.note for design in tested if design.note)]
    return "\n\n".join("\n".join(_wrapped(part)) for part in parts)


def _wrapped(part: str) -> list[str]:
    return [
        line
        for row in part.split("\n")
        for line in (textwrap.wrap(row, WIDTH) if len(row) > WIDTH else [row])
    ]


def verdict(design: Tested) -> str:
    """Return one line: certified or not, and what the attack came to."""
    tried, violations, *_ = totals(design)
    failing = ", ".join(design.certificate.failing)
    proved = "CERTIFIED" if design.certificate.holds_for_robot else f"NOT CERTIFIED ({failing})"
    return f"{design.name}: {proved}; {violations} laps of {tried} violate what is claimed"


def claim_table(tested: list[Tested]) -> str:
    """Return the claims side by side, three lines each: claimed, proved, seen."""
    columns = [left("claim"), left(""), *(left(design.name) for design in tested)]
    rows = []
    for claim in CLAIMS:
        words = [cells(claim, design) for design in tested]
        rows += _claim_rows(claim.title, dict(zip(HEADINGS, zip(*words, strict=True), strict=True)))
    words = [totals(design) for design in tested]
    for title, row in zip(TOTALS, zip(*words, strict=True), strict=True):
        rows += _claim_rows(title, {"": row})
    return format_table(columns, rows, WIDTH)


def _claim_rows(title: str, labelled: dict[str, tuple[str, ...]]) -> list[list[str]]:
    """Return the rows of one claim, the first with its title; rows without words are left out."""
    rows = []
    for label, words in labelled.items():
        if any(words):
            rows.append(["" if rows else title, label, *(word or "-" for word in words)])
    return rows


def law_table(design: Tested) -> str:
    """Return one line a law: laps in which each event occurred, rows active, greatest usage of W
    and E, the bound."""
    columns = [
        left(design.name),
        Column("laps"),
        Column("steps"),
        *(Column(VIOLATIONS[name]) for name in SHOWN),
        Column("active"),
        Column("W"),
        Column("E"),
        Column("at most"),
    ]
    rows = [_law_row(name, law) for name, law in design.laws.items()]
    return format_table(columns, rows, WIDTH)


def _law_row(name: str, law: dict) -> list[str]:
    return [
        name,
        f"{law['laps']:,}",
        f"{steps(law) / 1e6:.3g}M",
        *(str(law["events"][event]["laps"]) for event in SHOWN),
        f"{law['events']['row_active']['share_of_steps']:.2%}",
        f"{law['worst']['disturbance'][0]['usage']:.2f}",
        f"{law['worst']['error'][0]['usage']:.2f}",
        _percent(bound(law)),
    ]


def legend() -> str:
    """Return what the columns mean."""
    return (
        "Laps by law: w outside W, e outside E, u outside U, wheels asked beyond their limits, QP infeasible, QP "
        "unsolved; a lap with any of these violates the guarantee. at most: the share of such laps among all that the "
        f"law draws ({CONFIDENCE:.0%}, one-sided, Clopper-Pearson). active: share of steps with active rows. W, E: how "
        "far w and e went, 1 being the edge of the set. edge-: the first second, from the edge of the feasible set; "
        "the others: whole laps, from all over it."
    )


def markdown(tested: list[Tested]) -> str:
    """Return the same tables in Markdown."""
    head = ["claim", *(f"{design.name}: {heading}" for design in tested for heading in HEADINGS)]
    rows = [
        [claim.title, *(cell for each in tested for cell in cells(claim, each))] for claim in CLAIMS
    ]
    totalled = [totals(design) for design in tested]
    rows += [
        [title, *(c for cell in row for c in ("", "", cell))]
        for title, *row in zip(TOTALS, *totalled, strict=True)
    ]
    parts = [*map(verdict, tested), _markdown_table(head, rows)]
    parts += [_markdown_table(*_law_rows(design)) for design in tested]
    return (
        "\n\n".join([*parts, legend(), *(design.note for design in tested if design.note)]) + "\n"
    )


def _law_rows(design: Tested) -> tuple[list[str], list[list[str]]]:
    head = [design.name, "laps", "steps", *VIOLATIONS.values(), "active", "W", "E", "at most"]
    rows = []
    for name, law in design.laws.items():
        counts = [f"{law['events'][event]['laps']:,}" for event in VIOLATIONS]
        used = [f"{law['worst'][kind][0]['usage']:.4g}" for kind in ("disturbance", "error")]
        active = f"{law['events']['row_active']['share_of_steps']:.2%}"
        rows.append(
            [
                name,
                f"{law['laps']:,}",
                f"{steps(law):,}",
                *counts,
                active,
                *used,
                _percent(bound(law)),
            ]
        )
    return head, rows


def _markdown_table(head: list[str], rows: list[list[str]]) -> str:
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join(f"| {' | '.join(cell or '-' for cell in line)} |" for line in lines)
