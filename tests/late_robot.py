"""One period of a robot whose wheels lag, from any past, by superposition of steps and by an
integration of its own: what the bounds of `sets.robot.committed` are compared with."""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy.integrate import solve_ivp

from sets.robot.actuation import Nominal


@dataclass(frozen=True, eq=False)
class LatePeriod:
    """Commands c_{k-n} .. c_k (n + 1, 2), m/s, the first one for ever before; the lag, the delays
    of all commands (n + 1,), shares lost (2,) and the sideslip."""

    dt: float
    track_width: float
    nominal: Nominal
    commands: np.ndarray
    lag: float
    delays: np.ndarray
    losses: np.ndarray
    sideslip: float = 0.0

    @property
    def issued(self):
        """When each command is given, s after the instant."""
        return self.dt * (np.arange(len(self.commands)) - (len(self.commands) - 1))


def travel(period, times):
    """Return the travel of both wheels since the instant, m, (times, 2)."""
    steps = np.diff(period.commands, axis=0)

    def since_start(when):
        after = np.maximum(when[:, None] - period.issued[1:] - period.delays[1:], 0.0)
        covered = after - period.lag * (1 - np.exp(-after / max(period.lag, 1e-12)))
        return period.commands[0] * when[:, None] + covered @ steps

    return since_start(np.asarray(times, float)) - since_start(np.zeros(1))


def move(period, count=400):
    """Return the motion of the body (complex place, heading) in the period."""
    x = travel(period, np.linspace(0, period.dt, count + 1)) * (1 - period.losses)
    heading = (x[:, 0] - x[:, 1]) / period.track_width
    ways = np.diff(x.mean(axis=1))
    turns = np.diff(heading)
    chords = ways * np.sinc(turns / 2 / np.pi) * np.exp(1j * (heading[:-1] + turns / 2))
    return (1 + 1j * period.sideslip) * chords.sum(), heading[-1]


def move_by_integration(period):
    """Return the same by an integration of wheels and body."""
    arrivals = period.issued + period.delays
    start = _speeds_at_instant(period)
    cuts = np.unique(np.clip([0.0, period.dt, *arrivals], 0.0, period.dt))
    state = np.array([0.0, 0.0, 0.0, *start])
    for begin, end in pairwise(cuts):
        command = period.commands[np.flatnonzero(arrivals <= (begin + end) / 2)[-1]]

        def rates(_, state, command=command):
            right, left = state[3:] * (1 - period.losses)
            speed = (right + left) / 2
            moving = speed * (1 + 1j * period.sideslip) * np.exp(1j * state[2])
            turning = (right - left) / period.track_width
            return [moving.real, moving.imag, turning, *((command - state[3:]) / period.lag)]

        solved = solve_ivp(rates, (begin, end), state, method="DOP853", rtol=1e-12, atol=1e-13)
        state = solved.y[:, -1]
    return state[0] + 1j * state[1], state[2]


def _speeds_at_instant(period):
    before = np.minimum(period.issued[1:] + period.delays[1:], 0.0)
    return period.commands[0] - np.expm1(before / period.lag) @ np.diff(period.commands, axis=0)


def commit(period, now):
    """Return the motion ahead at the instant (now) or a period later, and its travel (2,)."""
    lag, delay = period.nominal
    end = 0.0 if now else period.dt
    nominal_steps = np.diff(period.commands, axis=0)
    after = end - period.issued[1:, None] - delay
    closed = np.where(after > 0, -np.expm1(-np.maximum(after, 0) / max(lag, 1e-12)), 0.0)
    expected = period.commands[0] + (nominal_steps * closed).sum(axis=0)
    ways = []
    place = lag * expected.mean()
    heading = lag * (expected[0] - expected[1]) / period.track_width
    ends = np.append(period.issued[1:], period.dt)
    for index, command in enumerate(period.commands):
        begins = period.issued[index] if index else -np.inf
        ways.append(max(min(ends[index], end) - max(begins, end - delay), 0.0) * command)
    for way in ways:
        chord, turn = arc(way, period.track_width)
        place = place + chord * np.exp(1j * heading)
        heading = heading + turn
    return place, heading, lag * expected + np.sum(ways, axis=0)


def arc(way, track_width):
    """Return the motion along an arc on which the wheels travel so far."""
    turn = (way[0] - way[1]) / track_width
    return way.mean() * np.sinc(turn / 2 / np.pi) * np.exp(1j * turn / 2), turn


def find_rest(period, lever):
    """Return (what is left of the error of the committed pose beside an arc at the mean speeds and
    a kick (0, lever), (2,) m; the speeds lost (2,) m/s; the kick, rad)."""
    before, heading_before, way_before = commit(period, now=True)
    after, heading_after, way_after = commit(period, now=False)
    place, heading = move(period)
    whole = place + after * np.exp(1j * heading)
    turn = heading + heading_after - heading_before
    motion = np.exp(-1j * heading_before) * (whole - before)
    way = travel(period, [period.dt])[0] * (1 - period.losses) + way_after - way_before
    chord, arc_turn = arc(way, period.track_width)
    assert abs(turn - arc_turn) < 1e-10
    lost = period.commands[-1] - way / period.dt
    kick = (lost[0] - lost[1]) * period.dt / period.track_width
    error = -np.exp(-1j * turn) * (motion - chord)
    return np.array([error.real, error.imag - kick * lever]), lost, kick


def join(first, second):
    """Return two motions (complex place, heading), one after the other."""
    return first[0] + second[0] * np.exp(1j * first[1]), first[1] + second[1]


def back(motion):
    """Return a motion back."""
    return -motion[0] * np.exp(-1j * motion[1]), -motion[1]


def read_errors(motion):
    """Return a motion as an error (m, m, rad)."""
    place, heading = motion
    return np.array([place.real, place.imag, heading])


def follow_back(period, wheels, time):
    """Return the motion of the reference over a time before the instant, at wheel speeds (n + 1, 2)
    in the periods of the commands, m/s; the last of these begins at the instant."""
    behind = (0j, 0.0)
    for age in range(len(wheels) - 1, 0, -1):
        duration = np.clip(time - period.dt * (age - 1), 0.0, period.dt)
        behind = join(behind, arc(wheels[-1 - age] * duration, period.track_width))
    return behind


def drive(period, time, count=300):
    """Return the motion of the body over a time after the instant, without sideslip."""
    steps = travel(period, np.linspace(0, time, count)) * (1 - period.losses)
    driven = (0j, 0.0)
    for way in np.diff(steps, axis=0):
        driven = join(driven, arc(way, period.track_width))
    return driven
