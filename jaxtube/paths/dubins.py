"""Dubins' paths: from a pose to many others along arcs of one radius and straight lines.

    LSL, RSR, LSR, RSL, RLR, LRL      three pieces each, lengths in radii

The shortest path of a bounded curvature from pose to pose is one of these six.

Sources: Dubins, American Journal of Mathematics 1957; the lengths are those of Shkel, Lumelsky,
Robotics and Autonomous Systems 2001.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

TURN = 2.0 * np.pi

ROUNDING = 1e-9
"""Angle in rad that is none: a turn to the left by so much less than nothing is no whole turn."""

SIDES = np.array([[1, 0, 1], [-1, 0, -1], [1, 0, -1], [-1, 0, 1], [-1, 1, -1], [1, -1, 1]])
"""Of the pieces of each path: 1 to the left, -1 to the right, 0 straight."""


def find_paths(
    start: Float[np.ndarray, "3"], ends: Float[np.ndarray, "k 3"], radius: float
) -> Float[np.ndarray, "k 6 3"]:
    """Return the lengths of the pieces of all six paths to each end, m; infinite for a path that
    does not exist.

    Args:
        start: (x m, y m, heading rad).
        ends: likewise.
        radius: of all arcs, m.
    """
    offset = ends[:, :2] - start[:2]
    distance = np.linalg.norm(offset, axis=1) / radius
    direction = np.arctan2(offset[:, 1], offset[:, 0])
    alpha = start[2] - direction
    beta = ends[:, 2] - direction
    with np.errstate(invalid="ignore"):
        pieces = np.stack(
            [
                *_find_outer(distance, alpha, beta),
                *_find_inner(distance, alpha, beta),
                *_find_curls(distance, alpha, beta),
            ],
            axis=1,
        )
    missing = np.isnan(pieces).any(axis=2)
    pieces[missing] = np.inf
    return radius * pieces


def find_headings(
    pieces: Float[np.ndarray, "3"],
    sides: Float[np.ndarray, "3"],
    radius: float,
    lengths: Float[np.ndarray, " n"],
) -> Float[np.ndarray, " n"]:
    """Return by how much a path has turned, to the left, after lengths along it, rad."""
    ends = np.concatenate([[0.0], np.cumsum(pieces)])
    turned = np.concatenate([[0.0], np.cumsum(sides * pieces / radius)])
    return np.interp(lengths, ends, turned)


def _wrap(angles: Float[np.ndarray, " k"]) -> Float[np.ndarray, " k"]:
    """Return angles in [0, 2 pi); those that rounding has put just below 0 are 0."""
    wrapped = np.mod(angles, TURN)
    return np.where(TURN - wrapped < ROUNDING, 0.0, wrapped)


def _stack(first, middle, last) -> Float[np.ndarray, "k 3"]:
    return np.stack([_wrap(first), middle, _wrap(last)], axis=-1)


def _find_outer(d, alpha, beta) -> list[Float[np.ndarray, "k 3"]]:
    """Return LSL and RSR."""
    sines = np.sin(alpha) - np.sin(beta)
    cosines = np.cos(beta) - np.cos(alpha)
    left = np.sqrt((d + sines) ** 2 + cosines**2)
    heading = np.arctan2(cosines, d + sines)
    right = np.sqrt((d - sines) ** 2 + cosines**2)
    opposite = np.arctan2(-cosines, d - sines)
    return [
        _stack(heading - alpha, left, beta - heading),
        _stack(alpha - opposite, right, opposite - beta),
    ]


def _find_inner(d, alpha, beta) -> list[Float[np.ndarray, "k 3"]]:
    """Return LSR and RSL."""
    sines = np.sin(alpha) + np.sin(beta)
    cosines = np.cos(alpha) + np.cos(beta)
    left = np.sqrt((d + sines) ** 2 + cosines**2 - 4.0)
    heading = np.arctan2(-cosines, d + sines) - np.arctan2(-2.0, left)
    right = np.sqrt((d - sines) ** 2 + cosines**2 - 4.0)
    opposite = np.arctan2(cosines, d - sines) - np.arctan2(2.0, right)
    return [
        _stack(heading - alpha, left, heading - beta),
        _stack(alpha - opposite, right, beta - opposite),
    ]


def _find_curls(d, alpha, beta) -> list[Float[np.ndarray, "k 3"]]:
    """Return RLR and LRL."""
    sines = np.sin(alpha) - np.sin(beta)
    chord = 2.0 * np.cos(alpha - beta)
    right = _wrap(-np.arccos((6.0 - d**2 + chord + 2.0 * d * sines) / 8.0))
    first_right = alpha - np.arctan2(np.cos(alpha) - np.cos(beta), d - sines) + right / 2.0
    left = _wrap(-np.arccos((6.0 - d**2 + chord - 2.0 * d * sines) / 8.0))
    first_left = -alpha + np.arctan2(np.cos(beta) - np.cos(alpha), d + sines) + left / 2.0
    return [
        _stack(first_right, right, alpha - beta - first_right + right),
        _stack(first_left, left, beta - alpha - first_left + left),
    ]
