"""The verdict of a Monte Carlo run as a figure: shares of what must not happen, with intervals."""

from __future__ import annotations

import re
from typing import NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from jaxtube.figures.style import (
    INSIDE,
    OUTSIDE,
    bottom_legend,
    line_key,
    mark_key,
    page_figure,
    styled,
)
from jaxtube.statistics.events import VIOLATIONS, find_event
from jaxtube.statistics.intervals import share_interval

STAGES = 5
"""Stages of the tube listed with the shares."""
LARGEST_RUN = 1e9
"""Laps up to which the figure says what a run without violation proves."""

LOOKS = {
    "laps": {"marker": "o", "color": INSIDE, "markersize": 5},
    "steps": {"marker": "D", "color": OUTSIDE, "markersize": 4},
    "plans": {"marker": "s", "color": "#009E73", "markersize": 4.5},
}
ARROW = 6
"""Length of an arrow below a bound, as a ratio of shares."""
OFFSET = 0.17
"""Distance of a share from the middle of its row, where the row has two."""


class DrawnShare(NamedTuple):
    """A share with its interval."""

    value: float
    low: float
    high: float


class DrawnRow(NamedTuple):
    """One line of the chart: what is counted and how often it was seen, and the shares."""

    label: str
    shares: dict[str, DrawnShare]


def share_rows(summary: dict) -> list[DrawnRow]:
    """Return what the chart of shares lists: W and E, stages of the tube in use, then the other
    events."""
    events = [_event_row(summary, name) for name in VIOLATIONS if name in summary["events"]]
    return [*events[:2], *_stage_rows(summary), *events[2:]]


def _event_row(summary: dict, name: str) -> DrawnRow:
    event = summary["events"][name]
    return DrawnRow(f"{typeset_event(name)}: {event['laps']:,} laps", make_shares(event))


def typeset_event(name: str) -> str:
    """Return the words of an event; as LaTeX those of a vector and its set, as in `w outside W`."""
    words = find_event(name).words
    return re.sub(r"^(\w) outside (\w)$", r"$\1$ outside $\\mathcal{\2}$", words)


def make_shares(event: dict) -> dict[str, DrawnShare]:
    """Return the shares of laps and of steps with an event, with their intervals."""
    return {
        kind: DrawnShare(event[f"share_of_{kind}"], *event[f"share_of_{kind}_interval"])
        for kind in ("laps", "steps")
    }


def _stage_rows(summary: dict) -> list[DrawnRow]:
    if not summary["plans"]:
        return []
    tube = summary["tube"]
    outside = [stage["outside"] for stage in tube["stages"]]
    counts = tube["plans_outside_by_stage"][tube["used"]]
    listed = np.linspace(1, len(outside), min(len(outside), STAGES)).round().astype(int)
    rows = []
    for j in np.unique(listed):
        share = DrawnShare(outside[j - 1]["share"], *outside[j - 1]["interval"])
        rows.append(DrawnRow(f"outside $R_{{{j}}}$: {counts[j - 1]:,} plans", {"plans": share}))
    return rows


@styled
def violations(summary: dict) -> Figure:
    """Draw how often what must not happen did, with intervals, and what a run without it proves by
    its length.

    Events that a run of this kind cannot have are not in its summary.
    """
    rows = share_rows(summary)
    figure = page_figure(1.4 + 0.27 * len(rows))
    chart, proof = figure.subplots(1, 2, width_ratios=(1.9, 1))
    draw_shares(chart, rows)
    _draw_proof(proof, summary)
    bottom_legend(figure, share_keys(rows, summary["confidence"]), columns=4)
    return figure


def draw_shares(axes: Axes, rows: list[DrawnRow]) -> None:
    """Draw the shares of all rows on a logarithmic axis."""
    for place, row in enumerate(rows):
        offsets = (-OFFSET, OFFSET) if len(row.shares) > 1 else (0.0,)
        for offset, (kind, share) in zip(offsets, row.shares.items(), strict=True):
            _draw_share(axes, place + offset, share, kind)
    axes.set_yticks(range(len(rows)), [row.label for row in rows])
    axes.set(
        xscale="log", xlim=(find_least(rows), 1.6), ylim=(len(rows) - 0.5, -0.5), xlabel="share"
    )
    axes.grid(False, axis="y")


def find_least(rows: list[DrawnRow]) -> float:
    """Return where the axis of shares begins: below every dot and every arrow."""
    shares = [share for row in rows for share in row.shares.values()]
    return min(share.value or share.high / ARROW for share in shares) / 3


def share_keys(rows: list[DrawnRow], confidence: float) -> list:
    """Return the legend's entries of the kinds of shares that occur, and of the intervals."""
    keys = [
        mark_key(f"share of {kind}", look["color"], **_without_colour(look))
        for kind, look in LOOKS.items()
        if any(kind in row.shares for row in rows)
    ]
    interval = f"{100 * confidence:g} % interval; arrow: at most, none seen"
    return [*keys, line_key(interval, color="0.35", linewidth=1.2)]


def _without_colour(look: dict) -> dict:
    return {key: value for key, value in look.items() if key != "color"}


def _draw_share(axes: Axes, place: float, share: DrawnShare, kind: str) -> None:
    """Draw a share with its interval, or, where nothing was seen, an arrow down from the bound."""
    look = LOOKS[kind]
    colour = look["color"]
    if share.value > 0:
        ends = [max(share.low, 1e-300), share.high]
        axes.plot(ends, [place, place], color=colour, linewidth=1.2)
        axes.plot(share.value, place, linestyle="none", **look)
        return
    axes.plot(share.high, place, marker="|", color=colour, markersize=6, markeredgewidth=1.2)
    arrow = {
        "arrowstyle": "-|>",
        "color": colour,
        "linewidth": 1.0,
        "shrinkA": 0,
        "shrinkB": 0,
    }
    axes.annotate("", (share.high / ARROW, place), (share.high, place), arrowprops=arrow)


def _draw_proof(axes: Axes, summary: dict) -> None:
    """Draw the largest share of laps that goes with none seen, by the number of laps, with this run
    marked."""
    confidence = summary["confidence"]
    most = max(LARGEST_RUN, 10 * summary["laps"])
    laps = np.unique(np.geomspace(1e2, most, 60).round().astype(int))
    bounds = [share_interval(0, count, confidence)[1] for count in laps]
    here = share_interval(0, summary["laps"], confidence)[1]
    axes.plot(laps, bounds, color="0.15")
    axes.plot(summary["laps"], here, **LOOKS["laps"])
    axes.annotate(
        f"this run: {summary['laps']:,} laps,\nat most {_power_of_ten(here)}",
        (0.96, 0.96),
        xycoords="axes fraction",
        ha="right",
        va="top",
        color=LOOKS["laps"]["color"],
    )
    axes.set(xscale="log", yscale="log")
    axes.set_xlabel("laps, none of them violating")
    axes.set_ylabel("share of laps, at most")


def _power_of_ten(value: float) -> str:
    """Write a small positive number as mathematics, such as 6.0 10^-5."""
    mantissa, exponent = f"{value:.1e}".split("e")
    return f"${mantissa} \\times 10^{{{int(exponent)}}}$"
