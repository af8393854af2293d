"""Laws of designs whose controller acts on an estimate: the set of its error, W, the certificate,
and laps."""

import dataclasses

import numpy as np
import pytest
from observed_design import NOISY, OBSERVED

import jaxtube as jt
from jaxtube.scenario import ScenarioError, load, replace
from jaxtube.simulation import batches, components
from jaxtube.simulation.choices import choose_starts
from jaxtube.simulation.rollout import realisation_keys
from jaxtube.synthesis.certificate.assumptions import assumptions
from jaxtube.synthesis.certificate.period import (
    find_disturbances,
    find_estimate_errors,
    noise_reach,
)
from jaxtube.synthesis.certificate.robot import check_estimate_error, check_robot
from jaxtube.synthesis.disturbance import complete_problem, kinematics, operation, prove_bound
from jaxtube.synthesis.estimate import RESERVE, Estimate
from jaxtube.synthesis.optimise import optimise
from jaxtube.synthesis.problem import Problem, make_problem
from jaxtube.synthesis.starts import caps_and_gains
from sets.robot.operation import Operation

PROCESSES = ("iid", "constant", "walk", "patches", "vertex", "adversarial")


@pytest.fixture(scope="module")
def problem() -> Problem:
    return complete_problem(load("certified", OBSERVED))


def test_the_certificate_says_that_the_error_of_the_estimate_stays_in_its_set(problem):
    conditions = {condition.name: condition for condition in check_robot(problem)}
    assert all(condition.holds for condition in conditions.values())
    condition = conditions["estimate_error_invariant"]
    assert condition.scope == "robot"
    assert "proved by interval arithmetic" in condition.sentence
    assert "estimated error and the error of the estimate" in conditions["true_error_in_e"].sentence
    room = problem.error_set.offsets[:3] - problem.operating_set.offsets[:3]
    np.testing.assert_allclose(room, problem.estimate_error, rtol=1e-12)
    assert (problem.estimate_error > problem.noise).all()


@pytest.mark.parametrize("coordinate", [0, 1, 2])
def test_a_set_that_is_too_small_is_refuted(problem, coordinate):
    smaller = problem.estimate_error.copy()
    smaller[coordinate] *= 0.99
    condition = check_estimate_error(dataclasses.replace(problem, estimate_error=smaller))
    assert not condition.holds
    assert condition.sentence.startswith("The ")


def test_the_witness_in_the_world_frame_comes_near_the_set_and_near_w(problem):
    """The witness shares no code with the bounds; it meets nearly all of both."""
    errors = np.abs(find_estimate_errors(problem)).max(axis=0) + noise_reach(problem, np.eye(3))
    shares = errors / problem.estimate_error
    assert (shares <= 1).all()
    assert (shares > 0.98).all()
    W = problem.disturbance_set
    heights = np.max(find_disturbances(problem) @ W.normals.T, axis=0)
    used = (heights + noise_reach(problem, W.normals)) / W.offsets
    assert (used <= 1).all()
    assert used.max() > 0.98


def test_w_is_narrower_than_without_an_observer(problem):
    unfiltered = [*OBSERVED, "controller.observer_gain=[1, 1, 1]"]
    measured = complete_problem(load("certified", unfiltered))
    narrow = problem.disturbance_set.support(np.eye(3))
    shares = narrow / measured.disturbance_set.support(np.eye(3))
    assert (shares < 1).all()
    assert shares[1] < 0.7
    np.testing.assert_array_equal(measured.estimate_error, measured.noise)
    names = [condition.name for condition in check_robot(measured)]
    assert "estimate_error_invariant" not in names


def test_the_estimate_of_a_search_is_close_to_the_proved_sets(problem):
    scenario = problem.scenario
    found = Estimate(make_problem(scenario))
    point = caps_and_gains(scenario)
    assert point is not None
    values = found.to_point(point)
    corners = found.corners.find(values)
    w = found.corners.disturbance(values[None], corners)
    lengths = np.array([found.units.length, found.units.length, 1.0])
    error = w.error[0] * lengths
    assert (error * (1 + RESERVE) > problem.estimate_error).all()
    np.testing.assert_allclose(error, problem.estimate_error, rtol=0.05)
    bound = prove_bound(problem)
    assert w.yaw[0] == pytest.approx(bound.yaw, rel=0.01)
    lateral_per_yaw = w.lateral_per_yaw[0] * found.units.length
    assert lateral_per_yaw == pytest.approx(bound.lateral_per_yaw, rel=1e-11)
    np.testing.assert_allclose(w.box[0] * lengths, bound.box, rtol=0.1)


def test_bounds_are_asked_for_what_the_scenario_says(problem):
    where: Operation = operation(problem)
    assert where.gain == (0.45, 0.22, 0.9)
    np.testing.assert_array_equal(where.noise, problem.noise)
    np.testing.assert_array_equal(where.estimate_error, problem.estimate_error)
    assert kinematics(problem).input_map == "x_exact"


def test_assumptions_name_the_estimate(problem):
    _, measured, *_ = assumptions(problem, True)
    assert "acts on an estimate" in measured
    assert "takes over 0.45, 0.22, 0.9" in measured


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        (["controller.observer_gain=[0.4, 0.01, 0.9]"], "controller.observer_gain = "),
        (["operating.lateral_m=0.29", "controller.observer_gain=[0.4, 0.2, 0.9]"], "0.29"),
        (["operating.bands=[]", "controller.observer_gain=[0.4, 0.0, 0.9]"], "observer_gain"),
    ],
)
def test_gains_and_caps_that_leave_no_room_are_refused(settings, words):
    with pytest.raises(ScenarioError, match=words):
        complete_problem(load("certified", [*OBSERVED, *settings]))


def test_a_law_by_bands_acts_on_the_measured_error():
    with pytest.raises(ScenarioError, match=r"leave out controller\.observer_gain"):
        load("certified_wide", ["controller.observer_gain=[0.5, 0.5, 0.5]"])


@pytest.mark.slow
@pytest.mark.parametrize("noise_frame", ["robot", "world"])
def test_laps_never_leave_w_and_estimates_never_leave_their_set(noise_frame):
    """All slip processes, from starts all over the feasible set, with sideslip and slips measured
    in an interval in the world's frame."""
    design = jt.design(
        load("certified", [*OBSERVED, f"noise.frame={noise_frame}", "reference.duration_s=3"])
    )
    problem = design.problem
    W = problem.disturbance_set
    controller = components.make_tube_mpc(design)
    for process in PROCESSES:
        keys = realisation_keys(7, 0, 4096)
        starts = np.asarray(choose_starts(design, "feasible").draw(keys))
        robot = components.slipping_robot(design, process)
        laps = batches.run_realisations(controller, robot, starts, 7)
        w = batches.model_disturbances(design, laps)
        assert (w @ W.normals.T <= W.offsets + 1e-12).all()
        assert (np.abs(laps.measured - laps.errors) <= problem.estimate_error).all()
        assert (np.abs(laps.errors) <= problem.error_set.offsets[:3] + 1e-12).all()


@pytest.mark.slow
@pytest.mark.parametrize("dt_s", [0.02, 0.05, 0.1])
def test_the_share_of_the_caps_does_not_grow_with_faster_sampling(dt_s):
    """Without an observer: 1.92, 0.97 and 0.73."""
    on_path = ["initial.x_m=0", "initial.y_m=0"]
    scenario = load("certified", [*NOISY, *on_path, f"controller.dt_s={dt_s}"])
    best = optimise(make_problem(scenario))
    assert best.ratio < 0.61
    assert min(best.scenario.controller.observer_gain) < 0.5
    design = jt.design(best.scenario)
    assert design.certificate.holds_for_robot


def test_the_optimiser_leaves_the_measured_error_where_noise_is_small():
    calm = replace(load("certified"), {"noise.heading_deg": 0.01})
    start = caps_and_gains(calm)
    assert start is not None
    best = optimise(make_problem(calm), near=start)
    assert best.scenario.controller.observer_gain == (1.0, 1.0, 1.0)
