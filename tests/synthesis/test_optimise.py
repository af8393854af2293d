"""Laws of the search's starts, and of the advice."""

import numpy as np
from tolerances import ROUNDING

from jaxtube.scenario import load
from jaxtube.synthesis.advice import say_what_helps, say_what_widens
from jaxtube.synthesis.disturbance import complete_problem
from jaxtube.synthesis.estimate import Estimate
from jaxtube.synthesis.optimise import STARTS, caps_and_gains, search_starts
from jaxtube.synthesis.problem import make_problem

SIZE = 2.0
LARGER = [
    "robot.track_width_m=1.0",
    "robot.wheel_speed_max_mps=6.0",
    "robot.wheel_speed_min_mps=-6.0",
    "reference.radius_m=5.0",
    "reference.speed_mps=2.72",
    "reference.wheel_speed_min_mps=2.448",
    "reference.wheel_speed_max_mps=2.992",
    "constraints.longitudinal_m=0.6",
    "constraints.lateral_m=0.6",
    "noise.longitudinal_m=0.002",
    "noise.lateral_m=0.002",
    "initial.x_m=0.2",
    "initial.y_m=0.2",
]


def test_the_caps_and_gains_of_the_file_are_tried_first():
    problem = make_problem(load("certified"))
    own, *usual = search_starts(problem)
    assert own == caps_and_gains(problem.scenario)
    np.testing.assert_array_equal(usual, STARTS)
    assert len(search_starts(make_problem(load("paper")))) == len(STARTS)


def test_starts_of_a_robot_of_twice_the_size_fill_its_caps_alike():
    scenario = load("certified")
    usual = Estimate(make_problem(scenario))
    larger = make_problem(load("certified", LARGER))
    scaled = search_starts(larger)[-len(STARTS) :]
    for start, same in zip(STARTS, scaled, strict=True):
        expected = usual.shares(np.log(start))
        found = Estimate(larger).shares(np.log(same))
        np.testing.assert_allclose(found.caps, expected.caps, rtol=1e3 * ROUNDING)
        np.testing.assert_allclose(found.limits, expected.limits, atol=1e3 * ROUNDING)


def test_advice_names_what_has_an_effect():
    assumed = make_problem(load("paper"))
    assert "[disturbance]" in say_what_helps(assumed)
    computed = complete_problem(load("certified", ["noise.lateral_m=0.02"]))
    assert "[disturbance]" not in say_what_helps(computed)
    assert "--optimise" in say_what_helps(computed)
    assert say_what_widens(computed).startswith("W is made of noise ")
