"""The operating set of a problem by its corners: caps, certified wheel speeds, wheel errors and
sideslip at their extremes, and W and the error of an estimate from there.

An extreme may also lie along the cut edges of the coupling and along the heading error, where
points in between are taken as well.

Source: new.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from jaxtube.synthesis.disturbance import find_place, kinematics
from jaxtube.synthesis.estimated_error import (
    CornerErrors,
    find_extremes,
    solve_error,
    split_at_corners,
    widen_disturbance,
)
from jaxtube.synthesis.late_corners import (
    LatePoints,
    add_lag,
    commit_points,
    find_speed_extremes,
)
from jaxtube.synthesis.learnt_slips import bound_slips
from jaxtube.synthesis.problem import Problem
from sets.polytope import hull_vertices
from sets.robot.plant import Late

ALONG = 5
"""Points along an edge, where an extreme may lie between its ends."""
ENDS = np.array([-1.0, 1.0])
NAMES = (
    "longitudinal_m",
    "lateral_m",
    "heading_deg",
    "speed_deficit_min_mps",
    "speed_deficit_max_mps",
    "yaw_rate_deficit_radps",
    "turning_longitudinal_m",
    "turning_yaw_rate_radps",
)
"""Caps in the order of a point of the search, the least speed deficit by its size; k1, k2, k3
follow."""
ERROR_CAPS = 3
"""Caps of the error, which come first among caps and gains."""
CAPS_AND_GAINS = 11
"""Numbers of a point before those of the observer."""

Corners = Int[np.ndarray, "axes corners"]
"""Corners by their place on each axis."""


class Caps(NamedTuple):
    """Caps in SI units of n points, the least speed deficit by its size."""

    longitudinal: Float[np.ndarray, " n"]
    lateral: Float[np.ndarray, " n"]
    heading: Float[np.ndarray, " n"]
    slower: Float[np.ndarray, " n"]
    faster: Float[np.ndarray, " n"]
    turning: Float[np.ndarray, " n"]
    coupled_error: Float[np.ndarray, " n"]
    coupled_turning: Float[np.ndarray, " n"]


class EstimatedDisturbance(NamedTuple):
    """W of n points by its yaw kick, rad, how far that moves sideways, m/rad, and the box of the
    rest (m, m, rad); the error of what the controller acts on (m, m, rad); the least and the
    greatest commanded ground speed, m/s; what lag and delay do, where there is any; and of slips
    that are learnt the greatest steps (m, m, rad) of the first period, when nothing is known of
    them."""

    yaw: Float[np.ndarray, " n"]
    lateral_per_yaw: Float[np.ndarray, " n"]
    box: Float[np.ndarray, "n 3"]
    error: Float[np.ndarray, "n 3"]
    least: Float[np.ndarray, " n"]
    greatest: Float[np.ndarray, " n"]
    late: LatePoints | None
    first: Float[np.ndarray, "n 3"] | None = None

    @property
    def steps(self) -> Float[np.ndarray, "n 3"]:
        """The greatest steps that w makes, (m, m, rad)."""
        lateral = self.lateral_per_yaw * np.ones_like(self.yaw)
        kick = self.yaw * np.stack([np.zeros_like(self.yaw), lateral, np.ones_like(self.yaw)])
        return self.box + kick.T


class OperatingCorners:
    """The corners of a problem's operating set, and what may happen there.

    Points are logarithms of the eight caps, of three tracking gains, which are not read, and, where
    there are three more, of an observer's gain; otherwise that is the scenario's own.
    """

    def __init__(self, problem: Problem):
        self.noise = problem.noise
        self.kinematics = kinematics(problem)
        self.operation = find_place(problem)
        self.scenario = problem.scenario
        self.learns = problem.scenario.slip.is_learnt
        self.period = self.operation.period
        self.schedules = hull_vertices(np.unique(problem.corners, axis=0))
        self.is_late = not self.operation.actuation.is_ideal
        if self.is_late:
            latency = self.operation.actuation.nominal(self.period.dt).latency
            lever = latency * 2 * self.period.lateral_per_yaw / self.period.dt
            self.period = self.period._replace(
                lateral_per_yaw=self.period.lateral_per_yaw + lever,
                lever_arm=0.0,
                late=Late(lever, 0.0, 0.0),
            )
        sides_of_sideslip = 2 if self.operation.sideslip and not self.is_late else 1
        sides_of_lag = 2 if self.is_late else 1
        self.axes = (
            *(4 * ALONG, 2, ALONG, 2, len(self.schedules), 2, 2),
            sides_of_sideslip,
            sides_of_lag,
        )

    def gain(self, points: Float[np.ndarray, "n k"]) -> Float[np.ndarray, "n 3"]:
        """Return the observer's gain at each point."""
        if points.shape[1] > CAPS_AND_GAINS:
            return np.exp(points[:, CAPS_AND_GAINS:])
        return np.tile(self.operation.gain, (len(points), 1))

    def find(self, point: Float[np.ndarray, " k"]) -> Corners:
        """Return the corners that make W, the estimate's error and the ground speeds."""
        gain = self.gain(point[None])
        places = np.ix_(*map(np.arange, self.axes))
        errors, late = self._split(point[None], places, self.learns)
        lateral_per_yaw = self.period.lateral_per_yaw
        size = solve_error(errors, lateral_per_yaw, gain, self.noise)
        extremes = find_extremes(errors, lateral_per_yaw, gain, size)
        if late is not None:
            extremes = np.append(extremes, find_speed_extremes(errors.speeds))
        return np.stack(np.unravel_index(extremes, self.axes))

    def disturbance(
        self, points: Float[np.ndarray, "n k"], corners: Corners
    ) -> EstimatedDisturbance:
        """Return W, the estimate's error and the ground speeds, from these corners."""
        learnt = self._disturbance(points, corners, self.learns)
        if not self.learns:
            return learnt
        unlearnt = self._disturbance(points, corners, learns=False)
        return learnt._replace(first=unlearnt.steps)

    def _disturbance(
        self, points: Float[np.ndarray, "n k"], corners: Corners, learns: bool
    ) -> EstimatedDisturbance:
        """Return the disturbance of slips that are learnt as well as they will be, or not at
        all."""
        gain = self.gain(points)
        errors, late = self._split(points, tuple(corners), learns)
        lateral_per_yaw = self.period.lateral_per_yaw
        size = solve_error(errors, lateral_per_yaw, gain, self.noise)
        return EstimatedDisturbance(
            gain[:, 2] * np.abs(errors.yaw).max(axis=1),
            lateral_per_yaw * gain[:, 1] / gain[:, 2],
            widen_disturbance(errors, gain, self.noise, size),
            size,
            errors.speeds.min(axis=(0, 2)),
            errors.speeds.max(axis=(0, 2)),
            late,
        )

    def _split(
        self,
        points: Float[np.ndarray, "n k"],
        places: tuple[Int[np.ndarray, "..."], ...],
        learns: bool,
    ) -> tuple[CornerErrors, LatePoints | None]:
        """Return what may happen at places of the grid, at each point, and what of it is lag's."""
        caps = read_caps(points)
        of_coupling, of_y, of_heading, of_speed, of_schedule, right, left, skid, side = places
        by_point = (-1, *([1] * np.broadcast(*places).ndim))
        e_x, u2 = np.moveaxis(_coupled_corners(caps)[:, of_coupling], -1, 0)
        e_y = caps.lateral.reshape(by_point) * ENDS[of_y]
        e_th = caps.heading.reshape(by_point) * np.linspace(-1.0, 1.0, ALONG)[of_heading]
        faster = caps.faster.reshape(by_point)
        u1 = np.where(of_speed == 1, faster, -caps.slower.reshape(by_point))
        V_r, V_l = np.moveaxis(self.schedules[of_schedule], -1, 0)
        asked = (e_x, e_y, e_th, u1, u2, V_r, V_l)
        if not self.is_late:
            d_r = self.operation.wheel_errors[right, 0]
            d_l = self.operation.wheel_errors[left, 1]
            if learns:
                learnt = self._learn(caps, (*asked, *[0.0 * (right + left + skid)] * 3))
                d_r = ENDS[right] * learnt[:, 0].reshape(by_point)
                d_l = ENDS[left] * learnt[:, 1].reshape(by_point)
            zeta = self.operation.sideslip * ENDS[skid]
            variables = (*asked, d_r, d_l, zeta)
            return split_at_corners(self.kinematics, self.period, variables, (), len(points)), None
        none = 0.0 * (right + left + skid + side)
        at_once = self.operation.period
        still = (*asked, none, none, none)
        speeds = split_at_corners(self.kinematics, at_once, still, (), len(points)).speeds
        late = commit_points(self.operation, speeds, caps.turning)
        loss = late.loss.reshape(2, 2, *by_point)
        d_r = np.where(right == 1, loss[1, 0], loss[0, 0])
        d_l = np.where(left == 1, loss[1, 1], loss[0, 1])
        taken = ENDS[side] * late.unknown.reshape(2, *by_point)
        variables = (*asked, d_r, d_l, none)
        errors = split_at_corners(self.kinematics, self.period, variables, taken, len(points))
        return add_lag(errors, late), late

    def _learn(self, caps: Caps, still: Sequence[np.ndarray]) -> Float[np.ndarray, "n 2"]:
        """Return the greatest wheel errors (right, left) of slips that are learnt, at each point,
        from the variables of a robot that does not slip."""
        count = len(caps.turning)
        speeds = split_at_corners(self.kinematics, self.period, still, (), count).speeds
        least = speeds.min(axis=2).T
        greatest = speeds.max(axis=2).T
        reference = np.abs(self.schedules @ [1.0, -1.0]).max() / self.period.track_width
        errors = np.stack([caps.longitudinal, caps.lateral, caps.heading], axis=1)
        bounds = [
            bound_slips(
                self.scenario,
                self.operation,
                errors[i],
                np.stack([least[i], greatest[i]]),
                float(caps.turning[i] + reference),
            )
            for i in range(count)
        ]
        return np.stack([bound.wheel_errors[-1] for bound in bounds])


def read_caps(points: Float[np.ndarray, "n k"]) -> Caps:
    """Return the caps of points."""
    values = np.exp(points[:, :8])
    values[:, 2] = np.deg2rad(values[:, 2])
    return Caps(*values.T)


def _coupled_corners(caps: Caps) -> Float[np.ndarray, "n points 2"]:
    """Return corners of {|e_x| <= x, |u2| <= turning, |e_x| / a + |u2| / b <= 1}, and points along
    its cut edges."""
    a = caps.coupled_error
    b = caps.coupled_turning
    error_left = a * (1 - caps.turning / b)
    turning_left = b * (1 - caps.longitudinal / a)
    error_at_most_turning = np.clip(error_left, 0.0, caps.longitudinal)
    turning_at_most_error = np.clip(turning_left, 0.0, caps.turning)
    first = np.stack([error_at_most_turning, np.minimum(caps.turning, b)], axis=1)
    last = np.stack([np.minimum(caps.longitudinal, a), turning_at_most_error], axis=1)
    along = np.linspace(0.0, 1.0, ALONG)[:, None]
    edge = (1 - along) * first[:, None] + along * last[:, None]
    signs = itertools.product((-1, 1), repeat=2)
    return np.concatenate([edge * sign for sign in signs], axis=1)
