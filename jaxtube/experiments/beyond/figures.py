"""The figure of `beyond`: what laps use of E and of W as a robot grows imperfect."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from jaxtube.experiments.figures.style import (
    LIMIT,
    Line,
    bottom_legend,
    line_keys,
    mark_key,
    page_figure,
    styled,
)

COORDINATES = (
    Line("$e_x$ of $\\mathcal{E}$", "#0072B2"),
    Line("$e_y$ of $\\mathcal{E}$", "#009E73", (0, (4, 1.5))),
    Line("$e_\\theta$ of $\\mathcal{E}$", "#CC79A7", (0, (3, 1, 1, 1))),
)
DISTURBANCE = Line("$w$ of $\\mathcal{W}$", "#E69F00", (0, (1, 1)))
FAILED = {"marker": "x", "markersize": 5, "color": "#D55E00", "linestyle": "none"}
HIGHEST = 2.0
"""Usage up to which is drawn: what lies far outside says nothing more."""


class Panel(NamedTuple):
    """What one panel shows: usages by level, 1 on the limit; `violation` is the first level with
    one."""

    title: str
    unit: str
    whole: bool  # levels are whole numbers
    levels: Float[np.ndarray, " levels"]  # increasing, from 0
    error: Float[np.ndarray, "levels 3"]  # of E, by coordinate
    disturbance: Float[np.ndarray, " levels"]  # of W
    violation: float | None


@styled
def usages(shown: Sequence[Panel]) -> Figure:
    """Draw usages by level, one panel an imperfection; a cross marks the first violation."""
    figure = page_figure(4.2)
    panels = figure.subplots(2, (len(shown) + 1) // 2, sharey=True, squeeze=False)
    for axes, panel in zip(panels.flat, shown, strict=False):
        _draw(axes, panel)
    for axes in panels[:, 0]:
        axes.set_ylabel("greatest usage")
    for axes in panels.flat[len(shown) :]:
        axes.set_axis_off()
    keys = [*line_keys((*COORDINATES, DISTURBANCE)), mark_key("first violation", **_mark())]
    bottom_legend(figure, keys, columns=5)
    return figure


def _draw(axes: Axes, panel: Panel) -> None:
    curves = [*panel.error.T, panel.disturbance]
    for values, line in zip(curves, (*COORDINATES, DISTURBANCE), strict=True):
        axes.plot(panel.levels, values, color=line.colour, linestyle=line.dashes)
    axes.axhline(1.0, **LIMIT)
    if panel.violation is not None:
        axes.plot([panel.violation], [1.0], **FAILED, zorder=3)
    axes.set(title=panel.title, xlabel=f"level [{panel.unit}]", ylim=(0, HIGHEST))
    if not panel.whole and len(panel.levels) > 1:
        linear = 4 * panel.levels[1]
        axes.set_xscale("symlog", linthresh=linear, linscale=0.6)
        axes.set_xticks([0.0, *(10.0**power for power in range(-4, 3) if 10.0**power >= linear)])
    if len(panel.levels) > 1:
        axes.set_xlim(0, panel.levels[-1])


def _mark() -> dict:
    return {"colour": FAILED["color"], "marker": FAILED["marker"]}
