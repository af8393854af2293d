"""The page of `montecarlo`: shares with exact bounds, quantiles, worst laps, what they assume."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from jaxtube.coordinates import COORDINATES
from jaxtube.experiments.montecarlo.report import findings, say_verdict
from jaxtube.experiments.run.design_page import certificate_section
from jaxtube.reporting.page import (
    Bar,
    Bars,
    Heading,
    Interval,
    Intervals,
    Listing,
    Page,
    Section,
    Table,
    Words,
)
from jaxtube.statistics.events import EVENTS, VIOLATIONS
from jaxtube.synthesis.parts import Design

SETS = {"error": "E", "disturbance": "W", "tube": "tube"}
"""By the name of what is ranked."""
QUANTILES = {"median": "median", "p999": "99.9 %"}
"""Those that are told, in words."""


def make_page(design: Design, summary: dict, player: Mapping[str, Any]) -> Page:
    """Return the page of a run.

    Args:
        design: that its laps were checked against.
        summary: of its statistics.
        player: laps to play.
    """
    happened = [event.name for event in EVENTS if _count(summary, event.name)]
    confidence = f"{summary['confidence']:.0%}"
    law = f"Bounds hold for laps drawn by this law alone, seed and numbers apart: {summary['law']}"
    sections = [
        Section(
            "What happened",
            [
                Listing([line.strip() for line in findings(summary).split("\n")[1:]]),
                _draw_events(summary, confidence),
                _list_events(summary, confidence),
            ],
        ),
        Section("How large errors were", [_quantiles(design, summary), _worst(summary)]),
        certificate_section(design.certificate),
    ]
    is_good = not set(happened) & set(VIOLATIONS)
    return Page(
        say_verdict(summary),
        "good" if is_good else "bad",
        [f"Certificate of the design: {summary['certificate']}."],
        sections,
        [law, *design.certificate.assumptions],
        player,
        "Bounds and certificate take this for granted, and say nothing of laps or robots for which "
        "it is not so:",
    )


def _count(summary: dict, event: str) -> int:
    return summary["events"].get(event, {"laps": 0})["laps"]


def _draw_events(summary: dict, confidence: str) -> Intervals:
    """Return the shares of laps with each event, on one axis."""
    rows = []
    for event in EVENTS:
        if event.name not in summary["events"] or event.part:
            continue
        numbers = summary["events"][event.name]
        low, high = numbers["share_of_laps_interval"]
        share = numbers["share_of_laps"]
        told = f"{low:.3g} to {high:.3g}" if numbers["laps"] else f"none: at most {high:.3g}"
        rows.append(Interval(event.words, told, share, low if share else 0.0, high))
    note = (
        "Dot: share of the laps in which the event occurred at least once; bar: exact interval "
        f"(Clopper-Pearson, {confidence} each). Logarithmic axis."
    )
    return Intervals("Share of laps", rows, note)


def _list_events(summary: dict, confidence: str) -> Table:
    headings = [
        Heading("event"),
        Heading("laps", True),
        Heading("share of steps", True),
        Heading(f"interval ({confidence})", True),
        Heading("what it means"),
    ]
    rows = []
    for event in EVENTS:
        if event.name not in summary["events"]:
            continue
        numbers = summary["events"][event.name]
        low, high = numbers["share_of_steps_interval"]
        between = f"{low:.3g} to {high:.3g}" if numbers["steps"] else f"at most {high:.3g}"
        is_bad = event.name in VIOLATIONS and numbers["laps"]
        laps = Words(f"{numbers['laps']:,}", "bad" if is_bad else "plain")
        rows.append([event.words, laps, f"{numbers['share_of_steps']:.3g}", between, event.meaning])
    return Table("Events", headings, rows)


def _quantiles(design: Design, summary: dict) -> Table:
    """Return quantiles over the laps of their largest and their RMS error, by coordinate."""
    kinds = {
        "largest": summary["peak_error"],
        f"RMS from {summary['settled_s']:.3g} s on": summary["rms_error_settled"],
    }
    headings = [Heading("error of a lap")]
    for kind in kinds:
        headings += [Heading(f"{kind}, {words}", True) for words in QUANTILES.values()]
    headings.append(Heading("limit", True))
    limits = design.problem.error_set.support(np.eye(3))
    rows = []
    for coordinate, limit in zip(COORDINATES, limits, strict=True):
        values = [
            f"{by_quantile[name][coordinate.key]:.3g}"
            for by_quantile in kinds.values()
            for name in QUANTILES
        ]
        label = f"{coordinate.symbol} [{coordinate.unit}]"
        rows.append([label, *values, f"{limit * coordinate.to_display:.3g}"])
    note = "Quantiles are read off buckets and up to 12 % too large or too small."
    return Table("", headings, rows, note)


def _worst(summary: dict) -> Bars:
    """Return the laps that used most of each set."""
    bars = [
        Bar(f"{of_set}, lap {entry['lap']:,}", entry["usage"], f"{entry['usage']:.2%}")
        for name, of_set in SETS.items()
        for entry in summary["worst"][name][:3]
    ]
    return Bars(
        "Laps that used most of a set",
        bars,
        "The dashed line is the boundary. `montecarlo --replay LAP` draws a lap again.",
    )
