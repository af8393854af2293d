"""Joining paths: from any pose onto a reference, with both wheels in their box in every period.

Dubins' paths lead to the poses that the reference has j periods from now. One of n periods that
ends in the pose of period j >= 0, n >= j, is n - j periods late there, and from there on. Of all of
them that one is wanted for which n and n - j together are least: soon there, and little late.

A path's arcs and lines do not end with periods. Its wheel speeds, held over each period, are
therefore moved, by as little as can be, until the arcs that they drive end exactly in the pose:
Newton steps of least norm, within the box.

Source: new; `dubins` names those of the paths.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from jaxtube.paths import dubins
from jaxtube.paths.profile import WheelLimits
from jaxtube.plant.reference import Reference, make_reference

TIGHTNESS = 0.85
"""Of the sharpest curvature within the box: what is left lets speeds be moved in turns, too."""

LEAST_SPEED = 0.9
"""Of the speed of the paths: slower ones are not tried."""

MOST_TRIES = 60
"""Paths whose wheel speeds are moved before it is said that there is none."""

NEAR_PERIODS = (4, 8, 16, 32, 64)
"""After so many periods a pose near to the reference may be on it, at speeds near to its own."""

NEAR = 0.25
"""Share of the way and of the turn of these periods up to which a pose is near."""

STEPS = 40
"""Of Newton's method."""

SERIES_END = 1e-4
"""Half turn in rad below which the derivative of sin(x) / x is its series."""

MET = 1e-10
"""Distance (m) and angle (rad) at which two poses are one."""


class Joining(NamedTuple):
    """A path onto a reference.

    Attributes:
        wheels: speeds (right, left) of every period, m/s.
        joins: the period of the reference that begins where the path ends.
    """

    wheels: Float[np.ndarray, "periods 2"]
    joins: int

    @property
    def late(self) -> int:
        """Periods by which the reference is followed late from there on."""
        return len(self.wheels) - self.joins


class _Guess(NamedTuple):
    """Where a path may join the reference, and how it may be driven there."""

    cost: int  # periods to the end, and those that it is late there
    joins: int
    make: Callable[[], Float[np.ndarray, "periods 2"]]


def find_joining(
    start: Float[np.ndarray, "3"], asked: Reference, limits: WheelLimits
) -> Joining | None:
    """Return a path from a pose onto a reference, None where none was found.

    Args:
        start: (x m, y m, heading rad).
        asked: reference from now on: its period 0 is the one that begins.
        limits: least and greatest speed of either wheel.
    """
    if np.max(np.abs(find_gap(start, asked.poses[0]))) <= MET:
        return Joining(np.zeros((0, 2)), 0)
    guesses = [*_guess_by_speeds(start, asked, limits), *_guess_by_paths(start, asked, limits)]
    guesses.sort(key=lambda guess: guess.cost)
    for guess in guesses[:MOST_TRIES]:
        wheels = meet(start, guess.make(), asked.poses[guess.joins], asked.dt, limits)
        if wheels is not None:
            return Joining(wheels, guess.joins)
    return None


def _guess_by_speeds(
    start: Float[np.ndarray, "3"], asked: Reference, limits: WheelLimits
) -> Iterator[_Guess]:
    """Yield the wheel speeds of the reference itself, for a pose that is near to it."""
    gap = find_gap(start, asked.poses[0])
    distance = float(np.hypot(gap[0], gap[1]))
    for count in NEAR_PERIODS:
        way = count * asked.dt * limits.least
        turn = way * limits.sharpest_curvature
        if count < len(asked.wheels) and distance <= NEAR * way and abs(gap[2]) <= NEAR * turn:
            yield _Guess(count, count, partial(_clip, asked.wheels[:count], limits))


def _guess_by_paths(
    start: Float[np.ndarray, "3"], asked: Reference, limits: WheelLimits
) -> Iterator[_Guess]:
    """Yield Dubins' paths to all poses of the reference, of those that cost least."""
    curvature = TIGHTNESS * limits.sharpest_curvature
    if curvature <= 0.0:
        return
    step = (limits.least + limits.greatest) / 2.0 * asked.dt
    pieces = dubins.find_paths(start, asked.poses, 1.0 / curvature)
    lengths = pieces.sum(axis=2)
    exists = np.isfinite(lengths)
    joins = np.broadcast_to(np.arange(len(lengths))[:, None], lengths.shape)
    shortest = np.ceil(np.where(exists, lengths, 0.0) / step - MET).astype(int)
    periods = np.maximum(shortest, joins)
    exists &= (lengths >= LEAST_SPEED * step * periods) & (periods > 0)
    cost = 2 * periods - joins
    best = np.argsort(np.where(exists, cost, np.iinfo(int).max), axis=None, kind="stable")
    for place in best[: min(MOST_TRIES, int(exists.sum()))]:
        end, kind = np.unravel_index(place, cost.shape)
        sides = dubins.SIDES[kind]
        count = int(periods[end, kind])
        make = partial(_sample, pieces[end, kind], sides, curvature, count, asked.dt, limits)
        yield _Guess(int(cost[end, kind]), int(end), make)


def find_gap(
    pose: Float[np.ndarray, "3"], ends: Float[np.ndarray, "... 3"]
) -> Float[np.ndarray, "... 3"]:
    """Return what a pose misses of others in the world (m, m, rad), headings without whole
    turns."""
    gap = ends - pose
    gap[..., 2] -= dubins.TURN * np.round(gap[..., 2] / dubins.TURN)
    return gap


def _clip(wheels: Float[np.ndarray, "n 2"], limits: WheelLimits) -> Float[np.ndarray, "n 2"]:
    return np.clip(wheels, limits.least, limits.greatest)


def extend(asked: Reference, start: Float[np.ndarray, "3"], limits: WheelLimits) -> Reference:
    """Return a reference that goes on with its last wheel speeds for long enough to be joined from
    a pose."""
    curvature = TIGHTNESS * limits.sharpest_curvature
    step = (limits.least + limits.greatest) / 2.0 * asked.dt
    distance = np.linalg.norm(asked.poses[0, :2] - start[:2])
    turns = 0.0 if curvature <= 0.0 else 3.0 * dubins.TURN / curvature
    missing = int(np.ceil((distance + turns) / step)) - len(asked.wheels)
    if missing <= 0:
        return asked
    wheels = np.concatenate([asked.wheels, np.repeat(asked.wheels[-1:], missing, axis=0)])
    return along(asked.poses[0], wheels, asked.dt, limits.track_width)


def along(
    start: Float[np.ndarray, "3"], wheels: Float[np.ndarray, "n 2"], dt: float, track_width: float
) -> Reference:
    """Return the reference of wheel speeds from a pose, without preview."""
    yaw_rates = wheels @ np.array([1.0, -1.0]) / track_width
    return make_reference(start, wheels.mean(axis=1), yaw_rates, dt, len(wheels), track_width)


def _sample(
    pieces: Float[np.ndarray, "3"],
    sides: Float[np.ndarray, "3"],
    curvature: float,
    count: int,
    dt: float,
    limits: WheelLimits,
) -> Float[np.ndarray, "count 2"]:
    """Return wheel speeds that follow a Dubins path at one speed, up to where its pieces meet."""
    lengths = np.linspace(0.0, pieces.sum(), count + 1)
    turns = np.diff(dubins.find_headings(pieces, sides, 1.0 / curvature, lengths))
    difference = turns * limits.track_width / (2.0 * dt)
    speed = pieces.sum() / (count * dt)
    wheels = np.stack([speed + difference, speed - difference], axis=-1)
    return _clip(wheels, limits)


def meet(
    start: Float[np.ndarray, "3"],
    wheels: Float[np.ndarray, "n 2"],
    end: Float[np.ndarray, "3"],
    dt: float,
    limits: WheelLimits,
) -> Float[np.ndarray, "n 2"] | None:
    """Return wheel speeds near to given ones, within the limits, that lead from a pose to another;
    None where Newton's method finds none.

    Args:
        start: (x m, y m, heading rad).
        wheels: speeds (right, left) of every period within the limits, m/s.
        end: pose to be met, its heading up to whole turns.
        dt: period, s.
        limits: of the wheels.
    """
    for _ in range(STEPS):
        reference = along(start, wheels, dt, limits.track_width)
        missed = find_gap(reference.poses[-1], end)
        if np.max(np.abs(missed)) <= MET:
            return wheels
        moved = _move(wheels, _differentiate(reference, limits.track_width), missed, limits)
        if moved is None:
            return None
        wheels = moved
    return None


def _move(
    wheels: Float[np.ndarray, "n 2"],
    slope: Float[np.ndarray, "3 2n"],
    missed: Float[np.ndarray, "3"],
    limits: WheelLimits,
) -> Float[np.ndarray, "n 2"] | None:
    """Return the wheel speeds after a step of least norm, those that it would take out of their box
    held at its edge."""
    speeds = wheels.ravel()
    is_free = np.ones(len(speeds), bool)
    while is_free.sum() >= len(missed):
        free = slope[:, is_free]
        step = np.zeros(len(speeds))
        step[is_free] = np.linalg.lstsq(free, missed, rcond=None)[0]
        held = is_free & (
            ((speeds >= limits.greatest) & (step > 0.0)) | ((speeds <= limits.least) & (step < 0.0))
        )
        if not held.any():
            moved = np.clip(speeds + step, limits.least, limits.greatest)
            return moved.reshape(wheels.shape)
        is_free &= ~held
    return None


def _differentiate(reference: Reference, track_width: float) -> Float[np.ndarray, "3 2n"]:
    """Return the derivative of the last pose of a reference in its wheel speeds, period by period
    (right, left), in m/(m/s) and rad/(m/s)."""
    dt = reference.dt
    speed = reference.wheels.mean(axis=1)
    turn = np.diff(reference.poses[:, 2])
    half = turn / 2.0
    sinc = np.sinc(half / np.pi)
    is_small = np.abs(half) < SERIES_END
    safe = np.where(is_small, 1.0, half)
    change = np.where(is_small, -half / 3.0, (np.cos(safe) - np.sin(safe) / safe) / safe)
    ahead = np.exp(1j * (reference.poses[:-1, 2] + half))
    places = reference.poses[:, :2] @ np.array([1.0, 1.0j])
    by_speed = dt * sinc * ahead
    # A turn moves its own chord, and swings all that comes after it.
    by_turn = dt * speed * ahead * (change + 1j * sinc) / 2.0 + 1j * (places[-1] - places[1:])
    turn_rate = dt / track_width
    columns = np.stack([by_speed / 2.0 + turn_rate * by_turn, by_speed / 2.0 - turn_rate * by_turn])
    headings = np.broadcast_to(turn_rate * np.array([[1.0], [-1.0]]), columns.shape)
    return np.stack([part.T.ravel() for part in (np.real(columns), np.imag(columns), headings)])
