"""The page of `guarantee`: claims of two designs side by side, and the laps that attacked them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from jaxtube.experiments.guarantee.claims import (
    PREMISE,
    DesignUnderTest,
    bound_violating_share,
    judge_claim,
    list_claims,
    list_violations,
)
from jaxtube.experiments.guarantee.report import (
    TOTALS,
    cells,
    describe_outcome,
    legend,
    say_verdict,
    totals,
)
from jaxtube.experiments.run.design_page import certificate_section
from jaxtube.reporting.page import (
    Bar,
    Bars,
    Cell,
    Heading,
    Interval,
    Intervals,
    Listing,
    Page,
    Part,
    Section,
    Table,
    Words,
)
from jaxtube.statistics.events import find_event
from jaxtube.statistics.intervals import CONFIDENCE

COUNTED = ("w_outside_W", "e_outside_E")
"""Events whose shares are drawn."""


def make_page(tested: list[DesignUnderTest], player: Mapping[str, Any]) -> Page:
    """Return the page of a run.

    Args:
        tested: the other design, then the one that is put to the test.
        player: laps to play.
    """
    *_, first = tested
    refuted = [claim for claim in list_claims([first]) if _is_refuted(claim, first)]
    is_good = first.certificate.holds_for_robot and not refuted
    designs = list(reversed(tested))
    sections = [
        Section("Claims", [_claim_table(designs), _totals_table(designs)]),
        *(Section(f"Laps of {design.name}", _describe_laps(design)) for design in designs),
        *(_certificate_section(design) for design in designs),
        Section("What the words mean", [Listing(legend(tested).split("\n"))]),
    ]
    return Page(
        say_verdict(tested),
        "good" if is_good else "bad",
        [f"{describe_outcome(design)}." for design in designs],
        sections,
        first.certificate.assumptions,
        player,
    )


def _certificate_section(design: DesignUnderTest) -> Section:
    return certificate_section(design.certificate)._replace(title=f"Certificate of {design.name}")


def _is_refuted(claim, design: DesignUnderTest) -> bool:
    seen = judge_claim(claim, design).seen
    return bool(seen and seen.seen)


def _claim_table(designs: list[DesignUnderTest]) -> Table:
    headings = [Heading("claim")]
    for design in designs:
        headings += [Heading(f"{design.name}: {words}") for words in ("claimed", "proved", "seen")]
    rows = []
    for claim in list_claims(designs):
        row: list[Cell] = [claim.title]
        for design in designs:
            claimed, proved, seen = cells(claim, design)
            is_certified = judge_claim(claim, design).certified
            row += [
                claimed,
                Words(proved, "good" if is_certified else "bad"),
                Words(seen or "-", "bad" if _is_refuted(claim, design) else "plain"),
            ]
        rows.append(row)
    note = (
        "Proved: by the certificate. Seen: how often laps refuted it; laps prove nothing. "
        f"What rests on the robot needs {', '.join(PREMISE).replace('_', ' ')}."
    )
    return Table("", headings, rows, note)


def _totals_table(designs: list[DesignUnderTest]) -> Table:
    by_total = zip(*map(totals, designs), strict=True)
    rows = [[title, *words] for title, words in zip(TOTALS, by_total, strict=True)]
    headings = [Heading("attack"), *(Heading(design.name) for design in designs)]
    return Table("", headings, rows)


def _describe_laps(design: DesignUnderTest) -> list[Part]:
    """Return what laps of each law came to: how far they went, and how often they left W and E."""
    uses = [
        Bar(f"{of_set}, {name}", usage, f"{usage:.1%} of {of_set}")
        for kind, of_set in (("disturbance", "W"), ("error", "E"))
        for name, law in design.laws.items()
        for usage in [law["worst"][kind][0]["usage"]]
    ]
    parts: list[Part] = [
        Bars("Worst lap of each law", uses, "The dashed line is the boundary of the set.")
    ]
    for event in COUNTED:
        rows = [_make_interval(name, law["events"][event]) for name, law in design.laws.items()]
        words = find_event(event).words
        note = f"Exact intervals (Clopper-Pearson, {CONFIDENCE:.0%}), one law each."
        parts.append(Intervals(f"Share of laps with {words}", rows, note))
    parts.append(_event_table(design))
    if design.note:
        parts.append(Listing(design.note.split("\n"), bulleted=False))
    return parts


def _make_interval(name: str, numbers: dict) -> Interval:
    low, high = numbers["share_of_laps_interval"]
    share = numbers["share_of_laps"]
    told = f"{low:.3g} to {high:.3g}" if numbers["laps"] else f"none: at most {high:.3g}"
    return Interval(name, told, share, low if share else 0.0, high)


def _event_table(design: DesignUnderTest) -> Table:
    counted = list_violations([design])
    headings = [Heading("law"), Heading("laps", True)]
    headings += [Heading(find_event(event).words, True) for event in counted]
    headings.append(Heading("violating share at most", True))
    rows = []
    for name, law in design.laws.items():
        row: list[Cell] = [name, f"{law['laps']:,}"]
        for event in counted:
            laps = law["events"][event]["laps"]
            row.append(Words(f"{laps:,}", "bad" if laps else "plain"))
        rows.append([*row, f"{bound_violating_share(law):.3g}"])
    return Table("Laps with each event", headings, rows)
