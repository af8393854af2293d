"""Laws of plans that cost their deviation from the tube's gain: the gain is what runs wherever it
may, the cost falls whatever happens, and the closed loop ends within what is certified."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import minimize

import jaxtube as jt
from jaxtube.scenario import ScenarioError, load
from jaxtube.synthesis.certificate.fill import ultimate_bound
from jaxtube.synthesis.certificate.ultimate import NAME, check_ultimate_bound
from jaxtube.synthesis.design import design
from jaxtube.tuning.tuner import make_tuner
from sets.polytope import Polytope

OF_DEVIATION = ["controller.cost=deviation", "reference.duration_s=8"]
ROUNDING = 1e-9


@pytest.fixture(scope="module")
def deviating():
    return design(load("certified", OF_DEVIATION))


def deviation_cost(made, window, error, plan):
    """Return the cost of a plan, stage by stage."""
    transitions, inputs = made.problem.model.matrices(made.windows.schedules[window])
    total = 0.0
    for stage, step in enumerate(plan.reshape(-1, 2)):
        deviation = step - made.windows.gains[window, stage] @ error
        total += deviation @ made.problem.input_weight @ deviation
        error = transitions[stage] @ error + inputs[stage] @ step
    return total


def test_the_condensed_cost_is_the_deviation_from_the_gains(deviating):
    generator = np.random.default_rng(0)
    qps = deviating.tube_qps
    for window in range(0, len(qps.linear), 3):
        error = generator.normal(size=3) * [0.1, 0.1, 0.2]
        plans = generator.normal(size=(4, 2 * deviating.problem.horizon))
        costs = [deviation_cost(deviating, window, error, plan) for plan in plans]
        unit = qps.cost_unit[window]
        hessian = qps.factors.hessian[window]
        condensed = [
            unit * (plan @ hessian @ plan / 2 + plan @ qps.linear[window] @ error) for plan in plans
        ]
        differences = np.subtract(costs, condensed)
        assert differences == pytest.approx(np.full(4, differences[0]), abs=1e-9)
        # What no plan changes is the cost of asking for nothing.
        nothing = deviation_cost(deviating, window, error, 0 * plans[0])
        assert differences[0] == pytest.approx(nothing, abs=1e-9)


def test_without_active_rows_the_law_is_the_tubes_gain(deviating):
    first = np.asarray(deviating.tube_qps.free_inputs[:, :2])
    assert first == pytest.approx(deviating.windows.gains[:, 0], abs=1e-9)


def test_the_free_plan_is_the_minimum_found_by_another_method(deviating):
    error = np.array([0.05, -0.1, 0.1])
    start = np.ones(2 * deviating.problem.horizon)
    found = minimize(lambda plan: deviation_cost(deviating, 0, error, plan), start, tol=1e-14)
    free = deviating.tube_qps.free_inputs[0] @ error
    assert found.x == pytest.approx(free, abs=1e-4)
    assert deviation_cost(deviating, 0, error, free) == pytest.approx(0, abs=1e-12)


def test_the_certificate_says_what_the_closed_loop_ends_within(deviating):
    assert deviating.certificate.holds_for_robot
    condition = deviating.certificate.conditions[NAME]
    assert condition.holds
    assert condition.scope == "information"
    assert "of the MPC itself" in condition.sentence
    assert NAME not in design(load("certified", OF_DEVIATION[1:])).certificate.conditions


def test_a_terminal_set_without_room_for_the_tube_ends_the_argument(deviating):
    invariant = deviating.terminal.invariant
    small = Polytope(invariant.normals, invariant.offsets / 4)
    cut = replace(deviating, terminal=replace(deviating.terminal, invariant=small))
    (condition,) = check_ultimate_bound(cut)
    assert not condition.holds


@pytest.mark.slow
def test_laps_from_the_edge_end_within_it_and_cost_falls_whatever_happens(deviating):
    run = jt.montecarlo(deviating, laps=2048, starts="feasible")
    assert run.share("e_outside_E").laps == 0
    assert run.statistics["cost_excesses"] == 0
    widths = ultimate_bound(deviating.problem, deviating.terminal.gains)
    laps = jt.simulate(deviating, "tube_mpc", laps=256, slip="vertex")
    assert np.all(np.abs(laps.trajectory.measured[-20:]) <= widths + ROUNDING)


def test_other_terminal_sets_and_tuning_are_refused():
    with pytest.raises(ScenarioError, match=r"controller\.cost.*T-A"):
        load("robust", ["controller.cost=deviation"])
    with pytest.raises(ScenarioError, match=r"controller\.cost.*tracking"):
        make_tuner(load("tuned", ["controller.cost=deviation"]), laps=8, held_out=8)


def test_a_cost_that_does_not_fall_along_the_loops_ends_the_argument(deviating):
    growing = replace(deviating.cost, cost=np.diag([1.0, 1.0, 1e-6]))
    (condition,) = check_ultimate_bound(replace(deviating, cost=growing))
    assert not condition.holds
