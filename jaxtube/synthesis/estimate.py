"""Estimated shares of the caps, fast enough for a search over caps and tracking gains.

W is taken from corners of the operating set, and the minimal RPI set from two parts: e_x alone,
which decoupled gains leave to itself, and a polygon around (e_y, e_th), driven by it.

Source: new.
"""

from __future__ import annotations

import copy
import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from jaxtube.scenario.error_box import error_vector
from jaxtube.synthesis.disturbance import ground_speed_limits, kinematics, operation
from jaxtube.synthesis.estimated_error import solve_error, split_at_corners, widen_disturbance
from jaxtube.synthesis.problem import Problem, region_corners
from sets.robot.plant import Parts, Period, split_disturbance

DIRECTIONS = 120
"""Facets of the polygon around the minimal RPI set in (e_y, e_th)."""
USUAL_TRACK_WIDTH_M = 0.5
"""Track width of the robot that numbers are for; lengths of another one are scaled by its own."""
MOST_STEPS = 500
"""Steps after which a polygon that still grows is not bounded."""
UNBOUNDED = 1e3
"""Growth, over one step's disturbance, at which a polygon is not bounded."""
START_STEPS = 2
"""Steps of W by which the caps exceed the start."""
START_TURN = 1 / 3
"""Share of the yaw rate deficit that the start leaves to turn with."""
ACCURACY = 1e-4
"""Relative accuracy of the estimate."""
CAPS_AND_GAINS = 11
"""Numbers of a point before those of the observer."""
RESERVE = 0.01
"""Share by which the proved error of an observer may pass that at corners."""
MISSED = 2e-3
"""Share of the constraints that a search may miss them by."""
ALONG = 5
"""Points along an edge, where an extreme may lie between its ends."""


class Caps(NamedTuple):
    """Caps in SI units, the least speed deficit by its size."""

    longitudinal: float
    lateral: float
    heading: float
    slower: float
    faster: float
    turning: float
    coupled_error: float
    coupled_turning: float


class EstimatedDisturbance(NamedTuple):
    """W by its yaw kick, rad, how far that moves sideways, m/rad, and the box of the rest (m, m,
    rad); the error of what the controller acts on (m, m, rad), rounded up; and the (least,
    greatest) commanded ground speed, m/s."""

    yaw: float
    lateral_per_yaw: float
    box: Float[np.ndarray, "3"]
    estimate_error: Float[np.ndarray, "3"]
    speeds: tuple[float, float]


@dataclass(frozen=True)
class Shares:
    """What share of each cap the tube fills, and how far the limits beside them are used."""

    caps: Float[np.ndarray, " caps"]
    limits: Float[np.ndarray, " limits"]


class Estimate:
    """One problem's shares as a function of the logarithms of caps and gains, and of an observer's
    gain, the scenario's own where it is left out."""

    def __init__(self, problem: Problem):
        scenario = problem.scenario
        model = problem.model
        self.problem = problem
        self.kinematics = kinematics(problem)
        self.noise = problem.noise
        self.constraints = error_vector(scenario.constraints)
        self.operation = operation(problem)
        self.corners = np.unique(problem.corners, axis=0)
        lateral_per_yaw = model.dt * float(self.corners.mean()) / 2
        self.period = Period(model.dt, model.track_width, lateral_per_yaw, problem.robot.lever_arm)
        slowest, fastest = ground_speed_limits(problem)
        self.slowest = float(slowest.max())
        self.fastest = float(fastest.min())
        stretched = [np.stack(model.stretched_box(*region)) for region in problem.regions]
        h, c = model.turn_and_reach(region_corners(np.stack(stretched))).T
        self.greatest_h = float(np.max(np.abs(h)))
        self.extreme_c = (float(c.min()), float(c.max()))
        turns = np.abs(self.corners @ [1.0, -1.0])
        self.yaw_rate = float(np.max(turns)) / model.track_width
        angles = 2 * np.pi * np.arange(DIRECTIONS) / DIRECTIONS
        lateral = np.cos(angles) * USUAL_TRACK_WIDTH_M / model.track_width
        self.directions = np.stack([lateral, np.sin(angles)], axis=1)

    def with_less_speed(self, factor: float) -> Estimate:
        """Return the same estimate, with the greatest ground speed divided by a factor."""
        slower = copy.copy(self)
        slower.fastest = self.fastest / factor
        return slower

    def shares(self, logarithms: Float[np.ndarray, " n"]) -> Shares | None:
        """Return the shares of caps and limits, None where the loops have no bounded tube."""
        caps = _read_caps(logarithms)
        k1, k2, k3 = np.exp(logarithms[8:11])
        w = self.disturbance_at(logarithms)
        points = self.lateral_tube(k1, k2, k3, w)
        if points is None:
            return None
        reach_x = w.box[0] / (1 - abs(1 - self.period.dt * k1))
        reach_y, reach_heading = points.max(axis=0)
        reach_speed = k1 * reach_x + self.yaw_rate * reach_y
        reach_turning = float(np.max(points @ [k2, k3]))
        of_coupling = reach_x / caps.coupled_error + reach_turning / caps.coupled_turning
        filled = [
            reach_x / caps.longitudinal,
            reach_y / caps.lateral,
            reach_heading / caps.heading,
            reach_speed / min(caps.slower, caps.faster),
            reach_turning / caps.turning,
            of_coupling,
        ]
        return Shares(np.array(filled), self.limits(caps, w))

    def disturbance_at(self, logarithms: Float[np.ndarray, " n"]) -> EstimatedDisturbance:
        """Return W under the caps and the observer's gain of a point."""
        caps = _read_caps(logarithms)
        own = self.problem.scenario.controller
        if len(logarithms) > CAPS_AND_GAINS:
            return self.observed_disturbance(caps, np.exp(logarithms[CAPS_AND_GAINS:]))
        if own.has_observer:
            return self.observed_disturbance(caps, np.array(own.observer_gain))
        return self.disturbance(caps)

    def limits(self, caps: Caps, w: EstimatedDisturbance) -> Float[np.ndarray, " limits"]:
        """Return how far caps, start and ground speeds use the limits beside the caps."""
        errors = np.array([caps.longitudinal, caps.lateral, caps.heading])
        left = self.constraints - w.estimate_error
        used = [*(errors / np.maximum(left, ACCURACY * self.constraints))]
        start = np.abs(self.problem.initial_error)
        if start.any():
            kick = np.array([0.0, w.lateral_per_yaw * w.yaw, w.yaw])
            used += [*((start + START_STEPS * (w.box + kick)) / errors)]
            left_to_turn = caps.coupled_turning * (1 - start[0] / caps.coupled_error)
            used.append(START_TURN * caps.turning / max(left_to_turn, ACCURACY))
        else:
            used.append(0.0)
        least, greatest = w.speeds
        used.append(greatest / self.fastest)
        used.append(1 + (self.slowest - least) / self.fastest)
        return np.array(used)

    def disturbance(self, caps: Caps) -> EstimatedDisturbance:
        """Return W and the ground speeds at corners of the operating set."""
        *variables, side = self._corner_grid(caps, [-1.0, 1.0])
        noise = side * self.noise[:, None]
        parts = split_disturbance(self.kinematics, self.period, (*variables, *noise))
        widths = [np.max(np.abs(coordinate)) for coordinate in parts.rest]
        box = np.array([*(widths + self.noise[:2]), 2 * self.noise[2]])
        yaw = float(np.max(np.abs(parts.yaw)))
        speeds = _speed_range(parts)
        return EstimatedDisturbance(yaw, self.period.lateral_per_yaw, box, self.noise, speeds)

    def observed_disturbance(
        self, caps: Caps, gain: Float[np.ndarray, "3"]
    ) -> EstimatedDisturbance:
        """Return the same where the controller acts on an estimate with this gain."""
        *variables, _ = self._corner_grid(caps, [0.0])
        corners = split_at_corners(self.kinematics, self.period, variables)
        lateral_per_yaw = self.period.lateral_per_yaw
        error = solve_error(corners, lateral_per_yaw, gain, self.noise)
        return EstimatedDisturbance(
            float(gain[2] * np.max(np.abs(corners.parts.yaw))),
            lateral_per_yaw * gain[1] / gain[2],
            widen_disturbance(corners, gain, self.noise, error),
            error * (1 + RESERVE) + MISSED * self.constraints,
            _speed_range(corners.parts),
        )

    def _corner_grid(
        self, caps: Caps, sides: Sequence[float]
    ) -> list[Float[np.ndarray, " corners"]]:
        """Return the first ten variables of `split_disturbance` and the side of the noise, at all
        corners."""
        coupled = _coupled_corners(caps)
        axes = [
            np.arange(len(coupled)),
            [-caps.lateral, caps.lateral],
            np.linspace(-caps.heading, caps.heading, ALONG),
            [-caps.slower, caps.faster],
            np.arange(len(self.corners)),
            *self.operation.wheel_errors.T,
            np.unique([-self.operation.sideslip, self.operation.sideslip]),
            sides,
        ]
        grid = [axis.ravel() for axis in np.meshgrid(*axes, indexing="ij")]
        of_coupling, e_y, e_th, u1, of_corner, d_r, d_l, zeta, side = grid
        e_x, u2 = coupled[of_coupling.astype(int)].T
        V_r, V_l = self.corners[of_corner.astype(int)].T
        return [e_x, e_y, e_th, u1, u2, V_r, V_l, d_r, d_l, zeta, side]

    def lateral_tube(
        self, k1: float, k2: float, k3: float, w: EstimatedDisturbance
    ) -> Float[np.ndarray, "points 2"] | None:
        """Return corners of a polygon around the minimal RPI set in (e_y, e_th), None where it does
        not settle."""
        T = self.period.dt
        contraction = abs(1 - T * k1)
        if not contraction < 1:
            return None
        w_x, w_y, w_heading = w.box
        drift = self.greatest_h * abs(2 - T * k1) * w_x / (1 - contraction)
        kick = np.abs(self.directions @ [w.lateral_per_yaw, 1.0])
        steps = w.yaw * kick + np.abs(self.directions) @ [w_y + drift, w_heading]
        loops = np.array(
            [
                [[1 - c * T * k2 / 2, c * (1 - T * k3 / 2)], [-T * k2, 1 - T * k3]]
                for c in self.extreme_c
            ]
        )
        images = self.directions @ loops
        offsets = steps.copy()
        for _ in range(MOST_STEPS):
            points = _polygon_corners(self.directions, offsets)
            reach = steps + np.max(images @ points.T, axis=(0, 2))
            if not np.all(reach < UNBOUNDED * steps.max()):
                return None
            if np.all(reach <= offsets * (1 + ACCURACY / 10)):
                return points
            offsets = np.maximum(offsets, reach)
        return None


def _speed_range(parts: Parts) -> tuple[float, float]:
    """Return the least and the greatest commanded ground speed, m/s."""
    least = min(parts.right.min(), parts.left.min())
    return float(least), float(max(parts.right.max(), parts.left.max()))


def _read_caps(logarithms: Float[np.ndarray, " n"]) -> Caps:
    values = np.exp(logarithms[:8])
    values[2] = np.deg2rad(values[2])
    return Caps(*values)


def _coupled_corners(caps: Caps) -> Float[np.ndarray, "points 2"]:
    """Return corners of {|e_x| <= x, |u2| <= turning, |e_x| / a + |u2| / b <= 1}, and points along
    its cut edges."""
    a = caps.coupled_error
    b = caps.coupled_turning
    error_at_most_turning = max(min(caps.longitudinal, a * (1 - caps.turning / b)), 0.0)
    turning_at_most_error = max(min(caps.turning, b * (1 - caps.longitudinal / a)), 0.0)
    first = np.array([error_at_most_turning, min(caps.turning, b)])
    last = np.array([min(caps.longitudinal, a), turning_at_most_error])
    along = np.linspace(0.0, 1.0, ALONG)[:, None]
    edge = (1 - along) * first + along * last
    return np.concatenate([edge * signs for signs in itertools.product((-1, 1), repeat=2)])


def _polygon_corners(
    directions: Float[np.ndarray, "k 2"], offsets: Float[np.ndarray, " k"]
) -> Float[np.ndarray, "k 2"]:
    """Return the points where neighbouring sides of a polygon meet."""
    following = np.roll(directions, -1, axis=0)
    next_offsets = np.roll(offsets, -1)
    determinant = directions[:, 0] * following[:, 1] - directions[:, 1] * following[:, 0]
    first = offsets * following[:, 1] - next_offsets * directions[:, 1]
    second = directions[:, 0] * next_offsets - following[:, 0] * offsets
    return np.stack([first, second], axis=1) / determinant[:, None]
