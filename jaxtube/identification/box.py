"""The box of slips and sideslip that holds every window of the commands it is made from.

    right:  min <= i_r <= max      left:  min <= i_l <= max      |v_y + L omega| <= s v

Each number is a side that extremes of the sample fix: five of them. Fewer sides promise more from
the same commands, and make a box that is no smaller:

    each     an interval for each wheel, and the sideslip                            5 sides
    alike    one interval for both wheels, and the sideslip                          3 sides
    scaled   the box of the commands that fitted the track, blown up by one factor   1 side

A margin that widens the box beyond the extremes promises nothing more.

Source: new; the smallest box around a sample as in Campi and Garatti 2008.
"""

from __future__ import annotations

from typing import Literal, NamedTuple

import numpy as np
from jaxtyping import Bool, Float

BoxKind = Literal["each", "alike", "scaled"]

SIDES: dict[BoxKind, int] = {"each": 5, "alike": 3, "scaled": 1}
"""That extremes of a sample fix, by kind."""

SMALLEST = 1e-6
"""Half width of an interval that is blown up."""


class Box(NamedTuple):
    """An interval of slip for each wheel, and the greatest sideslip."""

    right: tuple[float, float]
    left: tuple[float, float]
    sideslip: float

    @property
    def middle(self) -> Float[np.ndarray, "2"]:
        """Middle of the intervals (right, left)."""
        return np.array([sum(self.right), sum(self.left)]) / 2.0

    def holds(
        self, slips: Float[np.ndarray, "k 2"], sideslips: Float[np.ndarray, "k"]
    ) -> Bool[np.ndarray, "k"]:
        """Tell which windows lie inside; NaN does not."""
        least = np.array([self.right[0], self.left[0]])
        greatest = np.array([self.right[1], self.left[1]])
        inside = np.all((slips >= least) & (slips <= greatest), axis=1)
        return inside & (np.abs(sideslips) <= self.sideslip)

    def widen(self, margin: float) -> Box:
        """Return the box with every interval of slip wider by a margin at both ends."""
        right = (self.right[0] - margin, self.right[1] + margin)
        left = (self.left[0] - margin, self.left[1] + margin)
        return Box(right, left, self.sideslip)


def enclose(slips: Float[np.ndarray, "k 2"], sideslips: Float[np.ndarray, "k"]) -> Box:
    """Return the smallest box around windows.

    Args:
        slips: (right, left).
        sideslips: signed.
    """
    right, left = np.column_stack([slips.min(axis=0), slips.max(axis=0)]).tolist()
    return Box(tuple(right), tuple(left), float(np.abs(sideslips).max()))


def make_alike(box: Box) -> Box:
    """Return the smallest box with one interval for both wheels around a box."""
    both = (min(box.right[0], box.left[0]), max(box.right[1], box.left[1]))
    return Box(both, both, box.sideslip)


def blow_up(shape: Box, slips: Float[np.ndarray, "k 2"], sideslips: Float[np.ndarray, "k"]) -> Box:
    """Return a box about its middle times the least factor at which it holds windows, one at
    least."""
    half = np.maximum(np.ptp([shape.right, shape.left], axis=1) / 2.0, SMALLEST)
    side = max(shape.sideslip, SMALLEST)
    off = float((np.abs(slips - shape.middle) / half).max())
    factor = max(1.0, off, float(np.abs(sideslips).max()) / side)
    least = shape.middle - factor * half
    greatest = shape.middle + factor * half
    right, left = np.column_stack([least, greatest]).tolist()
    return Box(tuple(right), tuple(left), factor * side)
