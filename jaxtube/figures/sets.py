"""Figures of a design's sets: the tubes, the terminal set, and all of them inside the operating
set.

Sets of (e_x, e_y, e_theta) are drawn as projections onto the three coordinate planes, the convex
hull of the projected vertices, and one of them as a solid. Ellipsoids {e : e^T P e <= c} project to
{x : x^T (P^-1)_xx^-1 x <= c}.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float
from matplotlib.figure import Figure
from mpl_toolkits.mplot3d.axes3d import Axes3D

from jaxtube.coordinates import NAMES, PLANES
from jaxtube.figures.solid import draw_solid, prepare_solid
from jaxtube.figures.style import (
    LIMIT,
    METRES,
    MILLIMETRES,
    OUTSIDE,
    Line,
    Scale,
    bottom_legend,
    draw_line,
    draw_polygon,
    label_plane,
    line_keys,
    page_figure,
    row_text,
    styled,
)
from jaxtube.synthesis.parts import Design
from sets.polytope import Polytope

TUBES = {
    "paper": Line("paper, eq. (27)", "#D55E00"),
    "summed": Line("summed", "#56B4E9"),
    "hull": Line("hull", "black", (0, (2, 1.5))),
    "sequence": Line("sequence, widest window", "#009E73"),
}
"""From the outermost to the innermost."""
LIMITS = Line("$\\mathcal{E}$", LIMIT["color"], LIMIT["linestyle"])
MAXIMAL = Line("largest invariant set", "#0072B2")
INVARIANT = Line("terminal set", "#D55E00", (0, (3, 1.5)))
CONSTRAINT = Line("constraint on $e_N$", "#009E73")
LEVEL_SET = Line("level set of $e^\\top P\\,e$", "#CC79A7")
SECTION = Line("tube", "#E69F00")


@styled
def tube_sections(design: Design, name: str) -> Figure:
    """Draw the last section of the tube in use as a solid, and all sections of the four tubes
    projected onto the planes.

    Args:
        design: gives the tubes.
        name: of the design, for the title.
    """
    lines = {tube: line for tube, line in TUBES.items() if tube in design.tubes}
    last = f"R_{{{design.problem.horizon}}}"
    figure = page_figure(6.0)
    figure.suptitle(f"Design “{name}”: sections $R_1, \\ldots, {last}$ of the tubes, projected")
    solid = _draw_views(figure, MILLIMETRES, f"${last}$ of the tube in use, “{design.tube.name}”")
    corners = design.tube[-1].vertices() * MILLIMETRES.factors
    draw_solid(solid, corners, lines[design.tube.name].colour)
    for tube, line in lines.items():
        for section in design.tubes[tube][1:]:
            width = 1.2 if section is design.tubes[tube][-1] else 0.7
            _draw_projections(figure, section.vertices(), MILLIMETRES, line, width)
    bottom_legend(figure, line_keys(lines.values()), columns=4)
    return figure


@styled
def terminal_set(design: Design, name: str) -> Figure:
    """Draw the invariant sets, the constraint on e_N and an ellipsoid of the terminal cost, or why
    there is none.

    The ellipsoid is the largest level set of e^T P e inside the maximal invariant set.

    Args:
        design: gives the sets.
        name: of the design, for the title.
    """
    maximal = design.terminal.maximal.polytope
    invariant = design.terminal.invariant
    if maximal is None or invariant is None:
        return _draw_escape(design, name)
    window = int(design.windows.index[0])
    constraint = Polytope(design.bounds.terminal_normals, design.bounds.terminal[window])
    facets = f"{INVARIANT.label} of {len(invariant.offsets)} facets"
    figure = page_figure(6.2)
    figure.suptitle(f"Design “{name}”: terminal set, projected")
    solid = _draw_views(figure, METRES, facets)
    draw_solid(solid, invariant.vertices() * METRES.factors, INVARIANT.colour)
    for polytope, line in (
        (design.problem.operating_set, LIMITS),
        (maximal, MAXIMAL),
        (invariant, INVARIANT),
        (constraint, CONSTRAINT),
    ):
        _draw_projections(figure, polytope.vertices(), METRES, line)
    _draw_level_set(figure, maximal, design.cost.cost)
    keys = line_keys([LIMITS, MAXIMAL, INVARIANT, CONSTRAINT, LEVEL_SET])
    bottom_legend(figure, keys, columns=5)
    return figure


@styled
def design_sets(design: Design, name: str) -> Figure:
    """Draw the limits under which a design holds, its terminal set and the last section of its
    tube, projected.

    Args:
        design: gives the sets.
        name: of the design, for the title.
    """
    section = f"last section $R_{{{design.problem.horizon}}}$ of the tube “{design.tube.name}”"
    sets = {
        LIMITS._replace(label="limits on errors"): design.problem.operating_set.vertices(),
        SECTION._replace(label=section): design.tube[-1].vertices(),
    }
    if design.terminal.invariant is not None:
        sets[INVARIANT] = design.terminal.invariant.vertices()
    figure = page_figure(3.1)
    figure.suptitle(f"Design “{name}”: sets of errors, projected")
    for axes, plane in zip(figure.subplots(1, 3), PLANES, strict=True):
        label_plane(axes, plane)
        axes.margins(0.06)
    for line, corners in sets.items():
        _draw_projections(figure, corners, METRES, line)
    bottom_legend(figure, line_keys(sets))
    return figure


def _draw_views(figure: Figure, scale: Scale, title: str) -> Axes3D:
    """Add three panels, one a plane of two coordinates, and return a three-dimensional one."""
    grid = figure.add_gridspec(2, 2)
    cells = (grid[0, 1], grid[1, 0], grid[1, 1])
    for cell, plane, letter in zip(cells, PLANES, "bcd", strict=True):
        axes = figure.add_subplot(cell)
        label_plane(axes, plane, scale)
        axes.set_title(f"({letter}) {NAMES[plane[0]]} and {NAMES[plane[1]]} error")
        axes.margins(0.06)
    solid: Axes3D = figure.add_subplot(grid[0, 0], projection="3d")  # pyright: ignore[reportAssignmentType]
    prepare_solid(solid, scale, f"(a) {title}")
    return solid


def _draw_projections(
    figure: Figure,
    corners: Float[np.ndarray, "v 3"],
    scale: Scale,
    line: Line,
    width: float = 1.2,
) -> None:
    """Draw a set, given by its corners in (m, m, rad), in the first three panels of a figure."""
    points = corners * scale.factors
    look = {"edgecolor": line.colour, "linestyle": line.dashes, "linewidth": width}
    for axes, plane in zip(figure.axes, PLANES, strict=False):
        draw_polygon(axes, points[:, plane], **look)


def _draw_level_set(figure: Figure, maximal: Polytope, cost: Float[np.ndarray, "3 3"]) -> None:
    """Draw the largest level set of the cost inside a set in the first three panels."""
    shape = np.linalg.inv(cost)
    reach = np.einsum("fi,ij,fj->f", maximal.normals, shape, maximal.normals)
    level = np.min(maximal.offsets**2 / reach)
    for axes, plane in zip(figure.axes, PLANES, strict=False):
        ellipse = _ellipse(level * shape[np.ix_(plane, plane)])
        points = ellipse * METRES.factors[list(plane)]
        draw_line(axes, points[:, 0], points[:, 1], LEVEL_SET)


def _ellipse(covariance: Float[np.ndarray, "2 2"]) -> Float[np.ndarray, "200 2"]:
    """Return points on the boundary of {x : x^T covariance^-1 x <= 1}."""
    angles = np.linspace(0, 2 * np.pi, 200)
    circle = np.column_stack([np.cos(angles), np.sin(angles)])
    return circle @ np.linalg.cholesky(covariance).T


def _draw_escape(design: Design, name: str) -> Figure:
    """Say that no invariant set exists, and draw how disturbances carry the origin past a
    constraint."""
    figure = page_figure(2.8)
    axes = figure.subplots()
    axes.set_title(
        f"Design “{name}”: no invariant terminal set, $e_N$ is kept in $\\mathcal{{E}} - R_N$"
    )
    terminal = design.terminal
    escape = terminal.maximal.escape
    if escape is None:
        axes.text(0.5, 0.5, "none was found", transform=axes.transAxes, ha="center")
        axes.set_axis_off()
        return figure
    direction = escape.normal
    gains = [0.0]
    for index in (*reversed(escape.loops), 0):
        gains.append(float(terminal.disturbances[index].support(direction)[0]))
        direction = direction @ terminal.loops[index]
    reach = np.cumsum(gains)
    steps = len(reach) - 1
    axes.plot(reach, color=OUTSIDE, label="the worst that disturbances do to $e = 0$")
    axes.plot(steps, reach[-1], "o", color=OUTSIDE, markersize=4)
    axes.axhline(escape.offset, **LIMIT, label="constraint")
    axes.set_xlabel(f"steps ({steps} pass the constraint)")
    axes.set_ylabel(f"${row_text(escape.normal)}$, in m and rad")
    axes.legend(loc="lower right")
    return figure
