"""Laws of what can be guaranteed: the ratio of a design under conditions, and failures that are
told, not raised."""

import dataclasses

import pytest

from jaxtube.scenario import load, replace
from jaxtube.synthesis import ratio as module
from jaxtube.synthesis.certificate.existence import OBJECTIVES
from jaxtube.synthesis.certificate.fill import cap_shares
from jaxtube.synthesis.disturbance import complete_problem
from jaxtube.synthesis.gains import compensating_gain
from jaxtube.synthesis.ratio import (
    Guarantee,
    OperatingPoint,
    find_slip_error,
    guarantee,
    name_slip_error,
    set_point,
)
from jaxtube.synthesis.starts import caps_and_gains
from jaxtube.synthesis.terminal_cost import terminal_cost_and_gain

NEARBY_SEARCH = 0.02
"""Of the ratio; searches from different starts that end at the same optimum."""

OWN = OperatingPoint(0.1, 1.224, 0.1)


@pytest.fixture(scope="module")
def certified():
    return load("certified")


def test_a_condition_is_the_scenario_with_three_keys_changed_and_w_computed(certified):
    changed = set_point(certified, OperatingPoint(0.25, 0.9, 0.07))
    assert changed.slip.relative_error == 0.25 and changed.reference.wheel_speed_min_mps == 0.9
    assert changed.controller.dt_s == 0.07 and changed.disturbance.bound == "computed"
    assert changed.reference.duration_s == pytest.approx(429 * 0.07)
    assert set_point(certified, OWN) == certified


def test_the_slip_error_of_intervals_and_of_measured_slips_is_the_one_that_counts():
    wide = load("husky")
    own = find_slip_error(wide)
    point = OperatingPoint(own, wide.reference.wheel_speed_min_mps, wide.controller.dt_s)
    widened = set_point(wide, point._replace(slip_error=2 * own)).slip
    assert widened.right == pytest.approx((0.02935 - 2 * own, 0.02935 + 2 * own))
    known = set_point(wide, point._replace(slip_error=0.0)).slip
    assert known.right == known.left == pytest.approx((0.02935, 0.02935))
    assert set_point(wide, point).slip == wide.slip
    measured = replace(wide, {"slip.measurement_error_relative": 0.1})
    changed = set_point(measured, point._replace(slip_error=0.25)).slip
    assert changed.measurement_error_relative == 0.25 and changed.right == wide.slip.right
    names = [name_slip_error(each) for each in (wide, measured, load("certified"))]
    assert names == ["half width of slip interval", "error of measured slip", "slip error"]


def test_the_papers_ratio_is_the_least_of_its_gains_and_limits(certified):
    found = guarantee("paper", certified)
    noise = ["noise.longitudinal_m=0.001", "noise.lateral_m=0.001", "noise.heading_deg=0.02"]
    speeds = ["reference.wheel_speed_min_mps=1.224", "reference.wheel_speed_max_mps=1.496"]
    open_caps = complete_problem(load("paper", [*noise, *speeds, 'disturbance.bound="computed"']))
    bounds = [
        max(cap_shares(open_caps, gain).values())
        for gain in (terminal_cost_and_gain(open_caps)[1], compensating_gain(open_caps))
    ]
    assert found.ratio is not None and 1 < found.ratio < min(bounds)
    assert found.choice.startswith("caps") and not found.holds


@pytest.mark.slow
def test_weighted_gains_are_those_of_the_best_objective(certified):
    found = guarantee("weighted", set_point(certified, OWN._replace(slip_error=0.05)))
    settings = [
        "controller.tracking_gains=[]",
        'controller.model="consistent"',
        "slip.relative_error=0.05",
    ]
    problem = complete_problem(load("certified", settings))
    ratios = {}
    for objective in OBJECTIVES:
        own = dataclasses.replace(
            problem,
            scenario=load("certified", [*settings, f'controller.lmi_objective="{objective}"']),
        )
        ratios[objective] = max(cap_shares(problem, terminal_cost_and_gain(own)[1]).values())
    assert found.choice == min(ratios, key=lambda name: ratios[name])
    assert found.ratio == pytest.approx(min(ratios.values()), rel=1e-6)
    assert found.holds


def test_caps_and_gains_of_a_scenario_start_a_search(certified, monkeypatch):
    start = caps_and_gains(certified)
    assert start == (0.15, 0.2416, 16.5, 0.2915, 0.4754, 1.095, 0.1419, 1.235, 9.99, 9.302, 9.302)
    assert caps_and_gains(load("paper")) is None
    asked = []

    def refuse(problem, near):
        asked.append(near)
        raise ValueError("no start leads anywhere")

    monkeypatch.setattr(module, "optimise", refuse)
    found = guarantee("optimised", certified, start)
    assert asked == [start]
    assert found == Guarantee(reason="no start leads anywhere", caps_and_gains=start)


@pytest.mark.parametrize("design", ["paper", "weighted", "optimised"])
def test_a_condition_without_a_design_says_why(design, certified):
    found = guarantee(design, set_point(certified, OperatingPoint(0.1, 1.4, 0.1)))
    assert found.ratio is None and not found.holds
    assert "reference" in found.reason


def test_a_ratio_below_1_holds_only_where_the_wheels_can_follow():
    assert Guarantee(0.9, 1.0).holds
    assert not Guarantee(0.9, 1.01).holds
    assert not Guarantee(1.0, 0.5).holds


@pytest.mark.slow
def test_a_search_from_a_neighbours_optimum_ends_where_a_fresh_one_does(certified):
    scenario = set_point(certified, OWN._replace(slip_error=0.12))
    near = guarantee("optimised", scenario, caps_and_gains(certified))
    fresh = guarantee("optimised", scenario)
    assert near.holds and fresh.holds and near.ratio is not None
    assert near.ratio == pytest.approx(fresh.ratio, rel=NEARBY_SEARCH)
