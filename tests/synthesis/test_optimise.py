"""Laws of the optimiser: sizes, starts, what binds, corrections by rigorous bounds, advice."""

import re

import numpy as np
import pytest

from jaxtube.scenario import load, replace
from jaxtube.scenario.tree import Scenario
from jaxtube.synthesis.advice import say_what_helps, say_what_widens
from jaxtube.synthesis.corners import NAMES
from jaxtube.synthesis.descent import PENALTY, descend, find_ends
from jaxtube.synthesis.design import design, refuse_infeasible_start
from jaxtube.synthesis.disturbance import complete_problem
from jaxtube.synthesis.estimate import CAP_ROWS, LIMIT_ROWS, Estimate
from jaxtube.synthesis.levers import SPEED, list_levers
from jaxtube.synthesis.nearest import choose_levers, find_pull
from jaxtube.synthesis.optimise import UnboundedTubeError, optimise, optimise_nearby, wheel_excess
from jaxtube.synthesis.optimum import Optimum
from jaxtube.synthesis.problem import Problem, make_problem
from jaxtube.synthesis.starts import caps_and_gains, make_starts, without_caps

ON_PATH = {"initial.x_m": 0.0, "initial.y_m": 0.0}
SEARCHED = 0.03
"""Relative difference of two searches from different starts."""


def bare(values: dict | None = None) -> Scenario:
    return replace(without_caps(load("certified")), values or {})


@pytest.fixture(scope="module")
def found() -> Optimum:
    return optimise(make_problem(bare()))


def test_the_optimum_is_a_design_whose_start_has_a_plan(found):
    assert found.holds and found.ratio < 0.47
    made = design(found.scenario)
    assert made.certificate.failing == []
    assert wheel_excess(made.problem) <= 1
    refuse_infeasible_start(made)
    assert max(found.shares[row] for row in CAP_ROWS) == pytest.approx(found.ratio)
    assert max(found.shares[row] for row in LIMIT_ROWS) == pytest.approx(found.excess)


def test_a_reference_that_may_turn_half_a_turn_in_a_period_is_refused_with_a_cure():
    wheels = {"robot.wheel_speed_max_mps": 18.0, "robot.wheel_speed_min_mps": -14.0}
    turning = {**wheels, "reference.wheel_speed_max_mps": 9.1, "controller.dt_s": 0.2}
    with pytest.raises(UnboundedTubeError, match=r"by up to 3\.15 rad in a period of 0\.2 s"):
        optimise(make_problem(bare(turning)))
    with pytest.raises(UnboundedTubeError, match="no gains steer beyond half a turn"):
        optimise_nearby(make_problem(bare(turning)), (0.1,) * 11)
    shorter = Estimate(make_problem(bare({**turning, "controller.dt_s": 0.15})))
    assert make_starts(shorter)


def test_wheels_that_pass_their_limit_by_the_rigorous_bound_are_searched_again(found, monkeypatch):
    def bound(problem: Problem) -> float:
        return 1.003 * wheel_excess(problem)

    problem = make_problem(bare({"robot.wheel_speed_max_mps": 2.3}))
    near = caps_and_gains(found.scenario)
    assert bound(complete_problem(optimise(problem, near=near).scenario)) > 1
    monkeypatch.setattr("jaxtube.synthesis.optimise.wheel_excess", bound)
    spared = optimise(problem, near=near)
    assert spared.holds and bound(complete_problem(spared.scenario)) <= 1


def test_a_search_never_ends_worse_than_it_began():
    """So --optimise denies no caps and gains of a file: they are one of its starts."""
    own = (0.12, 0.28, 18.0, 0.27, 0.40, 0.9, 1e3, 1e3, 3.0, 6.5, 6.5)
    estimate = Estimate(make_problem(bare()))
    for start in (estimate.to_point(own), make_starts(estimate)[-1]):
        shares = estimate.shares(start)
        ended = descend(estimate, start)
        assert shares is not None and ended is not None
        excess = max(np.log(shares.limits.max()), 0.0)
        assert ended.objective <= np.log(shares.caps.max()) + PENALTY * excess
        ends = find_ends(ended.estimate, ended.point)
        assert ends is not None
        ratio, excess = ends
        assert ended.objective == pytest.approx(ratio + PENALTY * excess, abs=0.02)
    with_caps = load("certified")
    values = caps_and_gains(with_caps)
    assert values is not None and values[8:] == with_caps.controller.tracking_gains


@pytest.mark.slow
def test_a_search_from_an_optimum_nearby_ends_where_a_fresh_one_does(found):
    faster = bare({"slip.relative_error": 0.12})
    near = optimise(make_problem(faster), near=caps_and_gains(found.scenario))
    fresh = optimise(make_problem(faster))
    assert near.holds and fresh.holds
    assert near.ratio == pytest.approx(fresh.ratio, rel=SEARCHED)


@pytest.mark.slow
def test_pressures_say_what_binds_and_pulls_how_the_ratio_falls():
    """The pressures of the ratio's rows add up to 1; pulls are the slopes of searched ratios."""
    exact = {f"noise.{key}": 0.0 for key in ("longitudinal_m", "lateral_m", "heading_deg")}
    narrow = {"constraints.heading_deg": 8.0, "slip.relative_error": 0.3}
    scenario = bare({**exact, **narrow, **ON_PATH})
    tight = optimise(make_problem(scenario))
    assert sum(tight.pressures[row] for row in CAP_ROWS) == pytest.approx(1.0, abs=0.05)
    assert tight.pressing == ["constraints.heading_deg"]
    assert tight.binding == "constraints.heading_deg"
    near = caps_and_gains(tight.scenario)
    assert near is not None
    step = 0.05
    for lever in list_levers(scenario):
        eased = lever.scale(scenario, np.exp(lever.easier * step))
        other = optimise_nearby(make_problem(eased), near)
        assert other is not None
        slope = np.log(tight.ratio / other.ratio) / step
        assert find_pull(tight, lever) == pytest.approx(slope, rel=0.5, abs=0.1)
    assert choose_levers(tight)[0] is SPEED
    assert {lever.name for lever in choose_levers(tight)} == {
        *("speed", "slip", "constraints.heading_deg")
    }


@pytest.mark.parametrize(
    ("values", "words"),
    [
        ({"slip.relative_error": 0.5}, r"the tube fills \d+\.\d% of its caps, above all of the "),
        ({"robot.wheel_speed_max_mps": 1.95}, r"robot\.wheel_speed_max_mps by \d+\.\d% at best"),
        pytest.param(
            {"initial.y_m": 0.299},
            r"initial\.y_m by \d+\.\d% at best",
            marks=pytest.mark.slow,
        ),
    ],
)
def test_a_search_without_a_design_ends_with_what_denies_it(values, words):
    denied = optimise(make_problem(bare(values)))
    assert not denied.holds
    assert re.search(words, denied.describe_binding())


def test_wheel_speeds_that_no_gain_holds_end_in_one_line():
    scenario = bare({"reference.wheel_speed_min_mps": 0.001, "controller.dt_s": 0.5})
    try:
        denied = optimise(make_problem(scenario))
    except ValueError as error:
        assert "narrow reference.wheel_speed_min_mps" in str(error)
    else:
        assert not denied.holds


def test_caps_and_gains_that_bound_no_tube_lead_nowhere_nearby(found):
    values = np.array(caps_and_gains(found.scenario), float)
    values[9:] *= 10
    assert optimise_nearby(make_problem(bare()), values.tolist()) is None
    assert len(values) == len(NAMES) + 3


def test_advice_names_what_has_an_effect():
    assumed = make_problem(load("paper"))
    assert "[disturbance]" in say_what_helps(assumed)
    computed = complete_problem(load("certified", ["noise.lateral_m=0.02"]))
    assert "[disturbance]" not in say_what_helps(computed)
    assert "--optimise" in say_what_helps(computed)
    assert say_what_widens(computed).startswith("W is made of noise ")
