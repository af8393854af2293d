"""Laws of what is nearest where a design fails: found values are certified again, from starts on
the path, and what decides is searched first."""

import pytest

from jaxtube.scenario import load, replace
from jaxtube.synthesis.design import design
from jaxtube.synthesis.levers import RANGE, SPEED
from jaxtube.synthesis.nearest import ON_PATH, find_nearest, find_nearest_bounded
from jaxtube.synthesis.optimise import UnboundedTubeError, optimise
from jaxtube.synthesis.problem import make_problem
from jaxtube.synthesis.starts import without_caps

HUSKY = {
    "robot.track_width_m": 0.5385,
    "robot.effective_track_m": 0.93,
    "robot.wheel_speed_min_mps": -1.2,
    "robot.wheel_speed_max_mps": 1.2,
    "reference.speed_mps": 0.8,
    "reference.wheel_speed_min_mps": 0.65,
    "reference.wheel_speed_max_mps": 0.95,
    "slip.right": [-0.054, 0.106],
    "slip.left": [-0.054, 0.106],
    "slip.nominal_right": 0.026,
    "slip.nominal_left": 0.026,
    "initial.x_m": 0.2,
}
NEARLY_HALF_A_TURN = {
    "controller.dt_s": 0.2,
    "reference.speed_mps": 0.5,
    "reference.wheel_speed_min_mps": 0.01,
    "reference.wheel_speed_max_mps": 7.84,
    "robot.wheel_speed_min_mps": -14.0,
    "robot.wheel_speed_max_mps": 18.0,
    "initial.x_m": 0.0,
    "initial.y_m": 0.0,
}


@pytest.mark.slow
def test_the_nearest_speed_is_below_and_certified_again():
    scenario = replace(without_caps(load("certified")), HUSKY)
    denied = optimise(make_problem(scenario))
    assert not denied.holds
    counted = []
    nearest = find_nearest(denied, lambda: counted.append(1))
    assert next(iter(nearest)) is SPEED
    slower = nearest[SPEED]
    assert slower is not None and slower.initial == ON_PATH
    assert 0.5 < slower.reference.speed_mps < 0.8
    found = optimise(make_problem(slower))
    assert design(found.scenario).certificate.failing == []
    assert len(counted) == len(nearest) or len(counted) == 3


@pytest.mark.slow
def test_where_no_gains_bound_a_tube_a_narrower_range_of_wheel_speeds_is_found_and_certified():
    """The robot may turn by nearly half a turn in a period."""
    scenario = replace(without_caps(load("certified")), NEARLY_HALF_A_TURN)
    with pytest.raises(UnboundedTubeError, match="no tracking gains tried bound a tube"):
        optimise(make_problem(scenario))
    narrower = find_nearest_bounded(scenario)[RANGE]
    assert narrower is not None
    assert 0.6 < narrower.reference.wheel_speed_max_mps < 2.0
    found = optimise(make_problem(narrower))
    assert design(found.scenario).certificate.failing == []


def test_nothing_is_searched_where_no_quantity_scales_the_ends_of_bands():
    assert find_nearest_bounded(load("certified_wide")) == {}
