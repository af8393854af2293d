"""A tree of planes that tells regions of errors apart, learnt from errors whose regions are known.

Neighbours differ by a row that is active in one of them: between them lies the plane where its
multiplier is zero, which is where the row meets its bound. At each place of the tree that of these
planes is taken that leaves least doubt about the region (the entropy of the regions on either
side).

Source: Tondel, Johansen, Bemporad 2003, "Evaluation of piecewise affine control via binary search
tree", Automatica 39(5), for the tree and its planes; the choice by samples is that of Quinlan 1986,
"Induction of decision trees", Machine Learning 1(1).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from jaxtube.qp.regions import DEEPEST

MOST_JUDGED = 256
"""Errors by which the planes of a place are judged."""
MOST_BOUNDED = 6
"""Regions whose planes are judged at a place, the most frequent ones."""


class Tree(NamedTuple):
    """As in `jaxtube.qp.regions`; it begins at plane 0."""

    planes: Float[np.ndarray, "s 4"]
    following: Int[np.ndarray, "s 2"]

    def guess(self, points: Float[np.ndarray, "k 4"]) -> Int[np.ndarray, " k"]:
        """Return the regions of (e, 1)."""
        node = np.zeros(len(points), int)
        going = np.arange(len(points))
        while len(going):
            plane = node[going]
            values = np.sum(self.planes[plane] * points[going], axis=1)
            node[going] = self.following[plane, (values >= 0).astype(int)]
            going = going[node[going] >= 0]
        return ~node


def grow_tree(
    planes: Float[np.ndarray, "r m 4"],
    is_active: Bool[np.ndarray, "r m"],
    points: Float[np.ndarray, "k 4"],
    regions: Int[np.ndarray, " k"],
) -> Tree:
    """Return a tree that tells the regions of points apart.

    Args:
        planes: of each region, where a row becomes active, or idle.
        is_active: which rows are active in each region.
        points: (e, 1), some.
        regions: of the points.
    """
    return _Growth(planes, is_active, points, regions).tree()


class _Growth:
    """A tree that grows."""

    def __init__(
        self,
        planes: Float[np.ndarray, "r m 4"],
        is_active: Bool[np.ndarray, "r m"],
        points: Float[np.ndarray, "k 4"],
        regions: Int[np.ndarray, " k"],
    ):
        self.planes = planes
        self.is_active = is_active
        self.points = points
        self.regions = regions
        self.chosen: list[Float[np.ndarray, "4"]] = []
        self.following: list[tuple[int, int]] = []

    def tree(self) -> Tree:
        """Grow it."""
        end = self._divide(np.arange(len(self.regions)), DEEPEST)
        if end < 0:
            return Tree(np.zeros((1, 4)), np.full((1, 2), end, np.int32))
        return Tree(np.array(self.chosen), np.array(self.following, np.int32))

    def _divide(self, members: Int[np.ndarray, " k"], depth: int) -> int:
        """Return the place where these points are told apart, or where they end."""
        most_frequent = ~int(np.argmax(np.bincount(self.regions[members])))
        plane = self._choose(members[:: 1 + len(members) // MOST_JUDGED]) if depth else None
        if plane is None:
            return most_frequent
        beyond = self.points[members] @ plane >= 0
        if beyond.all() or not beyond.any():
            # Rounding: the plane was chosen by a product of another shape.
            return most_frequent
        place = len(self.chosen)
        self.chosen.append(plane)
        self.following.append((most_frequent, most_frequent))
        near = self._divide(members[~beyond], depth - 1)
        far = self._divide(members[beyond], depth - 1)
        self.following[place] = (near, far)
        return place

    def _choose(self, members: Int[np.ndarray, " k"]) -> Float[np.ndarray, "4"] | None:
        """Return the plane that leaves least doubt; None where there is none, or none divides."""
        present, number, counts = np.unique(
            self.regions[members], return_inverse=True, return_counts=True
        )
        if len(present) == 1:
            return None
        frequent = present[np.argsort(-counts, kind="stable")[:MOST_BOUNDED]]
        rows = np.flatnonzero(self.is_active[frequent].any(axis=0))
        planes = self.planes[np.ix_(frequent, rows)].reshape(-1, 4)
        one_hot = np.eye(len(present), dtype=np.float32)[number]
        beyond = planes @ self.points[members].T >= 0
        far = beyond.astype(np.float32) @ one_hot
        near = counts - far
        doubt = _doubt(far) + _doubt(near)
        doubt[(far.sum(axis=1) == 0) | (near.sum(axis=1) == 0)] = np.inf
        best = np.argmin(doubt)
        return planes[best] if np.isfinite(doubt[best]) else None


def _doubt(counts: Float[np.ndarray, "c r"]) -> Float[np.ndarray, " c"]:
    """Return the entropy of counts, times their sum."""
    total = counts.sum(axis=1)
    return total * np.log(np.maximum(total, 1)) - np.sum(
        counts * np.log(np.maximum(counts, 1)), axis=1
    )
