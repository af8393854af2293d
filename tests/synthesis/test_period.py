"""Laws of the witness for W: its period is that of the bound's own plant, and it stays in what is
certified."""

import numpy as np
import pytest
from tolerances import RESIDUAL_ROUNDING, ROUNDING

from jaxtube.scenario import load
from jaxtube.synthesis.certificate.period import (
    PeriodCases,
    extreme_cases,
    find_disturbances,
    next_errors,
)
from jaxtube.synthesis.disturbance import complete_problem, kinematics, operation
from jaxtube.synthesis.problem import make_problem
from sets.robot.disturbance import evaluate_disturbance

COUNT = 500


def random_cases(problem, seed=0) -> PeriodCases:
    random = np.random.default_rng(seed)
    return PeriodCases(
        errors=random.uniform(-0.3, 0.3, (COUNT, 3)),
        inputs=random.uniform(-0.8, 0.8, (COUNT, 2)),
        wheels=random.uniform(0.2, 1.5, (COUNT, 2)),
        slip=random.uniform(0.1, 0.3, (COUNT, 2)),
        measured_slip=random.uniform(0.1, 0.3, (COUNT, 2)),
        sideslip=random.uniform(-0.1, 0.1, COUNT),
        noise=random.uniform(-0.01, 0.01, (COUNT, 3)),
    )


def disturbances_by_the_bounds_plant(problem, cases):
    relative = cases.slip - cases.measured_slip
    wheel_errors = relative / (1 - cases.measured_slip)
    points = np.hstack(
        [
            cases.errors,
            cases.inputs,
            cases.wheels,
            wheel_errors,
            cases.sideslip[:, None],
            cases.noise,
        ]
    )
    none = np.zeros_like(cases.noise)
    w, _, _ = evaluate_disturbance(operation(problem), kinematics(problem), points, none)
    return w


@pytest.mark.parametrize("input_map", ["paper", "cosine_free", "x_exact"])
def test_a_period_in_the_world_frame_is_that_of_the_bounds_plant(input_map):
    settings = [f"controller.input_map={input_map}", "robot.lever_arm_m=0.05"]
    problem = make_problem(load("paper", settings))
    cases = random_cases(problem)
    A, B = problem.model.matrices(cases.wheels)
    predicted = np.einsum("nij,nj->ni", A, cases.errors)
    predicted += np.einsum("nij,nj->ni", B, cases.inputs)
    w = next_errors(problem, cases) - predicted
    expected = disturbances_by_the_bounds_plant(problem, cases)
    np.testing.assert_allclose(w, expected, rtol=0, atol=RESIDUAL_ROUNDING)


def test_what_is_met_under_the_exact_jacobian_is_what_the_bound_is_made_of():
    problem = complete_problem(load("certified"))
    cases = extreme_cases(problem)
    expected = disturbances_by_the_bounds_plant(problem, cases)
    np.testing.assert_allclose(find_disturbances(problem), expected, rtol=0, atol=RESIDUAL_ROUNDING)


@pytest.mark.parametrize("name", ["paper", "certified"])
def test_extremes_lie_in_what_is_certified_and_reach_its_limits(name):
    problem = make_problem(load(name))
    cases = extreme_cases(problem)
    rows = problem.input_rows
    used = cases.inputs @ rows.inputs.T + cases.errors @ rows.errors.T
    assert np.all(used <= rows.offsets + ROUNDING)
    np.testing.assert_allclose(used.max(axis=0), rows.offsets, atol=ROUNDING)
    assert problem.operating_set.margin(cases.errors).min() >= -ROUNDING
    low, high = problem.model.box
    assert np.all((cases.wheels >= low) & (cases.wheels <= high))
    # One of true and measured slip is nominal.
    nominal = 0.2
    deviates = np.stack([cases.slip != nominal, cases.measured_slip != nominal])
    assert not np.any(deviates.any(axis=2).all(axis=0))


def test_where_both_slips_vary_they_are_extreme_together():
    problem = make_problem(load("paper", ["slip.random=both"]))
    cases = extreme_cases(problem)
    errors = (cases.slip - cases.measured_slip) / (1 - cases.measured_slip)
    np.testing.assert_allclose(
        np.abs(errors).max(axis=0), operation(problem).wheel_errors[1], rtol=1e-12
    )
