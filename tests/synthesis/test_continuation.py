"""Laws of continuation: whichever way an optimum is reached, it is the same one; where there is
none, starts made for the robot and ways from easier scenarios agree on what is least."""

import numpy as np
import pytest

from jaxtube.scenario import load, replace
from jaxtube.synthesis.continuation import PATHS, follow
from jaxtube.synthesis.descent import descend
from jaxtube.synthesis.estimate import Estimate
from jaxtube.synthesis.levers import SPEED
from jaxtube.synthesis.problem import make_problem
from jaxtube.synthesis.starts import make_starts, without_caps

ON_PATH = {"initial.x_m": 0.0, "initial.y_m": 0.0}
SKID_STEERED = {
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
}
SAME = 0.02
"""Difference of two objectives, logarithms of ratios, that are the same optimum."""
SEED = 5
RANDOM_STARTS = 6
SPREAD = np.array([0.5] * 8 + [0.3, 0.8, 0.5])
"""Of random starts, in logarithms."""


def estimate(values: dict) -> Estimate:
    return Estimate(make_problem(replace(without_caps(load("certified")), {**ON_PATH, **values})))


def test_the_way_from_less_slip_ends_at_the_optimum():
    asked = estimate({"slip.relative_error": 0.3})
    direct = descend(asked, make_starts(asked)[0])
    assert direct is not None
    assert next(follow(asked)).objective == pytest.approx(direct.objective, abs=SAME)


@pytest.mark.slow
def test_where_there_is_no_slip_error_the_way_is_from_less_speed():
    asked = estimate({"slip.relative_error": 0.0})
    assert len(list(follow(asked))) == 1
    assert SPEED in PATHS


@pytest.mark.slow
def test_nothing_holds_a_skid_steered_robot_at_eight_tenths_of_a_metre_a_second():
    """Neither starts made for the robot, nor easier scenarios, nor random ones lead to a design:
    all end where the wheels' greatest speed leaves too little, with the same ratio."""
    asked = estimate(SKID_STEERED)
    random = np.random.default_rng(SEED)
    starts = make_starts(asked)
    anywhere = [starts[0] + SPREAD * random.normal(size=11) for _ in range(RANDOM_STARTS)]
    ends = [*(descend(asked, start) for start in [*starts, *anywhere]), *follow(asked)]
    objectives = np.array([descent.objective for descent in ends if descent is not None])
    assert len(objectives) == len(starts) + RANDOM_STARTS + len(PATHS)
    assert objectives.min() > np.log(1.3)
    assert objectives.max() - objectives.min() < SAME
