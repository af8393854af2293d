"""Figures of a design's sets: the tubes, the tightened sets, the terminal set, and realisations
inside the tube.

Sets of (e_x, e_y, e_theta) are drawn in three dimensions and as projections onto the three
coordinate planes: the convex hull of the projected vertices. Ellipsoids {e : e^T P e <= c} project
to {x : x^T (P^-1)_xx^-1 x <= c}.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import MaxNLocator
from mpl_toolkits.mplot3d.art3d import Line3DCollection, Poly3DCollection
from mpl_toolkits.mplot3d.axes3d import Axes3D
from scipy.spatial import ConvexHull

from jaxtube.experiments.figures.style import (
    ERRORS,
    LIMIT,
    TO_DISPLAY,
    UNITS,
    Line,
    bottom_legend,
    draw_polygon,
    error_label,
    line_keys,
    mark_key,
    page_figure,
    styled,
)
from jaxtube.experiments.run.metrics import tube_margins
from jaxtube.synthesis.design import Design
from jaxtube.synthesis.tightening import ERROR_NAMES
from sets.polytope import Polytope

PLANES = ((0, 1), (0, 2), (1, 2))
TUBES = {
    "paper": Line("paper, eq. (27)", "#D55E00"),
    "summed": Line("summed", "#56B4E9"),
    "hull": Line("hull", "black", (0, (2, 1.5))),
    "sequence": Line("sequence, widest window", "#009E73"),
}
"""From the outermost to the innermost."""

IN_MILLIMETRES = np.array([1e3, 1e3, np.rad2deg(1.0)])
SMALL_UNITS = ("mm", "mm", "deg")
INSIDE, OUTSIDE = "#0072B2", "#D55E00"
STAGES = 5
"""Sections shown side by side."""

BOX = (1.0, 1.0, 0.75)
AZIMUTH, ELEVATION = -55, 20
"""The three-dimensional view: sides of the box, and where the viewer stands, deg."""

FLAT = 1e-6
"""Sets thinner than this share of the box are drawn as their corners."""

SMOOTH = 1 - 1e-9
"""Triangles whose normals agree to this cosine are one facet: no edge is drawn between them."""


@styled
def tube_sections(design: Design) -> Figure:
    """Draw the last section of the four tubes in three dimensions, and all sections projected onto
    the planes."""
    lines = {name: line for name, line in TUBES.items() if name in design.tubes}
    corners = {
        name: [section.vertices() * IN_MILLIMETRES for section in design.tubes[name][1:]]
        for name in lines
    }
    figure = page_figure(6.0)
    last = f"R_{{{design.problem.horizon}}}"
    solid, planes = _views(
        figure, SMALL_UNITS, f"${last}$", f"projections of $R_1, \\ldots, {last}$"
    )
    outermost = next(iter(corners.values()))[-1]
    for name, sections in reversed(corners.items()):
        _draw_solid(solid, sections[-1], outermost, lines[name])
    for axes, plane in planes:
        for name, sections in corners.items():
            for section in sections:
                _draw_projection(
                    axes, section, plane, lines[name], 1.2 if section is sections[-1] else 0.7
                )
    bottom_legend(figure, line_keys(lines.values()), columns=4)
    return figure


def _views(figure: Figure, units, title: str, plane_title: str) -> tuple[Axes3D, list]:
    """Return a three-dimensional panel, and three panels with the coordinate plane that each shows."""
    grid = figure.add_gridspec(2, 2)
    solid: Axes3D = figure.add_subplot(grid[0, 0], projection="3d")  # pyright: ignore[reportAssignmentType]
    _label_solid(solid, units, f"(a) {title}")
    planes = []
    for cell, plane, letter in zip(
        (grid[0, 1], grid[1, 0], grid[1, 1]), PLANES, "bcd", strict=True
    ):
        axes = figure.add_subplot(cell)
        axes.set_xlabel(error_label(plane[0], unit=units[plane[0]]))
        axes.set_ylabel(error_label(plane[1], unit=units[plane[1]]))
        axes.set_title(f"({letter}) {plane_title}")
        axes.margins(0.06)
        planes.append((axes, plane))
    return solid, planes


def _draw_projection(
    axes: Axes, points: Float[np.ndarray, "v 3"], plane, line: Line, linewidth: float = 1.2
) -> None:
    draw_polygon(
        axes, points[:, plane], edgecolor=line.colour, linestyle=line.dashes, linewidth=linewidth
    )


def _draw_solid(
    axes: Axes3D, points: Float[np.ndarray, "v 3"], largest: Float[np.ndarray, "k 3"], line: Line
) -> None:
    """Draw what the viewer sees of a hull: faces see-through, edges as lines; the innermost of
    nested sets comes first.

    `largest` is the outermost set of the picture, which fills the box.
    """
    axes.auto_scale_xyz(*largest.T)
    size = np.ptp(largest, axis=0)
    # Angles are those of the picture: what faces the viewer is found in the coordinates of the box.
    boxed = (points - points.mean(axis=0)) / np.where(size > 0, size, 1.0) * BOX
    if np.linalg.matrix_rank(boxed, tol=FLAT) < 3:
        axes.plot(*points.T, ".", color=line.colour)
        return
    hull = ConvexHull(boxed)
    azimuth, elevation = np.deg2rad([AZIMUTH, ELEVATION])
    towards = [
        np.cos(elevation) * np.cos(azimuth),
        np.cos(elevation) * np.sin(azimuth),
        np.sin(elevation),
    ]
    normals = hull.equations[:, :3]
    seen = normals @ towards > 0
    edges = [
        points[np.intersect1d(hull.simplices[i], hull.simplices[j])]
        for i, neighbours in enumerate(hull.neighbors)
        for j in neighbours
        if i < j and (seen[i] or seen[j]) and normals[i] @ normals[j] < SMOOTH
    ]
    faces = Poly3DCollection(
        list(points[hull.simplices[seen]]), facecolor=line.colour, edgecolor="none", alpha=0.2
    )
    for collection in (
        faces,
        Line3DCollection(edges, color=line.colour, linestyle=line.dashes, linewidth=0.7),
    ):
        collection.set_zorder(len(axes.collections))
        axes.add_collection3d(collection)


def _label_solid(axes: Axes3D, units, title: str) -> None:
    axes.computed_zorder = False
    axes.set(
        xlabel=error_label(0, unit=units[0]), ylabel=error_label(1, unit=units[1]), title=title
    )
    axes.set_zlabel(error_label(2, unit=units[2]), labelpad=-4)
    for axis in (axes.xaxis, axes.yaxis, axes.zaxis):
        axis.set_major_locator(MaxNLocator(4))
        axis.set_tick_params(pad=-2)
    axes.xaxis.labelpad = axes.yaxis.labelpad = -4
    axes.set_proj_type("ortho")
    axes.set_box_aspect(BOX, zoom=0.92)  # pyright: ignore[reportArgumentType]
    axes.view_init(elev=ELEVATION, azim=AZIMUTH)


@styled
def tightened_sets(design: Design) -> Figure:
    """Draw what the tube leaves of E, coordinate by coordinate, and of U, in the first window of
    the reference."""
    problem, window = design.problem, int(design.windows.index[0])
    N, bounds = problem.horizon, design.bounds
    figure = page_figure(4.4)
    panels = figure.subplots(2, 3)
    last = Polytope(bounds.terminal_normals, bounds.terminal[window])
    for coordinate, axes in enumerate(panels[0]):
        scale, whole = TO_DISPLAY[coordinate], problem.operating_set.offsets[coordinate]
        left = bounds.errors[window, :, coordinate] * scale
        axes.stairs(left, np.arange(N + 1) - 0.5, baseline=None, color=INSIDE, linewidth=1.2)
        axes.plot(np.arange(N), left, "o", color=INSIDE, markersize=3)
        axes.plot(N, last.support(np.eye(3)[coordinate]) * scale, "D", color=OUTSIDE, markersize=4)
        axes.axhline(whole * scale, **LIMIT)
        axes.set(
            xlabel="stage $j$", ylabel=error_label(coordinate, absolute=True), xlim=(-0.7, N + 0.7)
        )
        axes.xaxis.set_major_locator(MaxNLocator(integer=True))
        axes.set_title(f"({'abc'[coordinate]}) {ERROR_NAMES[coordinate]}")
    _draw_input_sets(panels[1, 0], panels[1, 1], design, window)
    keys = [
        Line2D([], [], label="limits of $\\mathcal{E}$ and $\\mathcal{U}$", **LIMIT),
        Line2D([], [], color=INSIDE, marker="o", markersize=3, label="bounds of $\\mathcal{E}_j$"),
        mark_key("reach of the constraint on $e_N$", OUTSIDE, marker="D"),
        Patch(
            facecolor=INSIDE,
            edgecolor=INSIDE,
            alpha=0.4,
            label=f"$\\mathcal{{U}}_j$, $j = 0, \\ldots, {N - 1}$",
        ),
    ]
    panels[1, 2].set_axis_off()
    title = f"tube: {problem.scenario.controller.tube}"
    panels[1, 2].legend(handles=keys, loc="center left", title=title, alignment="left")
    return figure


def _draw_input_sets(whole: Axes, corner: Axes, design: Design, window: int) -> None:
    """Draw U and the nested U_j, whole and magnified at the corner of the greatest forward demand."""
    bounds = design.bounds.inputs[window]
    corners = design.problem.input_set.vertices()
    tightened = [
        Polytope(design.problem.input_rows.inputs, offsets).vertices() for offsets in bounds
    ]
    for axes in (whole, corner):
        axes.set(xlabel="$u_1$ [m/s]", ylabel="$u_2$ [rad/s]")
        for points in tightened:
            draw_polygon(axes, points, facecolor=INSIDE, alpha=0.15, linewidth=0)
            draw_polygon(axes, points, edgecolor=INSIDE, linewidth=0.6)
        draw_polygon(
            axes, corners, edgecolor=LIMIT["color"], linestyle=LIMIT["linestyle"], linewidth=0.9
        )
    tips = np.stack([points[np.argmin(points[:, 0])] for points in (corners, tightened[-1])])
    width, height = np.ptp(corners, axis=0)
    depth, slope = max(np.ptp(tips[:, 0]), 0.01 * width), height / width
    corner.set(
        xlim=tips[0, 0] + depth * np.array([-0.2, 1.8]),
        ylim=tips[0, 1] + depth * slope * np.array([-1, 1]),
    )
    whole.set_title("(d) $\\mathcal{U}_j$")
    corner.set_title("(e) $\\mathcal{U}_j$, left corner")


@styled
def terminal_set(design: Design) -> Figure:
    """Draw the invariant sets, the constraint on e_N and an ellipsoid of the terminal cost, or why
    there is none.

    The ellipsoid is the largest level set of e^T P e inside the maximal invariant set.
    """
    maximal, invariant = design.terminal.maximal.polytope, design.terminal.invariant
    if maximal is None or invariant is None:
        return _no_terminal_set(design)
    window = int(design.windows.index[0])
    constraint = Polytope(design.bounds.terminal_normals, design.bounds.terminal[window])
    sets = {
        "maximal": maximal,
        "invariant": invariant,
        "constraint": constraint,
        "limits": design.problem.operating_set,
    }
    corners = {name: polytope.vertices() * TO_DISPLAY for name, polytope in sets.items()}
    facets = f"set of {len(invariant.offsets)} facets"
    lines = {
        "limits": Line("$\\mathcal{E}$", LIMIT["color"], LIMIT["linestyle"]),
        "maximal": Line("largest invariant set", "#0072B2"),
        "invariant": Line(facets, "#D55E00", (0, (3, 1.5))),
        "constraint": Line("constraint on $e_N$", "#009E73"),
    }
    ellipsoid = Line("level set of $e^\\top P\\,e$", "#CC79A7")
    shape = np.linalg.inv(design.cost.cost)
    reach = np.einsum("fi,ij,fj->f", maximal.normals, shape, maximal.normals)
    shape *= np.min(maximal.offsets**2 / reach)
    figure = page_figure(6.2)
    solid, planes = _views(figure, UNITS, f"{facets} and constraint on $e_N$", "projections")
    _draw_solid(solid, corners["constraint"], corners["invariant"], lines["constraint"])
    _draw_solid(
        solid, corners["invariant"], corners["invariant"], lines["invariant"]._replace(dashes="-")
    )
    for axes, plane in planes:
        for name, line in lines.items():
            _draw_projection(axes, corners[name], plane, line)
        curve = _ellipse(shape[np.ix_(plane, plane)]) * TO_DISPLAY[list(plane)]
        axes.plot(*curve.T, color=ellipsoid.colour)
    bottom_legend(figure, line_keys([*lines.values(), ellipsoid]), columns=5)
    return figure


def _ellipse(covariance: Float[np.ndarray, "2 2"]) -> Float[np.ndarray, "200 2"]:
    """Return points on the boundary of {x : x^T covariance^-1 x <= 1}."""
    angles = np.linspace(0, 2 * np.pi, 200)
    return np.column_stack([np.cos(angles), np.sin(angles)]) @ np.linalg.cholesky(covariance).T


def _no_terminal_set(design: Design) -> Figure:
    """Say that no invariant set exists, and draw how disturbances carry the origin past a
    constraint."""
    figure, terminal = page_figure(2.8), design.terminal
    axes = figure.subplots()
    axes.set(title="No invariant terminal set: $e_N$ is kept in $\\mathcal{E} - R_N$ instead")
    escape = terminal.maximal.escape
    if escape is None:
        axes.text(0.5, 0.5, "none was found", transform=axes.transAxes, ha="center")
        axes.set_axis_off()
        return figure
    direction, gains = escape.normal, [0.0]
    for index in (*reversed(escape.loops), 0):
        gains.append(float(terminal.disturbance.support(direction)[0]))
        direction = direction @ terminal.loops[index]
    reach = np.cumsum(gains)
    axes.plot(reach, color=OUTSIDE, label="the worst that disturbances do to $e = 0$")
    axes.plot(len(reach) - 1, reach[-1], "o", color=OUTSIDE, markersize=4)
    axes.axhline(escape.offset, **LIMIT, label="constraint")
    axes.set(
        xlabel=f"steps ({len(reach) - 1} pass the constraint)",
        ylabel=f"${_row_text(escape.normal)}$, in m and rad",
    )
    axes.legend(loc="lower right")
    return figure


def _row_text(normal: Float[np.ndarray, "3"]) -> str:
    """Return a constraint's row as text, such as e_y - 0.5 e_theta."""
    terms = [
        f"{value:+.3g}\\,{letter}" for value, letter in zip(normal, ERRORS, strict=True) if value
    ]
    return "".join(terms).replace("+1\\,", "+").replace("-1\\,", "-").removeprefix("+")


@styled
def realisations_in_tube(
    design: Design, deviations: Float[np.ndarray, "horizon samples 3"]
) -> Figure:
    """Draw how far followed plans deviate from their predictions, against the tube in use.

    Args:
        design: gives the tube; for `sequence` the one along the widest window.
        deviations: e - e_nominal at stages 1..N, (m, m, rad).
    """
    tube = design.problem.scenario.controller.tube
    sections = design.tubes[tube][1:]
    outside = ~(tube_margins(design, deviations) >= 0)
    N = len(sections)
    stages = np.unique(np.linspace(0, N - 1, min(N, STAGES)).round().astype(int))
    figure = page_figure(3.6)
    panels = figure.subplots(2, len(stages), sharex="row", sharey="row", squeeze=False)
    for column, stage in zip(panels.T, stages, strict=True):
        points, corners = (
            deviations[stage] * IN_MILLIMETRES,
            sections[stage].vertices() * IN_MILLIMETRES,
        )
        for axes, plane in zip(column, ((1, 2), (0, 1)), strict=True):
            for chosen, colour in ((~outside[stage], INSIDE), (outside[stage], OUTSIDE)):
                axes.plot(
                    *points[chosen][:, plane].T,
                    ".",
                    color=colour,
                    markersize=1.5,
                    alpha=0.6,
                    rasterized=True,
                )
            draw_polygon(axes, corners[:, plane], edgecolor="0.1", linewidth=1.2)
            axes.set_xlabel(error_label(plane[0], unit=SMALL_UNITS[plane[0]]))
        column[0].set_title(f"$j = {stage + 1}$: {100 * outside[stage].mean():.1f} % outside")
    for axes, coordinate in zip(panels[:, 0], (2, 1), strict=True):
        axes.set_ylabel(error_label(coordinate, unit=SMALL_UNITS[coordinate]))
    keys = [
        mark_key("deviation inside $R_j$", INSIDE),
        mark_key("deviation outside $R_j$", OUTSIDE),
    ]
    keys += line_keys([Line(f"$R_j$ (tube: {tube}), projected", "0.1")])
    bottom_legend(figure, keys)
    return figure
