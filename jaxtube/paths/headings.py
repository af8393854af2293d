"""Headings of a recorded path: whether they are its robot's, and where it drives against them.

Source: new.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float

from jaxtube.paths.cells import Chain
from jaxtube.paths.turns import find_direction, wrap_angles
from jaxtube.recordings.path import RawPath

SAME_DIRECTION = np.deg2rad(30.0)
"""Angle between heading and motion, in the median of a path, up to which headings are believed."""

FEWEST_CELLS = 3
"""A shorter chain has no direction of motion."""


def find_heading_problem(raw: RawPath, chain: Chain) -> str:
    """Say why the headings of a path cannot be its robot's; empty where they can be, and where it
    has none.

    A robot that reverses has its heading against its motion: both senses count as fitting.
    """
    if raw.headings is None or len(chain.means) < FEWEST_CELLS:
        return ""
    angles = np.abs(_angles_to_motion(raw, chain))
    off = np.median(np.minimum(angles, np.pi - angles))
    if off < SAME_DIRECTION:
        return ""
    return (
        f"headings are off the direction of motion by {np.degrees(off):.0f} deg in half of the "
        "path, and not used; give them in rad, from the x axis to the left"
    )


def find_reversing(raw: RawPath, chain: Chain) -> Bool[np.ndarray, " cells"]:
    """Return in which cells the robot moves against its heading."""
    return np.abs(_angles_to_motion(raw, chain)) > np.pi / 2.0


def _angles_to_motion(raw: RawPath, chain: Chain) -> Float[np.ndarray, " cells"]:
    """Return the angles from the motion to the heading of each cell, rad."""
    assert raw.headings is not None
    middle = (chain.first + chain.last) // 2
    motion = find_direction(np.gradient(chain.means, axis=0))
    return wrap_angles(raw.headings[middle] - motion)
