"""Effective track and lever arm of a robot that skids to turn, by a robust fit to windows.

    v = (m_r v_r + m_l v_l) / 2,   omega = (m_r v_r - m_l v_l) / B,   v_y = -L omega + beta v

m is what mean slips leave of the wheel speeds, B the effective track, L the lever arm and beta a
constant crab angle (slope of the ground, or a heading that is mounted askew). What a window misses
counts as slip: by

    ((v - v^) + B (omega - omega^) / 2) / v_r   on the right,    the same with - and v_l on the left

with B there that of the iteration before. Wheels are given and do not slip into the regressors: a
fit of v_r - v_l by omega would shrink B, by the more the more slips scatter. Windows whose noise is
large for their wheel speed weigh less.

Source: effective track and instantaneous centres as in Mandow et al., Experimental kinematics for
wheeled skid-steer mobile robots, IROS 2007; generalised least squares with the weights of the last
iteration as in Carroll and Ruppert, Transformation and weighting in regression, 1988, chapter 2;
loss soft L1 of scipy.optimize.least_squares.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, cast

import numpy as np
from jaxtyping import Float, Int
from scipy.optimize import least_squares

from jaxtube.recordings.spread import find_spread

ITERATIONS = 8

BOOTSTRAPS = 40
"""Samples of commands that the standard errors come from."""


@dataclass(frozen=True)
class Geometry:
    """How the wheels move the body.

    Attributes:
        track: B, m.
        track_error: standard error, m, over samples of commands.
        lever_arm: L, m.
        lever_arm_error: m.
        crab: beta, rad.
        mean_slip: 1 - m, (right, left).
        slip_scale: robust spread of slips about it.
        explained: share of the yaw rate, by medians, that the wheels explain.
    """

    track: float
    track_error: float
    lever_arm: float
    lever_arm_error: float
    crab: float
    mean_slip: tuple[float, float]
    slip_scale: float
    explained: float


def fit_geometry(
    wheels: Float[np.ndarray, "k 2"],
    velocity: Float[np.ndarray, "k 3"],
    spread: Float[np.ndarray, "k 3"],
    command: Int[np.ndarray, "k"],
) -> Geometry:
    """Fit effective track and lever arm to windows that drive both wheels forwards.

    Args:
        wheels: (right, left), m/s, positive.
        velocity: (v, omega, v_y), m/s and rad/s.
        spread: standard deviations of the velocities by pose noise; 0 where it is not known.
        command: numbers; windows of one command are drawn together for the standard errors.
    """
    gains = _fit_track(wheels, velocity, spread)
    side = _fit_side(velocity)
    names = np.unique(command)
    rows = [np.flatnonzero(command == name) for name in names]
    generator = np.random.default_rng(0)
    tracks = []
    levers = []
    for _ in range(BOOTSTRAPS):
        drawn = np.concatenate([rows[k] for k in generator.integers(len(rows), size=len(rows))])
        tracks.append(_fit_track(wheels[drawn], velocity[drawn], spread[drawn], gains)[2])
        levers.append(_fit_side(velocity[drawn])[0])
    missed = velocity[:, 1] - _expect(wheels, gains)[:, 1]
    slips = find_slips(wheels, velocity, gains[2]) - (1.0 - gains[:2])
    return Geometry(
        float(gains[2]),
        find_spread(np.array(tracks) - np.median(tracks)),
        float(side[0]),
        find_spread(np.array(levers) - np.median(levers)),
        float(side[1]),
        (float(1.0 - gains[0]), float(1.0 - gains[1])),
        find_spread(slips),
        1.0 - float(np.median(np.abs(missed)) / max(np.median(np.abs(velocity[:, 1])), 1e-9)),
    )


def find_slips(
    wheels: Float[np.ndarray, "k 2"], velocity: Float[np.ndarray, "k 3"], track: float
) -> Float[np.ndarray, "k 2"]:
    """Return the slips (right, left) that a body's velocity and an effective track mean."""
    turning = track * velocity[:, 1] / 2.0
    ground = np.column_stack([velocity[:, 0] + turning, velocity[:, 0] - turning])
    return 1.0 - ground / wheels


def find_sideslip(velocity: Float[np.ndarray, "k 3"], lever_arm: float) -> Float[np.ndarray, "k"]:
    """Return the lateral speed that the lever arm leaves, by forward speed; signed, left
    positive."""
    return (velocity[:, 2] + lever_arm * velocity[:, 1]) / velocity[:, 0]


def _fit_track(
    wheels: Float[np.ndarray, "k 2"],
    velocity: Float[np.ndarray, "k 3"],
    spread: Float[np.ndarray, "k 3"],
    start: Float[np.ndarray, "3"] | None = None,
) -> Float[np.ndarray, "3"]:
    """Return (m_r, m_l, B)."""
    gains = _start(wheels, velocity) if start is None else start
    for _ in range(ITERATIONS if start is None else 2):
        track = float(gains[2])
        slips = find_slips(wheels, velocity, track)
        scale = max(find_spread(slips - (1.0 - gains[:2])), 1e-6)
        noise = np.hypot(spread[:, :1], track * spread[:, 1:2] / 2.0) / wheels
        weight = 1.0 / np.sqrt(scale**2 + noise**2)

        fit = least_squares(
            lambda values, *given: (_miss(wheels, velocity, values, given[0]) * given[1]).ravel(),
            gains,
            jac=cast(Any, _slopes),  # its stubs know the names of methods alone
            loss="soft_l1",
            x_scale=np.abs(gains) + 0.1,
            args=(track, weight, wheels),
        )
        gains = fit.x
    return gains


def _start(
    wheels: Float[np.ndarray, "k 2"], velocity: Float[np.ndarray, "k 3"]
) -> Float[np.ndarray, "3"]:
    """Return a first guess: slips alike, and the yaw rate fitted by least squares."""
    kept = float(np.median(velocity[:, 0] / wheels.mean(axis=1)))
    difference = kept * (wheels[:, 0] - wheels[:, 1])
    slope = float(difference @ velocity[:, 1]) / max(float(difference @ difference), 1e-12)
    track = 1.0 / slope if slope > 0.0 else 1.0
    return np.array([kept, kept, track])


def _expect(
    wheels: Float[np.ndarray, "k 2"], gains: Float[np.ndarray, "3"]
) -> Float[np.ndarray, "k 2"]:
    """Return the (v, omega) that mean slips and an effective track make of wheel speeds."""
    right = gains[0] * wheels[:, 0]
    left = gains[1] * wheels[:, 1]
    return np.column_stack([(right + left) / 2.0, (right - left) / gains[2]])


def _miss(
    wheels: Float[np.ndarray, "k 2"],
    velocity: Float[np.ndarray, "k 3"],
    gains: Float[np.ndarray, "3"],
    track: float,
) -> Float[np.ndarray, "k 2"]:
    """Return what windows miss, as slips (right, left) at a given track."""
    missed = velocity[:, :2] - _expect(wheels, gains)
    turning = track * missed[:, 1] / 2.0
    return np.column_stack([missed[:, 0] + turning, missed[:, 0] - turning]) / wheels


def _slopes(
    gains: Float[np.ndarray, "3"],
    track: float,
    weight: Float[np.ndarray, "k 2"],
    wheels: Float[np.ndarray, "k 2"],
) -> Float[np.ndarray, "2k 3"]:
    """Return the derivatives of the weighted misses by (m_r, m_l, B)."""
    by_track = track * (wheels * gains[:2] @ [1.0, -1.0]) / (2.0 * gains[2] ** 2)
    own = -(1.0 + track / gains[2]) / 2.0
    other = -(1.0 - track / gains[2]) / 2.0 * wheels[:, ::-1] / wheels
    right = np.column_stack([np.full(len(wheels), own), other[:, 0], by_track / wheels[:, 0]])
    left = np.column_stack([other[:, 1], np.full(len(wheels), own), -by_track / wheels[:, 1]])
    return (np.stack([right, left], axis=1) * weight[:, :, None]).reshape(-1, 3)


def _fit_side(velocity: Float[np.ndarray, "k 3"]) -> Float[np.ndarray, "2"]:
    """Return (L, beta)."""
    turned = velocity[:, 1] / velocity[:, 0]
    aside = velocity[:, 2] / velocity[:, 0]
    design = np.column_stack([-turned, np.ones(len(turned))])
    start = np.linalg.lstsq(design, aside, rcond=None)[0]
    scale = max(find_spread(aside - design @ start), 1e-6)

    def residuals(values: Float[np.ndarray, "2"]) -> Float[np.ndarray, "k"]:
        return aside - design @ values

    return least_squares(residuals, start, loss="soft_l1", f_scale=scale).x
