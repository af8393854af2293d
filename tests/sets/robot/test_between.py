"""Laws of the bound between the ends of periods: no motion leaves its chord by more, whoever
integrates it."""

import dataclasses

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from jaxtube.coordinates import describe_excursion
from jaxtube.scenario import load
from jaxtube.synthesis.certificate import between
from jaxtube.synthesis.certificate.assumptions import assumptions
from jaxtube.synthesis.certificate.between import NAME, check_between_periods
from jaxtube.synthesis.certificate.certify import certify
from jaxtube.synthesis.design import design
from jaxtube.synthesis.disturbance import (
    bound_committed_errors,
    bound_error_between_periods,
    complete_problem,
    kinematics,
    operation,
)
from sets.robot.between import bound_excursion

SHARES = np.linspace(0, 1, 21)
ASSUMED = (
    "disturbance.bound=assumed",
    "disturbance.longitudinal_m=0.005",
    "disturbance.lateral_m=0.002",
    "disturbance.heading_deg=0.5",
)
"""W, which says nothing of motions between periods; it takes long to compute."""


@pytest.fixture(scope="module")
def certified():
    return complete_problem(load("certified"))


def follow(wheels, body, sideways, track_width, start, dt):
    """Return the true error at SHARES of a period, by an integrator of two poses in the world."""
    right, left = wheels
    speed, turn = body

    def move(_, state):
        heading, robot_heading = state[2], state[5]
        reference_speed = (right + left) / 2
        return [
            reference_speed * np.cos(heading),
            reference_speed * np.sin(heading),
            (right - left) / track_width,
            speed * np.cos(robot_heading) - sideways * np.sin(robot_heading),
            speed * np.sin(robot_heading) + sideways * np.cos(robot_heading),
            turn,
        ]

    robot_heading = -start[2]
    x = -(np.cos(robot_heading) * start[0] - np.sin(robot_heading) * start[1])
    y = -(np.sin(robot_heading) * start[0] + np.cos(robot_heading) * start[1])
    motion = solve_ivp(
        move, (0, dt), [0, 0, 0, x, y, robot_heading], t_eval=dt * SHARES, rtol=1e-10, atol=1e-12
    ).y
    away = motion[:2] - motion[3:5]
    cosine = np.cos(motion[5])
    sine = np.sin(motion[5])
    along = cosine * away[0] + sine * away[1]
    aside = cosine * away[1] - sine * away[0]
    return np.stack([along, aside, motion[2] - motion[5]], axis=1)


def draw_motions(problem, sideslip=0.0):
    """Yield motions within the operation: errors, wheels of the reference, and a body that is off
    by inputs and slips at their extremes."""
    where = operation(problem)
    generator = np.random.default_rng(5)
    limits = bound_committed_errors(problem)
    for _ in range(150):
        start = limits * generator.choice([-1, -0.5, 0, 0.5, 1], 3)
        box = where.schedules[generator.integers(len(where.schedules))]
        wheels = box[generator.integers(2, size=2), [0, 1]]
        inputs = where.inputs[generator.integers(2, size=2), [0, 1]]
        turn = (wheels[0] - wheels[1]) / where.track_width - inputs[1]
        speed = wheels.mean() - inputs[0]
        ground = speed + np.array([0.5, -0.5]) * where.track_width * turn
        lost = ground * where.wheel_errors[generator.integers(2, size=2), [0, 1]]
        body = (speed - lost.mean(), turn - (lost[0] - lost[1]) / where.track_width)
        sideways = sideslip * body[0] * generator.choice([-1, 1])
        yield follow(wheels, body, sideways, where.track_width, start, where.dt)


@pytest.mark.parametrize("sideslip", [0.0, 0.05])
def test_no_motion_leaves_its_chord_by_more(certified, sideslip):
    where = dataclasses.replace(operation(certified), sideslip=sideslip)
    limits = bound_committed_errors(certified)
    bound = bound_excursion(where, kinematics(certified), limits)
    farthest = np.zeros(3)
    for errors in draw_motions(certified, sideslip):
        if np.any(np.abs(errors[-1]) > limits):
            continue
        chord = errors[:1] + SHARES[:, None] * (errors[-1:] - errors[:1])
        farthest = np.maximum(farthest, np.abs(errors - chord).max(axis=0))
        assert np.all(np.abs(errors) <= limits + bound + 1e-9)
    assert np.all(farthest <= bound + 1e-9)
    assert np.all(farthest[:2] >= 0.3 * bound[:2])


def test_the_bound_falls_with_the_square_of_the_period(certified):
    where = operation(certified)
    how = kinematics(certified)
    limits = bound_committed_errors(certified)
    whole = bound_excursion(where, how, limits)
    half = bound_excursion(dataclasses.replace(where, dt=where.dt / 2), how, limits)
    quarter = bound_excursion(dataclasses.replace(where, dt=where.dt / 4), how, limits)
    assert np.all(half[:2] < 0.3 * whole[:2])
    # The heading error runs along its chord.
    assert half[2] == whole[2] == 0
    assert quarter[:2] == pytest.approx(half[:2] / 4, rel=0.1)


def test_wheels_that_lag_and_wide_errors_have_no_bound(certified):
    lagging = operation(complete_problem(load("certified_lag")))
    with pytest.raises(ValueError, match="wheels lag"):
        bound_excursion(lagging, kinematics(certified), np.ones(3))
    with pytest.raises(ValueError, match=r"pi/2"):
        bound_excursion(operation(certified), kinematics(certified), np.array([1, 1, 2.0]))


def test_the_condition_compares_with_the_constraints(certified):
    (condition,) = check_between_periods(certified)
    assert condition.holds
    assert condition.scope == "information"
    limits = bound_committed_errors(certified) + bound_error_between_periods(certified)
    lateral = 0.5 * (limits[1] + bound_committed_errors(certified)[1])
    narrow = complete_problem(load("certified", [f"constraints.lateral_m={lateral}"]))
    (condition,) = check_between_periods(narrow)
    assert not condition.holds
    assert "lateral" in condition.sentence


def test_a_bound_that_is_too_small_is_refuted(certified, monkeypatch):
    halved = 0.5 * bound_error_between_periods(certified)
    monkeypatch.setattr(between, "bound_error_between_periods", lambda problem: halved)
    (condition,) = check_between_periods(certified)
    assert condition.scope == "robot"
    assert not condition.holds


def test_without_a_bound_nothing_is_said():
    for name in ("paper", "certified_lag"):
        assert list(check_between_periods(complete_problem(load(name)))) == []


def test_a_certificate_says_it():
    made = design(load("certified", ["reference.duration_s=3"]))
    condition = certify(made).conditions[NAME]
    assert "at all times" in condition.sentence
    assert "in between" in made.certificate.assumptions[4]


def test_assumptions_tell_the_regime_that_leaves_the_limits_furthest():
    learning = complete_problem(load("certified_learning", ASSUMED))
    first = bound_error_between_periods(learning.regimes[0])
    last = bound_error_between_periods(learning.regimes[-1])
    assert np.all(first[:2] > last[:2])
    assert describe_excursion(first) in assumptions(learning, any_order=True)[4]
