"""Laws of the scenario bound, against sums of binomials and against boxes of drawn samples."""

import numpy as np
import pytest
from scipy import stats

from jaxtube.identification.promise import count_needed, make_promise

EXACT = 1e-9
CHANCE = 1e-4
"""With which a test of drawn samples fails though the law holds."""


@pytest.mark.parametrize("sides", [1, 2, 3, 5])
@pytest.mark.parametrize("commands", [5, 19, 43, 400])
def test_the_bound_is_met_with_equality(sides, commands):
    promise = make_promise(commands, sides)
    assert stats.binom.cdf(sides - 1, commands, 1 - promise.share) == pytest.approx(0.05, abs=EXACT)
    # The same as the quantile of the share outside a box: a beta law.
    outside = stats.beta.ppf(0.95, sides, commands - sides + 1)
    assert promise.share == pytest.approx(1 - outside, abs=EXACT)


def test_two_sides_promise_what_one_interval_of_one_wheel_is_known_to():
    assert make_promise(19, 2).share == pytest.approx(0.77, abs=0.005)
    assert make_promise(43, 2).share == pytest.approx(0.89, abs=0.005)
    assert count_needed(0.95, 2) == 93
    assert count_needed(0.99, 2) == 473
    # Two wheels and the sideslip are five sides, and promise less.
    assert make_promise(19, 5).share == pytest.approx(0.58, abs=0.005)
    assert count_needed(0.95, 5) == 181


def test_the_needed_commands_are_the_fewest():
    for sides in (1, 3, 5):
        for share in (0.5, 0.8, 0.95):
            needed = count_needed(share, sides)
            assert make_promise(needed, sides).share >= share
            assert make_promise(needed - 1, sides).share < share


def test_fewer_commands_than_sides_promise_nothing():
    assert make_promise(4, 5).share == 0.0
    assert make_promise(0, 1).share == 0.0


def test_boxes_of_drawn_samples_break_the_promise_as_often_as_it_says():
    commands = 30
    samples = 2000
    draw = np.random.default_rng(8)
    points = draw.normal(size=(samples, commands, 2))
    inside = np.prod(
        stats.norm.cdf(points.max(axis=1)) - stats.norm.cdf(points.min(axis=1)), axis=1
    )
    broken = int(np.sum(inside < make_promise(commands, 4).share))
    assert broken <= stats.binom.ppf(1 - CHANCE, samples, 0.05)
    # One point may fix two sides: the bound is not met exactly, but nearly.
    assert broken >= 0.5 * 0.05 * samples


@pytest.mark.parametrize("share", [0.0, 1.0, 1.5, float("nan")])
def test_a_share_that_no_sample_promises_is_refused(share):
    with pytest.raises(ValueError, match="give a number between 0 and 1"):
        count_needed(share, 5)
