"""Laws of the search's starts, and of the advice."""

import numpy as np
import pytest
from tolerances import ROUNDING

from jaxtube.scenario import load
from jaxtube.synthesis.advice import say_what_helps, say_what_widens
from jaxtube.synthesis.disturbance import complete_problem
from jaxtube.synthesis.estimate import Estimate
from jaxtube.synthesis.optimise import TRIED, optimise
from jaxtube.synthesis.problem import make_problem
from jaxtube.synthesis.starts import make_starts

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


def test_starts_are_bounded_tubes_the_best_first():
    estimate = Estimate(make_problem(load("certified")))
    starts = make_starts(estimate)
    assert len(starts) >= TRIED
    missed = []
    for start in starts:
        shares = estimate.shares(start)
        missed.append(max(shares.caps.max(), shares.limits.max()))
    assert missed == sorted(missed)


def test_starts_of_a_robot_of_twice_the_size_fill_its_caps_alike():
    usual = Estimate(make_problem(load("certified")))
    larger = Estimate(make_problem(load("certified", LARGER)))
    for start, scaled in zip(make_starts(usual), make_starts(larger), strict=True):
        expected = usual.shares(start)
        found = larger.shares(scaled)
        np.testing.assert_allclose(found.caps, expected.caps, rtol=1e4 * ROUNDING)
        np.testing.assert_allclose(found.limits, expected.limits, atol=1e4 * ROUNDING)


@pytest.mark.slow
def test_a_robot_of_twice_the_size_has_the_same_ratio():
    usual = optimise(make_problem(load("certified")))
    larger = optimise(make_problem(load("certified", LARGER)))
    assert usual.holds and larger.holds
    assert larger.ratio == pytest.approx(usual.ratio, rel=0.01)


def test_a_search_ends_with_a_design_or_says_what_binds():
    found = optimise(make_problem(load("certified", ["slip.relative_error=0.6"])))
    assert not found.holds
    assert "passes a limit" in found.describe_binding() or "fills" in found.describe_binding()


def test_advice_names_what_has_an_effect():
    assumed = make_problem(load("paper"))
    assert "[disturbance]" in say_what_helps(assumed)
    computed = complete_problem(load("certified", ["noise.lateral_m=0.02"]))
    assert "[disturbance]" not in say_what_helps(computed)
    assert "--optimise" in say_what_helps(computed)
    assert say_what_widens(computed).startswith("W is made of noise ")
