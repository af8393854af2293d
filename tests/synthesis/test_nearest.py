"""Laws of what is nearest where a design fails: found values are certified again, from starts on
the path, and what decides is searched first."""

import pytest

from jaxtube.scenario import load, replace
from jaxtube.synthesis.design import design
from jaxtube.synthesis.levers import SPEED
from jaxtube.synthesis.nearest import ON_PATH, find_nearest
from jaxtube.synthesis.optimise import optimise
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
