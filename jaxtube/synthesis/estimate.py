"""Estimated shares of the caps, fast enough for a search over caps and gains.

W is taken from corners of the operating set (`synthesis.corners`), and the minimal RPI set from two
parts: e_x alone, which decoupled gains leave to itself, and a polygon around (e_y, e_th), driven by
it (`synthesis.lateral_tube`). Which corners and which sides count is found once for a point and
kept for its neighbours, so that differences between them are smooth and cheap.

Source: new.
"""

from __future__ import annotations

import copy
from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar, NamedTuple

import numpy as np
from jaxtyping import Float

from jaxtube.scenario.error_box import error_vector
from jaxtube.synthesis import lateral_tube
from jaxtube.synthesis.corners import (
    CAPS_AND_GAINS,
    NAMES,
    Caps,
    Corners,
    EstimatedDisturbance,
    OperatingCorners,
    read_caps,
)
from jaxtube.synthesis.disturbance import ground_speed_limits
from jaxtube.synthesis.late_corners import find_pose_errors
from jaxtube.synthesis.lateral_tube import Policy, Ring
from jaxtube.synthesis.natural import DECIMALS, NaturalUnits
from jaxtube.synthesis.problem import Problem, region_corners

START_STEPS = 2
"""Steps of W by which the caps exceed the start."""
START_TURN = 1 / 3
"""Share of the yaw rate deficit that the start leaves to turn with."""
ACCURACY = 1e-4
"""Relative accuracy of the estimate."""
RESERVE = 0.01
"""Share by which the proved error of an observer, or of a pose that comes late, may pass that at
corners."""
SPEED_RESERVE = 0.003
"""Share by which the proved ground speed may pass that at corners."""

SLOWEST_GAIN = 0.02
"""Least T k1."""
FASTEST_GAIN = 0.999
"""Greatest T k1."""
LEAST_OBSERVED = 0.01
"""Least gain of an observer that is searched."""

CAP_ROWS = (
    "longitudinal error",
    "lateral error",
    "heading error",
    "least speed deficit",
    "greatest speed deficit",
    "yaw rate deficit",
    "coupling",
)
"""What the tube fills, in the order of `Shares.caps`."""
LIMIT_ROWS = (
    "constraints.longitudinal_m",
    "constraints.lateral_m",
    "constraints.heading_deg",
    "initial.x_m",
    "initial.y_m",
    "initial.heading_deg",
    "turning at the start",
    "speed at the start",
    "robot.wheel_speed_max_mps",
    "robot.wheel_speed_min_mps",
)
"""What caps, start and wheels use, in the order of `Shares.limits`; a start's error by the key that
makes it on a reference that sets out along x."""


@dataclass(frozen=True)
class Shares:
    """What share of each cap the tube fills, and how far the limits beside them are used, at n
    points."""

    caps: Float[np.ndarray, "n caps"]
    limits: Float[np.ndarray, "n limits"]


class Active(NamedTuple):
    """What makes W and the tube at a point."""

    corners: Corners
    policy: Policy


class Estimate:
    """One problem's shares at points: logarithms of caps, tracking gains and, where it is not the
    scenario's own, an observer's gain.

    All but `problem` is in natural units (`synthesis.natural`), points too.
    """

    cap_rows: ClassVar[tuple[str, ...]] = CAP_ROWS
    limit_rows: ClassVar[tuple[str, ...]] = LIMIT_ROWS

    def __init__(self, problem: Problem):
        self.problem = problem
        self.reserve = RESERVE
        self.units = NaturalUnits.of(problem.scenario)
        problem = self.units.express(problem)
        scenario = problem.scenario
        model = problem.model
        self.corners = OperatingCorners(problem)
        self.period = self.corners.period
        self.constraints = error_vector(scenario.constraints)
        slowest, fastest = ground_speed_limits(problem)
        self.slowest = float(slowest.max())
        self.fastest = float(fastest.min()) / (1 + SPEED_RESERVE)
        stretched = [np.stack(model.stretched_box(*region)) for region in problem.regions]
        self.model = model
        self._set_speeds(self.corners.schedules, region_corners(np.stack(stretched)))
        self.start = np.abs(problem.initial_error)
        self.ring = Ring(self.error_limits[1] / self.error_limits[2])

    def _set_speeds(
        self, schedules: Float[np.ndarray, "k 2"], stretched: Float[np.ndarray, "v 2"]
    ) -> None:
        """Set the wheel speeds that loops are closed over: the hulls of these, the second one that
        of the stretched speeds, in which loops are affine."""
        h, c = self.model.turn_and_reach(stretched).T
        self.greatest_h = float(np.max(np.abs(h)))
        self.extreme_c = np.array([c.min(), c.max()])
        turns = np.abs(schedules @ [1.0, -1.0])
        self.yaw_rate = float(np.max(turns)) / self.model.track_width

    def to_point(self, values: Sequence[float]) -> Float[np.ndarray, " k"]:
        """Return caps and gains, in the order of `starts.caps_and_gains` and their own units, as a
        point; the gain of an observer that the scenario gives is no part of it."""
        given = self.problem.scenario.controller.has_observer
        taken = values[:CAPS_AND_GAINS] if given else values
        point = np.log(taken) - self.units.logarithms(NAMES)[: len(taken)]
        return point.round(DECIMALS)

    def to_values(self, point: Float[np.ndarray, " k"]) -> Float[np.ndarray, " k"]:
        """Return the caps and gains of a point in their own units."""
        return np.exp(point + self.units.logarithms(NAMES)[: len(point)])

    @property
    def error_limits(self) -> Float[np.ndarray, "3"]:
        """What the noise leaves of the constraints."""
        return self.constraints - self.corners.noise

    def ranges(self, size: int) -> Float[np.ndarray, "2 k"]:
        """Return the least and the greatest value of each number of a point of this size, infinite
        where a search sets none."""
        ranges = np.tile([[-np.inf], [np.inf]], (1, size))
        ranges[:, 8] = np.log(np.array([SLOWEST_GAIN, FASTEST_GAIN]) / self.period.dt)
        ranges[:, CAPS_AND_GAINS:] = np.array([[np.log(LEAST_OBSERVED)], [0.0]])
        return ranges

    def over(
        self, schedules: Float[np.ndarray, "k 2"], stretched: Float[np.ndarray, "v 2"]
    ) -> Estimate:
        """Return the same estimate, with loops closed over the hull of wheel speeds alone.

        Args:
            schedules: the wheel speeds.
            stretched: whose hull holds them, stretched.
        """
        narrower = copy.copy(self)
        narrower._set_speeds(schedules, stretched)
        return narrower

    def from_the_path(self) -> Estimate:
        """Return the same estimate for a start without an error."""
        started = copy.copy(self)
        started.start = np.zeros(3)
        return started

    def without_noise(self) -> Estimate:
        """Return the same estimate for poses that are measured exactly."""
        quiet = copy.copy(self)
        quiet.corners = copy.copy(self.corners)
        quiet.corners.noise = np.zeros(3)
        return quiet

    def with_less_speed(self, factor: float) -> Estimate:
        """Return the same estimate, with the greatest ground speed divided by a factor."""
        slower = copy.copy(self)
        slower.fastest = self.fastest / factor
        return slower

    def with_more_speed(self, share: float) -> Estimate:
        """Return the same estimate, with the least ground speed higher by a share of the greatest
        one."""
        faster = copy.copy(self)
        faster.slowest = self.slowest + share * self.fastest
        return faster

    def with_reserve(self, reserve: float) -> Estimate:
        """Return the same estimate, with another share by which proved errors may pass those at
        corners."""
        careful = copy.copy(self)
        careful.reserve = reserve
        return careful

    def with_farther_start(self, factor: float) -> Estimate:
        """Return the same estimate, with the start farther away by a factor."""
        farther = copy.copy(self)
        farther.start = self.start * factor
        return farther

    def shaped_like(self, point: Float[np.ndarray, " k"]) -> Estimate:
        """Return the same estimate, with directions spread as the tube of a point is wide, one of
        them along the point's own row of turning."""
        shares = self.shares(point)
        if shares is None:
            return self
        lateral, heading = shares.caps[0, 1:3] * np.exp(point[1:3])
        k2, k3 = np.exp(point[9:11])
        shaped = copy.copy(self)
        shaped.ring = Ring.through(k2, k3, lateral / np.deg2rad(heading))
        return shaped

    def shares(self, point: Float[np.ndarray, " k"]) -> Shares | None:
        """Return the shares of caps and limits at one point, None where the loops have no bounded
        tube there."""
        active = self.find_active(point)
        return None if active is None else self.shares_nearby(point[None], active)

    def find_corners(self, point: Float[np.ndarray, " k"], known: Corners | None = None) -> Corners:
        """Return the corners that make W at a point, with those that are known."""
        corners = self.corners.find(point)
        if known is None:
            return corners
        return np.unique(np.concatenate([known, corners], axis=1), axis=1)

    def find_active(
        self, point: Float[np.ndarray, " k"], corners: Corners | None = None
    ) -> Active | None:
        """Return what makes W and the tube at a point, None where the tube is not bounded; of all
        corners, or of those given."""
        points = point[None]
        if not self.keeps_ahead(points):
            return None
        corners = self.find_corners(point) if corners is None else corners
        w = self.corners.disturbance(points, corners)
        steps, images, rows = self.tube_data(points, w, self.reach_ahead(points, w))
        policy = lateral_tube.settle(self.ring, images[0], steps[0], rows[0])
        return None if policy is None else Active(corners, policy)

    def shares_nearby(self, points: Float[np.ndarray, "n k"], active: Active) -> Shares:
        """Return the shares at points where the same corners and sides count."""
        w = self.corners.disturbance(points, active.corners)
        ahead = self.reach_ahead(points, w)
        steps, images, rows = self.tube_data(points, w, ahead)
        supports = lateral_tube.solve(self.ring, active.policy, images, steps)
        sideways = lateral_tube.reach(self.ring, active.policy.rows, supports, rows)
        return self.fill(points, w, np.column_stack([ahead, sideways]))

    def keeps_ahead(self, points: Float[np.ndarray, "n k"]) -> bool:
        """Whether k1 bounds the longitudinal error at every point."""
        return bool(np.all(np.abs(1 - self.period.dt * np.exp(points[:, 8])) < 1))

    def reach_ahead(
        self, points: Float[np.ndarray, "n k"], w: EstimatedDisturbance
    ) -> Float[np.ndarray, " n"]:
        """Return how far the tube reaches in e_x, which decoupled gains leave to itself."""
        return w.box[:, 0] / (1 - np.abs(1 - self.period.dt * np.exp(points[:, 8])))

    def fill(
        self,
        points: Float[np.ndarray, "n k"],
        w: EstimatedDisturbance,
        reach: Float[np.ndarray, "n 4"],
    ) -> Shares:
        """Return the shares that a tube fills which reaches so far in e_x, e_y, e_th and along
        (k2, k3)."""
        caps = read_caps(points)
        reach_x, reach_y, reach_heading, reach_turning = reach.T
        reach_speed = np.exp(points[:, 8]) * reach_x + self.yaw_rate * reach_y
        filled = [
            reach_x / caps.longitudinal,
            reach_y / caps.lateral,
            reach_heading / caps.heading,
            reach_speed / caps.slower,
            reach_speed / caps.faster,
            reach_turning / caps.turning,
            reach_x / caps.coupled_error + reach_turning / caps.coupled_turning,
        ]
        limits = [
            self._use_of_constraints(points, caps, w),
            self._use_by_start(points, caps, w, reach_speed),
            w.greatest / self.fastest,
            1 + (self.slowest - w.least) / self.fastest,
        ]
        return Shares(np.stack(filled, axis=1), np.column_stack(limits))

    def _use_of_constraints(
        self, points: Float[np.ndarray, "n k"], caps: Caps, w: EstimatedDisturbance
    ) -> Float[np.ndarray, "n 3"]:
        """Return how far the caps use what the error of the estimate leaves of the constraints; the
        proved error of an observer is a little larger."""
        is_observed = self.corners.gain(points).min(axis=1) < 1
        error = w.error * (1 + self.reserve * is_observed[:, None])
        kept = np.stack([caps.longitudinal, caps.lateral, caps.heading], axis=1)
        if w.late is not None:
            later = find_pose_errors(self.corners.operation, w.late, kept + error)
            error = (later - kept) * (1 + self.reserve)
        left = np.maximum(self.constraints - error, ACCURACY * self.constraints)
        return kept / left

    def _use_by_start(
        self,
        points: Float[np.ndarray, "n k"],
        caps: Caps,
        w: EstimatedDisturbance,
        reach_speed: Float[np.ndarray, " n"],
    ) -> Float[np.ndarray, "n 5"]:
        """Return how far the start uses what it needs of the caps: of the errors, of turning, and
        of the speed that brings its longitudinal error to what k1 can hold within the horizon.

        Where slips are learnt the first disturbance is the widest, and what is turned to undo it
        shares the coupling with what is left of the longitudinal error a period later.
        """
        k1, k2, k3 = np.exp(points[:, 8:CAPS_AND_GAINS]).T
        if not self.start.any() and w.first is None:
            return np.zeros((len(k1), 5))
        errors = np.stack([caps.longitudinal, caps.lateral, caps.heading], axis=1)
        first = w.steps if w.first is None else w.first
        at_start = (self.start + first + (START_STEPS - 1) * w.steps) / errors
        turning = START_TURN * caps.turning / caps.coupled_turning
        turning += self.start[0] / caps.coupled_error
        if w.first is not None:
            left = np.maximum(self.start[0] - self.period.dt * caps.faster, 0.0)
            undone = k2 * first[:, 1] + k3 * first[:, 2]
            coupled = undone / caps.coupled_turning + (first[:, 0] + left) / caps.coupled_error
            turned = undone / caps.turning + START_TURN * np.sign(self.start[1])
            turning = np.maximum(turning, np.maximum(coupled, turned))
        ahead = self.problem.initial_error[0] < 0
        horizon = self.problem.horizon * self.period.dt
        needed = self.start[0] / horizon + reach_speed
        available = (caps.faster if ahead else caps.slower) * (1 + 1 / (k1 * horizon))
        speed = needed / available
        if w.first is not None:
            undone = k1 * first[:, 0] + self.yaw_rate * first[:, 1]
            speed = np.maximum(speed, undone / np.minimum(caps.slower, caps.faster))
        return np.column_stack([at_start, turning, speed])

    def tube_data(
        self,
        points: Float[np.ndarray, "n k"],
        w: EstimatedDisturbance,
        ahead: Float[np.ndarray, " n"],
    ) -> tuple[
        Float[np.ndarray, "n directions"],
        Float[np.ndarray, "n loops directions 2"],
        Float[np.ndarray, "n 3 2"],
    ]:
        """Return one step's disturbance, the images of the directions and the rows of the caps, in
        (e_y, e_th), where e_x reaches so far ahead."""
        T = self.period.dt
        directions = self.ring.directions
        k1, k2, k3 = np.exp(points[:, 8:CAPS_AND_GAINS]).T
        drift = self.greatest_h * np.abs(2 - T * k1) * ahead
        kick = np.abs(np.outer(w.lateral_per_yaw, directions[:, 0]) + directions[:, 1])
        box = np.stack([w.box[:, 1] + drift, w.box[:, 2]], axis=1)
        steps = w.yaw[:, None] * kick + box @ np.abs(directions).T
        c = self.extreme_c
        loops = np.empty((len(points), len(c), 2, 2))
        loops[..., 0, 0] = 1 - T * np.outer(k2, c) / 2
        loops[..., 0, 1] = c * (1 - T * k3[:, None] / 2)
        loops[..., 1, 0] = -T * k2[:, None]
        loops[..., 1, 1] = 1 - T * k3[:, None]
        one = np.ones_like(k2)
        rows = np.stack([[one, 0 * one], [0 * one, one], [k2, k3]]).transpose(2, 0, 1)
        return steps, directions @ loops, rows
