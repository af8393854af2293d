"""What the command `falsify` reports of its search: the table and the metrics."""

from __future__ import annotations

from typing import Any

import numpy as np
from jaxtyping import Float

from jaxtube.experiments.run.design_page import certificate_section
from jaxtube.experiments.run.page_table import make_table
from jaxtube.experiments.run.table import Column, format_table, left, wrap
from jaxtube.falsification.cases import (
    Row,
    compute_certified_usage,
    describe_facet,
    list_worst_first,
)
from jaxtube.falsification.falsify import Falsification
from jaxtube.falsification.setting import LoopLimits
from jaxtube.plant.reference import TRANSIENT_S
from jaxtube.reporting.page import Bar, Bars, Page, Section

COLUMNS = (
    left("limit"),
    Column("certified"),
    Column("found\nusage"),
    Column("found\nmargin"),
    Column("found\nlaps"),
    Column("found\ntime", "s"),
    Column("drawn\nusage"),
    Column("drawn\nlaps"),
    left("where"),
)
NOTE = (
    "usage: 1 on the facet, above 1 outside; certified: what no lap can pass; found: by gradient, "
    "with the laps that were played with their derivative; drawn: the worst of laps that were "
    "drawn, as many as fit into the time of the search, or, for limits that one lap answers, into "
    "the sum of their times."
)

WIDEST = "Of the tube `sequence` only the plans with the widest window ahead were searched."


def report(falsification: Falsification) -> str:
    """Return the verdict and the table."""
    rows = falsification.rows
    lines = [say_verdict(falsification), *wrap(falsification.verdict, "  "), ""]
    lines += [format_table(COLUMNS, _list_rows(falsification)), "", *wrap(NOTE)]
    if "tube" in rows and falsification.design.tube.follows_reference:
        lines.append(WIDEST)
    return "\n".join(lines)


def say_verdict(falsification: Falsification) -> str:
    """Return one line: which limits are violated, and by how much at the worst."""
    rows = falsification.rows
    names = list_worst_first(rows)
    worst = rows[names[0]].worst
    facet = describe_facet(falsification.limits.all[names[0]], worst)
    violated = [name for name in names if rows[name].is_violated]
    if violated:
        size = f"{-facet.margin:.4g} {facet.unit}"
        return f"VIOLATED: {', '.join(violated)}; at the worst by {size} at step {worst.step}"
    return f"no violation found; smallest margin {facet.margin:.4g} {facet.unit} of `{names[0]}`"


def make_page(falsification: Falsification) -> Page:
    """Return the page of a search."""
    limits = falsification.limits
    uses = [
        Bar(name, row.worst.usage, f"{row.worst.usage:.1%} by gradient")
        for name, row in falsification.rows.items()
    ]
    uses += [
        Bar(f"{name}, drawn laps", row.sampled.usage(name), f"{row.sampled.usage(name):.1%}")
        for name, row in falsification.rows.items()
    ]
    is_violated = any(row.is_violated for row in falsification.rows.values())
    note = "The dashed line is the limit. What was not found may exist all the same."
    sections = [
        Section(
            "Worst cases",
            [
                Bars("What worst cases use of each limit", uses, note),
                make_table(COLUMNS, _list_rows(falsification), note=NOTE),
            ],
        ),
        certificate_section(limits.design.certificate),
    ]
    return Page(
        say_verdict(falsification),
        "bad" if is_violated else "good",
        [f"{falsification.verdict}."],
        sections=sections,
        not_covered=limits.design.certificate.assumptions,
    )


def _list_rows(falsification: Falsification) -> list[list[str]]:
    limits = falsification.limits
    return [_make_line(limits, name, row) for name, row in falsification.rows.items()]


def _make_line(limits: LoopLimits, name: str, row: Row) -> list[str]:
    facet = describe_facet(limits.all[name], row.worst)
    certified = compute_certified_usage(limits, name)
    return [
        name,
        f"<= {certified:.4f}" if np.isfinite(certified) else "nothing",
        f"{row.worst.usage:.4f}",
        f"{facet.margin:.4g} {facet.unit}",
        f"{row.search.laps:,}",
        f"{row.search.seconds:.1f}",
        f"{row.sampled.usage(name):.4f}",
        f"{row.sampled.laps:,}",
        f"step {row.worst.step}, {facet.words}",
    ]


def metrics(falsification: Falsification) -> dict[str, Any]:
    """Return the numbers of the search."""
    measured = {
        name: _measure_row(falsification.limits, name, row)
        for name, row in falsification.rows.items()
    }
    return {"limits": measured, "violation": falsification.is_violated}


def _measure_row(limits: LoopLimits, name: str, row: Row) -> dict[str, Any]:
    facet = describe_facet(limits.all[name], row.worst)
    numbers: dict[str, Any] = {
        "violation": row.is_violated,
        "facet": facet.words,
        "step": row.worst.step,
        "margin": facet.margin,
        "margin_unit": facet.unit,
        "usage": row.worst.usage,
        "certified_usage": compute_certified_usage(limits, name),
        "seconds": row.search.seconds,
        "laps": row.search.laps,
        "drawn_usage": row.sampled.usage(name),
        "drawn_laps": row.sampled.laps,
        "drawn_seconds": row.sampled.seconds,
    }
    if name == "tube":
        return numbers
    settled = round(TRANSIENT_S / limits.design.problem.reference.dt)
    of_search = _measure_facets("", row.search.reach[name], settled)
    of_draws = _measure_facets("drawn_", row.sampled.reach[name], settled)
    return numbers | of_search | of_draws


def _measure_facets(
    which: str, reach: Float[np.ndarray, "steps facets"], settled: int
) -> dict[str, Any]:
    """Return the greatest usage of each facet, over the lap and once it has settled."""
    first = min(settled, len(reach) - 1)
    return {
        f"{which}usage_by_facet": reach.max(axis=0),
        f"{which}usage_by_facet_after_10_s": reach[first:].max(axis=0),
    }
