"""The figure of the plan that leaves its tube furthest: in the section of its stage, and stage by
stage."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Patch
from matplotlib.ticker import MaxNLocator

from jaxtube.falsification.worst import Worst
from jaxtube.figures.style import (
    INSIDE,
    LIMIT,
    MILLIMETRES,
    OUTSIDE,
    bottom_legend,
    draw_polygon,
    label_plane,
    line_key,
    mark_key,
    page_figure,
    row_text,
    styled,
)
from jaxtube.simulation.usage import Replay, read_values
from jaxtube.synthesis.parts import Design
from sets.tubes import Section

FACET = {"color": OUTSIDE, "linewidth": 2.2, "solid_capstyle": "butt"}
EDGE_ON = 1e-9
"""Entry of a unit normal below which its facet is seen edge-on."""


@styled
def worst_section(design: Design, worst: Worst, played: Replay) -> Figure:
    """Draw the deviation from the plan that goes furthest, in the section of its stage and along
    its facet.

    The facet is drawn in the planes in which it is seen edge-on; seen from any other side it hides
    the section.

    Args:
        design: gives the tube in use; of `sequence` that of the widest window.
        worst, played: the worst case of the limit `tube` and its replay.
    """
    sections = design.tube
    stage = worst.step - worst.when
    deviations = read_values("tube", played)
    normal = sections[stage].polytope().normals[worst.facet]
    planes = _choose_planes(normal)
    figure = page_figure(2.9)
    panels = figure.subplots(1, 3, width_ratios=(1, 1, 0.9))
    path = deviations[: stage + 1] * MILLIMETRES.factors
    for axes, plane in zip(panels, planes, strict=False):
        _draw_section(axes, sections[stage], worst.facet, plane)
        _draw_deviation(axes, path[:, plane])
        label_plane(axes, plane, MILLIMETRES)
        axes.margins(0.12)
    panels[0].set_title(f"$R_{{{stage}}}$ and the deviation")
    panels[1].set_title(f"facet: bound of ${row_text(normal)}$")
    _draw_usage(panels[2], sections[1:], deviations[1:])
    keys = [
        line_key("$e - \\bar e$ after $j$ steps", color=INSIDE, marker="o", markersize=2.5),
        mark_key("worst stage", OUTSIDE),
        Patch(facecolor="0.94", edgecolor="0.1", label=f"$R_{{{stage}}}$, projected"),
    ]
    if any(_is_edge_on(normal, plane) for plane in planes):
        keys.append(line_key("the facet", **FACET))
    bottom_legend(figure, keys, columns=4)
    return figure


def _choose_planes(normal: Float[np.ndarray, "3"]) -> tuple[tuple[int, int], tuple[int, int]]:
    """Return two planes; those in which the facet is seen edge-on come first."""
    planes = sorted([(1, 2), (0, 1), (0, 2)], key=lambda plane: not _is_edge_on(normal, plane))
    return planes[0], planes[1]


def _is_edge_on(normal: Float[np.ndarray, "3"], plane: tuple[int, int]) -> bool:
    """Tell whether a facet is a line in the projection onto a plane of two coordinates."""
    (across,) = set(range(3)) - set(plane)
    return bool(abs(normal[across]) <= EDGE_ON * np.linalg.norm(normal))


def _draw_section(axes: Axes, section: Section, facet: int, plane: tuple[int, int]) -> None:
    """Draw the projection of a section, and one of its facets where that is a line."""
    polytope = section.polytope()
    normal = polytope.normals[facet]
    corners = section.vertices()
    on_facet = np.abs(corners @ normal - polytope.offsets[facet]) <= 1e-9
    shown = (corners * MILLIMETRES.factors)[:, plane]
    draw_polygon(axes, shown, edgecolor="0.1", facecolor="0.94", linewidth=1.0)
    if _is_edge_on(normal, plane):
        line = shown[on_facet]
        along = line @ np.array([normal[plane[1]], -normal[plane[0]]])
        ends = line[[np.argmin(along), np.argmax(along)]]
        axes.plot(ends[:, 0], ends[:, 1], **FACET)


def _draw_deviation(axes: Axes, path: Float[np.ndarray, "stages 2"]) -> None:
    """Draw the deviation by stage, numbered, up to the worst one."""
    axes.plot(path[:, 0], path[:, 1], color=INSIDE, marker="o", markersize=2.5)
    axes.plot(path[-1, 0], path[-1, 1], "o", color=OUTSIDE, markersize=4.5, zorder=5)
    for stage, place in enumerate(path[1:], start=1):
        look = {"xytext": (3, 3), "textcoords": "offset points", "fontsize": 7}
        axes.annotate(str(stage), (place[0], place[1]), **look)


def _draw_usage(
    axes: Axes, sections: list[Section], deviations: Float[np.ndarray, "horizon 3"]
) -> None:
    """Draw how much of the nearest facet of its section the deviation uses, stage by stage."""
    usage = []
    for section, deviation in zip(sections, deviations, strict=True):
        polytope = section.polytope()
        usage.append(np.max(polytope.normals @ deviation / polytope.offsets))
    colours = [OUTSIDE if share > 1 else INSIDE for share in usage]
    stages = np.arange(1, len(sections) + 1)
    axes.bar(stages, 100 * np.array(usage), color=colours, width=0.6)
    axes.axhline(100, **LIMIT)
    axes.set(xlabel="stage $j$", ylabel="nearest facet of $R_j$ used [%]")
    axes.xaxis.set_major_locator(MaxNLocator(integer=True))
