"""From a scenario to the data of a control problem: reference, model, weights, and the sets E, U
and W.

    E: |e_x|, |e_y|, |e_th| bounded, for the true error; the controller keeps the measured one in
        `operating_set`
    U: caps on u1, u2, or a parallelogram in p = u1 + (b/2) u2, q = u1 - (b/2) u2,
       per wheel  V - (1 - i) v_max <= p, q <= V - (1 - i) v_min   for every reference speed V and slip i it may meet
    W: a box that is assumed, or a bound computed for the slipping robot over all of these
        (`synthesis.disturbance`)

Source: Gonzalez, Fiacchini, Guzman, Alamo 2009, eqs. (7)-(8), (11), section IV.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from jaxtyping import Float

from jaxtube.plant.model import VERTEX_SIDES, Model, make_model
from jaxtube.plant.recorded_reference import from_file
from jaxtube.plant.reference import Reference, lemniscate, two_circles
from jaxtube.plant.robot import Robot
from jaxtube.scenario import Scenario, ScenarioError, check_reference_wheels, weight_matrix
from jaxtube.scenario.reference_rules import is_in_box
from sets.polytope import Polytope
from sets.robot.disturbance import DisturbanceBound

MOST_SPEED_PAIRS = 64
"""Pairs of wheel speeds along a path that are certified one by one: each is a loop of every set."""
SAME_SPEED_DECIMALS = 12
"""Wheel speeds that agree to so many decimals, m/s, are one: they differ by rounding."""


@dataclass(frozen=True, eq=False)
class InputRows:
    """Constraints  inputs u + errors e <= offsets  of one period; the second half of the rows is
    minus the first.

    The rows of U, where e does not count, and with a coupling |e_x| / a + |u2| / b <= 1 its four.
    """

    inputs: Float[np.ndarray, "k 2"]
    errors: Float[np.ndarray, "k 3"]
    offsets: Float[np.ndarray, " k"]

    def on_errors(self, gains: Float[np.ndarray, "... 2 3"]) -> Float[np.ndarray, "... k 3"]:
        """Return the rows on the error under u = K e."""
        return self.inputs @ gains + self.errors

    @classmethod
    def of(cls, input_set: Polytope) -> InputRows:
        """Return the rows of a set of inputs."""
        count = len(input_set.offsets)
        return cls(input_set.normals, np.zeros((count, 3)), input_set.offsets)


@dataclass(frozen=True, eq=False)
class Problem:
    """What a design starts from: the scenario as arrays in SI units and radians.

    `regions` are boxes of wheel speeds, lower and upper (right, left) in m/s, over whose union sets
    and certificate hold under arbitrary changes: the box of the reference, or the points that occur
    on its path. `disturbance_bound` is what W was computed from, None where W is assumed.
    """

    scenario: Scenario
    robot: Robot
    reference: Reference
    model: Model
    horizon: int
    error_weight: Float[np.ndarray, "3 3"]
    input_weight: Float[np.ndarray, "2 2"]
    error_set: Polytope
    operating_set: Polytope
    input_set: Polytope
    input_rows: InputRows
    disturbance_set: Polytope
    initial_error: Float[np.ndarray, "3"]
    regions: Float[np.ndarray, "m 2 2"]
    disturbance_bound: DisturbanceBound | None = None

    @property
    def schedule(self) -> Float[np.ndarray, "periods 2"]:
        """Reference wheel speeds (right, left) of every period, preview included, m/s."""
        return self.reference.wheels

    @property
    def noise(self) -> Float[np.ndarray, "3"]:
        """Half widths of the error of the measured pose in the robot's frame (m, m, rad)."""
        return error_vector(self.scenario.noise)

    @property
    def given_gains(self) -> Float[np.ndarray, " kappa"]:
        """The numbers of the gains that the scenario gives, none where they come from the terminal
        cost's LMI."""
        settings = self.scenario.controller
        return np.ravel(np.array(settings.tracking_gains or settings.vertex_gains, float))

    @property
    def corners(self) -> Float[np.ndarray, "4m 2"]:
        """Schedules at the corners of the regions, m/s; repeated where a region is a point."""
        return region_corners(self.regions)


def region_corners(regions: Float[np.ndarray, "... 2 2"]) -> Float[np.ndarray, "k 2"]:
    """Return the four corners of every region, in the order of `VERTEX_SIDES`."""
    return regions[..., VERTEX_SIDES, [0, 1]].reshape(-1, 2)


def error_vector(section) -> Float[np.ndarray, "3"]:
    """Return (m, m, rad) of a scenario section with longitudinal_m, lateral_m and heading_deg."""
    return np.array([section.longitudinal_m, section.lateral_m, np.deg2rad(section.heading_deg)])


def wheel_rows(track_width: float) -> Float[np.ndarray, "2 2"]:
    """Return the matrix that takes (u1, u2) to (p, q), the deficits of the right and the left
    wheel, m/s."""
    return np.array([[1.0, track_width / 2], [1.0, -track_width / 2]])


def wheel_deficit_bounds(
    robot: Robot,
    slowest: float,
    fastest: float,
    slip_range: tuple[float, float],
    heading_range: float = 0.0,
) -> tuple[float, float]:
    """Return (least, greatest) p that the wheel limits allow for every reference speed and slip in
    the ranges.

    Args:
        robot: the limits.
        slowest, fastest: reference wheel speeds, m/s; equal ones follow a known reference.
        slip_range: least and greatest slip.
        heading_range: bound of the heading error, rad, where the input map is cosine-free and adds
            V (cos e_th - 1).
    """
    lost = fastest * (1 - np.cos(heading_range))
    grips = [1 - slip for slip in slip_range]
    least = fastest - min(grip * robot.wheel_speed_max for grip in grips)
    greatest = slowest - lost - max(grip * robot.wheel_speed_min for grip in grips)
    return float(least), float(greatest)


def make_problem(scenario: Scenario) -> Problem:
    """Build the problem of a scenario, with the disturbance set it assumes (`synthesis.disturbance`
    computes one).

    Raises:
        ScenarioError: one line, where the reference leaves its box or the wheel limits leave no
            input.
    """
    settings = scenario.controller
    robot = Robot(
        scenario.robot.track_width_m,
        scenario.robot.wheel_speed_min_mps,
        scenario.robot.wheel_speed_max_mps,
    )
    reference = _make_reference(scenario)
    _refuse_fast_recording(scenario, reference)
    check_reference_wheels(scenario, float(reference.wheels.min()), float(reference.wheels.max()))
    box = _speed_box(scenario, reference)
    slip = np.array([scenario.slip.nominal_right, scenario.slip.nominal_left])
    model = make_model(
        settings.model,
        settings.discretisation,
        settings.dt_s,
        robot.track_width,
        slip,
        (box[0], box[1]),
    )
    operating = _operating_bounds(scenario)
    noise = error_vector(scenario.noise)
    disturbance = error_vector(scenario.disturbance)
    input_set, input_rows = input_constraints(scenario, robot)
    return Problem(
        scenario=scenario,
        robot=robot,
        reference=reference,
        model=model,
        horizon=settings.horizon,
        error_weight=weight_matrix(settings.error_weight),
        input_weight=weight_matrix(settings.input_weight),
        error_set=Polytope.box(-operating - noise, operating + noise),
        operating_set=Polytope.box(-operating, operating),
        input_set=input_set,
        input_rows=input_rows,
        disturbance_set=Polytope.box(-disturbance, disturbance),
        initial_error=_initial_error(scenario),
        regions=_make_regions(scenario, reference, box),
    )


def with_controller(problem: Problem, scenario: Scenario) -> Problem:
    """Return the problem with weights and gains of a scenario that has the same sets, model and
    reference."""
    settings = scenario.controller
    return replace(
        problem,
        scenario=scenario,
        error_weight=weight_matrix(settings.error_weight),
        input_weight=weight_matrix(settings.input_weight),
    )


def merge_equal_speeds(wheels: Float[np.ndarray, "..."]) -> Float[np.ndarray, "..."]:
    """Return wheel speeds in which those that differ by rounding are one: the first of them, not
    rounded."""
    rounded = wheels.round(SAME_SPEED_DECIMALS).ravel()
    _, first, which = np.unique(rounded, return_index=True, return_inverse=True)
    return wheels.ravel()[first][which].reshape(wheels.shape)


def input_constraints(scenario: Scenario, robot: Robot) -> tuple[Polytope, InputRows]:
    """Return U, and the rows on input and error that are U and the coupling."""
    input_set = _make_input_set(scenario, robot)
    return input_set, _make_input_rows(scenario, input_set)


def _speed_box(scenario: Scenario, reference: Reference) -> Float[np.ndarray, "2 2"]:
    """Return the least and the greatest reference wheel speeds, each (right, left), m/s.

    A path on the edge of the scenario's box may leave it by rounding; the box returned holds it.
    """
    section = scenario.reference
    lower = min(section.wheel_speed_min_mps, float(reference.wheels.min()))
    upper = max(section.wheel_speed_max_mps, float(reference.wheels.max()))
    return np.array([[lower, lower], [upper, upper]])


def _refuse_fast_recording(scenario: Scenario, reference: Reference) -> None:
    """Refuse a recorded path whose wheel speeds leave the box of the reference."""
    section = scenario.reference
    slowest = float(reference.wheels.min())
    fastest = float(reference.wheels.max())
    if section.shape == "file" and not is_in_box(section, slowest, fastest):
        raise ScenarioError(
            f"scenario: reference.file = {section.file}: the path asks the wheels for "
            f"{slowest:.4g} to {fastest:.4g} m/s, outside the box "
            f"[{section.wheel_speed_min_mps:.4g}, {section.wheel_speed_max_mps:.4g}]; smooth the "
            "recording, check its units, or widen reference.wheel_speed_min_mps and "
            "wheel_speed_max_mps"
        )


def _operating_bounds(scenario: Scenario) -> Float[np.ndarray, "3"]:
    """Return half widths of the measured error: the caps, where none is given what the noise leaves
    of E."""
    left = error_vector(scenario.constraints) - error_vector(scenario.noise)
    operating = scenario.operating
    caps = left.copy()
    if operating.longitudinal_m is not None:
        caps[0] = operating.longitudinal_m
    if operating.lateral_m is not None:
        caps[1] = operating.lateral_m
    if operating.heading_deg is not None:
        caps[2] = np.deg2rad(operating.heading_deg)
    return np.minimum(caps, left)


def _make_input_set(scenario: Scenario, robot: Robot) -> Polytope:
    """Return U: the caps on u1 and u2 where they are given, else what the wheel limits allow of p
    and q."""
    operating = scenario.operating
    if operating.yaw_rate_deficit_radps is None:
        return _wheel_limited_inputs(robot, _wheel_deficits(scenario, robot))
    assert operating.speed_deficit_min_mps is not None
    assert operating.speed_deficit_max_mps is not None
    turning = operating.yaw_rate_deficit_radps
    return Polytope.box(
        np.array([operating.speed_deficit_min_mps, -turning]),
        np.array([operating.speed_deficit_max_mps, turning]),
    )


def _wheel_limited_inputs(robot: Robot, bounds: Float[np.ndarray, "2 2"]) -> Polytope:
    """Return U from [[p_min, p_max], [q_min, q_max]]: rows p, q, -p, -q."""
    rows = wheel_rows(robot.track_width)
    return Polytope(np.vstack([rows, -rows]), np.concatenate([bounds[:, 1], -bounds[:, 0]]))


def _make_input_rows(scenario: Scenario, input_set: Polytope) -> InputRows:
    """Return the rows of U and of the coupling, each half in the same order."""
    operating = scenario.operating
    rows = InputRows.of(input_set)
    if operating.turning_longitudinal_m is None or operating.turning_yaw_rate_radps is None:
        return rows
    turning = np.array([0.0, 1 / operating.turning_yaw_rate_radps])
    along = np.array([1 / operating.turning_longitudinal_m, 0.0, 0.0])
    coupled = InputRows(np.stack([turning, -turning]), np.stack([along, along]), np.ones(2))
    half = len(rows.offsets) // 2
    return InputRows(
        np.concatenate([rows.inputs[:half], coupled.inputs, rows.inputs[half:], -coupled.inputs]),
        np.concatenate([rows.errors[:half], coupled.errors, rows.errors[half:], -coupled.errors]),
        np.concatenate(
            [rows.offsets[:half], coupled.offsets, rows.offsets[half:], coupled.offsets]
        ),
    )


def _make_regions(
    scenario: Scenario, reference: Reference, box: Float[np.ndarray, "2 2"]
) -> Float[np.ndarray, "m 2 2"]:
    if scenario.reference.certified_for == "box":
        return box[None]
    pairs = np.unique(merge_equal_speeds(reference.wheels), axis=0)
    if len(pairs) > MOST_SPEED_PAIRS:
        raise ScenarioError(
            f'scenario: reference.certified_for = "path": the path has {len(pairs)} different '
            f"pairs of wheel speeds, more than {MOST_SPEED_PAIRS}; set reference.certified_for = "
            '"box"'
        )
    return np.stack([pairs, pairs], axis=1)


def _make_reference(scenario: Scenario) -> Reference:
    section = scenario.reference
    settings = scenario.controller
    preview = settings.horizon + 1
    track_width = scenario.robot.track_width_m
    try:
        if section.shape == "file":
            return from_file(
                Path(section.file), settings.dt_s, preview, track_width, section.duration_s
            )
        assert section.duration_s is not None  # which only a recording leaves open
        shape = {"two_circles": two_circles, "lemniscate": lemniscate}[section.shape]
        return shape(
            section.radius_m,
            section.speed_mps,
            section.duration_s,
            settings.dt_s,
            preview,
            track_width,
        )
    except ValueError as error:
        raise ScenarioError(f"scenario: {error}") from None


def _wheel_deficits(scenario: Scenario, robot: Robot) -> Float[np.ndarray, "2 2"]:
    """Return [[p_min, p_max], [q_min, q_max]] over the box of reference speeds and every slip, in
    m/s."""
    maps_speed = scenario.controller.input_map != "paper"
    heading = np.deg2rad(scenario.constraints.heading_deg) if maps_speed else 0.0
    section = scenario.reference
    slip = scenario.slip
    bounds = np.array(
        [
            wheel_deficit_bounds(
                robot,
                section.wheel_speed_min_mps,
                section.wheel_speed_max_mps,
                (nominal * (1 - slip.relative_error), nominal * (1 + slip.relative_error)),
                heading,
            )
            for nominal in (slip.nominal_right, slip.nominal_left)
        ]
    )
    if np.any(bounds[:, 0] >= 0):
        raise ScenarioError(
            f"scenario: robot.wheel_speed_max_mps = {robot.wheel_speed_max}: the wheels cannot "
            f"follow every reference speed under the greatest slip: they are "
            f"{bounds[:, 0].max():.4g} m/s too slow; widen the wheel limits or lower "
            "reference.wheel_speed_max_mps"
        )
    if np.any(bounds[:, 1] <= 0):
        raise ScenarioError(
            f"scenario: robot.wheel_speed_min_mps = {robot.wheel_speed_min}: the wheels cannot "
            f"turn as slowly as the reference under the least slip: they are "
            f"{-bounds[:, 1].min():.4g} m/s too fast; lower robot.wheel_speed_min_mps or raise "
            "reference.wheel_speed_min_mps"
        )
    return bounds


def _initial_error(scenario: Scenario) -> Float[np.ndarray, "3"]:
    """Return the tracking error of the start, eq. (3), the reference being at the origin of its own
    frame; the heading error is in (-180, 180] degrees."""
    start = scenario.initial
    heading = np.deg2rad(start.heading_deg)
    turn = np.array([[np.cos(heading), np.sin(heading)], [-np.sin(heading), np.cos(heading)]])
    heading_error = -math.remainder(start.heading_deg, 360.0)
    if heading_error == -180.0:
        heading_error = 180.0
    return np.append(turn @ [-start.x_m, -start.y_m], np.deg2rad(heading_error))
