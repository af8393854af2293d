"""The box of slips and sideslip that holds every window of the commands it is made from.

    right:  min <= i_r <= max      left:  min <= i_l <= max      |v_y + L omega| <= s v

Each number is a side, that extremes of the sample fix: five of them. Where both wheels are taken to
be alike they share an interval, and three sides remain. A margin that widens the box beyond the
extremes promises nothing more.

Source: new; the smallest box around a sample as in Campi and Garatti 2008.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

SIDESLIP_SIDES = 1


class Box(NamedTuple):
    """An interval of slip for each wheel, and the greatest sideslip."""

    right: tuple[float, float]
    left: tuple[float, float]
    sideslip: float
    sides: int  # that a sample has fixed

    def holds(
        self, slips: Float[np.ndarray, "k 2"], sideslips: Float[np.ndarray, "k"]
    ) -> Bool[np.ndarray, "k"]:
        """Tell which windows lie inside; NaN does not."""
        least = np.array([self.right[0], self.left[0]])
        greatest = np.array([self.right[1], self.left[1]])
        inside = np.all((slips >= least) & (slips <= greatest), axis=1)
        return inside & (np.abs(sideslips) <= self.sideslip)


def enclose(
    slips: Float[np.ndarray, "k 2"],
    sideslips: Float[np.ndarray, "k"],
    alike: bool = False,
    margin: float = 0.0,
) -> Box:
    """Return the smallest box around windows.

    Args:
        slips: (right, left).
        sideslips: signed.
        alike: both wheels share an interval.
        margin: slip by which every interval is widened at both ends.
    """
    least = slips.min(axis=0)
    greatest = slips.max(axis=0)
    slip_sides = 4
    if alike:
        least = np.full(2, least.min())
        greatest = np.full(2, greatest.max())
        slip_sides = 2
    right = (float(least[0]) - margin, float(greatest[0]) + margin)
    left = (float(least[1]) - margin, float(greatest[1]) + margin)
    return Box(right, left, float(np.abs(sideslips).max()), slip_sides + SIDESLIP_SIDES)
