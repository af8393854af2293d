"""Figures of a Monte Carlo run: errors over the lap and disturbances against their sets.

All but the worst lap, which is simulated again, are functions of the run's statistics alone.
"""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor

import numpy as np
from jaxtyping import Float, Int
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from jaxtube.coordinates import NAMES
from jaxtube.experiments.montecarlo import heat_figures, lap_figure, map_figure
from jaxtube.experiments.run.folder import RunFolder
from jaxtube.figures import shares as shares_figure
from jaxtube.figures.style import (
    INSIDE,
    LIMIT,
    METRES,
    MILLIMETRES,
    OUTSIDE,
    area_key,
    bottom_legend,
    disturbance_label,
    error_label,
    line_key,
    mark_key,
    page_figure,
    styled,
)
from jaxtube.progress import progress
from jaxtube.simulation.starts import UniformStart
from jaxtube.statistics import histogram
from jaxtube.statistics.lap import lap
from jaxtube.statistics.run import Statistics, Task
from jaxtube.statistics.task import disturbance_facets
from jaxtube.synthesis.parts import Design
from jaxtube.synthesis.problem import Problem

SHADES = {0.5: 0.6, 0.9: 0.35, 0.999: 0.15}
"""Shares of the laps, and how strong the band up to their quantile is."""
FILL = 0.75
BEYOND = {"color": "0.5", "alpha": 0.12, "linewidth": 0}
"""Looks of a histogram, and of the background outside a limit."""


def draw(
    design: Design,
    task: Task,
    seed: int,
    statistics: Statistics,
    summary: dict,
    folder: RunFolder,
) -> None:
    """Draw the figures of a run into its folder; those that have nothing to show are left out."""
    problem = design.problem
    worst = summary["worst"]["error"][0]["lap"]
    # Simulated while the others are drawn: most of it is compilation, which runs beside Python.
    pool = ThreadPoolExecutor(1)
    worst_lap = pool.submit(lap, design, task, seed, worst)
    drawings = {
        "violations": lambda: shares_figure.violations(summary),
        "error_quantiles": lambda: error_quantiles(problem, statistics),
        "disturbance": lambda: disturbance(problem, statistics, summary),
        "map": lambda: map_figure.error_map(problem, task.checks, statistics),
    }
    if summary["plans"]:
        drawings["tube_cloud"] = lambda: heat_figures.tube_cloud(design, statistics, summary)
    if isinstance(task.starts, UniformStart):
        corners = np.asarray(task.starts.triangles).reshape(-1, 3)
        drawings["coverage"] = lambda: heat_figures.coverage(problem, statistics, summary, corners)
    drawings["worst"] = lambda: lap_figure.draw(problem, worst_lap.result())
    with pool, progress(len(drawings), "drawing", "figures", starting="starting") as bar:
        for name, figure in drawings.items():
            folder.save_figure(figure(), name)
            bar.update()


@styled
def error_quantiles(problem: Problem, statistics: Statistics) -> Figure:
    """Draw quantiles of the errors over the laps, step by step, and the largest of all, against the
    limits of E."""
    excess = np.reshape(statistics["excess/error"], (2, 3)).max(axis=0)
    figure = page_figure(5.4)
    panels = figure.subplots(3, 1, sharex=True)
    for coordinate, axes in enumerate(panels):
        limit = float(problem.error_set.support(np.eye(3)[coordinate]))
        quantiles = quantiles_by_step(statistics, coordinate)
        time = np.arange(1, len(quantiles[0.5]) + 1) * problem.reference.dt
        scale = METRES.factors[coordinate]
        _draw_quantiles(axes, time, quantiles, scale)
        _draw_largest(axes, (limit + excess[coordinate]) * scale, limit * scale)
        axes.set(xlim=(0, time[-1]), ylabel=error_label(coordinate, absolute=True))
        axes.set_ylim(bottom=histogram.EDGES[1] * scale)
    panels[-1].set_xlabel("time [s]")
    keys = [
        area_key(f"{100 * share:g} % of the laps", INSIDE, alpha=shade)
        for share, shade in SHADES.items()
    ]
    keys += [
        line_key("largest of all laps and steps", color=OUTSIDE, linewidth=1.0),
        line_key("limits of $\\mathcal{E}$", **LIMIT),
    ]
    bottom_legend(figure, keys, columns=5)
    return figure


def quantiles_by_step(
    statistics: Statistics, coordinate: int
) -> dict[float, Float[np.ndarray, " steps"]]:
    """Return quantiles of |e| over the laps, by share and step, inside the histogram's edges."""
    counts = statistics["error_by_step"][:, coordinate]
    # The first bucket is open below, the last one above.
    return {
        share: np.clip(histogram.quantile(counts, share), histogram.EDGES[0], histogram.EDGES[-1])
        for share in SHADES
    }


def _draw_quantiles(axes: Axes, time, quantiles: dict, scale: float) -> None:
    lower = np.full_like(time, histogram.EDGES[0] * scale)
    for share, shade in SHADES.items():
        upper = quantiles[share] * scale
        axes.fill_between(time, lower, upper, color=INSIDE, alpha=shade, linewidth=0)
        lower = upper
    axes.plot(time, quantiles[0.5] * scale, color=INSIDE, linewidth=1.0)


def _draw_largest(axes: Axes, largest: float, limit: float) -> None:
    """Draw the largest error and its limit."""
    axes.axhline(largest, color=OUTSIDE, linewidth=1.0)
    axes.axhline(limit, **LIMIT)
    axes.set_yscale("log")
    top = np.nanmax([largest, limit])
    if np.isfinite(top):
        axes.set_ylim(top=1.6 * top)
    share = 100 * largest / limit
    axes.set_title(f"largest: {share:.3g} % of the limit", loc="right", pad=3)


def split_at(
    counts: Int[np.ndarray, " buckets"], limit: float, outside: int
) -> tuple[Float[np.ndarray, " edges"], Int[np.ndarray, " parts"]]:
    """Return (edges, counts) of a histogram whose bucket around a limit is cut there: `outside` are
    known beyond it."""
    edges = np.concatenate([[0.0], histogram.EDGES[1:], [2.0**histogram.GREATEST]])
    bucket = int(np.searchsorted(edges, limit, side="right")) - 1
    if bucket >= len(counts) or edges[bucket] == limit:
        return edges, counts
    beyond = outside - counts[bucket + 1 :].sum()
    parts = [counts[bucket] - beyond, beyond]
    cut = np.concatenate([counts[:bucket], parts, counts[bucket + 1 :]])
    return np.insert(edges, bucket + 1, limit), cut


@styled
def disturbance(problem: Problem, statistics: Statistics, summary: dict) -> Figure:
    """Draw how |w| is distributed by coordinate, and how often it exceeds a size, against W."""
    limits = problem.disturbance_set.support(np.eye(3))
    normals = disturbance_facets(problem).normals
    # The two facets across each axis; W may have slanted ones besides.
    across = np.abs(normals).T == 1.0
    excess = [np.max(statistics["excess/disturbance"][rows]) for rows in across]
    figure = page_figure(4.4)
    panels = figure.subplots(2, 3, sharex="col")
    for i, column in enumerate(panels.T):
        event = summary["events"][f"w_outside_{NAMES[i]}"]
        edges, counts = split_at(statistics["disturbance"][i], limits[i], event["steps"])
        unit = MILLIMETRES.factors[i]
        largest = (limits[i] + excess[i]) * unit
        _draw_distribution(column, edges * unit, counts, limits[i] * unit, largest)
        words = heat_figures.share_words(event["share_of_steps"], event["share_of_steps_interval"])
        column[0].set_title(words)
        column[0].set_ylabel(f"density [1/{MILLIMETRES.units[i]}]")
        column[1].set_xlabel(disturbance_label(i, absolute=True))
        column[1].sharey(panels[1, 0])
    panels[1, 0].set_ylabel("share of steps beyond")
    keys = [
        area_key("steps with $w$ inside its limit", INSIDE, alpha=FILL),
        area_key("outside", OUTSIDE, alpha=FILL),
        line_key("limits of $\\mathcal{W}$", **LIMIT),
        mark_key("largest", "0.15"),
    ]
    bottom_legend(figure, keys, columns=4)
    return figure


def _draw_distribution(column, edges, counts, limit: float, largest: float) -> None:
    """Draw a histogram, and the shares beyond its edges down to the largest value, of which there
    is one at least."""
    density, exceedance = column
    total = max(counts.sum(), 1)
    relative = counts / total / np.diff(edges)
    beyond = np.cumsum(counts[::-1])[::-1] / total
    lower = edges[:-1]
    for shown, colour in ((lower < limit, INSIDE), (lower >= limit, OUTSIDE)):
        heights = np.where(shown, relative, 0)
        density.stairs(heights, edges, fill=True, color=colour, alpha=FILL, linewidth=0)
    passed = (lower < largest) & (beyond > 0)
    least = 1 / total
    exceedance.plot([*lower[passed], largest], [*beyond[passed], least], color="0.15")
    exceedance.plot(largest, least, "o", color="0.15", markersize=4)
    end = 1.08 * max(1.15 * limit, largest, edges[1])
    exceedance.set(xlim=(0, end), yscale="log")
    for axes in (density, exceedance):
        axes.axvline(limit, **LIMIT)
        axes.axvspan(limit, end, **BEYOND)
