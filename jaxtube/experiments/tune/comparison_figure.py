"""The figure of designs on references that tuning never saw: mean errors with their intervals."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from jaxtube.experiments.tune.figures import AFTER, BEFORE
from jaxtube.figures.style import LABEL_SIZE, page_figure, styled
from jaxtube.figures.ticks import plain_ticks, spans_decade
from jaxtube.statistics.intervals import CONFIDENCE

TUNED: dict[str, Any] = {"color": AFTER.colour, "marker": "o", "markersize": 6}
OTHERS: tuple[dict[str, Any], ...] = (
    {"color": BEFORE.colour, "marker": "D", "markersize": 4.5},
    {"color": "#E69F00", "marker": "s", "markersize": 4.5},
    {"color": "#009E73", "marker": "^", "markersize": 4.5},
    {"color": "#CC79A7", "marker": "v", "markersize": 4.5},
    {"color": "#56B4E9", "marker": "P", "markersize": 4.5},
)
"""Looks of compared designs, the last of which is drawn as tuned."""
ROW = 0.19
HEADING = 0.24
"""Heights of a design's and of a reference's row, inches."""


class ComparedRow(NamedTuple):
    """One design on one reference: mean of the lateral RMS and the ends of its interval, m."""

    reference: str
    design: str
    mean: float
    low: float
    high: float


@styled
def comparison_figure(rows: Sequence[tuple[str, str, float, float, float]]) -> Figure:
    """Draw mean lateral errors with their intervals, reference by reference.

    Args:
        rows: as in `ComparedRow`; the design met last is drawn as the tuned one.
    """
    every = [ComparedRow(*row) for row in rows]
    references = list(dict.fromkeys(row.reference for row in every))
    looks = _choose_looks(list(dict.fromkeys(row.design for row in every)))
    figure = page_figure(0.65 + HEADING * len(references) + ROW * len(rows))
    axes = figure.subplots()
    place = 0.0
    places = []
    for reference in references:
        place += HEADING
        _write_beside(axes, -0.012, place, reference, ha="right", weight="bold")
        for row in every:
            if row.reference == reference:
                place += ROW
                places.append((place, row.design))
                _draw_row(axes, place, row, looks[row.design])
    ticks, names = zip(*places, strict=True)
    axes.set_yticks(ticks, names)
    axes.tick_params(axis="y", length=0)
    axes.grid(False, axis="y")
    axes.set(ylim=(place + ROW, HEADING / 2))
    axes.set_xlabel(f"lateral RMS once settled, {100 * CONFIDENCE:g} % interval [mm]")
    if spans_decade(np.array([row.mean for row in every])):
        axes.set_xscale("log")
        plain_ticks(axes.xaxis)
    else:
        axes.set_xlim(left=0)
    return figure


def _choose_looks(designs: list[str]) -> dict[str, dict[str, Any]]:
    looks = {design: OTHERS[i % len(OTHERS)] for i, design in enumerate(designs)}
    return {**looks, designs[-1]: TUNED}


def _draw_row(axes: Axes, place: float, row: ComparedRow, look: dict[str, Any]) -> None:
    """Draw and write the mean of a design with its interval, in mm."""
    mean = 1e3 * row.mean
    low = 1e3 * row.low
    high = 1e3 * row.high
    axes.plot(
        [low, high],
        [place, place],
        color=look["color"],
        linewidth=1.4,
        solid_capstyle="butt",
    )
    axes.plot(mean, place, **look)
    text = f"{_three_digits(mean)}  ({_three_digits(low)} to {_three_digits(high)})"
    _write_beside(axes, 1.015, place, text)


def _three_digits(value: float) -> str:
    return f"{value:#.3g}".rstrip(".")


def _write_beside(axes: Axes, x: float, place: float, text: str, **look: Any) -> None:
    """Write beside the panel, at a share of its width."""
    transform = axes.get_yaxis_transform()
    axes.text(
        x, place, text, transform=transform, va="center_baseline", fontsize=LABEL_SIZE, **look
    )
