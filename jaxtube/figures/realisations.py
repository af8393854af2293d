"""The figure of followed plans: how far they deviate from what was predicted, against the tube."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from jaxtube.figures.style import (
    INSIDE,
    MILLIMETRES,
    OUTSIDE,
    Line,
    bottom_legend,
    draw_polygon,
    error_label,
    line_keys,
    mark_key,
    page_figure,
    styled,
)
from jaxtube.synthesis.parts import Design
from sets.polytope import Polytope

STAGES = 5
"""Sections shown side by side."""
SHOWN_PLANES = ((1, 2), (0, 1))
"""Planes of the rows."""
ROUNDING = 1e-9
"""Distance beyond a facet of a projection that is rounding, mm or deg."""


@styled
def realisations_in_tube(
    design: Design, deviations: Float[np.ndarray, "horizon samples 3"]
) -> Figure:
    """Draw how far followed plans deviate from their predictions, against the tube in use.

    The title of a column counts deviations outside R_j; in the panels below, a deviation has the
    colour of the projection that is drawn, which it may be inside of all the same.

    Args:
        design: gives the tube; for `sequence` the one along the widest window.
        deviations: e - e_nominal at stages 1..N, (m, m, rad).
    """
    sections = design.tube[1:]
    outside = ~(design.tube.margins(deviations) >= 0)
    last = len(sections) - 1
    stages = np.unique(np.linspace(0, last, min(last + 1, STAGES)).round().astype(int))
    figure = page_figure(3.6)
    panels = figure.subplots(2, len(stages), sharex="row", sharey="row", squeeze=False)
    for column, stage in zip(panels.T, stages, strict=True):
        points = deviations[stage] * MILLIMETRES.factors
        corners = sections[stage].vertices() * MILLIMETRES.factors
        for axes, plane in zip(column, SHOWN_PLANES, strict=True):
            _draw_cloud(axes, points[:, plane], corners[:, plane])
            axes.set_xlabel(error_label(plane[0], MILLIMETRES))
        share = 100 * outside[stage].mean()
        column[0].set_title(f"{share:.1f} % outside $R_{{{stage + 1}}}$")
    for axes, plane in zip(panels[:, 0], SHOWN_PLANES, strict=True):
        axes.set_ylabel(error_label(plane[1], MILLIMETRES))
    keys = [
        mark_key("deviation inside what is drawn of $R_j$", INSIDE),
        mark_key("outside", OUTSIDE),
        *line_keys([Line(f"$R_j$ of the tube “{design.tube.name}”, projected", "0.1")]),
    ]
    bottom_legend(figure, keys)
    return figure


def _draw_cloud(
    axes: Axes, points: Float[np.ndarray, "samples 2"], corners: Float[np.ndarray, "v 2"]
) -> None:
    """Draw points around a polygon, those outside it in another colour."""
    outside = ~(Polytope.from_vertices(corners).margin(points) >= -ROUNDING)
    _draw_points(axes, points[~outside], INSIDE)
    _draw_points(axes, points[outside], OUTSIDE)
    draw_polygon(axes, corners, edgecolor="0.1", linewidth=1.2)


def _draw_points(axes: Axes, points: Float[np.ndarray, "k 2"], colour: str) -> None:
    axes.plot(
        points[:, 0],
        points[:, 1],
        linestyle="none",
        marker=".",
        color=colour,
        markersize=1.5,
        alpha=0.6,
        # An empty picture would take as long as a full one.
        rasterized=len(points) > 0,
    )
