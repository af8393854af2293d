"""The figures of `maps`: the ratio over slip error and speed range or period."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import BoundaryNorm, LinearSegmentedColormap
from matplotlib.figure import Figure

from jaxtube.experiments.maps.points import Grid, GuaranteeByPoint, Point
from jaxtube.figures.style import (
    bottom_legend,
    mark_key,
    page_figure,
    styled,
)
from jaxtube.synthesis.ratio import Guarantee

TITLES = {
    "paper": "(a) the paper's weights and model",
    "weighted": "(b) LMI, weights (1, 3, 1), 0.3",
    "optimised": "(c) optimised caps and gains",
}
AXES = {"slowest_mps": "lowest reference wheel speed [m/s]", "dt_s": "period $T$ [s]"}
LEVELS = (0.2, 0.35, 0.5, 0.65, 0.8, 1.0, 1.3, 1.8, 3.0, 5.0, 8.0)
"""Borders of the colours: blue below 1, orange above."""
COLOURS = LinearSegmentedColormap.from_list(
    "ratio", ["#0b3f78", "#2b7bba", "#d9e9f5", "#fde3cf", "#f2a268", "#a63f00"]
)
MARK: dict[str, Any] = {"marker": "o", "markersize": 3.5, "markeredgewidth": 0.7}
LOOKS: dict[str, dict[str, Any]] = {
    "guaranteed": {**MARK, "markerfacecolor": "black"},
    "not guaranteed": {**MARK, "markerfacecolor": "white"},
    "wheels too weak": {**MARK, "markerfacecolor": "white", "marker": "s"},
    "no design found": {**MARK, "marker": "x", "markersize": 5},
}
"""Marks of what became of a point."""
MOST_TICKS = 7
OWN = "the scenario"
OWN_LOOK = {**MARK, "markersize": 8, "markerfacecolor": "none", "markeredgewidth": 0.9}


@styled
def ratio_map(grid: Grid, found: GuaranteeByPoint, axis: str, slip_error: str) -> Figure:
    """Draw the ratio of the three designs over slip error and "slowest_mps" or "dt_s", a cell a
    point that was computed; `slip_error` says what that error is."""
    figure = page_figure(3.4)
    panels = figure.subplots(1, 3, sharex=True, sharey=True)
    norm = BoundaryNorm(LEVELS, COLOURS.N, extend="both")
    outcomes = set()
    for axes, (design, title) in zip(panels, TITLES.items(), strict=True):
        _draw_cells(axes, grid, ratio_table(grid, found, design, axis), axis, norm)
        outcomes |= _draw_marks(axes, grid, found, design, axis)
        axes.set(title=title, xlabel=f"{slip_error} [%]")
    panels[0].set_ylabel(AXES[axis])
    scale = ScalarMappable(norm, COLOURS)
    bar = figure.colorbar(scale, ax=panels, label="largest share of a cap", pad=0.015)
    bar.set_ticks(list(LEVELS))
    bar.ax.grid(False)
    keys = [
        mark_key(outcome, "black", **look) for outcome, look in LOOKS.items() if outcome in outcomes
    ]
    bottom_legend(figure, [*keys, mark_key(OWN, "black", **OWN_LOOK)], columns=5)
    return figure


def _values(grid: Grid, axis: str) -> Sequence[float]:
    return grid.slowest_mps if axis == "slowest_mps" else grid.periods_s


def _draw_cells(
    axes: Axes, grid: Grid, ratios: Float[np.ndarray, "values errors"], axis: str, norm
) -> None:
    """Draw a cell around every point, up to half of the way to its neighbours."""
    x = _make_edges(100 * np.array(grid.slip_errors))
    y = _make_edges(np.array(_values(grid, axis)))
    cells = np.ma.masked_invalid(ratios)
    axes.pcolormesh(x, y, cells, norm=norm, cmap=COLOURS, edgecolor="white", linewidth=0.5)
    axes.grid(False)
    axes.set(xlim=(x[0], x[-1]), ylim=(y[0], y[-1]))
    # Few values are ticks themselves: nothing is known in between.
    if len(x) <= MOST_TICKS:
        errors = 100 * np.array(grid.slip_errors)
        axes.set_xticks(errors, [f"{error:.3g}" for error in errors])
    if len(y) <= MOST_TICKS:
        axes.set_yticks(_values(grid, axis))


def _make_edges(places: Float[np.ndarray, " k"]) -> Float[np.ndarray, " k+1"]:
    """Return the borders of cells around increasing places."""
    if len(places) == 1:
        return places[0] + np.array([-0.5, 0.5])
    middles = (places[1:] + places[:-1]) / 2
    first = 2 * places[0] - middles[0]
    last = 2 * places[-1] - middles[-1]
    return np.array([first, *middles, last])


def _draw_marks(
    axes: Axes, grid: Grid, found: GuaranteeByPoint, design: str, axis: str
) -> set[str]:
    """Mark what became of every point, and the scenario's own; return the outcomes that occur."""
    outcomes = set()
    for value in _values(grid, axis):
        for error in grid.slip_errors:
            operating_point = grid.own._replace(slip_error=error, **{axis: value})
            outcome = _outcome(found[Point(design, operating_point)])
            outcomes.add(outcome)
            look = {"color": "black", "linestyle": "none", "zorder": 3}
            axes.plot(100 * error, value, **look, **LOOKS[outcome])
            if operating_point == grid.own:
                axes.plot(100 * error, value, **look, **OWN_LOOK)
    return outcomes


def _outcome(guarantee: Guarantee) -> str:
    """Return the key of LOOKS of a point."""
    if guarantee.ratio is None:
        return "no design found"
    if guarantee.holds:
        return "guaranteed"
    return "wheels too weak" if guarantee.ratio < 1 else "not guaranteed"


def ratio_table(
    grid: Grid, found: GuaranteeByPoint, design: str, axis: str
) -> Float[np.ndarray, "values errors"]:
    """Return the ratios over "slowest_mps" or "dt_s" (rows) and slip error; NaN where no design was
    found."""
    rows = []
    for value in _values(grid, axis):
        operating_points = [
            grid.own._replace(slip_error=error, **{axis: value}) for error in grid.slip_errors
        ]
        rows.append(
            [found[Point(design, operating_point)].ratio for operating_point in operating_points]
        )
    return np.array(rows, dtype=float)
