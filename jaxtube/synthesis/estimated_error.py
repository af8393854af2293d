"""The set S of an estimate's error at corners of the operating set, fast enough for a search.

    s = max over corners  (I - L) (|r| + C s) + L nu

with r what the robot adds to its prediction without noise, and C how much of it the errors of the
estimate make, one by one. `sets.robot.observer` bounds the same over the whole operating set. All
functions take n points of a search at once.

Source: policy iteration by Howard 1960 for the corners that count; else new.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from sets.robot.plant import Kinematics, Period, split_disturbance

SMALL = 1e-3
"""Error of an estimate, m or rad, by which its effect is differenced: linear up to there."""
MOST_POLICIES = 20
FAR = 1e3
"""Bound, m or rad, of an error that grows without one."""


class CornerErrors(NamedTuple):
    """What can happen in a period at corners, the estimate being exact or not.

    Attributes:
        model: what the model misses in the plane, m.
        sliding: what slip and sideslip add in the plane beside the yaw kick, m.
        yaw: the kick, rad.
        speeds: commanded ground speeds (right, left), m/s.
        effects: sizes of what an error of the estimate by one unit (m, m, rad) makes of w in the
            plane, by (coordinate of w, coordinate of the error).
    """

    model: Float[np.ndarray, "2 n corners"]
    sliding: Float[np.ndarray, "2 n corners"]
    yaw: Float[np.ndarray, "n corners"]
    speeds: Float[np.ndarray, "2 n corners"]
    effects: Float[np.ndarray, "2 3 n corners"]


def split_at_corners(
    kinematics: Kinematics,
    period: Period,
    variables: Sequence[np.ndarray],
    taken: Iterable[np.ndarray],
    count: int,
) -> CornerErrors:
    """Return what happens at corners.

    Args:
        kinematics, period: as of `split_disturbance`.
        variables: its first ten, which broadcast to the points times any axes of corners.
        taken: those after the noise.
        count: n.
    """
    shape = np.broadcast_shapes(*(np.shape(variable) for variable in variables))
    # One coordinate after the other, along an axis of its own, which no other part gets.
    noise = SMALL * np.eye(3).reshape(3, 3, *([1] * len(shape)))
    parts = split_disturbance(kinematics, period, (*variables, *noise, *taken))
    model = parts.bilinear.plus(parts.sine).plus(parts.sampling)
    sliding = parts.slip.plus(parts.sideslip)

    def spread(numbers: Iterable) -> Float[np.ndarray, "k n corners"]:
        return np.stack([np.broadcast_to(each, shape).reshape(count, -1) for each in numbers])

    effects = [spread(np.broadcast_to(each, (3, *shape))) for each in parts.noise]
    return CornerErrors(
        spread(model),
        spread(sliding),
        spread([parts.yaw])[0],
        spread([parts.right, parts.left]),
        np.abs(np.stack(effects)) / SMALL,
    )


def solve_error(
    corners: CornerErrors,
    lateral_per_yaw: float,
    gain: Float[np.ndarray, "n 3"],
    noise: Float[np.ndarray, "3"],
) -> Float[np.ndarray, "n 3"]:
    """Return the half widths S (m, m, rad) under a gain L and pose noise; `FAR` where errors grow
    without a bound."""
    heading = noise[2] + (1 / gain[:, 2] - 1) * np.abs(corners.yaw).max(axis=1)
    unpredicted = np.abs(corners.sliding + _kick(corners, lateral_per_yaw))
    unpredicted += corners.effects[:, 2] * heading[:, None]
    left = 1 - gain[:, :2]
    rows = np.arange(2)[:, None]
    points = np.arange(len(gain))
    plane = np.tile(noise[:2], (len(gain), 1))
    for _ in range(MOST_POLICIES):
        grown = unpredicted + np.einsum("ijnk,nj->ink", corners.effects[:, :2], plane)
        worst = grown.argmax(axis=2)
        slopes = left[:, :, None] * corners.effects[rows, :2, points, worst].transpose(1, 0, 2)
        offsets = left * unpredicted[rows, points, worst].T + gain[:, :2] * noise[:2]
        grows = np.abs(np.linalg.eigvals(slopes)).max(axis=1) >= 1
        slopes[grows] = 0.0
        before = plane
        plane = np.linalg.solve(np.eye(2) - slopes, offsets[..., None])[..., 0]
        plane[grows] = FAR
        if np.allclose(plane, before, rtol=1e-9, atol=0.0):
            break
    return np.maximum(np.column_stack([plane, heading]), noise)


def find_extremes(
    corners: CornerErrors,
    lateral_per_yaw: float,
    gain: Float[np.ndarray, "1 3"],
    error: Float[np.ndarray, "1 3"],
) -> Int[np.ndarray, " extremes"]:
    """Return the corners where yaw kick, W, S and ground speeds of a single point are extreme."""
    unpredicted = np.abs(corners.sliding + _kick(corners, lateral_per_yaw))
    of_error = np.einsum("ijnk,nj->ink", corners.effects, error)
    levels = [*_widths(corners, gain, error), *(unpredicted + of_error), np.abs(corners.yaw)]
    levels += [*corners.speeds, *-corners.speeds]
    return np.array([level.argmax() for level in levels])


def widen_disturbance(
    corners: CornerErrors,
    gain: Float[np.ndarray, "n 3"],
    noise: Float[np.ndarray, "3"],
    error: Float[np.ndarray, "n 3"],
) -> Float[np.ndarray, "n 3"]:
    """Return the half widths of the box of W, the yaw kick apart, for estimates of this error."""
    plane = _widths(corners, gain, error).max(axis=2).T
    return np.column_stack([plane, gain[:, 2] * error[:, 2]]) + gain * noise


def _widths(
    corners: CornerErrors, gain: Float[np.ndarray, "n 3"], error: Float[np.ndarray, "n 3"]
) -> Float[np.ndarray, "2 n corners"]:
    """Return how far the plane part of W reaches at each corner, without the next measurement."""
    share = gain[:, :2].T[:, :, None]
    of_error = np.einsum("ijnk,nj->ink", corners.effects, error)
    return np.abs(corners.model + share * corners.sliding) + share * of_error


def _kick(corners: CornerErrors, lateral_per_yaw: float) -> Float[np.ndarray, "2 n corners"]:
    """Return what the yaw kick moves in the plane."""
    return np.stack([np.zeros_like(corners.yaw), lateral_per_yaw * corners.yaw])
