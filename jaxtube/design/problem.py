"""From a scenario to the data of a control problem: reference, model, weights, and the sets E, U and W.

    E: |e_x|, |e_y|, |e_th| bounded;   W: a box;   U: a parallelogram in p = u1 + (b/2) u2, q = u1 - (b/2) u2,
    per wheel  V - (1 - i) v_max <= p, q <= V - (1 - i) v_min   for every reference speed V and slip i it may meet.

Source: Gonzalez, Fiacchini, Guzman, Alamo 2009, eqs. (7)-(8), (11), section IV.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float

from jaxtube.model import Model, make_model
from jaxtube.reference import Reference, from_file, lemniscate, two_circles
from jaxtube.robot import Robot
from jaxtube.scenario import Scenario, ScenarioError, check_reference_wheels, weight_matrix
from sets.polytope import Polytope


@dataclass(frozen=True, eq=False)
class Problem:
    """What a design starts from: the scenario as arrays in SI units and radians."""

    scenario: Scenario
    robot: Robot
    reference: Reference
    model: Model
    horizon: int
    error_weight: Float[np.ndarray, "3 3"]
    input_weight: Float[np.ndarray, "2 2"]
    error_set: Polytope
    input_set: Polytope
    disturbance_set: Polytope
    initial_error: Float[np.ndarray, "3"]

    @property
    def schedule(self) -> Float[np.ndarray, "periods 2"]:
        """Reference wheel speeds (right, left) of every period, preview included, m/s."""
        return self.reference.wheels


def error_vector(section) -> Float[np.ndarray, "3"]:
    """Return (m, m, rad) of a scenario section with longitudinal_m, lateral_m and heading_deg."""
    return np.array([section.longitudinal_m, section.lateral_m, np.deg2rad(section.heading_deg)])


def input_rows(track_width: float) -> Float[np.ndarray, "2 2"]:
    """Return the matrix that takes (u1, u2) to (p, q), the deficits of the right and the left wheel, m/s."""
    return np.array([[1.0, track_width / 2], [1.0, -track_width / 2]])


def wheel_deficit_bounds(
    robot: Robot,
    slowest: float,
    fastest: float,
    slip_range: tuple[float, float],
    heading_range: float = 0.0,
) -> tuple[float, float]:
    """Return (least, greatest) p that the wheel limits allow for every reference speed and slip in the ranges.

    Args:
        robot: the limits.
        slowest, fastest: reference wheel speeds, m/s; equal ones follow a known reference.
        slip_range: least and greatest slip.
        heading_range: bound of the heading error, rad, where the input map is cosine-free and adds V (cos e_th - 1).
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
    """Build the problem of a scenario.

    Raises:
        ScenarioError: one line, where the reference leaves its box or the wheel limits leave no input.
    """
    settings = scenario.controller
    robot = Robot(scenario.robot.track_width_m, scenario.robot.wheel_speed_min_mps, scenario.robot.wheel_speed_max_mps)
    box = np.repeat([[scenario.reference.wheel_speed_min_mps], [scenario.reference.wheel_speed_max_mps]], 2, axis=1)
    slip = np.array([scenario.slip.nominal_right, scenario.slip.nominal_left])
    model = make_model(
        settings.model, settings.discretisation, settings.dt_s, robot.track_width, slip, (box[0], box[1])
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
    error_bounds = error_vector(scenario.constraints)
    disturbance = error_vector(scenario.disturbance)
    return Problem(
        scenario=scenario,
        robot=robot,
        reference=reference,
        model=model,
        horizon=settings.horizon,
        error_weight=weight_matrix(settings.error_weight),
        input_weight=weight_matrix(settings.input_weight),
        error_set=Polytope.box(-error_bounds, error_bounds),
        input_set=input_polytope(robot, _input_bounds(scenario, robot)),
        disturbance_set=Polytope.box(-disturbance, disturbance),
        initial_error=_initial_error(scenario),
    )


def _reference(scenario: Scenario) -> Reference:
    section, settings = scenario.reference, scenario.controller
    track_width, preview = scenario.robot.track_width_m, settings.horizon + 1
    try:
        if section.shape == "file":
            return from_file(Path(section.file), settings.dt_s, preview, track_width, section.duration_s)
        shape = {"two_circles": two_circles, "lemniscate": lemniscate}[section.shape]
        return shape(section.radius_m, section.speed_mps, section.duration_s, settings.dt_s, preview, track_width)
    except ValueError as error:
        raise ScenarioError(f"scenario: {error}") from None


def _input_bounds(scenario: Scenario, robot: Robot) -> Float[np.ndarray, "2 2"]:
    """Return [[p_min, p_max], [q_min, q_max]] over the box of reference speeds and every slip, in m/s."""
    cosine_free = scenario.controller.input_map == "cosine_free"
    heading = np.deg2rad(scenario.constraints.heading_deg) if cosine_free else 0.0
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
    """Return the tracking error of the start, eq. (3), the reference being at the origin of its own frame."""
    start = scenario.initial
    heading = np.deg2rad(start.heading_deg)
    turn = np.array([[np.cos(heading), np.sin(heading)], [-np.sin(heading), np.cos(heading)]])
    return np.append(turn @ [-start.x_m, -start.y_m], -heading)
