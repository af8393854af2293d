"""What lag and delay do to the committed pose: bounds against sampled worst cases, which they hold
and come near; and their independent parts."""

import numpy as np
import pytest
from late_robot import LatePeriod, commit, find_rest, move, move_by_integration
from tolerances import ROUNDING

from sets.robot.actuation import Actuation
from sets.robot.committed import bound_commitment
from sets.robot.late_ways import Driving, Ground

T = 0.1
B = 0.5
SPEED = np.array([0.9, 1.7])
YAW = np.array([-1.2, 1.2])
WHEELS = np.array([[0.6, 0.6], [2.0, 2.0]])
MIDDLE = 1.36
SAMPLES = 250


def make_driving(change=np.inf):
    """Return what is asked for, wheel speeds changing by so much in a period."""
    return Driving(WHEELS, SPEED, YAW, np.array([change, 2 * change / B]), np.full(2, change))


def draw_commands(generator, change):
    """Return commands at extremes of what is asked for, with steps of at most `change`."""
    count = int(generator.integers(7, 12))
    wheels = np.zeros((count, 2))
    for index in range(count):
        v = generator.choice(SPEED) if generator.random() < 0.7 else generator.uniform(*SPEED)
        w = generator.choice(YAW) if generator.random() < 0.7 else generator.uniform(*YAW)
        asked = np.clip([v + B * w / 2, v - B * w / 2], *WHEELS)
        if index:
            asked = np.clip(asked, wheels[index - 1] - change, wheels[index - 1] + change)
        wheels[index] = asked
    return wheels


def draw_period(generator, actuation, errors, change=np.inf, sideslip=0.0):
    commands = draw_commands(generator, change)
    return LatePeriod(
        T,
        B,
        actuation.nominal(T),
        commands,
        float(generator.choice(actuation.lag)),
        generator.choice(actuation.delay, len(commands)),
        generator.choice([-1.0, 1.0], 2) * errors,
        sideslip * generator.choice([-1.0, 1.0]),
    )


CASES = (
    # lag, delay, wheel error, change, least shares of the bounds (x, y, kick) that samples reach
    ((0.05, 0.05), (0.0, 0.0), 0.0, np.inf, (0.3, 0.7, 0.0)),
    ((0.05, 0.05), (0.0, 0.0), 0.0256, np.inf, (0.2, 0.5, 0.9)),
    ((0.1, 0.1), (0.0, 0.0), 0.0256, np.inf, (0.15, 0.5, 0.9)),
    ((0.05, 0.05), (0.13, 0.13), 0.0256, np.inf, (0.15, 0.3, 0.9)),
    ((0.1, 0.1), (0.3, 0.3), 0.0256, np.inf, (0.15, 0.25, 0.9)),
    ((0.0, 0.0), (0.2, 0.2), 0.0256, np.inf, (0.1, 0.1, 0.9)),
    ((0.05, 0.1), (0.0, 0.0), 0.06, np.inf, (0.02, 0.1, 0.5)),
    ((0.05, 0.1), (0.0, 0.0), 0.06, 0.15, (0.05, 0.1, 0.5)),
    ((0.0, 0.0), (0.02, 0.06), 0.03, 0.2, (0.02, 0.05, 0.5)),
    ((0.04, 0.06), (0.08, 0.12), 0.03, 0.2, (0.02, 0.05, 0.4)),
)


@pytest.mark.parametrize(("lag", "delay", "errors", "change", "reached"), CASES)
def test_bounds_hold_sampled_worst_cases_and_are_not_far_from_them(
    lag, delay, errors, change, reached
):
    actuation = Actuation(lag, delay)
    ground = Ground(errors * np.array([[-1.0, -1.0], [1.0, 1.0]]))
    bound = bound_commitment(actuation, T, B, make_driving(change), ground, MIDDLE)
    generator = np.random.default_rng(3)
    found = np.zeros(3)
    for _ in range(SAMPLES):
        period = draw_period(generator, actuation, errors, change)
        rest, lost, kick = find_rest(period, bound.lever)
        assert np.all(np.abs(rest) <= bound.box + ROUNDING)
        taken = bound.unknown @ [1.0, B / 2]
        assert np.all(lost >= bound.loss[0] - taken - ROUNDING)
        assert np.all(lost <= bound.loss[1] + taken + ROUNDING)
        assert abs(kick) <= bound.kick + ROUNDING
        found = np.maximum(found, [*np.abs(rest), abs(kick)])
    assert np.all(found >= reached * np.array([*bound.box, bound.kick]))


def test_wheels_that_obey_at_once_add_nothing():
    errors = np.array([[-0.03, -0.02], [0.05, 0.04]])
    bound = bound_commitment(Actuation(), T, B, make_driving(), Ground(errors), MIDDLE)
    np.testing.assert_array_equal(bound.box, 0.0)
    np.testing.assert_array_equal(bound.slide, 0.0)
    assert bound.lever == 0.0
    np.testing.assert_allclose(bound.loss, errors * WHEELS[1], rtol=1e-9)


def test_sideslip_and_lever_arm_are_held_with_the_rest():
    actuation = Actuation((0.05, 0.05), (0.04, 0.04))
    errors = 0.02
    ground = Ground(errors * np.array([[-1.0, -1.0], [1.0, 1.0]]), sideslip=0.05)
    bound = bound_commitment(actuation, T, B, make_driving(), ground, MIDDLE)
    generator = np.random.default_rng(3)
    found = np.zeros(2)
    for _ in range(SAMPLES):
        period = draw_period(generator, actuation, errors, sideslip=0.05)
        rest, _, _ = find_rest(period, bound.lever)
        assert np.all(np.abs(rest) <= bound.box + bound.slide + ROUNDING)
        found = np.maximum(found, np.abs(rest))
    assert found[1] >= 0.6 * (bound.box + bound.slide)[1]


def test_slips_compensated_anew_in_each_command_widen_what_is_lost():
    errors = 0.01 * np.array([[-1.0, -1.0], [1.0, 1.0]])
    for actuation in (Actuation((0.05, 0.05)), Actuation((0.05, 0.08))):
        ground = Ground(errors)
        once = bound_commitment(actuation, T, B, make_driving(), ground, MIDDLE)
        anew = bound_commitment(
            actuation, T, B, make_driving(), ground._replace(stale_errors=5 * errors), MIDDLE
        )
        all_stale = bound_commitment(actuation, T, B, make_driving(), Ground(5 * errors), MIDDLE)
        assert np.all(anew.box > once.box)
        assert once.kick < anew.kick
        assert np.all(np.abs(anew.loss) < np.abs(all_stale.loss))


def test_the_motion_of_the_oracle_is_that_of_an_integration():
    generator = np.random.default_rng(8)
    actuation = Actuation((0.01, 0.1), (0.03, 0.12))
    for _ in range(3):
        period = draw_period(generator, actuation, 0.1, sideslip=0.1)
        place, heading = move(period, 20_000)
        expected, expected_heading = move_by_integration(period)
        assert abs(place - expected) < 1e-8
        assert abs(heading - expected_heading) < 1e-10


def test_no_more_is_ahead_than_the_commands_of_the_latency():
    generator = np.random.default_rng(8)
    actuation = Actuation((0.05, 0.05), (0.23, 0.23))
    period = draw_period(generator, actuation, 0.0)
    steady = LatePeriod(
        T,
        B,
        period.nominal,
        np.tile(period.commands[:1], (5, 1)),
        period.lag,
        period.delays[:5],
        0.0,
    )
    _, heading, way = commit(steady, now=True)
    np.testing.assert_allclose(way, 0.28 * period.commands[0], rtol=1e-12)
    turn = (period.commands[0, 0] - period.commands[0, 1]) / B
    np.testing.assert_allclose(heading, 0.28 * turn, rtol=1e-12)


def test_wheels_that_may_lose_too_much_are_refused():
    errors = 0.9 * np.array([[-1.0, -1.0], [1.0, 1.0]])
    with pytest.raises(ValueError, match="wheels lose may turn"):
        bound_commitment(Actuation((0.05, 0.05)), T, B, make_driving(), Ground(errors), MIDDLE)
    with pytest.raises(ValueError, match="may turn by"):
        bound_commitment(Actuation((1.5, 1.5)), T, B, make_driving(), Ground(errors * 0.01), MIDDLE)
