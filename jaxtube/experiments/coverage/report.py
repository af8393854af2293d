"""The report of `coverage`: one line, and a table by horizon."""

from __future__ import annotations

from jaxtube.experiments.coverage.measure import ROUNDS
from jaxtube.experiments.run.page_table import make_table
from jaxtube.experiments.run.table import Column, format_table, left
from jaxtube.reporting.page import Page, Section

COLUMNS = [
    Column("horizon"),
    Column("of the caps"),
    Column("coverage"),
    Column("rows"),
    Column("us a step"),
    left("certified"),
]


def write(sets: dict) -> str:
    """Return the report as text."""
    return f"{say_verdict(sets)}\n\n{format_table(COLUMNS, _list_rows(sets))}\n{say_what(sets)}"


def make_page(sets: dict) -> Page:
    """Return the report as a page."""
    table = make_table(COLUMNS, _list_rows(sets), note=say_what(sets))
    return Page(say_verdict(sets), sections=[Section("By horizon", [table])])


def say_verdict(sets: dict) -> str:
    """Return one line: the greatest certified coverage and its horizon."""
    certified = [
        record
        for record in sets["horizons"]
        if record["volume"] is not None and not record["failing"] and record["covered"] is not None
    ]
    if not certified:
        return "no horizon tried has a certified design whose coverage can be told"
    best = max(certified, key=lambda record: record["covered"])
    share = best["covered"] / sets["control_invariant"]["volume"]
    return (
        f"certified coverage: {share:.1%} of the largest control invariant set at horizon "
        f"{best['horizon']}"
    )


def say_what(sets: dict) -> str:
    """Return what the columns mean."""
    largest = sets["control_invariant"]
    share = largest["volume"] / sets["operating_volume"]
    state = "settled" if largest["settled"] else "NOT settled"
    windows = max((record.get("windows", 0) for record in sets["horizons"]), default=0)
    return (
        f"largest control invariant set C: {share:.1%} of the volume of the caps (outer bound, "
        f"{state}\nafter {largest['steps']} steps); coverage: what of C has a plan, least over "
        f"{windows} windows of the reference,\nby an inner bound; us a step: of the processor, "
        f"of laps\nside by side from all over the feasible set, the median of {ROUNDS} rounds\n"
        "C is for wheel speeds in any order; plans know those ahead, so that a feasible set may\n"
        "pass C, and what is beyond it does not count"
    )


def _list_rows(sets: dict) -> list[list[str]]:
    return [_write_row(record, sets) for record in sets["horizons"]]


def _write_row(record: dict, sets: dict) -> list[str]:
    horizon = str(record["horizon"])
    if record["volume"] is None:
        return [horizon, "none", "", "", "", record["reason"]]
    of_caps = f"{record['volume'] / sets['operating_volume']:.1%}"
    covered = record["covered"]
    coverage = "-" if covered is None else f"{covered / sets['control_invariant']['volume']:.1%}"
    time = f"{record['microseconds']:.3g}"
    certified = f"no: {', '.join(record['failing'])}" if record["failing"] else "yes"
    return [horizon, of_caps, coverage, str(record["rows"]), time, certified]
