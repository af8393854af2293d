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

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from jaxtyping import Float

from jaxtube.plant.model import VERTEX_SIDES, Model, make_model
from jaxtube.plant.recording import from_file
from jaxtube.plant.reference import Reference, lemniscate, two_circles
from jaxtube.plant.robot import Robot
from jaxtube.scenario import Scenario, ScenarioError, check_reference_wheels, weight_matrix
from sets.polytope import Polytope
from sets.robot.disturbance import DisturbanceBound

MOST_VALUES = 64
"""Pairs of wheel speeds along a path that are certified one by one: each is a loop of every set."""


@dataclass(frozen=True, eq=False)
class InputRows:
    """Constraints  inputs u + errors e <= offsets  of one period; the second half of the rows is minus the first.

    The rows of U, where e does not count, and with a coupling |e_x| / a + |u2| / b <= 1 its four.
    """

    inputs: Float[np.ndarray, "k 2"]
    errors: Float[np.ndarray, "k 3"]
    offsets: Float[np.ndarray, " k"]

    def under(self, gains: Float[np.ndarray, "... 2 3"]) -> Float[np.ndarray, "... k 3"]:
        """Return the rows on the error under u = K e."""
        return self.inputs @ gains + self.errors


@dataclass(frozen=True, eq=False)
class Problem:
    """What a design starts from: the scenario as arrays in SI units and radians.

    `regions` are boxes of wheel speeds, lower and upper (right, left) in m/s, over whose union sets
    and certificate hold under arbitrary changes: the box of the reference, or the points that occur
    on its path.
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
    residual: DisturbanceBound | None = None

    @property
    def schedule(self) -> Float[np.ndarray, "periods 2"]:
        """Reference wheel speeds (right, left) of every period, preview included, m/s."""
        return self.reference.wheels

    @property
    def given_gains(self) -> Float[np.ndarray, " kappa"]:
        """The numbers of the gains that the scenario gives, none where they come from the terminal
        cost's LMI."""
        settings = self.scenario.controller
        return np.ravel(np.array(settings.tracking_gains or settings.vertex_gains, float))

    @property
    def corners(self) -> Float[np.ndarray, "4m 2"]:
        """Schedules at the corners of the regions, m/s; repeated where a region is a point."""
        return self.regions[:, VERTEX_SIDES, [0, 1]].reshape(-1, 2)


def error_vector(section) -> Float[np.ndarray, "3"]:
    """Return (m, m, rad) of a scenario section with longitudinal_m, lateral_m and heading_deg."""
    return np.array([section.longitudinal_m, section.lateral_m, np.deg2rad(section.heading_deg)])


def input_rows(track_width: float) -> Float[np.ndarray, "2 2"]:
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


def input_polytope(robot: Robot, bounds: Float[np.ndarray, "2 2"]) -> Polytope:
    """Return U from [[p_min, p_max], [q_min, q_max]]: rows p, q, -p, -q."""
    rows = input_rows(robot.track_width)
    return Polytope(np.vstack([rows, -rows]), np.concatenate([bounds[:, 1], -bounds[:, 0]]))


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
    box = np.repeat(
        [[scenario.reference.wheel_speed_min_mps], [scenario.reference.wheel_speed_max_mps]],
        2,
        axis=1,
    )
    slip = np.array([scenario.slip.nominal_right, scenario.slip.nominal_left])
    model = make_model(
        settings.model,
        settings.discretisation,
        settings.dt_s,
        robot.track_width,
        slip,
        (box[0], box[1]),
    )
    reference = _reference(scenario)
    slowest, fastest = (float(bound) for bound in (reference.wheels.min(), reference.wheels.max()))
    if scenario.reference.shape == "file" and not box[0, 0] <= slowest <= fastest <= box[1, 0]:
        raise ScenarioError(
            f"scenario: reference.file = {scenario.reference.file}: the path asks the wheels for {slowest:.4g} to "
            f"{fastest:.4g} m/s, outside the box [{box[0, 0]:.4g}, {box[1, 0]:.4g}]; smooth the recording, check its "
            "units, or widen reference.wheel_speed_min_mps and wheel_speed_max_mps"
        )
    check_reference_wheels(scenario, slowest, fastest)
    operating, noise = _operating_bounds(scenario), error_vector(scenario.noise)
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
        regions=_regions(scenario, reference, box),
    )


def with_controller(problem: Problem, scenario: Scenario) -> Problem:
    """Return the problem with weights and gains of a scenario that has the same sets, model and
    reference."""
    settings = scenario.controller
    weights = weight_matrix(settings.error_weight), weight_matrix(settings.input_weight)
    return replace(problem, scenario=scenario, error_weight=weights[0], input_weight=weights[1])


def _operating_bounds(scenario: Scenario) -> Float[np.ndarray, "3"]:
    """Return half widths of the measured error: the caps, where none is given what the noise leaves
    of E."""
    left = error_vector(scenario.constraints) - error_vector(scenario.noise)
    caps, operating = left.copy(), scenario.operating
    for i, cap in enumerate((operating.longitudinal_m, operating.lateral_m, operating.heading_deg)):
        if cap is not None:
            caps[i] = np.deg2rad(cap) if i == 2 else cap
    return np.minimum(caps, left)


def input_constraints(scenario: Scenario, robot: Robot) -> tuple[Polytope, InputRows]:
    """Return U, and the rows on input and error that are U and the coupling."""
    input_set = _input_set(scenario, robot)
    return input_set, _input_rows(scenario, input_set)


def _input_set(scenario: Scenario, robot: Robot) -> Polytope:
    """Return U: the caps on u1 and u2 where they are given, else what the wheel limits allow of p
    and q."""
    operating = scenario.operating
    if operating.yaw_rate_deficit_radps is None:
        return input_polytope(robot, _input_bounds(scenario, robot))
    assert (
        operating.speed_deficit_min_mps is not None and operating.speed_deficit_max_mps is not None
    )
    lower = [operating.speed_deficit_min_mps, -operating.yaw_rate_deficit_radps]
    return Polytope.box(
        np.array(lower),
        np.array([operating.speed_deficit_max_mps, operating.yaw_rate_deficit_radps]),
    )


def _input_rows(scenario: Scenario, input_set: Polytope) -> InputRows:
    operating, k = scenario.operating, len(input_set.offsets)
    if operating.turning_longitudinal_m is None or operating.turning_yaw_rate_radps is None:
        return InputRows(input_set.normals, np.zeros((k, 3)), input_set.offsets)
    along, turning = 1 / operating.turning_longitudinal_m, 1 / operating.turning_yaw_rate_radps
    inputs = np.array([[0.0, turning], [0.0, -turning]])
    errors = np.array([[along, 0.0, 0.0]] * 2)
    first, second = slice(None, k // 2), slice(k // 2, None)
    return InputRows(
        np.concatenate([input_set.normals[first], inputs, input_set.normals[second], -inputs]),
        np.concatenate([np.zeros((k // 2, 3)), errors, np.zeros((k // 2, 3)), -errors]),
        np.concatenate(
            [input_set.offsets[first], [1.0, 1.0], input_set.offsets[second], [1.0, 1.0]]
        ),
    )


def _regions(scenario: Scenario, reference: Reference, box) -> Float[np.ndarray, "m 2 2"]:
    if scenario.reference.certified_for == "box":
        return box[None]
    values = np.unique(reference.wheels.round(12), axis=0)
    if len(values) > MOST_VALUES:
        raise ScenarioError(
            f'scenario: reference.certified_for = "path": the path has {len(values)} different pairs of wheel speeds, '
            f'more than {MOST_VALUES}; set reference.certified_for = "box"'
        )
    return np.stack([values, values], axis=1)


def _reference(scenario: Scenario) -> Reference:
    section, settings = scenario.reference, scenario.controller
    track_width, preview = scenario.robot.track_width_m, settings.horizon + 1
    try:
        if section.shape == "file":
            return from_file(
                Path(section.file), settings.dt_s, preview, track_width, section.duration_s
            )
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


def _input_bounds(scenario: Scenario, robot: Robot) -> Float[np.ndarray, "2 2"]:
    """Return [[p_min, p_max], [q_min, q_max]] over the box of reference speeds and every slip, in
    m/s."""
    maps_speed = scenario.controller.input_map != "paper"
    heading = np.deg2rad(scenario.constraints.heading_deg) if maps_speed else 0.0
    error = scenario.slip.relative_error
    bounds = np.array(
        [
            wheel_deficit_bounds(
                robot,
                scenario.reference.wheel_speed_min_mps,
                scenario.reference.wheel_speed_max_mps,
                (nominal * (1 - error), nominal * (1 + error)),
                heading,
            )
            for nominal in (scenario.slip.nominal_right, scenario.slip.nominal_left)
        ]
    )
    if not np.all((bounds[:, 0] < 0) & (bounds[:, 1] > 0)):
        raise ScenarioError(
            f"scenario: robot.wheel_speed_max_mps = {robot.wheel_speed_max}: the wheels cannot follow every reference "
            f"speed under the greatest slip (deficits {bounds.round(3).tolist()} m/s must have 0 inside); "
            "widen the wheel limits or lower reference.wheel_speed_max_mps"
        )
    return bounds


def _initial_error(scenario: Scenario) -> Float[np.ndarray, "3"]:
    """Return the tracking error of the start, eq. (3), the reference being at the origin of its own
    frame."""
    start = scenario.initial
    heading = np.deg2rad(start.heading_deg)
    turn = np.array([[np.cos(heading), np.sin(heading)], [-np.sin(heading), np.cos(heading)]])
    return np.append(turn @ [-start.x_m, -start.y_m], -heading)
