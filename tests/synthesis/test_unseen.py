"""Laws of scenarios that nobody chose: each is certified, or refused by what binds with a nearest
scenario that holds; nothing that is certified is seen to fail.

`python tests/attack_unseen.py FOLDER --laps 100000 --seconds 60` does the same at length, one
record a scenario, and goes on where it was stopped.
"""

import pytest
from attack_unseen import FAILURES, attack, is_short, judge
from unseen import COUNT, draw_scenario

from jaxtube.scenario.tree import to_toml
from jaxtube.synthesis.design import design
from jaxtube.synthesis.disturbance import complete_problem
from jaxtube.synthesis.optimise import optimise, wheel_excess, wheel_shortfall
from jaxtube.synthesis.problem import make_problem

QUICK = (4, 14)
"""Numbers of scenarios that are designed in moments."""
WITHOUT_ROOM = (11, 39)
"""Numbers of scenarios whose proved error of the estimate, or least wheel speed, is close to what
the first search leaves of its limits."""
NEAR_ITS_LIMITS = 31
"""Number of one whose caps fill what the error of the estimate leaves of the constraints."""
LAPS = 1000
SECONDS = 5.0


def test_the_scenario_of_a_number_is_always_the_same():
    for index in (0, COUNT - 1):
        assert to_toml(draw_scenario(index)) == to_toml(draw_scenario(index))
    texts = {to_toml(draw_scenario(index)) for index in range(COUNT)}
    assert len(texts) == COUNT


def test_unseen_scenarios_are_within_what_is_claimed_of_them():
    for index in range(COUNT):
        scenario = draw_scenario(index)
        assert 0.2 <= scenario.robot.track_width_m <= 1.2
        assert 0.05 <= scenario.controller.dt_s <= 0.2
        assert 0.8 <= scenario.reference.radius_m <= 12.0
        assert 0.0 <= min(scenario.slip.nominal) <= max(scenario.slip.nominal) <= 0.35
        assert scenario.slip.right != scenario.slip.left
        assert scenario.noise.longitudinal_m <= 0.005
        assert scenario.operating.lateral_m is None


def test_where_corners_flatter_the_estimate_the_search_leaves_it_room(monkeypatch):
    monkeypatch.setattr("jaxtube.synthesis.estimate.RESERVE", -0.05)
    found = optimise(make_problem(draw_scenario(NEAR_ITS_LIMITS)))
    assert found.holds
    problem = complete_problem(found.scenario)
    assert (problem.estimate_error > problem.noise).all()


@pytest.mark.slow
@pytest.mark.parametrize("index", WITHOUT_ROOM)
def test_what_a_search_says_holds_is_certified_where_corners_flatter_the_robot(index):
    found = optimise(make_problem(draw_scenario(index)))
    assert found.holds
    made = design(found.scenario)
    assert made.certificate.failing == []
    assert wheel_excess(made.problem) <= 1
    assert wheel_shortfall(made.problem) <= 0


@pytest.mark.slow
@pytest.mark.parametrize("index", QUICK)
def test_an_unseen_scenario_that_is_certified_is_not_seen_to_fail(index):
    record = judge(index)
    assert record["verdict"] == "certified"
    assert is_short(record, LAPS, SECONDS)
    attacked = attack(record, LAPS, SECONDS)
    assert all(seen[event] == 0 for seen in attacked["seen"].values() for event in FAILURES)
    assert not attacked["falsified"]
    assert not is_short(record | attacked, LAPS, SECONDS)


@pytest.mark.slow
@pytest.mark.parametrize("index", range(COUNT))
def test_every_unseen_scenario_is_certified_or_refused_with_one_that_holds(index):
    record = judge(index)
    assert record["verdict"] in ("certified", "refused")
    if record["verdict"] == "refused":
        assert record["reason"]
        assert any(entry.get("holds") for entry in record["nearest"])
