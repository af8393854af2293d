"""Heat maps of a Monte Carlo run: deviations from plans against the tube, and starts.

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
from matplotlib.ticker import MaxNLocator

from jaxtube.coordinates import TO_DISPLAY
from jaxtube.figures.style import (
    LIMIT,
    LIMIT_EDGE,
    MILLIMETRES,
    OUTSIDE,
    Line,
    area_key,
    bottom_legend,
    draw_polygon,
    error_label,
    label_plane,
    line_key,
    line_keys,
    page_figure,
    styled,
)
from jaxtube.statistics.run import Statistics
from jaxtube.statistics.tally import CLOUD_REACH, PLANES
from jaxtube.synthesis.parts import Design
from jaxtube.synthesis.problem import Problem
from sets.tubes import Section

COLUMNS = 5
"""Stages side by side."""
COUNTS = LinearSegmentedColormap.from_list(
    "counts", ["#d9e9f5", "#7fb5dc", "#2b7bba", "#0b3f78", "#04173a"]
)
SHARES = LinearSegmentedColormap.from_list(
    "shares", ["#fde3cf", "#f2a268", "#d55e00", "#7f2704", "#3a1000"]
)
NONE_LEFT = "0.88"
STARTS = Line("set of the starts, projected", "#009E73")
NOTE_BOX = {"facecolor": "white", "edgecolor": "none", "alpha": 0.85, "pad": 1.2}


@styled
def tube_cloud(design: Design, statistics: Statistics, summary: dict) -> Figure:
    """Draw how far followed plans deviated from their predictions, stage by stage, with the tube in
    use around them.

    The sections of the tube `sequence` change along the reference: its clouds are scaled to the
    section in the widest window, which is drawn.
    """
    sections = design.tube[1:]
    clouds = statistics["cloud"]
    columns = min(len(sections), COLUMNS)
    bands = -(-len(sections) // columns)
    figure = page_figure(0.9 + 4.4 * bands)
    panels = figure.subplots(len(PLANES) * bands, columns, squeeze=False)
    norm = count_norm(clouds)
    for stage, section in enumerate(sections):
        band, column = divmod(stage, columns)
        rows = panels[len(PLANES) * band : len(PLANES) * (band + 1), column]
        _draw_stage(rows, section, clouds[stage], summary["plans"], norm)
        outside = summary["tube"]["stages"][stage]["outside"]
        words = share_words(outside["share"], outside["interval"])
        rows[0].set_title(f"$j = {stage + 1}$: {words}")
    for row, axes in enumerate(panels[:, 0]):
        plane = PLANES[row % len(PLANES)]
        axes.set_ylabel(error_label(plane[1], MILLIMETRES), labelpad=1)
    for axes in panels.flat:
        if not axes.has_data():
            axes.set_axis_off()
    colour_bar(figure, panels, norm, COUNTS, "plans in a cell")
    widest = "; widest window" if design.tube.follows_reference else ""
    label = f"$R_j$ of the tube “{design.tube.name}”, projected{widest}; {summary['plans']:,} plans"
    bottom_legend(figure, line_keys([Line(label, OUTSIDE)]))
    return figure


def _draw_stage(
    rows, section: Section, clouds: Int[np.ndarray, "planes cells cells"], plans: int, norm: LogNorm
) -> None:
    """Draw the clouds of one stage, a plane a row, with the section around them."""
    corners = section.vertices() * MILLIMETRES.factors
    reach = CLOUD_REACH * np.abs(corners).max(axis=0)
    # Where the section is flat, cells reach 1 m or 1 rad.
    reach = np.where(reach > 0, reach, MILLIMETRES.factors)
    for axes, plane, cloud in zip(rows, PLANES, clouds, strict=True):
        draw_cells(axes, cloud, [(-reach[i], reach[i]) for i in plane], norm, COUNTS)
        draw_polygon(axes, corners[:, plane], edgecolor=OUTSIDE, linewidth=1.3)
        beyond = plans - int(cloud.sum())
        if beyond:
            _note_beyond(axes, beyond / plans)
        axes.set_xlabel(error_label(plane[0], MILLIMETRES), labelpad=1)
        axes.xaxis.set_major_locator(MaxNLocator(4, symmetric=True))
        axes.yaxis.set_major_locator(MaxNLocator(4, symmetric=True))


def _note_beyond(axes: Axes, share: float) -> None:
    """Say what share of the plans lies beyond the cells."""
    note = f"{100 * share:.2g} % beyond"
    look: dict[str, Any] = {"ha": "right", "fontsize": 6.5, "bbox": NOTE_BOX, "zorder": 2.4}
    axes.text(0.97, 0.04, note, transform=axes.transAxes, **look)


def share_words(share: float, interval: tuple[float, float]) -> str:
    """Return what share is outside, with its interval, in two lines."""
    low, high = 100 * np.array(interval)
    if not share:
        return f"none outside\n(at most {high:.2g} %)"
    return f"{100 * share:.3g} % outside\n({low:.3g} to {high:.3g} %)"


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
    starts = statistics["starts"]
    left = statistics["starts_that_left"]
    shares = 100 * left / np.maximum(starts, 1)
    least_share = np.min(shares, where=left > 0, initial=1.0)
    count_colours = count_norm(starts)
    share_colours = LogNorm(least_share, 100.0)
    figure = page_figure(5.2)
    panels = figure.subplots(2, 3)
    limits = problem.error_set.support(np.eye(3)) * TO_DISPLAY
    for column, plane in enumerate(PLANES):
        counted, shared = panels[:, column]
        ends = [(-limits[i], limits[i]) for i in plane]
        draw_cells(counted, starts[column], ends, count_colours, COUNTS)
        draw_cells(shared, starts[column], ends, count_colours, ListedColormap([NONE_LEFT]))
        draw_cells(shared, shares[column], ends, share_colours, SHARES)
        for axes in (counted, shared):
            _draw_bounds(axes, ends, hull[:, plane] * TO_DISPLAY[list(plane)])
            label_plane(axes, plane)
        counted.set_xlabel("")
    panels[0, 1].set_title(f"starts of {summary['laps']:,} laps")
    panels[1, 1].set_title(_words_of_left(summary["events"]["e_outside_E"], summary["laps"]))
    colour_bar(figure, panels[0], count_colours, COUNTS, "laps in a cell")
    colour_bar(figure, panels[1], share_colours, SHARES, "of them left $\\mathcal{E}$ [%]")
    keys = [
        line_key("limits of $\\mathcal{E}$", **LIMIT),
        *line_keys([STARTS]),
        area_key("none left $\\mathcal{E}$", NONE_LEFT),
    ]
    bottom_legend(figure, keys)
    return figure


def _draw_bounds(axes: Axes, ends, hull: Float[np.ndarray, "k 2"]) -> None:
    """Draw the limits of E and the set of the starts."""
    box = np.array(np.meshgrid(*ends)).reshape(2, -1).T
    draw_polygon(axes, box, **LIMIT_EDGE)
    draw_polygon(axes, hull, edgecolor=STARTS.colour, linewidth=1.2)
    axes.set(xlim=np.multiply(ends[0], 1.08), ylim=np.multiply(ends[1], 1.08))


def _words_of_left(event: dict, laps: int) -> str:
    low, high = 100 * np.array(event["share_of_laps_interval"])
    interval = f"{low:.3g} to {high:.3g} %" if event["laps"] else f"at most {high:.2g} %"
    return f"{event['laps']:,} of {laps:,} laps left $\\mathcal{{E}}$ ({interval})"


def count_norm(counts: Int[np.ndarray, "*shape"]) -> LogNorm:
    """Return logarithmic colours for counts from 1 on."""
    return LogNorm(1, max(int(np.max(counts, initial=0)), 10))


def draw_cells(axes: Axes, values: np.ndarray, ends, norm: LogNorm, colours) -> None:
    """Draw cells, rows upwards, between the ends [(least, greatest) of x, of y]; cells of 0 stay
    empty."""
    rows, columns = values.shape
    (left, right), (bottom, top) = ends
    x = np.linspace(left, right, columns + 1)
    y = np.linspace(bottom, top, rows + 1)
    cells = np.ma.masked_less_equal(values, 0)
    axes.pcolormesh(x, y, cells, norm=norm, cmap=colours, rasterized=True)


def colour_bar(figure: Figure, panels: Any, norm: LogNorm, colours, label: str) -> None:
    """Put the scale of the colours beside panels."""
    scale = ScalarMappable(norm, colours)
    bar = figure.colorbar(scale, ax=panels, label=label, aspect=35, pad=0.015)
    bar.ax.grid(False)
