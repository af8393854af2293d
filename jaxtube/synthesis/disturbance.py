"""The disturbance bound of a problem: what the slipping robot adds to its model over everything
that is certified."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from jaxtyping import Float

from jaxtube.scenario import Scenario, ScenarioError
from jaxtube.synthesis.problem import Problem, make_problem
from sets.robot.disturbance import Operation, disturbance_bound, wheel_error_bound
from sets.robot.plant import Kinematics


def operation(problem: Problem) -> Operation:
    """Return where the robot works: measured errors, inputs, certified wheel speeds, slip errors
    and noise."""
    slip, caps = problem.scenario.slip, problem.scenario.operating
    # The measured slip's error is the larger of the two single ones, so either may vary.
    reading = "both" if slip.random == "both" else "measured"
    coupling = None
    if caps.turning_longitudinal_m is not None and caps.turning_yaw_rate_radps is not None:
        coupling = caps.turning_longitudinal_m, caps.turning_yaw_rate_radps
    return Operation(
        errors=problem.operating_set.offsets[:3] * np.array([[-1.0], [1.0]]),
        inputs=_ends(problem.input_set),
        schedules=problem.regions,
        wheel_error=wheel_error_bound(
            np.array([slip.nominal_right, slip.nominal_left]), slip.relative_error, reading
        ),
        noise=problem.error_set.support(np.eye(3)) - problem.operating_set.support(np.eye(3)),
        dt=problem.model.dt,
        track_width=problem.model.track_width,
        coupling=coupling,
    )


def kinematics(problem: Problem) -> Kinematics:
    """Return the input map and the model of a problem."""
    settings = problem.scenario.controller
    factors = tuple(float(factor) for factor in problem.model.slip_factors)
    return Kinematics(
        settings.input_map, settings.model, settings.discretisation, (factors[0], factors[1])
    )


def ground_speed_limits(problem: Problem) -> Float[np.ndarray, "2 2"]:
    """Return the (least, greatest) ground speeds (right, left), m/s, that the wheels reach under
    every slip."""
    slip, robot = problem.scenario.slip, problem.robot
    nominal = np.array([slip.nominal_right, slip.nominal_left])
    most, least = 1 - nominal * (1 - slip.relative_error), 1 - nominal * (1 + slip.relative_error)
    slowest = np.maximum(most * robot.wheel_speed_min, least * robot.wheel_speed_min)
    return np.stack([slowest, least * robot.wheel_speed_max])


def complete_problem(scenario: Scenario) -> Problem:
    """Build the problem of a scenario, W computed for the robot itself where the scenario asks for
    it.

    Raises:
        ScenarioError: as `make_problem`; where the operating set is so wide that angles leave a
            quarter turn.
    """
    problem = make_problem(scenario)
    return problem if scenario.disturbance.bound == "assumed" else with_computed_bound(problem)


def with_computed_bound(problem: Problem) -> Problem:
    """Return the problem with W computed for the robot itself, over all that is certified.

    Raises:
        ScenarioError: where the operating set is so wide that angles leave a quarter turn.
    """
    try:
        bound = disturbance_bound(operation(problem), kinematics(problem))
        if not bound.yaw + bound.box[2] > 0:
            raise ValueError("without slip error and noise W is flat; give one of them")
    except ValueError as error:
        raise ScenarioError(
            f'scenario: disturbance.bound = "computed": {error}; narrow [operating]'
        ) from None
    return replace(problem, residual=bound, disturbance_set=bound.polytope())


def _ends(polytope) -> np.ndarray:
    identity = np.eye(polytope.dimension)
    return np.stack([-polytope.support(-identity), polytope.support(identity)])
