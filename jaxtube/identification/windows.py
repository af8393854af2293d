"""The windows of a log: stretches of one command, over which wheels and body are averaged.

A command is a stretch of constant `step` and commanded velocity. Windows are laid from its end
backwards, without overlap: its last one is the most settled, and the first one begins when the
wheels have followed the command. A stretch that no command is known for
(a robot driven by hand) is cut into windows from its start, and each run of steady ones whose wheel
speeds agree counts as a command.

    steady:  the mean of each wheel over any quarter within `DRIFT` of that over the window, and its
             spread within `SPREAD`, by the fastest wheel speed of the log
    lost:    the window touches a cut, or has too few poses

Source: new; two-second windows as in D. Baril et al., "DRIVE: data-driven robot input vector
exploration" (2024).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from jaxtube.identification.arcs import FEWEST_POSES, find_noise, fit_arc
from jaxtube.identification.clocks import Clock
from jaxtube.identification.cuts import Cuts
from jaxtube.identification.samples import Poses, Travel
from jaxtube.recordings.log import Log
from jaxtube.recordings.windows import Windows

DRIFT = 0.05
SPREAD = 0.1
"""Of the fastest wheel speed of the log."""

QUARTERS = 4

SAME = 0.1
"""Of the fastest wheel speed, by which the wheels of one command driven by hand may differ."""

LEAST_SHARE_OF_POSES = 0.6
"""Of those that a window has at the usual period."""

FASTEST = 95.0
"""Percentile of the faster wheel's speed, among moving samples, that counts as the fastest."""

MOVING_MPS = 0.02

SLACK = 1e-6
"""Of a window's length: a command as long as its windows holds them all."""


@dataclass(frozen=True, eq=False)
class LogWindows:
    """Windows of a log, and when they were.

    Attributes:
        windows: as a table of windows would hold them.
        start: of each window, s on the clock of the wheels.
        length: of every window, s.
        spread: standard deviations of (v, omega, v_y) in the robot's frame for noise of one metre,
            one radian, one metre, that is 1/s; NaN where the pose was lost.
        missed: what the poses of steady windows that drive miss of a smooth path, by
            `arcs.find_noise`: (x m, y m, heading rad) in the world frame.
        standing: the same of the steady windows that stand.
    """

    windows: Windows
    start: Float[np.ndarray, "k"]
    length: float
    spread: Float[np.ndarray, "k 3"]
    missed: Float[np.ndarray, "poses 3"]
    standing: Float[np.ndarray, "poses 3"]


class _Place(NamedTuple):
    """Where a window lies, before anything is measured."""

    start: float
    stretch: int
    by_hand: bool


def cut_windows(
    log: Log,
    travel: Travel,
    poses: Poses,
    clock: Clock,
    cuts: Cuts,
    length: float,
    settle: float = 0.0,
) -> LogWindows:
    """Cut a log into windows and measure each.

    Args:
        log: of wheels and commands.
        travel: of the wheels.
        poses: without held ones.
        clock: of wheels and poses.
        cuts: where poses are not trusted.
        length: of a window, s.
        settle: left out after each new command, s.
    """
    places = _lay_windows(log, length, settle)
    start = np.array([place.start for place in places])
    fastest = find_fastest(log.wheels)
    wheels = travel.between(start, start + length) / length
    steady = np.array([_is_steady(log, place.start, length, fastest) for place in places], bool)
    lost = cuts.touch(start + clock.offset, start + clock.offset + length)
    least = max(FEWEST_POSES, round(LEAST_SHARE_OF_POSES * length / poses.period))
    velocity = np.full((len(places), 3), np.nan)
    spread = np.full((len(places), 3), np.nan)
    missed = [np.empty((0, 3))]
    standing = [np.empty((0, 3))]
    for k, begin in enumerate(start + clock.offset):
        rows = slice(*np.searchsorted(poses.time, [begin, begin + length]))
        lost[k] |= rows.stop - rows.start < least
        if lost[k]:
            continue
        arc = fit_arc(poses.time[rows], poses.pose[rows])
        velocity[k] = arc.velocity
        spread[k] = arc.spread
        if steady[k]:
            is_standing = np.abs(wheels[k]).max() < MOVING_MPS
            noise = find_noise(poses.time[rows], poses.pose[rows])
            (standing if is_standing else missed).append(noise)
    windows = Windows(
        log.path, _number_commands(places, wheels, steady, fastest), wheels, velocity, steady, lost
    )
    return LogWindows(
        windows, start, length, spread, np.concatenate(missed), np.concatenate(standing)
    )


def find_fastest(wheels: Float[np.ndarray, "n 2"]) -> float:
    """Return the speed that counts as the fastest one of the wheels, m/s."""
    faster = np.abs(wheels).max(axis=1)
    moving = faster[faster > MOVING_MPS]
    return float(np.percentile(moving, FASTEST)) if len(moving) else 0.0


def _lay_windows(log: Log, length: float, settle: float) -> list[_Place]:
    """Place windows on each stretch of one command, in order of time."""
    changes = np.zeros(len(log.time) - 1, dtype=bool)
    known = np.zeros(len(log.time), dtype=bool)
    if log.commands is not None:
        changes |= np.any(np.diff(log.commands, axis=0) != 0.0, axis=1)
        known |= np.any(log.commands != 0.0, axis=1)
    elif log.step is not None:
        known |= log.step != log.step[0]
    if log.step is not None:
        changes |= np.diff(log.step) != 0
    first = np.concatenate([[0], np.flatnonzero(changes) + 1])
    # A command is given before the row that shows it first: the wheels may have left the last one.
    end = log.time[np.append(first[1:] - 1, -1)]
    places = []
    for stretch, (row, stop) in enumerate(zip(first, end, strict=True)):
        held = stop - log.time[row] - (settle if known[row] else 0.0)
        count = max(int(held / length + SLACK), 0)
        spare = stop - log.time[row] - count * length if known[row] else 0.0
        begins = log.time[row] + spare + length * np.arange(count)
        places += [_Place(float(begin), stretch, not known[row]) for begin in begins]
    return places


def _is_steady(log: Log, start: float, length: float, fastest: float) -> bool:
    """Tell whether the wheels had settled in a window."""
    rows = slice(*np.searchsorted(log.time, [start, start + length]))
    wheels = log.wheels[rows]
    if len(wheels) < QUARTERS:
        return False
    means = np.array([part.mean(axis=0) for part in np.array_split(wheels, QUARTERS)])
    drift = np.abs(means - wheels.mean(axis=0)).max()
    return bool(drift <= DRIFT * fastest and wheels.std(axis=0).max() <= SPREAD * fastest)


def _number_commands(
    places: list[_Place],
    wheels: Float[np.ndarray, "k 2"],
    steady: np.ndarray,
    fastest: float,
) -> Int[np.ndarray, "k"]:
    """Number the command of each window: its stretch, and where a robot is driven by hand its run
    of steady windows that agree."""
    number = np.zeros(len(places), dtype=int)
    current = -1
    first = 0
    for k, place in enumerate(places):
        goes_on = k > 0 and place.stretch == places[k - 1].stretch
        if goes_on and place.by_hand:
            agrees = np.abs(wheels[k] - wheels[first]).max() <= SAME * fastest
            goes_on = bool(steady[k] and steady[first] and agrees)
        if not goes_on:
            current += 1
            first = k
        number[k] = current
    return number
