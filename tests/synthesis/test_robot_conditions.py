"""Laws of the premise on W: met disturbances refute it, a bound proves it, whoever chose it."""

import dataclasses

import numpy as np
import pytest

from jaxtube.scenario import load
from jaxtube.synthesis.certificate import robot
from jaxtube.synthesis.certificate.robot import (
    PREMISE,
    assumptions,
    check_disturbance_set,
    check_robot,
)
from jaxtube.synthesis.disturbance import complete_problem
from jaxtube.synthesis.problem import make_problem


@pytest.fixture(scope="module")
def certified():
    return complete_problem(load("certified"))


def assumed(x_m: float, y_m: float, heading_deg: float):
    widths = [
        f"disturbance.longitudinal_m={x_m}",
        f"disturbance.lateral_m={y_m}",
        f"disturbance.heading_deg={heading_deg}",
    ]
    return make_problem(load("certified", ["disturbance.bound=assumed", *widths]))


def test_a_computed_w_holds_what_the_robot_meets(certified):
    condition = check_disturbance_set(certified)
    assert condition.holds
    assert condition.scope == "robot"
    assert "proved by interval arithmetic" in condition.sentence


@pytest.mark.parametrize("share", [0.98, 0.9])
def test_a_computed_w_that_is_too_small_is_refuted_whatever_it_was_made_from(certified, share):
    """Bound and W shrink together: that they agree proves nothing."""
    bound = certified.disturbance_bound
    smaller = dataclasses.replace(bound, yaw=share * bound.yaw, box=share * bound.box)
    tampered = dataclasses.replace(
        certified, disturbance_bound=smaller, disturbance_set=smaller.polytope()
    )
    condition = check_disturbance_set(tampered)
    assert not condition.holds
    assert condition.sentence.startswith("W is refuted: ")


def test_the_papers_w_is_refuted_by_its_worst_coordinate():
    condition = check_disturbance_set(make_problem(load("paper")))
    assert condition.sentence == (
        "W is refuted: a lateral disturbance of 0.38 m is found where W allows 0.005 m."
    )
    assert condition.margin < -0.3


def test_an_assumed_w_is_proved_where_it_holds_the_bound(certified):
    x, y, heading = certified.disturbance_set.support(np.eye(3))
    wide = assumed(1.01 * x, 1.01 * y, np.rad2deg(1.01 * heading))
    conditions = {condition.name: condition for condition in check_robot(wide)}
    assert conditions[PREMISE].holds
    assert conditions["wheel_limits"].holds
    narrow = assumed(x, 0.5 * y, np.rad2deg(heading))
    assert check_disturbance_set(narrow).sentence.startswith("W is refuted: a lateral")


def test_between_what_is_met_and_the_bound_nothing_is_known(certified, monkeypatch):
    monkeypatch.setattr(robot, "find_disturbances", lambda problem: np.zeros((1, 3)))
    x, y, heading = certified.disturbance_set.support(np.eye(3))
    condition = check_disturbance_set(assumed(x, 0.9 * y, np.rad2deg(heading)))
    assert not condition.holds
    assert "narrower than the proved bound" in condition.sentence

    def refuse(*parts):
        raise ValueError("angle: leaves a quarter turn")

    monkeypatch.setattr(robot, "disturbance_bound", refuse)
    condition = check_disturbance_set(assumed(x, y, np.rad2deg(heading)))
    assert condition.margin == -np.inf
    assert "too wide for a bound" in condition.sentence


def test_wheels_are_not_asked_for_more_where_their_limits_are_u_itself():
    names = [condition.name for condition in check_robot(make_problem(load("paper")))]
    assert "wheel_limits" not in names
    capped = make_problem(load("certified", ["disturbance.bound=assumed"]))
    assert "wheel_limits" in [condition.name for condition in check_robot(capped)]


def test_assumptions_say_what_is_not_covered():
    slip, noise, reference, _, when, start = assumptions(make_problem(load("paper")), True)
    assert "constant nominal value" in slip
    assert slip.endswith("the other one nominal")
    assert "in the robot's frame, not the world's" in noise
    assert "in any order" in reference
    assert "nothing between them" in when
    assert "within its caps and has a plan" in start
    along = assumptions(make_problem(load("paper")), False)[2]
    assert "in any order" not in along
    assert "in the order of this path alone" in along
    no_slip = make_problem(load("paper", ["slip.nominal_left=0"]))
    assert "of a nominal slip of 0 that is no error at all" in assumptions(no_slip, True)[0]
    both = make_problem(load("paper", ["slip.random=both"]))
    assert assumptions(both, True)[0].startswith("true and, on its own, measured slip")
