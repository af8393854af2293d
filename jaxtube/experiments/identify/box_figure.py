"""The figure of where the box comes from: slips of both wheels, sideslip, and who made each side.

A line joins the windows of one command; a side is marked at the window that fixes it.
"""

from __future__ import annotations

import math

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from jaxtube.experiments.identify.figures import LEFT, RIGHT, SIDE, SIZE
from jaxtube.figures.style import (
    LIMIT,
    LIMIT_EDGE,
    OUTSIDE,
    Line,
    bottom_legend,
    line_key,
    line_keys,
    mark_key,
    page_figure,
    styled,
)
from jaxtube.identification.box import Box
from jaxtube.identification.identify import Identified

ROUNDING = 1e-9
"""By which a window may miss a side that it fixes."""

COUNTED = "#0072B2"
GROWN = (Line("right wheel", RIGHT), Line("left wheel", LEFT), Line("sideslip", SIDE))


@styled
def where_from(identified: Identified) -> Figure:
    """Draw the slips of the windows in the box, and the extremes of each command against its
    place in the sample."""
    figure = page_figure(3.7)
    plane, side = figure.subplots(1, 2, width_ratios=(1.15, 1))
    _draw_plane(plane, identified)
    _draw_growth(side, identified)
    keys = [
        line_key(
            "windows of one command", color=COUNTED, marker="o", markersize=SIZE, linewidth=0.7
        ),
        mark_key("fits the track", "0.35", markerfacecolor="white", markersize=SIZE),
        mark_key("fixes a side", OUTSIDE, marker="o", markerfacecolor="none", markersize=7),
        line_key("box", **LIMIT),
        *line_keys(GROWN),
    ]
    bottom_legend(figure, keys, columns=4)
    return figure


def _draw_plane(axes: Axes, identified: Identified) -> None:
    slips = 100 * identified.slips
    command = identified.windows.command
    fits = slips[identified.fits]
    axes.plot(
        fits[:, 0],
        fits[:, 1],
        linestyle="none",
        marker="o",
        markersize=SIZE,
        markeredgewidth=0.6,
        markerfacecolor="white",
        markeredgecolor="0.35",
    )
    for name in np.unique(command[identified.counts]):
        own = slips[identified.counts & (command == name)]
        axes.plot(
            own[:, 0],
            own[:, 1],
            color=COUNTED,
            marker="o",
            markersize=SIZE,
            linewidth=0.7,
            alpha=0.8,
        )
    _draw_box(axes, identified.box, LIMIT_EDGE)
    if identified.choices.margin:
        _draw_box(axes, identified.widened_box, {**LIMIT_EDGE, "edgecolor": "0.6"})
    for point in _find_fixing(identified):
        axes.plot(
            100 * point[0],
            100 * point[1],
            marker="o",
            markersize=8,
            markerfacecolor="none",
            markeredgecolor=OUTSIDE,
        )
    axes.set(
        xlabel="slip of the right wheel [%]", ylabel="slip of the left wheel [%]", title="(a) slips"
    )


def _draw_box(axes: Axes, box: Box, look: dict) -> None:
    corner = (100 * box.right[0], 100 * box.left[0])
    width = 100 * (box.right[1] - box.right[0])
    height = 100 * (box.left[1] - box.left[0])
    axes.add_patch(Rectangle(corner, width, height, facecolor="none", zorder=3, **look))


def _find_fixing(identified: Identified) -> list[Float[np.ndarray, "2"]]:
    """Return the slips of the windows that lie on a side of the box."""
    slips = identified.slips[identified.counts]
    box = identified.box
    ends = np.array([box.right, box.left])
    on_side = np.abs(slips[:, :, None] - ends) <= ROUNDING
    return list(slips[on_side.any(axis=(1, 2))])


def _draw_growth(axes: Axes, identified: Identified) -> None:
    """Draw how the box grew, command by command, in per cent of its final widths."""
    command = identified.windows.command
    counts = identified.counts
    names = np.unique(command[counts])
    slips = identified.slips[counts]
    own = command[counts]
    least = np.array([slips[own == name].min(axis=0) for name in names])
    greatest = np.array([slips[own == name].max(axis=0) for name in names])
    side = np.array([np.abs(identified.sideslips[counts][own == name]).max() for name in names])
    grown_least = np.minimum.accumulate(least)
    grown_greatest = np.maximum.accumulate(greatest)
    x = np.arange(1, len(names) + 1)
    for column, line in enumerate(GROWN[:2]):
        for extremes in (grown_least, grown_greatest):
            axes.step(x, 100 * extremes[:, column], color=line.colour, where="mid")
    axes.step(x, 100 * np.maximum.accumulate(side), color=GROWN[2].colour, where="mid")
    promised = math.floor(100 * identified.promise.share)
    axes.set(
        xlabel="commands counted, in order of time",
        ylabel="extremes so far [%]",
        title=f"(b) growth; promised: {promised} % of new commands",
    )
