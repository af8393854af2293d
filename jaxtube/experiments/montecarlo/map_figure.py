"""The map of a Monte Carlo run: how large the errors of almost all laps are along the path."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float, Int
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.colors import ListedColormap, Normalize
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from jaxtube.coordinates import COORDINATES
from jaxtube.experiments.montecarlo.heat_figures import COUNTS
from jaxtube.figures.style import (
    MILLIMETRES,
    OUTSIDE,
    area_key,
    bottom_legend,
    line_key,
    page_figure,
    styled,
)
from jaxtube.plant.reference import settled_step
from jaxtube.statistics import histogram
from jaxtube.statistics.checks import Checks
from jaxtube.statistics.run import Statistics
from jaxtube.synthesis.problem import Problem

SHARE = 0.999
"""Share of the laps whose error is smaller than what is drawn."""
VISITED = "0.88"
PATH_WIDTH = 3.5
LEAST_SPAN = 1e-3
"""Share of the least size by which the colours span more than one size."""


@styled
def error_map(problem: Problem, checks: Checks, statistics: Statistics) -> Figure:
    """Draw the reference in the colours of the 99.9 % quantile of |e|, one panel a coordinate, over
    the cells that laps visited.

    The colours span what is met once laps have settled.

    Args:
        problem: gives the reference.
        checks: give the grid of the cells.
        statistics: of the run.
    """
    counts = statistics["map"]
    cell = float(checks.map_cell)
    width, height = np.ptp(problem.reference.poses[:, :2], axis=0)
    figure = page_figure(float(np.clip(2.1 * height / width, 2.0, 5.0)) + 1.0)
    panels = figure.subplots(1, 3, sharex=True, sharey=True)
    for coordinate, axes in enumerate(panels):
        _draw_visited(axes, np.asarray(checks.map_corner), cell, counts)
        path = _draw_path(axes, problem, statistics, coordinate)
        axes.set(title=f"$|{COORDINATES[coordinate].error}|$", aspect="equal", xlabel="$x$ [m]")
        label = f"{100 * SHARE:g} % of the laps below [{MILLIMETRES.units[coordinate]}]"
        bar = figure.colorbar(
            path, ax=axes, label=label, orientation="horizontal", aspect=25, extend="max"
        )
        bar.locator = MaxNLocator(5)
        bar.ax.grid(False)
    panels[0].set_ylabel("$y$ [m]")
    visits = f"cells of {100 * cell:.3g} cm that laps visited ({counts.sum():,} visits)"
    larger = line_key("larger, before laps have settled", color=OUTSIDE, linewidth=PATH_WIDTH)
    bottom_legend(figure, [larger, area_key(visits, VISITED)])
    return figure


def _draw_visited(
    axes: Axes,
    corner: Float[np.ndarray, "2"],
    cell: float,
    counts: Int[np.ndarray, "rows columns"],
) -> None:
    """Grey the cells in which a lap has been, and end the axes around them."""
    rows, columns = counts.shape
    x = corner[0] + cell * np.arange(columns + 1)
    y = corner[1] + cell * np.arange(rows + 1)
    visited = np.ma.masked_equal(counts > 0, False)
    axes.pcolormesh(x, y, visited, cmap=ListedColormap([VISITED]), rasterized=True)
    used_rows, used_columns = np.nonzero(counts)
    if len(used_rows):
        axes.set_xlim(x[used_columns.min()] - cell, x[used_columns.max() + 1] + cell)
        axes.set_ylim(y[used_rows.min()] - cell, y[used_rows.max() + 1] + cell)


def _draw_path(
    axes: Axes, problem: Problem, statistics: Statistics, coordinate: int
) -> LineCollection:
    """Draw the reference period by period, in the colour of the errors at its end, large ones on
    top."""
    places = problem.reference.poses[: problem.reference.steps + 1, :2]
    quantile = histogram.quantile(statistics["error_by_step"][:, coordinate], SHARE)
    # The first bucket is open below, the last one above.
    inside = np.clip(quantile, histogram.EDGES[1], histogram.EDGES[-1])
    sizes = np.nan_to_num(inside, nan=histogram.EDGES[1]) * MILLIMETRES.factors[coordinate]
    order = np.argsort(sizes, kind="stable")
    segments = np.stack([places[:-1], places[1:]], axis=1)
    settled = sizes[min(settled_step(problem.reference), len(sizes) - 1) :]
    norm = Normalize(settled.min(), max(settled.max(), (1 + LEAST_SPAN) * settled.min()))
    look = {"cmap": COUNTS.with_extremes(over=OUTSIDE), "linewidth": PATH_WIDTH}
    path = LineCollection(list(segments[order]), norm=norm, **look)
    path.set_array(sizes[order])
    path.set_capstyle("round")
    axes.add_collection(path)
    return path
