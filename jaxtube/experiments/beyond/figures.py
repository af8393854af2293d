"""The figure of `beyond`: what laps use of E and of W as a robot grows imperfect."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, MaxNLocator, NullLocator

from jaxtube.coordinates import COORDINATES
from jaxtube.figures.style import (
    LIMIT,
    OUTSIDE,
    Line,
    bottom_legend,
    draw_line,
    line_key,
    line_keys,
    mark_key,
    page_figure,
    styled,
)

LOOKS = (("#0072B2", "-"), ("#009E73", (0, (4, 1.5))), ("#CC79A7", (0, (3, 1, 1, 1))))
ERRORS = tuple(
    Line(f"${coordinate.error}$, of $\\mathcal{{E}}$", *look)
    for coordinate, look in zip(COORDINATES, LOOKS, strict=True)
)
DISTURBANCE = Line("$w$, of $\\mathcal{W}$", "#E69F00", (0, (1, 1)))
FAILED = {"marker": "x", "markersize": 5}
HIGHEST = 2.0
"""Usage up to which is drawn: what lies far outside says nothing more."""

LEVELS = {
    "lag": "time constant of the wheels [s]",
    "delay": "delay of commands [periods]",
    "sluggishness": "1 / greatest acceleration [s²/m]",
    "sideslip": "sideways by forward speed [–]",
    "slip_change": "share of the last slip error that lasts [–]",
    "preview": "shift of the reference [periods]",
}
"""What the levels of an imperfection are, with their unit."""


class Panel(NamedTuple):
    """What one panel shows: usages by level, 1 on the limit; `violation` is the first level with
    one."""

    name: str  # of the imperfection, a key of LEVELS
    title: str
    whole: bool  # levels are whole numbers
    levels: Float[np.ndarray, " levels"]  # increasing, from 0
    error: Float[np.ndarray, "levels 3"]  # of E, by coordinate
    disturbance: Float[np.ndarray, " levels"]  # of W
    violation: float | None


@styled
def usages(shown: Sequence[Panel]) -> Figure:
    """Draw usages by level, one panel an imperfection; a cross marks the first violation."""
    figure = page_figure(4.4)
    panels = figure.subplots(2, (len(shown) + 1) // 2, sharey=True, squeeze=False)
    for axes, panel in zip(panels.flat, shown, strict=False):
        _draw_panel(axes, panel)
    for axes in panels[:, 0]:
        axes.set_ylabel("largest share of a limit used")
    for axes in panels.flat[len(shown) :]:
        axes.set_axis_off()
    keys = [
        *line_keys((*ERRORS, DISTURBANCE)),
        line_key("the limit", **LIMIT),
        mark_key("first violation", OUTSIDE, **FAILED),
    ]
    bottom_legend(figure, keys, columns=6)
    return figure


def _draw_panel(axes: Axes, panel: Panel) -> None:
    for values, line in zip(panel.error.T, ERRORS, strict=True):
        draw_line(axes, panel.levels, values, line)
    draw_line(axes, panel.levels, panel.disturbance, DISTURBANCE)
    axes.axhline(1.0, **LIMIT)
    if panel.violation is not None:
        axes.plot([panel.violation], [1.0], color=OUTSIDE, linestyle="none", zorder=3, **FAILED)
    axes.set(title=panel.title, xlabel=LEVELS[panel.name], ylim=(0, HIGHEST))
    axes.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{100 * value:g} %"))
    if len(panel.levels) > 1:
        _scale_levels(axes, panel)


def _scale_levels(axes: Axes, panel: Panel) -> None:
    """Show whole levels as they are, others in powers of ten from a few times the least one on."""
    greatest = panel.levels[-1]
    if panel.whole:
        axes.xaxis.set_major_locator(MaxNLocator(integer=True))
    else:
        linear = 4 * panel.levels[1]
        axes.set_xscale("symlog", linthresh=linear, linscale=0.6)
        decades = np.arange(np.floor(np.log10(linear)), np.log10(greatest) + 1)
        ticks = np.sort(np.concatenate([10.0**decades, 3 * 10.0**decades]))
        shown = ticks[(ticks >= 1.5 * linear) & (ticks <= greatest)]
        axes.set_xticks([0.0, *shown])
        axes.xaxis.set_minor_locator(NullLocator())
        axes.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axes.set_xlim(0, greatest)
