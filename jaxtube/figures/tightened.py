"""The figure of the tightened sets: what the tube leaves of the limits on errors and inputs."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Patch
from matplotlib.ticker import MaxNLocator

from jaxtube.coordinates import NAMES, TO_DISPLAY
from jaxtube.figures.style import (
    INSIDE,
    LIMIT,
    LIMIT_EDGE,
    OUTSIDE,
    draw_polygon,
    error_label,
    line_key,
    mark_key,
    page_figure,
    styled,
)
from jaxtube.synthesis.parts import Design
from sets.polytope import Polytope


@styled
def tightened_sets(design: Design, name: str) -> Figure:
    """Draw what the tube leaves of E, coordinate by coordinate, and of U, in the first window of
    the reference.

    Args:
        design: gives the bounds.
        name: of the design, for the title.
    """
    figure = page_figure(4.4)
    figure.suptitle(f"Design “{name}”: limits less the tube “{design.tube.name}”")
    panels = figure.subplots(2, 3)
    for coordinate, axes in enumerate(panels[0]):
        _draw_error_bounds(axes, design, coordinate)
        axes.set_title(f"({'abc'[coordinate]}) {NAMES[coordinate]} error")
    _draw_input_sets(panels[1, 0], panels[1, 1], design)
    panels[1, 2].set_axis_off()
    panels[1, 2].legend(handles=_keys(design.problem.horizon), loc="center left")
    return figure


def _draw_error_bounds(axes: Axes, design: Design, coordinate: int) -> None:
    """Draw the bounds of one error by stage, and how far the constraint on e_N lets it reach."""
    window = int(design.windows.index[0])
    horizon = design.problem.horizon
    scale = TO_DISPLAY[coordinate]
    left = design.bounds.errors[window, :, coordinate] * scale
    last = Polytope(design.bounds.terminal_normals, design.bounds.terminal[window])
    reach = last.support(np.eye(3)[coordinate]) * scale
    whole = design.problem.operating_set.offsets[coordinate] * scale
    axes.stairs(left, np.arange(horizon + 1) - 0.5, baseline=None, color=INSIDE, linewidth=1.2)
    axes.plot(np.arange(horizon), left, "o", color=INSIDE, markersize=3)
    axes.plot(horizon, reach, "D", color=OUTSIDE, markersize=4)
    axes.axhline(whole, **LIMIT)
    axes.set_xlim(-0.7, horizon + 0.7)
    axes.set_xlabel("stage $j$")
    axes.set_ylabel(error_label(coordinate, absolute=True))
    axes.xaxis.set_major_locator(MaxNLocator(integer=True))


def _draw_input_sets(whole: Axes, corner: Axes, design: Design) -> None:
    """Draw U and the nested U_j, whole and at the corner of the greatest forward demand."""
    window = int(design.windows.index[0])
    bounds = design.bounds.inputs[window]
    regimes = design.windows.regimes[window]
    rows = design.problem.rows_of(regimes).inputs
    corners = design.problem.every_regime[regimes[0]].input_set.vertices()
    tightened = [Polytope(*stage).vertices() for stage in zip(rows, bounds, strict=True)]
    for axes in (whole, corner):
        axes.set(xlabel="$u_1$ [m/s]", ylabel="$u_2$ [rad/s]")
        for points in tightened:
            draw_polygon(axes, points, facecolor=INSIDE, alpha=0.15, linewidth=0)
            draw_polygon(axes, points, edgecolor=INSIDE, linewidth=0.6)
        draw_polygon(axes, corners, **LIMIT_EDGE)
    first = corners[np.argmin(corners[:, 0])]
    last = tightened[-1][np.argmin(tightened[-1][:, 0])]
    width, height = np.ptp(corners, axis=0)
    depth = max(abs(last[0] - first[0]), 0.01 * width)
    across = depth * height / width
    corner.set_xlim(first[0] - 0.2 * depth, first[0] + 1.8 * depth)
    corner.set_ylim(first[1] - across, first[1] + across)
    whole.set_title("(d) $\\mathcal{U}_j$")
    corner.set_title("(e) $\\mathcal{U}_j$, left corner")


def _keys(horizon: int) -> list:
    stages = f"$\\mathcal{{U}}_j$, $j = 0, \\ldots, {horizon - 1}$"
    return [
        line_key("limits of $\\mathcal{E}$ and $\\mathcal{U}$", **LIMIT),
        line_key("bounds of $\\mathcal{E}_j$", color=INSIDE, marker="o", markersize=3),
        mark_key("reach of the constraint on $e_N$", OUTSIDE, marker="D"),
        Patch(facecolor=INSIDE, edgecolor=INSIDE, alpha=0.4, label=stages),
    ]
