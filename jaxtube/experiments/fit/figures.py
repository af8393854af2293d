"""The figure of `fit`: how the tube fills its caps towards the border, and the border by a second
quantity."""

from __future__ import annotations

import itertools
from typing import Any

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter

from jaxtube.experiments.fit.attempts import Fit
from jaxtube.figures.style import (
    INSIDE,
    LIMIT,
    OUTSIDE,
    bottom_legend,
    line_key,
    mark_key,
    page_figure,
    styled,
)
from jaxtube.scenario.tree import Scenario
from jaxtube.synthesis.attempt import Attempt

SHAPES = ("o", "^", "D", "v", "P", "X")
"""Marks of attempts, by what binds there; the last one for all others."""
MARK: dict[str, Any] = {"markersize": 4.5, "linestyle": "none", "zorder": 3}
CERTIFIED = {**MARK, "color": INSIDE}
DENIED = {**MARK, "color": OUTSIDE, "markerfacecolor": "white"}
OWN = {**MARK, "marker": "o", "markersize": 10, "markerfacecolor": "none", "color": "0.15"}
HIGHEST = 2.0
"""Share up to which is drawn, where the least one is not near it or above."""
ABOVE_LEAST = 1.2
"""Times the least share up to which is drawn at least."""


@styled
def frontier(scenario: Scenario, found: Fit) -> Figure:
    """Draw the shares of the caps by the fitted quantity, and its border by the second one."""
    figure = page_figure(3.2)
    panels = figure.subplots(1, 1 if found.second is None else 2, squeeze=False)[0]
    shapes = _choose_shapes(found)
    _draw_shares(panels[0], scenario, found, shapes)
    keys: list[Artist] = [
        mark_key("certified", INSIDE, marker="s"),
        mark_key("not certified", OUTSIDE, marker="s", markerfacecolor="white"),
        mark_key("the scenario", "0.15", markersize=8, markerfacecolor="none"),
        line_key("caps filled", **LIMIT),
    ]
    if found.second is not None:
        _draw_frontier(panels[1], scenario, found, shapes)
    keys += [mark_key(f"{row} binds", "0.5", marker=shape) for row, shape in shapes.items()]
    bottom_legend(figure, keys, columns=4)
    return figure


def _choose_shapes(found: Fit) -> dict[str, str]:
    """Return a mark for each row that binds somewhere."""
    attempts = [*found.border.attempts, *(point.attempt for point in found.frontier)]
    rows = dict.fromkeys(each.binding for each in attempts if each is not None and each.binding)
    return dict(zip(rows, itertools.chain(SHAPES, itertools.repeat(SHAPES[-1])), strict=False))


def _draw_shares(axes: Axes, scenario: Scenario, found: Fit, shapes: dict[str, str]) -> None:
    attempts = [attempt for attempt in found.border.attempts if attempt.value is not None]
    values = np.array([attempt.value for attempt in attempts], float)
    ratios = np.array([attempt.ratio for attempt in attempts], float)
    known = np.isfinite(ratios)
    order = np.argsort(values[known])
    axes.plot(values[known][order], ratios[known][order], color="0.6", linewidth=0.8)
    highest = max(HIGHEST, ABOVE_LEAST * np.min(ratios[known], initial=np.inf))
    top = min(highest, 1.08 * np.max(ratios[known], initial=1.0))
    # Larger ones, and where no caps keep the limits: at the upper edge.
    heights = np.fmin(ratios, top)
    heights[~known] = top
    for value, height, attempt in zip(values, heights, attempts, strict=True):
        axes.plot(value, height, **_look(attempt, shapes), clip_on=False)
    own = values == found.lever.measure(scenario)
    axes.plot(values[own], heights[own], **OWN, clip_on=False)
    axes.axhline(1.0, **LIMIT)
    axes.set(title="(a) the tube of the best design found", xlabel=found.lever.label)
    axes.set_ylabel("largest share of a cap")
    axes.set_ylim(0, top)
    axes.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{100 * value:g} %"))


def _draw_frontier(axes: Axes, scenario: Scenario, found: Fit, shapes: dict[str, str]) -> None:
    assert found.second is not None
    held = [(point.value, point.attempt) for point in found.frontier if point.attempt is not None]
    seconds = np.array([value for value, _ in held])
    values = np.array([attempt.value for _, attempt in held], float)
    own = found.lever.measure(scenario)
    top = 1.15 * max(values.max(), own)
    is_upper = found.lever.easier < 0
    axes.plot(seconds, values, color=INSIDE, linewidth=0.8)
    for second, value, (_, attempt) in zip(seconds, values, held, strict=True):
        axes.plot(second, value, **_look(attempt, shapes))
    for point in found.frontier:
        if point.attempt is None:
            edge = 0.0 if is_upper else top
            axes.plot(point.value, edge, **DENIED, marker="s", clip_on=False)
    axes.plot(found.second.measure(scenario), own, **OWN)
    axes.set(title="(b) the border found", xlabel=found.second.label, ylabel=found.lever.label)
    axes.set_ylim(0, top)


def _look(attempt: Attempt, shapes: dict[str, str]) -> dict[str, Any]:
    look = CERTIFIED if attempt.holds else DENIED
    return {**look, "marker": shapes.get(attempt.binding, SHAPES[-1])}
