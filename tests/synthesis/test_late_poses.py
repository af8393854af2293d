"""Laws of the witness for the pose of robots whose wheels lag: it moves them as an integration of
wheels and body does, stays in what is certified, and refutes bounds that promise too much."""

import functools
from itertools import pairwise

import numpy as np
import pytest
from late_robot import LatePeriod, commit
from scipy.integrate import solve_ivp
from tolerances import RESIDUAL_ROUNDING, ROUNDING

from jaxtube.scenario import load
from jaxtube.synthesis import disturbance
from jaxtube.synthesis.acceleration import find_command_steps, find_reference_steps
from jaxtube.synthesis.certificate import late_pasts
from jaxtube.synthesis.certificate.late_pasts import draw_pasts
from jaxtube.synthesis.certificate.late_poses import drive, expect_ahead, find_pose_errors
from jaxtube.synthesis.certificate.true_error import check_true_error
from jaxtube.synthesis.disturbance import (
    bound_committed_errors,
    bound_pose_errors,
    complete_problem,
    find_actuation,
    kinematics,
    operation,
)
from jaxtube.synthesis.problem import make_problem
from sets.robot.driving import find_driving

ROWS = (0, 1, 7)
SLIPS = ("slip.right=[0.1, 0.25]", "slip.left=[0.15, 0.3]", "slip.sideslip=0.04")
LATE = {
    "lag": ("robot.wheel_lag_s=[0.05, 0.05]",),
    "long": ("robot.wheel_lag_s=[0.02, 0.09]", "robot.command_delay_s=[0.2, 0.26]"),
    "measured": (
        "robot.wheel_lag_s=[0.0, 0.06]",
        "robot.command_delay_s=[0.0, 0.04]",
        "robot.lever_arm_m=0.05",
        "slip.measurement_error=0.02",
        *SLIPS,
    ),
    "limited": ("robot.wheel_lag_s=[0.05, 0.05]", "robot.wheel_acceleration_max_mps2=21"),
}
SHIPPED = ("certified_lag", "husky", "tracked", "indoor")
QUICK = SHIPPED[:2]
SHIPPED_OR_SLOW = [
    name if name in QUICK else pytest.param(name, marks=pytest.mark.slow) for name in SHIPPED
]


@functools.cache
def make_case(name):
    return make_problem(load("certified", LATE[name]))


@functools.cache
def complete(name):
    return complete_problem(load(name))


def latency_of(problem):
    return find_actuation(problem.scenario).nominal(problem.model.dt).latency


def move_by_integration(problem, pasts, row, time):
    """Return the motion of the body after the instant, its wheels integrated from the beginning."""
    b = problem.model.track_width
    begins = pasts.begins
    arrivals = begins + pasts.delay[row]
    told = pasts.asked[row] / (1 - pasts.measured_slip[row])
    state = np.array([0.0, 0.0, 0.0, *told[0]])
    marks = np.unique([*arrivals, *begins, 0.0, time])
    for begin, end in pairwise(marks[(marks >= begins[0]) & (marks <= time)]):
        middle = (begin + end) / 2
        command = told[max(np.flatnonzero(arrivals <= middle), default=0)]
        period = np.flatnonzero(begins <= middle)[-1]
        slip = pasts.slip[row, period]
        zeta = pasts.sideslip[row, period]
        if pasts.lag[row] == 0:
            state[3:] = command

        def rates(_, state, command=command, slip=slip, zeta=zeta):
            right, left = state[3:] * (1 - slip)
            speed = (right + left) / 2
            turn = (right - left) / b
            sideways = zeta * speed - problem.robot.lever_arm * turn
            moving = (speed + 1j * sideways) * np.exp(1j * state[2])
            change = (command - state[3:]) / pasts.lag[row] if pasts.lag[row] else np.zeros(2)
            return [moving.real, moving.imag, turn, *change]

        solved = solve_ivp(rates, (begin, end), state, method="DOP853", rtol=1e-12, atol=1e-13)
        state = solved.y[:, -1]
        if end <= 0:
            state[:3] = 0.0
    return state[0] + 1j * state[1], state[2]


@pytest.mark.parametrize("name", ["long", "measured"])
def test_poses_move_as_an_integration_of_wheels_and_body_does(name):
    problem = make_case(name)
    pasts = draw_pasts(problem)
    latency = latency_of(problem)
    driven = drive(problem, pasts, latency)
    for row in ROWS:
        place, heading = move_by_integration(problem, pasts, row, latency)
        assert abs(driven.place[row] - place) < 1e-9
        assert abs(driven.heading[row] - heading) < 1e-9


@pytest.mark.parametrize("name", ["lag", "long"])
def test_what_is_ahead_is_what_the_committed_pose_counts_on(name):
    problem = make_case(name)
    pasts = draw_pasts(problem)
    ahead = expect_ahead(problem, pasts)
    nominal = find_actuation(problem.scenario).nominal(problem.model.dt)
    known = int(np.sum(pasts.begins <= 0))
    for row in ROWS:
        commands = pasts.asked[row, :known]
        none = np.zeros(len(commands))
        b = problem.model.track_width
        period = LatePeriod(problem.model.dt, b, nominal, commands, nominal.lag, none, np.zeros(2))
        place, heading, _ = commit(period, now=True)
        assert abs(ahead.place[row] - place) < ROUNDING
        assert abs(ahead.heading[row] - heading) < ROUNDING


@pytest.mark.parametrize("name", LATE)
def test_pasts_lie_in_what_is_certified_and_reach_its_ends(name):
    problem = make_case(name)
    pasts = draw_pasts(problem)
    where = operation(problem)
    driving = find_driving(where, kinematics(problem))
    asked = pasts.asked.reshape(-1, 2)
    assert np.all(asked >= driving.wheels[0] - ROUNDING)
    assert np.all(asked <= driving.wheels[1] + ROUNDING)
    turns = (asked[:, 0] - asked[:, 1]) / problem.model.track_width
    np.testing.assert_allclose([turns.min(), turns.max()], driving.yaw_rate, rtol=1e-9)
    low, high = problem.model.box
    assert np.all((pasts.wheels >= low - ROUNDING) & (pasts.wheels <= high + ROUNDING))
    errors = 1 - (1 - pasts.slip) / (1 - pasts.measured_slip)
    least, most = where.wheel_errors
    assert np.all((errors >= least - ROUNDING) & (errors <= most + ROUNDING))
    assert np.all(np.ptp(errors, axis=(0, 1)) >= 0.95 * (most - least))
    actuation = find_actuation(problem.scenario)
    assert set(pasts.lag) == set(actuation.lag)
    assert set(pasts.delay.ravel()) == set(actuation.delay)


def test_pasts_keep_the_acceleration_of_the_wheels():
    problem = make_case("limited")
    pasts = draw_pasts(problem)
    changes = np.abs(np.diff(pasts.asked, axis=1)).max(axis=(0, 1))
    np.testing.assert_allclose(changes, find_command_steps(problem), rtol=1e-9)
    changes = np.abs(np.diff(pasts.wheels, axis=1)).max(axis=(0, 1))
    assert np.all(changes <= find_reference_steps(problem) + ROUNDING)


def test_a_past_is_the_same_however_many_there_are(monkeypatch):
    problem = make_case("long")
    many = draw_pasts(problem)
    monkeypatch.setattr(late_pasts, "COUNT", 20)
    few = draw_pasts(problem)
    np.testing.assert_array_equal(few.asked, many.asked[:20])
    np.testing.assert_array_equal(few.delay, many.delay[:20])


@pytest.mark.parametrize("name", LATE)
def test_no_pose_is_found_beyond_its_bound(name):
    problem = make_case(name)
    bound = bound_pose_errors(problem)
    for errors in find_pose_errors(problem):
        assert np.all(np.abs(errors) <= bound + RESIDUAL_ROUNDING)


@pytest.mark.parametrize("name", SHIPPED_OR_SLOW)
def test_bounds_of_shipped_scenarios_are_not_refuted_and_the_sentence_tells_the_reach(name):
    condition = check_true_error(complete(name))
    assert condition.holds
    assert "Errors found reach 9" in condition.sentence


def promise(monkeypatch, change):
    """Let the bound on errors of poses be another."""
    bound = disturbance.bound_late_pose_errors
    monkeypatch.setattr(
        disturbance,
        "bound_late_pose_errors",
        lambda committed, *others: change(committed, bound(committed, *others)),
    )


@pytest.mark.parametrize("coordinate", range(3))
@pytest.mark.parametrize(("name", "share"), [("certified_lag", 0.93), ("husky", 0.5)])
def test_a_bound_of_one_coordinate_that_is_too_small_is_refuted(
    name, share, coordinate, monkeypatch
):
    factors = np.where(np.arange(3) == coordinate, share, 1.0)
    promise(monkeypatch, lambda committed, bound: factors * bound)
    condition = check_true_error(complete(name))
    assert not condition.holds
    assert condition.margin < 0
    assert condition.sentence.startswith("The bound of the true errors is refuted: ")
    assert ("longitudinal", "lateral", "heading")[coordinate] in condition.sentence


@pytest.mark.parametrize("name", SHIPPED_OR_SLOW)
def test_a_bound_without_what_the_latency_adds_is_refuted(name, monkeypatch):
    problem = complete(name)
    promise(monkeypatch, lambda committed, bound: committed)
    np.testing.assert_array_equal(bound_pose_errors(problem), bound_committed_errors(problem))
    assert not check_true_error(problem).holds


@pytest.mark.parametrize("share", [0.3, 0.6])
def test_a_bound_with_too_little_of_what_the_latency_adds_is_refuted(share, monkeypatch):
    problem = complete("certified_lag")
    promise(monkeypatch, lambda committed, bound: committed + share * (bound - committed))
    assert not check_true_error(problem).holds


def test_wheels_that_obey_at_once_are_told_as_before():
    sentence = check_true_error(make_problem(load("certified"))).sentence
    assert sentence.endswith("the pose noise together lie in the error constraints.")
