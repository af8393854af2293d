"""What unknown lag and delay add to travel, enclosed on integers.

The bounds of `sets.robot.unknown_travel` once more. A unit step that arrived x ago moves a wheel at
the speed 1 - e^{-x / tau}; against the nominal lag it takes from the wheel

    phi(x) = e^{-x / tau} - e^{-x / tau_0},    tau > tau_0 (else its opposite)

at the time x, which is never negative, rises and then falls, and grows with tau. Let A_i(f) be its
integral over the first f T of the i-th period after the step, A_i = A_i(1). Then

* sum A_i = |tau - tau_0|, the area below phi: so much per greatest step;
* of commands in a range of width 1, with steps c_i - c_{i-1}, it is half the variation of the A_i,
  hence max A_i, for averages of a function with one peak have one peak; and so at every time,
  max phi;
* beside a constant speed, sum |A_i(f) - f A_i| per greatest step, both terms of a difference
  growing with tau and f: where these lie in a cell, between what they are at its ends.

A delay that is wrong moves the same speeds in time. Per step, travel of a period that came too
early or too late lies between 0 and its own total; both together are at most the width of the
delays.
Steps after the last period that is summed up add less than the area that they have left.

Source: new.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from fractions import Fraction
from functools import lru_cache
from itertools import pairwise
from math import atanh, ceil
from typing import NamedTuple

import numpy as np

from sets.exact import Row
from sets.exact_interval import ExactInterval, decay, enclose_numbers
from sets.robot.actuation import Actuation

LAG_CELLS = 128
"""Cells of the lag."""
SHARES = tuple(Fraction(cell, 32) for cell in range(33))
"""Ends of the cells of a period."""
FORGOTTEN = 40
"""Time constants for which steps are summed up."""
PEAK_SHARE = Fraction(1, 2**40)
"""Relative distance of the times between which the peak of phi is proved to lie, from its float."""


class Taken(NamedTuple):
    """What unknown lag and delay do to signals, m or rad: in a period, up and down, and beside
    travel at constant speed."""

    total: ExactInterval
    variation: ExactInterval
    unevenness: ExactInterval


class _Shares(NamedTuple):
    """Per greatest step, or per width of the range of commands: see `Taken`."""

    total_of_step: ExactInterval
    total_of_width: ExactInterval
    variation_of_width: ExactInterval
    uneven: ExactInterval


def enclose_taken(actuation: Actuation, dt: float, widths: Row, steps: Row | None) -> Taken:
    """Enclose the bounds of what unknown lag and delay take from travel within a period.

    Args:
        actuation: what is known.
        dt: period, s.
        widths: of the ranges of commanded signals, m/s or rad/s.
        steps: their greatest changes from one command to the next; None for no limit.

    Raises:
        ValueError: where two lags are too near each other to be told apart.
    """
    shares, late = _find_shares(actuation, dt)
    steps = widths if steps is None else tuple(map(min, steps, widths))
    step = enclose_numbers(steps)
    width = enclose_numbers(widths)
    of_step = shares.total_of_step * step
    total = find_smallest(of_step, shares.total_of_width * width)
    variation = find_smallest(of_step, shares.variation_of_width * width)
    moved = late * step
    return Taken(total + moved, variation + moved, shares.uneven * step + moved)


def find_largest(*values: ExactInterval) -> ExactInterval:
    """Return the larger of each of several numbers."""
    return ExactInterval(
        np.maximum.reduce([value.lower for value in values]),
        np.maximum.reduce([value.upper for value in values]),
    )


def find_smallest(*values: ExactInterval) -> ExactInterval:
    """Return the smaller of each of several numbers."""
    return -find_largest(*(-value for value in values))


def enclose_one(number: float | Fraction) -> ExactInterval:
    """Return a number as an array of one interval."""
    return enclose_numbers([number])


def fade(time: Fraction, *lags: Fraction) -> ExactInterval:
    """Enclose e^{-t / tau} for several lags, the share of a step still to be made up."""
    value = decay(enclose_numbers([time / lag if lag else 0 for lag in lags]))
    lasts = [lag > 0 for lag in lags]
    return ExactInterval(np.where(lasts, value.lower, 0), np.where(lasts, value.upper, 0))


def enclose_travel(time: Fraction, *lags: Fraction) -> ExactInterval:
    """Enclose the travel since a unit step arrived for several lags, time not negative."""
    return time - (1 - fade(time, *lags)) * enclose_numbers(lags)


@lru_cache(maxsize=16)
def _find_shares(actuation: Actuation, dt: float) -> tuple[_Shares, ExactInterval]:
    """Return the shares of the lag under the nominal delay, and per greatest step that of the delay
    under any lag."""
    lag, delay = map(Fraction, actuation.nominal(dt))
    ends = {Fraction(end) for end in actuation.lag} - {lag}
    each = [_find_shares_of_end(actuation, Fraction(dt), lag, end, delay) for end in ends]
    each.append(_Shares(*[enclose_one(0)] * 4))
    shares = _Shares(*(find_largest(*values) for values in zip(*each, strict=True)))
    return shares, _sum_late(actuation, Fraction(dt), delay)


def _count_periods(actuation: Actuation, dt: Fraction) -> int:
    return ceil((FORGOTTEN * Fraction(actuation.lag[1]) + Fraction(actuation.delay[1])) / dt) + 1


def _find_shares_of_end(
    actuation: Actuation, dt: Fraction, lag: Fraction, end: Fraction, delay: Fraction
) -> _Shares:
    """Return the shares of all lags from the nominal one to an end of their interval."""
    lags = [lag + (end - lag) * cell / LAG_CELLS for cell in range(LAG_CELLS + 1)]
    arrives = delay % dt
    count = _count_periods(actuation, dt)
    ahead = _enclose_ahead(lags, -arrives % dt, dt, count)
    taken = (_enclose_taken_by(lags, ahead, arrives, share * dt) for share in SHARES)
    whole = _enclose_taken_by(lags, ahead, arrives, dt)
    left = take(ahead, np.s_[-1:, -1]) - take(ahead, np.s_[:1, -1])
    left = find_largest(left, -left)
    return _Shares(
        total_of_step=enclose_one(abs(end - lag)),
        total_of_width=find_largest(_reduce(np.maximum, take(whole, np.s_[-1:]), 1), left),
        variation_of_width=_enclose_peak(lag, end) * dt,
        uneven=_sum_uneven(taken, whole) + left,
    )


def _enclose_ahead(
    lags: Sequence[Fraction], first: Fraction, dt: Fraction, count: int
) -> ExactInterval:
    """Enclose the travel of a unit step still to come, tau e^{-x / tau}, by lag and x = first + i T
    with i up to count."""
    missing = fade(first, *lags) * enclose_numbers(lags)
    ratio = fade(dt, *lags)
    columns = [missing]
    for _ in range(count):
        columns.append(columns[-1] * ratio)
    return _stack_columns(columns)


def _enclose_taken_by(
    lags: Sequence[Fraction], ahead: ExactInterval, arrives: Fraction, time: Fraction
) -> ExactInterval:
    """Enclose |A_i| up to a time of each period, by lag and period: first that in which the step
    arrives, if it does so after it began, then the others."""
    made = 1 - fade(time, *lags)
    columns = ExactInterval(made.lower[:, None], made.upper[:, None])
    later = take(ahead, np.s_[:, :-1]) * columns
    since = max(time - arrives, Fraction(0))
    first = -enclose_travel(since, *lags)
    taken = _stack_columns([first]) if arrives else take(later, np.s_[:, :0])
    taken = ExactInterval(
        np.hstack([taken.lower, later.lower]), np.hstack([taken.upper, later.upper])
    )
    more = taken - take(taken, np.s_[:1])
    return more if lags[-1] > lags[0] else -more


def _sum_uneven(taken: Iterable[ExactInterval], whole: ExactInterval) -> ExactInterval:
    """Return the greatest sum of |A_i(f) - f A_i| from |A_i(f)| by share f, and |A_i|: each by lag
    and period."""
    worst = enclose_one(0)
    nearer = np.s_[:-1]
    farther = np.s_[1:]
    for (least, most), (before, after) in zip(pairwise(SHARES), pairwise(taken), strict=True):
        more = take(after, farther) - take(whole, nearer) * least
        less = take(whole, farther) * most - take(before, nearer)
        sums = _reduce(np.add, find_largest(more, less), 1)
        worst = find_largest(worst, _reduce(np.maximum, sums, 0, keepdims=True))
    return worst


def _enclose_peak(lag: Fraction, other: Fraction) -> ExactInterval:
    """Enclose the peak of phi for two lags.

    It lies where e^{-x / a} / a and e^{-x / b} / b are equal, at x = ln(a / b) a b / (a - b); up to
    twice that phi is concave, and so stays below its tangents.
    """
    small, large = sorted((lag, other))
    if small == 0:
        return enclose_one(1)
    z = (large - small) / (large + small)
    about = Fraction(2 * float(large * small / (large + small)) * atanh(float(z)) / float(z))
    before = about * (1 - PEAK_SHARE)
    after = about * (1 + PEAK_SHARE)
    slope = _slope_of_peak(before, small, large)
    if not (slope.lower[0] > 0 and _slope_of_peak(after, small, large).upper[0] < 0):
        raise ValueError(f"lags of {float(small)} s and {float(large)} s cannot be told apart")
    value = fade(before, large) - fade(before, small)
    highest = value + slope * (after - before)
    return ExactInterval(value.lower, highest.upper)


def _slope_of_peak(time: Fraction, small: Fraction, large: Fraction) -> ExactInterval:
    return fade(time, small) * (1 / small) - fade(time, large) * (1 / large)


def _sum_late(actuation: Actuation, dt: Fraction, delay: Fraction) -> ExactInterval:
    """Return what delays do per greatest step, in cells of the lag, of which travel falls."""
    earliest, latest = map(Fraction, actuation.delay)
    width = latest - earliest
    if width == 0:
        return enclose_one(0)
    least, most = map(Fraction, actuation.lag)
    cells = LAG_CELLS if least < most else 1
    lags = [least + (most - least) * cell / cells for cell in range(cells + 1)]
    count = _count_periods(actuation, dt)
    early = _difference(_enclose_travels(lags, -earliest, dt, count))
    middle = _difference(_enclose_travels(lags, -delay, dt, count))
    late = _difference(_enclose_travels(lags, -latest, dt, count))
    sooner = take(early, slice(-1)) - take(middle, slice(1, None))
    later = take(middle, slice(-1)) - take(late, slice(1, None))
    sums = _reduce(np.add, find_largest(sooner, later), 1)
    left = width * fade(count * dt - latest, most)
    together = _reduce(np.maximum, sums, 0, keepdims=True) + left
    return find_smallest(together, enclose_one(width))


def _enclose_travels(
    lags: Sequence[Fraction], first: Fraction, step: Fraction, count: int
) -> ExactInterval:
    """Enclose the travel since a unit step by lag and by time, first + k step with k up to count; 0
    where that is negative."""
    times = [first + k * step for k in range(count + 1)]
    after = [time for time in times if time >= 0]
    lag = enclose_numbers(lags)
    missing = fade(after[0], *lags)
    ratio = fade(step, *lags)
    columns = [lag * 0] * (len(times) - len(after))
    for time in after:
        columns.append(time - lag + lag * missing)
        missing = missing * ratio
    return _stack_columns(columns)


def _stack_columns(columns: Sequence[ExactInterval]) -> ExactInterval:
    return ExactInterval(
        np.stack([column.lower for column in columns], axis=1),
        np.stack([column.upper for column in columns], axis=1),
    )


def take(values: ExactInterval, index) -> ExactInterval:
    """Return some of several numbers."""
    return ExactInterval(values.lower[index], values.upper[index])


def _difference(values: ExactInterval) -> ExactInterval:
    return take(values, np.s_[:, 1:]) - take(values, np.s_[:, :-1])


def _reduce(operation: np.ufunc, values: ExactInterval, axis: int, **options) -> ExactInterval:
    return ExactInterval(
        operation.reduce(values.lower, axis=axis, **options),
        operation.reduce(values.upper, axis=axis, **options),
    )
