"""Names beside marks, placed so that they cover little and lie close to their own mark.

Every name has the same places around its mark; names take turns at choosing the cheapest one.
"""

from __future__ import annotations

from itertools import product
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.text import Annotation, Text
from matplotlib.transforms import Bbox

ANGLES = np.deg2rad([0, 180, 22.5, -22.5, 157.5, -157.5, 45, -45, 135, -135, 90, -90])
"""Directions from a mark to its name, the best ones first."""
GAPS = np.arange(9.0, 50.0, 4.0)
"""Between a mark and its name, points."""
SWEEPS = 3
LEADER_POINTS = 30

OUTSIDE_COST = 1e3
OVERLAP_COST = 1e3
CROSSING_COST = 40
NEAR_MARK_COST = 20
COVERED_COST = 3
GAP_COST = 0.3
"""Costs of a place: beyond the panel, on another name, leaders that cross or touch, close to a
named mark, on a mark, and a point of distance from its own."""


class Place(NamedTuple):
    """A place for a name, pixels."""

    centre: Float[np.ndarray, "2"]
    box: Bbox
    leader: Float[np.ndarray, "k 2"]  # from the mark to the box
    gap: float  # between mark and box, points


def make_places(
    mark: Float[np.ndarray, "2"], size: Float[np.ndarray, "2"], pixels: float
) -> list[Place]:
    """Return the places around a mark for a name of a size, with so many pixels a point."""
    places = []
    for gap, angle in product(GAPS, ANGLES):
        direction = np.array([np.cos(angle), np.sin(angle)])
        away = gap * pixels * direction + size / 2 * np.clip(1.5 * direction, -1, 1)
        centre = mark + away
        box = Bbox([centre - size / 2, centre + size / 2])
        leader = mark + np.linspace(0, 1, LEADER_POINTS)[:, None] * away
        inside = np.all((leader >= box.min) & (leader <= box.max), axis=1)
        places.append(Place(centre, box, leader[~inside], gap))
    return places


def place_names(figure: Figure, axes: Axes) -> None:
    """Move each name of a panel to where it covers the fewest marks, and no name or leader, close
    to its own mark."""
    pixels = figure.dpi / 72
    panel = axes.get_window_extent()
    names = [text for text in axes.texts if isinstance(text, Annotation)]
    marks = np.concatenate([_covered_pixels(line) for line in axes.lines])
    named = axes.transData.transform([text.xy for text in names]).reshape(-1, 2)
    around = []
    for mark, text in zip(named, names, strict=True):
        size = np.array(Text.get_window_extent(text).size)
        around.append(make_places(mark, size, pixels))
    own = [[_own_cost(place, panel, marks, named, pixels) for place in places] for places in around]
    chosen = [places[int(np.argmin(costs))] for places, costs in zip(around, own, strict=True)]
    # Again and again, for names give way to each other.
    for _ in range(SWEEPS):
        for i, places in enumerate(around):
            others = [*chosen[:i], *chosen[i + 1 :]]
            mutual = [
                sum(_mutual_cost(place, other, pixels) for other in others) for place in places
            ]
            chosen[i] = places[int(np.argmin(np.add(own[i], mutual)))]
    for text, mark, place in zip(names, named, chosen, strict=True):
        offset = (place.centre - mark) / pixels
        text.set(position=(offset[0], offset[1]), ha="center", va="center")


def _own_cost(place: Place, panel: Bbox, marks, named, pixels: float) -> float:
    """Return what a place costs whatever the other names do."""
    box = place.box.padded(1.5 * pixels)
    outside = not (panel.contains(*box.min) and panel.contains(*box.max))
    near = box.padded(4.5 * pixels).count_contains(named)
    covered = box.count_contains(marks)
    return (
        OUTSIDE_COST * outside
        + NEAR_MARK_COST * near
        + COVERED_COST * covered
        + GAP_COST * place.gap
    )


def _mutual_cost(place: Place, other: Place, pixels: float) -> float:
    """Return what a place costs beside another name's."""
    box = place.box.padded(pixels)
    crossed = other.box.count_contains(place.leader) + box.count_contains(other.leader) > 0
    between = place.leader[:, None] - other.leader
    touching = np.hypot(between[..., 0], between[..., 1]).min() < 4 * pixels
    return OVERLAP_COST * box.overlaps(other.box) + CROSSING_COST * (int(crossed) + int(touching))


def _covered_pixels(line: Line2D) -> Float[np.ndarray, "k 2"]:
    """Return the pixels of a line's marks, or many along it where it is drawn through."""
    pixels = line.get_transform().transform(np.asarray(line.get_xydata()))
    if line.get_linestyle() == "None":
        return pixels
    places = np.arange(len(pixels))
    fine = np.linspace(0, len(pixels) - 1, 100 * len(pixels))
    return np.column_stack([np.interp(fine, places, pixels[:, i]) for i in range(2)])
