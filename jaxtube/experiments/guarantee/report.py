"""The report of `guarantee`: the claims of two designs side by side, and the laps of each under
every law."""

from __future__ import annotations

import textwrap
from collections.abc import Collection

from jaxtube.experiments.guarantee.claims import (
    Count,
    DesignUnderTest,
    GuaranteeClaim,
    bound_violating_laps,
    bound_violating_share,
    count_steps,
    judge_claim,
    list_claims,
    list_violations,
)
from jaxtube.experiments.run.table import WIDTH, Column, format_table, left
from jaxtube.experiments.run.verdict import fit_line
from jaxtube.statistics.events import VIOLATIONS, find_event
from jaxtube.statistics.intervals import CONFIDENCE

TOTALS = (
    "laps tried",
    "laps that violate any of it",
    "laps that violate more than W",
    f"violating share, worst law, at most ({CONFIDENCE:.0%})",
)
HEADINGS = ("claimed", "proved", "seen")
WIDE = ("acceleration_exceeded", "not_finite")
"""Events that are counted in the second table of the text, where there is room."""
USAGES = ("steps", "active", "w, share of W", "e, share of E", "violating share at most")


def cells(claim: GuaranteeClaim, design: DesignUnderTest) -> tuple[str, str, str]:
    """Return in words what a design claims, what is certified of it, and what was seen."""
    verdict = judge_claim(claim, design)
    claimed = "yes" if verdict.claimed else "no"
    if verdict.claimed and verdict.scope:
        claimed = f"yes: {verdict.scope}"
    return claimed, verdict.proof, _say_what_was_seen(verdict.seen)


def _say_what_was_seen(count: Count | None) -> str:
    if count is None:
        return ""
    text = f"{count.seen:,} of {count.trials:,} {count.unit}"
    if not count.seen:
        return text
    return f"{text}; most: {_percent(count.seen_there / count.trials_there)}, {count.worst}"


def _percent(share: float) -> str:
    return f"{100 * share:.3g}%"


def totals(design: DesignUnderTest) -> tuple[str, ...]:
    """Return in words the cells of TOTALS."""
    laws = design.laws
    laps = sum(law["laps"] for law in laws.values())
    steps = sum(map(count_steps, laws.values()))
    beyond_premise = [name for name in VIOLATIONS if name != "w_outside_W"]
    shares = {name: bound_violating_share(law) for name, law in laws.items()}
    worst = max(shares, key=lambda name: shares[name])
    return (
        f"{laps:,} in {steps:,} steps",
        _say_how_many(laws, VIOLATIONS),
        _say_how_many(laws, beyond_premise),
        f"{_percent(shares[worst])} ({worst})",
    )


def _say_how_many(laws: dict[str, dict], events: Collection[str]) -> str:
    """Return in words how many laps had one of some events."""
    bounds = [bound_violating_laps(law, events) for law in laws.values()]
    least = sum(fewest for fewest, _ in bounds)
    largest = sum(most for _, most in bounds)
    return f"{least:,}" if least == largest else f"{least:,} to {largest:,}"


def text(tested: list[DesignUnderTest]) -> str:
    """Return the report as text of at most WIDTH columns."""
    parts = [say_verdict(tested), *map(describe_outcome, tested)]
    parts.append(claim_table(tested))
    for design in tested:
        parts += law_tables(design)
    parts += [legend(tested), *_notes(tested)]
    return "\n\n".join("\n".join(_wrap(part)) for part in parts)


def _notes(tested: list[DesignUnderTest]) -> list[str]:
    return [design.note for design in tested if design.note]


def _wrap(part: str) -> list[str]:
    lines = []
    for line in part.split("\n"):
        lines += textwrap.wrap(line, WIDTH) if len(line) > WIDTH else [line]
    return lines


def say_verdict(tested: list[DesignUnderTest]) -> str:
    """Return one line: of each design, the scenario's own first, whether it is certified, and how
    many laps violate what it claims."""
    return fit_line("; ".join(map(_say_briefly, reversed(tested))))


def _say_briefly(design: DesignUnderTest) -> str:
    proved = "CERTIFIED" if design.certificate.holds_for_robot else "NOT CERTIFIED"
    return f"{design.name}: {proved}, {totals(design)[1]} laps violate it"


def describe_outcome(design: DesignUnderTest) -> str:
    """Return whether a design is certified, what fails, and what the attack came to."""
    laps, violations, *_ = totals(design)
    failing = ", ".join(design.certificate.failing)
    proved = "CERTIFIED" if design.certificate.holds_for_robot else f"NOT CERTIFIED ({failing})"
    return f"{design.name}: {proved}; {violations} laps of {laps} violate what is claimed"


def claim_table(tested: list[DesignUnderTest]) -> str:
    """Return the claims side by side, three lines each: claimed, proved, seen."""
    columns = [left("claim"), left(""), *(left(design.name) for design in tested)]
    rows = []
    for claim in list_claims(tested):
        by_heading = zip(*[cells(claim, design) for design in tested], strict=True)
        rows += _claim_rows(claim.title, HEADINGS, list(by_heading))
    by_total = zip(*map(totals, tested), strict=True)
    for title, words in zip(TOTALS, by_total, strict=True):
        rows += _claim_rows(title, ("",), [words])
    return format_table(columns, rows)


def _claim_rows(
    title: str, headings: Collection[str], words: list[tuple[str, ...]]
) -> list[list[str]]:
    """Return the rows of one claim, the first with its title; rows without words are left out.

    Args:
        title: of the claim.
        headings: one for each row.
        words: of each row, by design.
    """
    rows = []
    for heading, by_design in zip(headings, words, strict=True):
        if any(by_design):
            rows.append(["" if rows else title, heading, *(cell or "-" for cell in by_design)])
    return rows


def law_tables(design: DesignUnderTest) -> list[str]:
    """Return a line for each law: the laps in which each event occurred; and how far w and e went,
    with the bound on the violating laps."""
    counted = list_violations([design])
    first = [name for name in counted if name not in WIDE]
    second = [name for name in counted if name in WIDE]
    events = [
        [name, f"{law['laps']:,}", *_event_cells(law, first)] for name, law in design.laws.items()
    ]
    usages = [
        [*_usage_row(name, law), *_event_cells(law, second)] for name, law in design.laws.items()
    ]
    words = [find_event(name).words for name in (*first, *second)]
    event_columns = ["laps", *words[: len(first)]]
    usage_columns = [*USAGES, *words[len(first) :]]
    return [
        format_table([left(design.name), *map(Column, event_columns)], events),
        format_table([left(design.name), *map(Column, usage_columns)], usages),
    ]


def _event_cells(law: dict, counted: Collection[str]) -> list[str]:
    return [f"{law['events'][event]['laps']:,}" for event in counted]


def _usage_row(name: str, law: dict) -> list[str]:
    return [
        name,
        f"{count_steps(law):,}",
        f"{law['events']['row_active']['share_of_steps']:.2%}",
        f"{law['worst']['disturbance'][0]['usage']:.3f}",
        f"{law['worst']['error'][0]['usage']:.3f}",
        _percent(bound_violating_share(law)),
    ]


def legend(tested: list[DesignUnderTest]) -> str:
    """Return what the columns mean."""
    events = [find_event(name) for name in list_violations(tested)]
    lines = [
        "Each row is a law, which laps are drawn from: the process of the slips, over whole laps "
        "from starts all over the feasible set; edge-: the first second, from its edge.",
        "Laps in which, at least once:",
        *(f"  {event.words}: {event.meaning}" for event in events),
        "A lap with any of these violates the guarantee; violating share: of such laps among all "
        f"that the law draws ({CONFIDENCE:.0%}, one-sided, Clopper-Pearson).",
        "active: share of the steps in which a constraint of the plan is active; shares of W and "
        "E: how far w and e went, 1 being the boundary of the set.",
    ]
    return "\n".join(lines)


def markdown(tested: list[DesignUnderTest]) -> str:
    """Return the same tables in Markdown."""
    parts = [say_verdict(tested), *map(describe_outcome, tested), _claims_in_markdown(tested)]
    parts += [_laws_in_markdown(design) for design in tested]
    parts += [legend(tested), *_notes(tested)]
    return "\n\n".join(parts) + "\n"


def _claims_in_markdown(tested: list[DesignUnderTest]) -> str:
    head = ["claim"]
    for design in tested:
        head += [f"{design.name}: {heading}" for heading in HEADINGS]
    rows = []
    for claim in list_claims(tested):
        row = [claim.title]
        for design in tested:
            row += cells(claim, design)
        rows.append(row)
    by_total = zip(*map(totals, tested), strict=True)
    for title, words in zip(TOTALS, by_total, strict=True):
        row = [title]
        for cell in words:
            row += ["", "", cell]
        rows.append(row)
    return _format_markdown(head, rows)


def _laws_in_markdown(design: DesignUnderTest) -> str:
    counted = list_violations([design])
    events = [find_event(name).words for name in counted]
    rows = []
    for name, law in design.laws.items():
        rows.append(
            [name, f"{law['laps']:,}", *_event_cells(law, counted), *_usage_row(name, law)[1:]]
        )
    return _format_markdown([design.name, "laps", *events, *USAGES], rows)


def _format_markdown(head: list[str], rows: list[list[str]]) -> str:
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join(f"| {' | '.join(cell or '-' for cell in line)} |" for line in lines)
