"""Speed along a curve that keeps both wheels in their box and within their acceleration.

The wheels run v q with q = 1 +- kappa b / 2. With x = v^2 over the arc length s and u = v dv/ds,

    least^2 <= x q^2 <= greatest^2        |u q + x dq/ds| <= a        x_{i+1} = x_i + 2 ds u_i

are linear in (x, u). Backwards along the curve: the speeds from which the end can still be
reached; forwards: of those the one nearest to the speed that is wanted. Where none is left, no
speed whatever keeps the limits.

Source: Pham, Pham 2018, A new approach to time-optimal path parameterization based on reachability
analysis, algorithm 1; the wheels are new.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

SLOWEST = 1e-3
"""Speed in m/s that a reference does not go below: it moves."""


NOTHING = 1e-9
"""Share of the speed at which a wheel counts as standing."""

ROUNDING = 1e-9
"""Share by which bounds that are equal may cross."""

LAPS = 3
"""Laps after which a closed profile repeats itself."""


class WheelLimits(NamedTuple):
    """What reference wheels may do: speeds between `least` and `greatest` m/s, `acceleration` m/s^2
    at most either way, None for no limit; `track_width` m between them."""

    least: float
    greatest: float
    acceleration: float | None
    track_width: float

    @property
    def sharpest_curvature(self) -> float:
        """Greatest curvature for which both wheels keep their speeds, 1/m.

        With a least speed above 0 the inner wheel cannot slow down as the outer one speeds up.
        """
        if self.least <= 0.0:
            return np.inf
        share = (self.greatest - self.least) / (self.greatest + self.least)
        return 2.0 * share / self.track_width

    def shrink(self, margin: float, acceleration_margin: float) -> WheelLimits:
        """Return limits with a margin (m/s, m/s^2) taken off."""
        acceleration = self.acceleration
        if acceleration is not None:
            acceleration = max(acceleration - acceleration_margin, 0.0)
        return WheelLimits(
            self.least + margin, self.greatest - margin, acceleration, self.track_width
        )


class NoSpeedError(Exception):
    """No speed keeps the wheels' limits at an arc length `at`, m."""

    def __init__(self, at: float):
        super().__init__(at)
        self.at = at


@dataclass(frozen=True, eq=False)
class SpeedProfile:
    """Speed over arc length and time; between the points of the grid it changes at a constant rate.

    Attributes:
        lengths: arc lengths, m, from 0.
        speeds: m/s.
        times: s, from 0.
    """

    lengths: Float[np.ndarray, " n"]
    speeds: Float[np.ndarray, " n"]
    times: Float[np.ndarray, " n"]

    @property
    def duration(self) -> float:
        """Time to the end, s; of one lap of a closed curve."""
        return float(self.times[-1])

    def lengths_at(self, times: Float[np.ndarray, " k"]) -> Float[np.ndarray, " k"]:
        """Return the arc lengths reached at times; beyond the end laps follow upon laps."""
        laps = np.floor(times / self.duration)
        within = times - laps * self.duration
        place = np.clip(np.searchsorted(self.times, within, "right") - 1, 0, len(self.times) - 2)
        since = within - self.times[place]
        rate = np.diff(self.speeds)[place] / np.diff(self.times)[place]
        inside = self.lengths[place] + since * (self.speeds[place] + rate * since / 2.0)
        return inside + laps * self.lengths[-1]


def make_profile(
    lengths: Float[np.ndarray, " n"],
    curvature: Float[np.ndarray, " n"],
    curvature_change: Float[np.ndarray, " n"],
    wanted: Float[np.ndarray, " n"],
    limits: WheelLimits,
    closed: bool,
) -> SpeedProfile:
    """Return a profile that keeps the limits, as near to the wanted speeds as they allow.

    Args:
        lengths: of the grid, m, from 0.
        curvature: 1/m.
        curvature_change: its derivative by arc length, 1/m^2.
        wanted: speeds, m/s.
        limits: of the wheels.
        closed: whether the profile ends with the speed it begins with.

    Raises:
        NoSpeedError: where no speed keeps the limits.
    """
    half = limits.track_width / 2.0
    shares = 1.0 + half * np.outer(curvature, [1.0, -1.0])
    least, greatest = _bound_speeds(shares, limits)
    empty = np.flatnonzero(least > greatest)
    if empty.size:
        worst = empty[np.argmax((least - greatest)[empty])]
        raise NoSpeedError(float(lengths[worst]))
    if limits.acceleration is None:
        return _time(lengths, np.clip(wanted, least, greatest))
    changes = half * np.outer(curvature_change, [1.0, -1.0])
    grid = _Grid(lengths, _rate_lines(shares, changes, limits.acceleration), least**2, greatest**2)
    last = (grid.low[-1], grid.high[-1])
    reachable = _look_back(grid, last)
    if closed:
        for _ in range(LAPS):
            reachable = _look_back(grid, (reachable[0, 0], reachable[0, 1]))
    squares = _drive(grid, reachable, wanted**2, float(wanted[0]) ** 2)
    if closed:
        for _ in range(LAPS):
            squares = _drive(grid, reachable, wanted**2, float(squares[-1]))
    return _time(lengths, np.sqrt(squares))


class _Grid(NamedTuple):
    """The limits at each point of a grid.

    Attributes:
        lengths: arc lengths, m.
        lines: (a, b, c): a - c x <= u <= b - c x, for either wheel.
        low: least x.
        high: greatest x.
    """

    lengths: Float[np.ndarray, " n"]
    lines: Float[np.ndarray, "n 2 3"]
    low: Float[np.ndarray, " n"]
    high: Float[np.ndarray, " n"]


def _bound_speeds(
    shares: Float[np.ndarray, "n 2"], limits: WheelLimits
) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"]]:
    """Return the least and the greatest speeds at which both wheels are in their box, m/s."""
    safe = np.where(np.abs(shares) > NOTHING, shares, NOTHING)
    ends = np.stack([limits.least / safe, limits.greatest / safe])
    least = np.maximum(ends.min(axis=0).max(axis=1), SLOWEST)
    greatest = ends.max(axis=0).min(axis=1)
    # Rounding must not close a box that is as wide as the path asks for.
    is_even = (least > greatest) & (least <= greatest * (1.0 + ROUNDING))
    return np.where(is_even, greatest, least), greatest


def _rate_lines(
    shares: Float[np.ndarray, "n 2"], changes: Float[np.ndarray, "n 2"], acceleration: float
) -> Float[np.ndarray, "n 2 3"]:
    """Return the bounds |u q + x dq/ds| <= a as lines of u over x."""
    safe = np.where(np.abs(shares) > NOTHING, shares, NOTHING)
    reach = acceleration / np.abs(safe)
    return np.stack([-reach, reach, changes / safe], axis=-1)


def _look_back(grid: _Grid, last: tuple[float, float]) -> Float[np.ndarray, "n 2"]:
    """Return the interval of x at each point from which x can end in the last one."""
    reachable = np.empty((len(grid.lengths), 2))
    reachable[-1] = last
    low, high = last
    steps = 2.0 * np.diff(grid.lengths)
    for place in range(len(steps) - 1, -1, -1):
        step = float(steps[place])
        # The next x lies in its interval: another line, of slope 1 / step.
        lines = [*grid.lines[place].tolist(), (low / step, high / step, 1.0 / step)]
        low = float(grid.low[place])
        high = float(grid.high[place])
        for lower, _, lower_slope in lines:
            for _, upper, upper_slope in lines:
                # lower - lower_slope x <= upper - upper_slope x
                slope = upper_slope - lower_slope
                if slope > 0.0:
                    high = min(high, (upper - lower) / slope)
                elif slope < 0.0:
                    low = max(low, (upper - lower) / slope)
        if low > high * (1.0 + ROUNDING):
            raise NoSpeedError(float(grid.lengths[place]))
        low = min(low, high)
        reachable[place] = (low, high)
    return reachable


def _drive(
    grid: _Grid,
    reachable: Float[np.ndarray, "n 2"],
    wanted: Float[np.ndarray, " n"],
    start: float,
) -> Float[np.ndarray, " n"]:
    """Return x along the grid, from a start on, as near to the wanted as can be."""
    squares = np.empty(len(wanted))
    x = min(max(start, reachable[0, 0]), reachable[0, 1])
    squares[0] = x
    steps = 2.0 * np.diff(grid.lengths)
    for place, step in enumerate(steps.tolist()):
        lines = grid.lines[place].tolist()
        low = x + step * max(lower - slope * x for lower, _, slope in lines)
        high = x + step * min(upper - slope * x for _, upper, slope in lines)
        low = max(low, float(reachable[place + 1, 0]))
        high = max(min(high, float(reachable[place + 1, 1])), low)
        x = min(max(float(wanted[place + 1]), low), high)
        squares[place + 1] = x
    return squares


def _time(lengths: Float[np.ndarray, " n"], speeds: Float[np.ndarray, " n"]) -> SpeedProfile:
    """Return the profile of speeds, each change at a constant rate."""
    durations = 2.0 * np.diff(lengths) / (speeds[:-1] + speeds[1:])
    return SpeedProfile(lengths, speeds, np.append(0.0, np.cumsum(durations)))
