"""Motion of a body over a window of poses: the arc of constant velocity that fits them.

    phi(t) = phi_0 + omega t,    p(t) = p_0 + v (C, S) + v_y (-S, C),   C, S = int_0^t cos, sin phi

Heading first, by a line; position is then linear in (p_0, v, v_y). Independent noise of spread
sigma leaves the velocities uncertain by the usual covariance of least squares.

Pose noise is what poses miss of parabolas through few neighbours: over a whole window the motion
itself leaves its arc, by slips that wander.

Source: least squares as in any textbook; the arc is that of a body with constant velocity, e.g.
Lynch and Park, Modern Robotics, 2017, section 13.3.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

FEWEST_POSES = 4

NEIGHBOURS = 7
"""Poses that a parabola is fitted to."""


class Arc(NamedTuple):
    """The motion of a body over one window.

    Attributes:
        velocity: (v m/s forward, omega rad/s, v_y m/s to the left), in the body's frame.
        spread: standard deviations of it for noise of one metre, one radian, one metre, 1/s.
    """

    velocity: Float[np.ndarray, "3"]
    spread: Float[np.ndarray, "3"]


def fit_arc(time: Float[np.ndarray, "k"], pose: Float[np.ndarray, "k 3"]) -> Arc:
    """Fit the arc of constant velocity to poses.

    Args:
        time: s, at least `FEWEST_POSES`.
        pose: (x m, y m, heading rad unwrapped).
    """
    count = len(time)
    elapsed = time - time.mean()
    moment = float(elapsed @ elapsed)
    yaw_rate = float(elapsed @ pose[:, 2]) / moment
    middle = float(pose[:, 2].mean())
    ahead, aside = _integrate_direction(elapsed, middle, yaw_rate)
    one = np.ones(count)
    none = np.zeros(count)
    design = np.block(
        [
            [one[:, None], none[:, None], ahead[:, None], -aside[:, None]],
            [none[:, None], one[:, None], aside[:, None], ahead[:, None]],
        ]
    )
    target = np.concatenate([pose[:, 0], pose[:, 1]])
    inverse = np.linalg.inv(design.T @ design)
    found = inverse @ (design.T @ target)
    velocity = np.array([found[2], yaw_rate, found[3]])
    spread = np.sqrt([inverse[2, 2], 1.0 / moment, inverse[3, 3]])
    return Arc(velocity, spread)


def find_noise(
    time: Float[np.ndarray, "k"], pose: Float[np.ndarray, "k 3"]
) -> Float[np.ndarray, "middles 3"]:
    """Return what poses miss of parabolas in time through `NEIGHBOURS` poses around them, (m, m,
    rad), scaled so that independent noise keeps its standard deviation; empty for fewer poses.
    """
    half = NEIGHBOURS // 2
    missed = []
    for middle in range(half, len(time) - half):
        near = slice(middle - half, middle + half + 1)
        powers = np.vander(time[near] - time[middle], 3)
        # Least squares give the pose in the middle as weights of all; its own weight is the
        # leverage.
        weights = np.linalg.pinv(powers)[2]
        leverage = weights[half]
        missed.append((pose[middle] - weights @ pose[near]) / np.sqrt(1.0 - leverage))
    return np.array(missed).reshape(-1, 3)


def _integrate_direction(
    elapsed: Float[np.ndarray, "k"], middle: float, yaw_rate: float
) -> tuple[Float[np.ndarray, "k"], Float[np.ndarray, "k"]]:
    """Return the integrals of cosine and sine of the heading from the middle of the window on."""
    half_turn = yaw_rate * elapsed / 2.0
    chord = elapsed * np.sinc(half_turn / np.pi)
    return chord * np.cos(middle + half_turn), chord * np.sin(middle + half_turn)
