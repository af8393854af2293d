"""From errors of the committed pose to those of the pose itself, and noise the other way, against
motions of the plane."""

from fractions import Fraction

import numpy as np
import pytest
from late_robot import LatePeriod, arc, commit, move
from test_committed import SPEED, YAW, B, T, draw_period, make_driving
from tolerances import ROUNDING

from sets.robot.actuation import Actuation
from sets.robot.late_ways import Ground
from sets.robot.latency import (
    bound_committed_noise,
    bound_later_errors,
    bound_present_errors,
)


def turned(vector, angle):
    return vector * np.exp(1j * angle)


@pytest.mark.parametrize("latency", [0.02, 0.05, 0.3])
def test_noise_of_the_pose_becomes_noise_of_the_committed_pose_within_its_bound(latency):
    generator = np.random.default_rng(4)
    noise = np.array([0.01, 0.02, 0.03])
    bound = bound_committed_noise(noise, latency, fastest=1.5, yaw_rate=1.2)
    found = np.zeros(3)
    for _ in range(2000):
        n = noise * generator.choice([-1.0, 1.0], 3)
        turn = latency * generator.choice(YAW)
        way = latency * 1.5 * np.exp(1j * generator.uniform(-0.5, 0.5))
        # e~ = M^-1 + e + R, of which only the turn of M and the way of R meet the noise.
        heading = generator.uniform(-0.4, 0.4)
        change = turned(n[0] + 1j * n[1] + turned(way, heading) * (np.exp(1j * n[2]) - 1), -turn)
        met = np.abs([change.real, change.imag, n[2]])
        assert np.all(met <= bound + ROUNDING)
        found = np.maximum(found, met)
    assert np.all(found >= 0.7 * bound)


def test_the_bound_of_committed_noise_is_no_less_than_its_exact_value():
    generator = np.random.default_rng(5)
    for _ in range(100):
        noise = generator.uniform(0.001, 0.05, 3)
        latency, fastest = generator.uniform(0.01, 1.0, 2)
        bound = bound_committed_noise(noise, latency, fastest, yaw_rate=0.0)
        swing = Fraction(latency) * Fraction(fastest) * Fraction(noise[2])
        assert all(Fraction(bound[i]) >= Fraction(noise[i]) + swing for i in range(2))


@pytest.mark.parametrize(
    ("lag", "delay", "slack"),
    [
        ((0.05, 0.05), (0.0, 0.0), 0.6),
        ((0.0, 0.0), (0.06, 0.06), 0.6),
        ((0.03, 0.07), (0.0, 0.02), 0.3),
    ],
)
def test_a_latency_later_the_pose_is_near_where_it_was_committed_to_be(lag, delay, slack):
    actuation = Actuation(lag, delay)
    nominal = actuation.nominal(T)
    largest = 0.02
    ground = Ground(largest * np.array([[-1.0, -1.0], [1.0, 1.0]]), sideslip=0.03)
    committed = np.array([0.1, 0.15, 0.2])
    bound = bound_later_errors(committed, actuation, T, B, make_driving(), ground)
    generator = np.random.default_rng(4)
    found = np.zeros(3)
    for _ in range(400):
        period = draw_period(generator, actuation, largest, sideslip=0.03)
        place, heading, _ = commit(period, now=True)
        driven, turn = move(_Until(period, nominal.latency))
        # e' = m^-1 + M + e~
        error = committed * generator.choice([-1.0, 1.0], 3)
        ahead = turned(place - driven, -turn)
        rest = heading - turn
        seen = ahead + turned(error[0] + 1j * error[1], rest)
        met = np.abs([seen.real, seen.imag, rest + error[2]])
        assert np.all(met <= bound + ROUNDING)
        found = np.maximum(found, met)
    assert np.all(found - committed >= slack * (bound - committed) * [0.2, 0.1, 0.5])


REFERENCE = np.array([1.0, 1.4])
"""Least and greatest wheel speed of a reference, m/s."""


@pytest.mark.parametrize(
    ("lag", "delay"), [(0.01, 0.0), (0.05, 0.0), (0.0, 0.06), (0.05, 0.13), (0.2, 0.0)], ids=str
)
def test_at_the_instant_the_pose_is_within_its_bound_too(lag, delay):
    nominal = Actuation((lag, lag), (delay, delay)).nominal(T)
    committed = np.array([0.1, 0.15, 0.2])
    schedules = np.tile(REFERENCE[:, None], 2)[None]
    bound = bound_present_errors(committed, nominal, T, B, make_driving(), schedules)
    generator = np.random.default_rng(4)
    found = np.zeros(3)
    for _ in range(1500):
        reference = generator.choice(REFERENCE, (10, 2))
        place, heading, _ = commit(_follow(generator, reference, nominal), now=True)
        x, y, turn = committed * generator.choice([-1.0, 1.0], 3)
        way, turn_behind = _drive(reference, nominal.latency)
        # e = M + e~ + R^-1
        tilt = heading + turn - turn_behind
        error = place + turned(x + 1j * y, heading) - turned(way, tilt)
        met = np.abs([error.real, error.imag, tilt])
        assert np.all(met <= bound + ROUNDING)
        found = np.maximum(found, met)
    assert np.all(found >= 0.65 * bound)
    # The pose has more than the committed one.
    assert found[1] > committed[1] + 0.5 * nominal.latency * REFERENCE[1] * np.sin(committed[2])


def _follow(generator, reference, nominal):
    """Return commands of extreme speed and yaw rate deficit, along a reference's wheel speeds of
    each period, the last of them yet to come."""
    deficit = YAW[1] - np.ptp(REFERENCE) / B
    speed = generator.choice(SPEED, len(reference))
    turning = (reference[:, 0] - reference[:, 1]) / B
    turning = turning + deficit * generator.choice([-1.0, 1.0], len(reference))
    commands = speed[:, None] + B / 2 * turning[:, None] * [1.0, -1.0]
    return LatePeriod(T, B, nominal, commands, nominal.lag, np.zeros(len(reference)), np.zeros(2))


def _drive(reference, latency):
    """Return the motion of a reference over a latency, which ends as its last period begins."""
    place = 0j
    heading = 0.0
    for age, wheels in zip(range(len(reference) - 1, 0, -1), reference[:-1], strict=True):
        time = min(max(latency - (age - 1) * T, 0.0), T)
        chord, turn = arc(time * wheels, B)
        place += turned(chord, heading)
        heading += turn
    return place, heading


class _Until:
    """A period cut off earlier, its commands given when they were."""

    def __init__(self, period, end):
        self.__dict__.update(vars(period), dt=end)
        self.issued = period.issued
