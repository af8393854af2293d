"""The figure of `beyond`: what laps use of E and of W as a robot grows imperfect."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from jaxtube.experiments.beyond import IMPERFECTIONS, Search
from jaxtube.experiments.style import LIMIT, Line, bottom_legend, line_keys, mark_key, page_figure, styled

COORDINATES = (
    Line("$e_x$ of $\\mathcal{E}$", "#0072B2"),
    Line("$e_y$ of $\\mathcal{E}$", "#009E73", (0, (4, 1.5))),
    Line("$e_\\theta$ of $\\mathcal{E}$", "#CC79A7", (0, (3, 1, 1, 1))),
)
DISTURBANCE = Line("$w$ of $\\mathcal{W}$", "#E69F00", (0, (1, 1)))
FAILED = {"marker": "x", "markersize": 5, "color": "#D55E00", "linestyle": "none"}
HIGHEST = 2.0
"""Usage up to which is drawn: what lies far outside says nothing more."""


@styled
def usages(searches: Mapping[str, Search]) -> Figure:
    """Draw the usage by level, one panel an imperfection; a cross marks the first violation, 1 is the limit."""
    figure = page_figure(4.2)
    panels = figure.subplots(2, (len(searches) + 1) // 2, sharey=True, squeeze=False)
    for axes, (name, search) in zip(panels.flat, searches.items(), strict=False):
        _panel(axes, name, search)
    for axes in panels[:, 0]:
        axes.set_ylabel("greatest usage")
    for axes in panels.flat[len(searches) :]:
        axes.set_axis_off()
    keys = [*line_keys((*COORDINATES, DISTURBANCE)), mark_key("first violation", **_mark())]
    bottom_legend(figure, keys, columns=5)
    return figure


def _panel(axes: Axes, name: str, search: Search) -> None:
    imperfection = IMPERFECTIONS[name]
    levels = np.array(list(search.usages))
    error = np.array([usage.error.max(axis=0) for usage in search.usages.values()])
    for values, line in zip(error.T, COORDINATES, strict=True):
        axes.plot(levels, values, color=line.colour, linestyle=line.dashes)
    disturbance = [usage.disturbance.max() for usage in search.usages.values()]
    axes.plot(levels, disturbance, color=DISTURBANCE.colour, linestyle=DISTURBANCE.dashes)
    axes.axhline(1.0, **LIMIT)
    if search.violation is not None:
        axes.plot([search.violation], [1.0], **FAILED, zorder=3)
    axes.set(title=imperfection.title, xlabel=f"level [{imperfection.unit}]", ylim=(0, HIGHEST))
    if not imperfection.whole:
        least = min(level for level in search.usages if level > 0)
        axes.set_xscale("symlog", linthresh=4 * least, linscale=0.6)
    axes.set_xlim(0, max(search.usages))


def _mark() -> dict:
    return {"colour": FAILED["color"], "marker": FAILED["marker"]}
