"""A convex set in three dimensions, drawn as a lit solid of which the hidden side is left out."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float
from matplotlib.colors import to_rgb
from matplotlib.ticker import MaxNLocator
from mpl_toolkits.mplot3d.art3d import Poly3DCollection
from mpl_toolkits.mplot3d.axes3d import Axes3D
from scipy.spatial import ConvexHull

from jaxtube.figures.style import Scale, error_label

BOX = (1.0, 1.0, 0.75)
"""Sides of the box that the picture fills."""
AZIMUTH = -55
ELEVATION = 20
"""Where the viewer stands, deg."""
LIGHT = np.array([-0.3, -0.75, 0.6])
"""Direction towards the lamp, in the coordinates of the box."""
DARKEST = 0.75
BRIGHTEST = 0.2
"""Shares of its colour that a facet has which faces away from the lamp, and towards it."""

FLAT = 1e-6
"""Sets thinner than this share of the box are drawn as their corners."""
ROUNDING = 6
"""Decimals to which the planes of two triangles agree that are one facet."""


def draw_solid(axes: Axes3D, points: Float[np.ndarray, "v 3"], colour: str) -> None:
    """Draw what the viewer sees of the convex hull of points."""
    size = np.ptp(points, axis=0)
    # Angles are those of the picture: what faces the viewer is found in the coordinates of the box.
    boxed = (points - points.mean(axis=0)) / np.where(size > 0, size, 1.0) * BOX
    if np.linalg.matrix_rank(boxed, tol=FLAT) < 3:
        axes.plot(points[:, 0], points[:, 1], points[:, 2], ".", color=colour)
        return
    facets = _visible_facets(boxed)
    polygons = [points[corners] for corners, _ in facets]
    faces = [_lit(colour, normal) for _, normal in facets]
    solid = Poly3DCollection(polygons, facecolor=faces, edgecolor="0.2", linewidth=0.4)
    axes.add_collection3d(solid, autolim=False)
    for axis, values in zip((axes.xaxis, axes.yaxis, axes.zaxis), points.T, strict=True):
        axis.set_view_interval(values.min(), values.max(), ignore=True)


def _visible_facets(
    points: Float[np.ndarray, "v 3"],
) -> list[tuple[np.ndarray, Float[np.ndarray, "3"]]]:
    """Return (indices of the corners in order, outer normal) of the facets that face the viewer."""
    azimuth, elevation = np.deg2rad([AZIMUTH, ELEVATION])
    across = np.cos(elevation)
    viewer = [across * np.cos(azimuth), across * np.sin(azimuth), np.sin(elevation)]
    hull = ConvexHull(points)
    planes, facet_of = np.unique(np.round(hull.equations, ROUNDING), axis=0, return_inverse=True)
    facets = []
    for number, plane in enumerate(planes):
        normal = plane[:3]
        if normal @ viewer > 0:
            corners = np.unique(hull.simplices[facet_of.ravel() == number])
            facets.append((_in_order(points, corners), normal))
    return facets


def _in_order(points: Float[np.ndarray, "v 3"], corners: np.ndarray) -> np.ndarray:
    """Return the corners of a plane polygon in the order of its edge."""
    away = points[corners] - points[corners].mean(axis=0)
    plane = np.linalg.svd(away)[2][:2]
    first, second = plane @ away.T
    return corners[np.argsort(np.arctan2(second, first))]


def _lit(colour: str, normal: Float[np.ndarray, "3"]) -> tuple[float, float, float]:
    """Return the colour of a facet: paler the more it faces the lamp."""
    facing = max(normal @ LIGHT / np.linalg.norm(LIGHT), 0.0)
    share = DARKEST + (BRIGHTEST - DARKEST) * facing
    red, green, blue = 1 - share * (1 - np.array(to_rgb(colour)))
    return red, green, blue


def prepare_solid(axes: Axes3D, scale: Scale, title: str) -> None:
    """Set view, box and labels of a panel for a solid."""
    axes.set_title(title)
    axes.set_xlabel(error_label(0, scale), labelpad=-4)
    axes.set_ylabel(error_label(1, scale), labelpad=-4)
    axes.set_zlabel(error_label(2, scale), labelpad=-4)
    for axis in (axes.xaxis, axes.yaxis, axes.zaxis):
        axis.set_major_locator(MaxNLocator(4))
        axis.set_tick_params(pad=-2)
    axes.set_proj_type("ortho")
    axes.set_box_aspect(BOX, zoom=0.92)  # pyright: ignore[reportArgumentType]
    axes.view_init(elev=ELEVATION, azim=AZIMUTH)
