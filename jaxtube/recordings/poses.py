"""Poses in the plane: headings from quaternions, units of headings, coordinates far from zero.

Source: B. Siciliano et al., "Robotics: Modelling, Planning and Control" (2009), 2.6, for unit
quaternions; K. Mardia and P. Jupp, "Directional Statistics" (2000), 2.3, for mean resultants.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float, Int

FAR = 1e5
"""Coordinates in m from which on the first point is taken for the origin, as of UTM; floats keep
them to a micrometre, but single-precision tools and figures do not."""

UNIT_QUATERNION = 0.05
"""Largest deviation of a quaternion's norm from 1: more is no rounding."""

LONGEST_WAY = 3.0
"""From one pose to the next that counts in full, by the median of those that move."""

LEAST_ALIGNMENT = 0.3
"""Of headings with the way; noise of a robot that stands lowers it, a wrong axis makes it
negative."""


def find_headings(quaternions: Float[np.ndarray, "n 4"]) -> Float[np.ndarray, "n"]:
    """Return the headings of bodies, rad in (-pi, pi].

    Args:
        quaternions: (x, y, z, w) from the body's frame to the world's.
    """
    x, y, z, w = quaternions.T
    return np.arctan2(2.0 * (w * z + x * y), w * w + x * x - y * y - z * z)


def find_bad_quaternions(quaternions: Float[np.ndarray, "n 4"]) -> Int[np.ndarray, "bad"]:
    """Return the rows whose quaternion is no rotation, NaN included."""
    norms = np.linalg.norm(quaternions, axis=1)
    return np.flatnonzero(~(np.abs(norms - 1.0) <= UNIT_QUATERNION))


def align_headings(positions: Float[np.ndarray, "n 2"], headings: Float[np.ndarray, "n"]) -> float:
    """Return how well headings lie along the way between positions: 1 always along it, forward or
    backward, near 0 for numbers that are no headings.

    Weighted with the way, up to a few times the usual one: poses that jump tell no direction.
    """
    steps = np.diff(positions, axis=0)
    ways = np.hypot(steps[:, 0], steps[:, 1])
    directions = np.arctan2(steps[:, 1], steps[:, 0])
    # Twice the angle does not tell forward from backward.
    turned = np.exp(2j * (directions - headings[:-1]))
    moving = ways[ways > 0.0]
    weights = np.minimum(ways, LONGEST_WAY * np.median(moving)) if len(moving) else ways
    total = float(weights.sum())
    return float((weights * turned).sum().real) / total if total > 0.0 else 0.0


def are_degrees(positions: Float[np.ndarray, "n 2"], headings: Float[np.ndarray, "n"]) -> bool:
    """Say whether headings of unknown unit are in degrees: they leave a full turn of radians, and
    lie along the way better if they are."""
    if np.abs(headings).max(initial=0.0) <= 2.0 * np.pi:
        return False
    in_degrees = align_headings(positions, np.deg2rad(headings))
    return in_degrees > align_headings(positions, headings)


def find_origin(positions: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, "2"]:
    """Return the origin that positions are counted from: the first of them where they are far from
    zero, else zero."""
    is_far = np.abs(positions).max(initial=0.0) > FAR
    return positions[0].copy() if is_far else np.zeros(2)


def describe_headings(
    positions: Float[np.ndarray, "n 2"], headings: Float[np.ndarray, "n"]
) -> tuple[str, ...]:
    """Return a warning, a clause, where headings do not lie along the way."""
    alignment = align_headings(positions, headings)
    if alignment >= LEAST_ALIGNMENT or not np.ptp(positions, axis=0).any():
        return ()
    return (
        f"headings do not lie along the way (mean of cos 2 angle {alignment:.2f}): they should be "
        "counter-clockwise from the axis x",
    )


def describe_origin(origin: Float[np.ndarray, "2"]) -> tuple[str, ...]:
    """Return what positions are counted from, in words, where it is not zero."""
    if not origin.any():
        return ()
    return (f"positions from ({float(origin[0])!r}, {float(origin[1])!r}) m",)
