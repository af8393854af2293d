"""Heat maps of a Monte Carlo run: deviations from plans against the tube, positions along the
reference, starts.

Cells hold whole numbers in logarithmic colours; a cell in which nothing was counted stays white.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from jaxtyping import Float, Int
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import LinearSegmentedColormap, ListedColormap, LogNorm
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import MaxNLocator

from jaxtube.experiments.figures.sets import IN_MILLIMETRES, OUTSIDE, SMALL_UNITS
from jaxtube.experiments.figures.style import (
    LIMIT,
    TO_DISPLAY,
    Line,
    bottom_legend,
    draw_polygon,
    error_label,
    line_keys,
    page_figure,
    styled,
)
from jaxtube.statistics.checks import Checks
from jaxtube.statistics.run import Statistics
from jaxtube.statistics.tally import PLANES
from jaxtube.synthesis.design import Design
from jaxtube.synthesis.problem import Problem

COLUMNS = 5
"""Stages side by side."""
CLOUD_REACH = 2.0
"""The cells of a cloud reach so many times as far as the box around the section."""
COUNTS = LinearSegmentedColormap.from_list(
    "counts", ["#d9e9f5", "#7fb5dc", "#2b7bba", "#0b3f78", "#04173a"]
)
GREY = "0.88"
HULL = "#009E73"
SHARES = LinearSegmentedColormap.from_list(
    "shares", ["#fde3cf", "#f2a268", "#d55e00", "#7f2704", "#3a1000"]
)


@styled
def tube_cloud(design: Design, statistics: Statistics, summary: dict) -> Figure:
    """Draw how far followed plans deviated from their predictions, stage by stage, with the tube in
    use around them.

    The sections of the tube `sequence` change along the reference: its clouds are scaled to the
    section in the widest window, which is drawn.
    """
    sections, clouds = design.tube[1:], statistics["cloud"]
    columns = min(len(sections), COLUMNS)
    bands = -(-len(sections) // columns)
    figure = page_figure(0.9 + 4.4 * bands)
    panels = figure.subplots(len(PLANES) * bands, columns, squeeze=False)
    norm = count_norm(clouds)
    for stage, section in enumerate(sections):
        band, column = divmod(stage, columns)
        corners = section.vertices() * IN_MILLIMETRES
        reach = CLOUD_REACH * np.abs(corners).max(axis=0)
        # Where the section is flat, cells reach 1 m or 1 rad.
        reach = np.where(reach > 0, reach, IN_MILLIMETRES)
        for row, plane in enumerate(PLANES):
            axes = panels[len(PLANES) * band + row, column]
            heat(axes, clouds[stage, row], [(-reach[i], reach[i]) for i in plane], norm, COUNTS)
            draw_polygon(axes, corners[:, plane], edgecolor=OUTSIDE, linewidth=1.3)
            if beyond := summary["plans"] - int(clouds[stage, row].sum()):
                note = f"{100 * beyond / summary['plans']:.2g} % beyond"
                box = {"facecolor": "white", "edgecolor": "none", "alpha": 0.85, "pad": 1.2}
                axes.text(
                    0.97,
                    0.04,
                    note,
                    transform=axes.transAxes,
                    ha="right",
                    fontsize=6.5,
                    bbox=box,
                    zorder=2.4,
                )
            axes.set_xlabel(error_label(plane[0], unit=SMALL_UNITS[plane[0]]), labelpad=1)
            for axis in (axes.xaxis, axes.yaxis):
                axis.set_major_locator(MaxNLocator(4, symmetric=True))
        found = summary["tube"]["stages"][stage]["outside"]
        words = share_words(found["share"], found["interval"])
        panels[len(PLANES) * band, column].set_title(f"$j = {stage + 1}$: {words}")
    for row, axes in enumerate(panels[:, 0]):
        coordinate = PLANES[row % len(PLANES)][1]
        axes.set_ylabel(error_label(coordinate, unit=SMALL_UNITS[coordinate]), labelpad=1)
    for axes in panels.flat:
        if not axes.has_data():
            axes.set_axis_off()
    colour_bar(figure, panels, norm, COUNTS, "plans in a cell")
    key = f"$R_j$ of the tube `{design.tube.name}`, projected" + (
        "; widest window" if design.tube.follows_reference else ""
    )
    bottom_legend(figure, line_keys([Line(f"{key}; {summary['plans']:,} plans", OUTSIDE)]))
    return figure


def share_words(share: float, interval: tuple[float, float]) -> str:
    """Return what share is outside, with its interval, in two lines."""
    low, high = (100 * bound for bound in interval)
    return (
        f"{100 * share:.3g} % outside\n({low:.3g} to {high:.3g} %)"
        if share
        else f"none outside\n(at most {high:.2g} %)"
    )


@styled
def trajectory_map(
    problem: Problem, checks: Checks, counts: Int[np.ndarray, "rows columns"]
) -> Figure:
    """Draw how often robots were where, in the world frame, with the reference; turned to lie where
    it is tall.

    Args:
        problem: gives the reference.
        checks: give the grid.
        counts: of the run.
    """
    corner, cell = np.asarray(checks.map_corner), float(checks.map_cell)
    ends = [(corner[i], corner[i] + cell * size) for i, size in enumerate(counts.shape[::-1])]
    poses = problem.reference.poses[: problem.reference.steps + 1, :2]
    low, high = poses.min(axis=0), poses.max(axis=0)
    margin = np.min(low - corner)
    shown = np.stack([low - margin, high + margin])
    width, height = np.ptp(shown, axis=0)
    order = [1, 0] if height > width else [0, 1]
    figure = page_figure(1.0 + 5.7 * min(height, width) / max(height, width))
    axes, norm = figure.subplots(), count_norm(counts)
    heat(axes, counts if order == [0, 1] else counts.T, [ends[i] for i in order], norm, COUNTS)
    axes.plot(*poses[:, order].T, color=OUTSIDE, linewidth=0.8)
    axes.set(aspect="equal", xlim=shown[:, order[0]], ylim=shown[:, order[1]])
    axes.set(xlabel=f"${'xy'[order[0]]}$ [m]", ylabel=f"${'xy'[order[1]]}$ [m]")
    if order == [1, 0]:
        axes.invert_yaxis()  # a rotation, no mirror image
    colour_bar(figure, axes, norm, COUNTS, f"visits of a cell of {100 * cell:.3g} cm")
    bottom_legend(figure, line_keys([Line(f"reference; {counts.sum():,} visits", OUTSIDE)]))
    return figure


@styled
def coverage(
    problem: Problem, statistics: Statistics, summary: dict, hull: Float[np.ndarray, "k 3"]
) -> Figure:
    """Draw where laps started, and how many of them left E.

    Args:
        problem: gives E, which the cells span.
        statistics: of the run.
        summary: of the run.
        hull: corners of the set that the starts are drawn from, (m, m, rad).
    """
    starts, left = statistics["starts"], statistics["starts_that_left"]
    shares = 100 * left / np.maximum(starts, 1)
    limits = problem.error_set.support(np.eye(3)) * TO_DISPLAY
    figure = page_figure(5.2)
    panels = figure.subplots(2, 3)
    norms = (
        count_norm(starts),
        LogNorm(min(1.0, np.min(shares, where=left > 0, initial=1.0)), 100.0),
    )
    for column, plane in enumerate(PLANES):
        ends = [(-limits[i], limits[i]) for i in plane]
        heat(panels[0, column], starts[column], ends, norms[0], COUNTS)
        heat(panels[1, column], starts[column], ends, norms[0], ListedColormap([GREY]))
        heat(panels[1, column], shares[column], ends, norms[1], SHARES)
        for axes in panels[:, column]:
            box = np.array([(x, y) for x in ends[0] for y in ends[1]])
            draw_polygon(
                axes,
                box,
                **{"edgecolor" if key == "color" else key: look for key, look in LIMIT.items()},
            )
            draw_polygon(
                axes, hull[:, plane] * TO_DISPLAY[list(plane)], edgecolor=HULL, linewidth=1.2
            )
            axes.set_ylabel(error_label(plane[1]), labelpad=0)
            axes.set(xlim=np.multiply(ends[0], 1.08), ylim=np.multiply(ends[1], 1.08))
        panels[1, column].set_xlabel(error_label(plane[0]))
    panels[0, 1].set_title(f"starts of {summary['laps']:,} laps")
    panels[1, 1].set_title(_share_left(summary["events"]["e_outside_E"], summary["laps"]))
    colour_bar(figure, panels[0], norms[0], COUNTS, "laps in a cell")
    colour_bar(figure, panels[1], norms[1], SHARES, "of them left $\\mathcal{E}$ [%]")
    keys = [
        Line2D([], [], label="limits of $\\mathcal{E}$", **LIMIT),
        *line_keys([Line("set of the starts, projected", HULL)]),
        Patch(color=GREY, label="none left $\\mathcal{E}$"),
    ]
    bottom_legend(figure, keys)
    return figure


def _share_left(event: dict, laps: int) -> str:
    low, high = (100 * bound for bound in event["share_of_laps_interval"])
    interval = f"{low:.3g} to {high:.3g} %" if event["laps"] else f"at most {high:.2g} %"
    return f"{event['laps']:,} of {laps:,} laps left $\\mathcal{{E}}$ ({interval})"


def count_norm(counts: Int[np.ndarray, "*shape"]) -> LogNorm:
    """Return logarithmic colours for counts from 1 on."""
    return LogNorm(1, max(int(np.max(counts, initial=0)), 10))


def heat(axes: Axes, values: np.ndarray, limits, norm: LogNorm, colours) -> None:
    """Draw cells, rows upwards, between limits [(least, greatest) of x, of y]; cells of 0 stay
    empty."""
    edges = [
        np.linspace(least, greatest, count + 1)
        for (least, greatest), count in zip(limits, values.shape[::-1], strict=True)
    ]
    cells = np.ma.masked_less_equal(values, 0)
    axes.pcolormesh(*edges, cells, norm=norm, cmap=colours, rasterized=True)


def colour_bar(figure: Figure, panels: Any, norm: LogNorm, colours, label: str) -> None:
    """Put the scale of the colours beside panels."""
    bar = figure.colorbar(
        ScalarMappable(norm, colours), ax=panels, label=label, aspect=35, pad=0.015
    )
    bar.ax.grid(False)
