"""The set S of an estimate's error at corners of the operating set, fast enough for a search.

    s = max over corners  (I - L) (|r| + C s) + L nu

with r what the robot adds to its prediction without noise, and C how much of it the errors of the
estimate make, one by one. `sets.robot.observer` bounds the same over the whole operating set.

Source: policy iteration by Howard 1960 for the corners that count; else new.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from sets.robot.plant import Kinematics, Parts, Period, split_disturbance

SMALL = 1e-3
"""Error of an estimate, m or rad, by which its effect is differenced: linear up to there."""
MOST_POLICIES = 20
FAR = 1e3
"""Bound, m or rad, of an error that grows without one."""


class CornerErrors(NamedTuple):
    """What can happen in a period at corners, the estimate being exact or not.

    Attributes:
        parts: of w, the estimate being exact.
        effects: sizes of what an error of the estimate by one unit (m, m, rad) makes of w in the
            plane, by (coordinate of w, coordinate of the error).
    """

    parts: Parts
    effects: Float[np.ndarray, "2 3 corners"]


def split_at_corners(
    kinematics: Kinematics, period: Period, variables: Sequence[Float[np.ndarray, " corners"]]
) -> CornerErrors:
    """Return what happens at corners, given by the first ten variables of `split_disturbance`."""
    none = np.zeros_like(variables[0])
    effects = []
    for coordinate in range(3):
        noise = [none, none, none]
        noise[coordinate] = none + SMALL
        shifted = split_disturbance(kinematics, period, (*variables, *noise)).noise
        effects.append(np.abs(shifted) / SMALL)
    exact = split_disturbance(kinematics, period, (*variables, none, none, none))
    return CornerErrors(exact, np.stack(effects, axis=1))


def solve_error(
    corners: CornerErrors,
    lateral_per_yaw: float,
    gain: Float[np.ndarray, "3"],
    noise: Float[np.ndarray, "3"],
) -> Float[np.ndarray, "3"]:
    """Return the half widths S (m, m, rad) under a gain L and pose noise; `FAR` where errors grow
    without a bound."""
    parts = corners.parts
    heading = noise[2] + (1 / gain[2] - 1) * np.max(np.abs(parts.yaw))
    x = parts.slip.x + parts.sideslip.x
    y = parts.slip.y + parts.sideslip.y + lateral_per_yaw * parts.yaw
    unpredicted = np.abs([x, y]) + corners.effects[:, 2] * heading
    left = 1 - gain[:2]
    plane = noise[:2]
    for _ in range(MOST_POLICIES):
        grown = unpredicted + np.einsum("ijk,j->ik", corners.effects[:, :2], plane)
        worst = np.argmax(grown, axis=1)
        slopes = left[:, None] * corners.effects[[0, 1], :2, worst]
        offsets = left * unpredicted[[0, 1], worst] + gain[:2] * noise[:2]
        if np.max(np.abs(np.linalg.eigvals(slopes))) >= 1:
            return np.full(3, FAR)
        before = plane
        plane = np.linalg.solve(np.eye(2) - slopes, offsets)
        if np.allclose(plane, before, rtol=1e-9, atol=0.0):
            break
    return np.maximum(np.append(plane, heading), noise)


def widen_disturbance(
    corners: CornerErrors,
    gain: Float[np.ndarray, "3"],
    noise: Float[np.ndarray, "3"],
    error: Float[np.ndarray, "3"],
) -> Float[np.ndarray, "3"]:
    """Return the half widths of the box of W, the yaw kick apart, for estimates of this error."""
    exact = np.abs(corners.parts.rest_under(gain[:2].tolist()))
    of_error = np.einsum("ijk,j->ik", corners.effects, error)
    plane = np.max(exact + gain[:2, None] * of_error, axis=1)
    return np.append(plane, gain[2] * error[2]) + gain * noise
