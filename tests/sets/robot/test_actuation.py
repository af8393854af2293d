"""Travel of wheels whose lag and delay are not known, against sampled and worst sequences of
commands."""

import numpy as np
import pytest

from sets.robot.actuation import (
    NO_LAG,
    Actuation,
    held_back,
    step_travel,
)
from sets.robot.unknown_travel import bound_unknown_travel

T = 0.1
PERIODS = 60
SHARES = np.linspace(0.0, 1.0, 21)

CASES = (
    # lag, delay, least shares of (total, variation, unevenness) that are reached
    ((0.05, 0.1), (0.0, 0.0), (0.9, 0.75, 0.4)),
    ((0.0, 0.02), (0.0, 0.0), (0.9, 0.9, 0.8)),
    ((0.05, 0.05), (0.02, 0.04), (0.9, 0.9, 0.2)),
    ((0.05, 0.1), (0.08, 0.12), (0.6, 0.6, 0.15)),
    ((0.0, 0.0), (0.08, 0.12), (0.9, 0.9, 0.4)),
)


def extra_travel(lag, delays, nominal):
    """Return what a unit step of each of the last commands adds to the travel within shares of a
    period, (shares, commands)."""
    issued = T * np.arange(PERIODS)
    ends = issued + T * SHARES[:, None]
    of_lag = step_travel(ends - delays, lag) - step_travel(issued - delays, lag)
    expected = step_travel(ends - nominal.delay, nominal.lag)
    return of_lag - (expected - step_travel(issued - nominal.delay, nominal.lag))


def worst_steps(wanted, change, span):
    """Return steps of at most `change` between speeds in a range, backwards in time, that follow
    wanted signs."""
    speed = span if wanted[0] > 0 else 0.0
    steps = np.zeros(len(wanted))
    for index, sign in enumerate(wanted):
        earlier = np.clip(speed - sign * change, 0.0, span)
        steps[index] = speed - earlier
        speed = earlier
    return steps


@pytest.mark.parametrize(("lag", "delay", "reached"), CASES)
@pytest.mark.parametrize("change", [0.2, 1.0])
def test_unknown_travel_is_held_and_nearly_met(lag, delay, reached, change):
    actuation = Actuation(lag, delay)
    nominal = actuation.nominal(T)
    bound = bound_unknown_travel(actuation, T, np.ones(1), np.array([change]))
    bounds = np.concatenate(bound)
    generator = np.random.default_rng(2)
    found = np.zeros(3)
    for trial in range(400):
        true_lag = generator.choice([*lag, generator.uniform(*lag)])
        delays = generator.choice([*delay, generator.uniform(*delay)], PERIODS)
        extra = extra_travel(true_lag, delays, nominal)
        middle = len(SHARES) // 2
        wanted = (
            extra[-1],
            extra[middle] - extra[-1] / 2,
            generator.choice([-1.0, 1.0], PERIODS),
        )[trial % 3]
        travel = extra @ worst_steps(np.sign(wanted), change, 1.0)
        uneven = travel - SHARES * travel[-1]
        variation = np.abs(np.diff(travel)).sum()
        met = np.array([abs(travel[-1]), variation, np.abs(uneven).max()])
        assert np.all(met <= bounds + 1e-12)
        found = np.maximum(found, met)
    assert np.all(found >= np.array(reached) * bounds * (0.7 if change == 1.0 else 1.0))


def test_nothing_is_unknown_of_known_lag_and_delay():
    known = Actuation((0.05, 0.05), (0.13, 0.13))
    for part in bound_unknown_travel(known, T, np.ones(2), np.ones(2)):
        np.testing.assert_array_equal(part, 0.0)
    assert known.nominal(T) == (0.05, 0.13)
    assert NO_LAG.is_ideal


def test_the_nominal_lag_holds_back_the_mean_of_what_its_ends_hold_back():
    nominal = Actuation((0.02, 0.3), (0.01, 0.05)).nominal(T)
    expected = (held_back(0.02, T) + held_back(0.3, T)) / 2
    assert held_back(nominal.lag, T) == pytest.approx(expected, rel=1e-12)
    assert nominal.delay == pytest.approx(0.03)


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        ({"lag": (0.1, 0.05)}, "lag"),
        ({"lag": (-0.1, 0.05)}, "lag"),
        ({"delay": (0.0, np.inf)}, "delay"),
        ({"delay": (0.0, np.nan)}, "delay"),
    ],
)
def test_what_is_no_interval_of_times_is_refused(settings, words):
    with pytest.raises(ValueError, match=words):
        Actuation(**settings)


def test_delays_by_which_commands_overtake_each_other_are_refused():
    with pytest.raises(ValueError, match="overtake"):
        Actuation(delay=(0.0, 0.15)).nominal(T)
