"""Laws of the premise on W: met disturbances refute it, a bound proves it, whoever chose it."""

import dataclasses

import numpy as np
import pytest

from jaxtube.scenario import load
from jaxtube.synthesis.certificate import robot
from jaxtube.synthesis.certificate.assumptions import assumptions
from jaxtube.synthesis.certificate.robot import (
    PREMISE,
    check_disturbance_set,
    check_robot,
)
from jaxtube.synthesis.disturbance import complete_problem, prove_bound
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


def conditions_of(problem) -> dict:
    return {condition.name: condition for condition in check_robot(problem)}


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


@pytest.mark.parametrize("share", [0.999, 0.9])
@pytest.mark.parametrize("part", ["yaw", "y", "heading"])
def test_one_coordinate_of_a_computed_w_that_is_too_small_is_seen(certified, part, share):
    """The bound is worked out anew: what the problem carries proves nothing."""
    bound = certified.disturbance_bound
    box = np.array(bound.box)
    if part != "yaw":
        box[("x", "y", "heading").index(part)] *= share
    smaller = dataclasses.replace(bound, box=box, yaw=bound.yaw * (share if part == "yaw" else 1))
    tampered = dataclasses.replace(
        certified, disturbance_bound=smaller, disturbance_set=smaller.polytope()
    )
    assert not check_disturbance_set(tampered).holds


@pytest.mark.parametrize("part", ["box of inputs", "coupling", "caps", "noise"])
def test_w_of_another_operating_set_is_not_proved(certified, part):
    """One per cent more of what W was computed over, and W is too small."""
    wider = 1.01
    rows = certified.input_rows
    grown = np.where(rows.is_coupled == (part == "coupling"), wider, 1.0)
    changes = {"input_rows": dataclasses.replace(rows, offsets=grown * rows.offsets)}
    if part == "caps":
        changes = {"operating_set": certified.operating_set.scale(wider)}
    if part == "noise":
        changes = {"scenario": load("certified", ["noise.lateral_m=0.0015"])}
    tampered = dataclasses.replace(certified, **changes)
    assert not check_disturbance_set(tampered).holds


def test_wheels_of_another_operating_set_are_not_proved(certified):
    """Wheels of `certified` have 0.5 mm/s to spare: one per cent more of U asks for more."""
    assert conditions_of(certified)["wheel_limits"].holds
    rows = certified.input_rows
    rows = dataclasses.replace(rows, offsets=1.01 * rows.offsets)
    wider = dataclasses.replace(
        certified, input_rows=rows, input_set=certified.input_set.scale(1.01)
    )
    assert not conditions_of(wider)["wheel_limits"].holds


@pytest.mark.parametrize(
    ("limit", "share", "expected"),
    [
        ("wheel_speed_max", 1.001, True),
        ("wheel_speed_max", 0.999, False),
        ("wheel_speed_min", 0.999, True),
        ("wheel_speed_min", 1.001, False),
    ],
)
def test_both_limits_of_the_wheels_are_proved(certified, limit, share, expected):
    """A limit just beyond the speeds that may be asked for holds, one just inside does not."""
    slowest, fastest = prove_bound(certified).ground_speeds
    slip = certified.scenario.slip
    assert slip.nominal_right == slip.nominal_left
    at_limit = {
        "wheel_speed_max": fastest.max() / (1 - slip.nominal_right * (1 + slip.relative_error)),
        "wheel_speed_min": slowest.min() / (1 - slip.nominal_right * (1 - slip.relative_error)),
    }
    limited = dataclasses.replace(certified.robot, **{limit: share * at_limit[limit]})
    problem = dataclasses.replace(certified, robot=limited)
    assert conditions_of(problem)["wheel_limits"].holds is expected


@pytest.mark.parametrize(("limit", "value"), [("wheel_speed_max", 1.5), ("wheel_speed_min", 0.5)])
def test_a_wheel_that_is_asked_for_more_than_it_has_is_shown_by_a_period(
    certified, limit, value, monkeypatch
):
    """Whatever the proved bound says of the ground speeds."""
    bound = prove_bound(certified)
    tame = dataclasses.replace(bound, ground_speeds=np.array([[0.9, 0.9], [1.0, 1.0]]))
    monkeypatch.setattr(robot, "prove_bound", lambda problem: tame)
    limited = dataclasses.replace(certified.robot, **{limit: value})
    problem = dataclasses.replace(certified, robot=limited)
    condition = conditions_of(problem)["wheel_limits"]
    assert not condition.holds
    assert "may be asked for; the wheels have" in condition.sentence


def test_the_wheels_of_the_exact_map_are_checked_without_caps_too():
    scenario = load("paper", ["controller.input_map=x_exact"])
    assert "wheel_limits" in conditions_of(make_problem(scenario))


def test_the_papers_w_is_refuted_by_its_worst_coordinate():
    condition = check_disturbance_set(make_problem(load("paper")))
    assert condition.sentence.startswith(
        "W is refuted: a lateral disturbance of 0.38 m, where W allows 0.005 m, is possible "
        "somewhere within everything that the limits allow, where laps need not come, at e = ("
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

    monkeypatch.setattr(robot, "prove_bound", refuse)
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
    assert noise == "tracking error measured exactly, without delay"
    noisy = make_problem(load("certified"))
    assert "in the robot's frame, not the world's" in assumptions(noisy, True)[1]
    assert "in any order" in reference
    assert "nothing between them" in when
    assert "within its caps and has a plan" in start
    assert start.endswith("and no disturbance leaves W")
    *_, start = assumptions(make_problem(load("paper")), True, has_proved_w=True)
    assert "W" not in start
    along = assumptions(make_problem(load("paper")), False)[2]
    assert "in any order" not in along
    assert "in the order of this path alone" in along
    no_slip = make_problem(load("paper", ["slip.nominal_left=0"]))
    assert "of a nominal slip of 0 that is no error at all" in assumptions(no_slip, True)[0]
    both = make_problem(load("paper", ["slip.random=both"]))
    assert assumptions(both, True)[0].startswith("true and, on its own, measured slip")
