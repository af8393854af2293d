"""How far the wheels' true travel strays from what a nominal lag and delay let expect.

By superposition over the steps d_j = c_j - c_{j-1} of its commands a wheel travels more in period k
than the nominal one by

    sum_i d_{k-i} A_i,      A_i = [G((i + 1) T - D) - G(i T - D)] - [the same, nominal]

with G of `sets.robot.actuation`. In tau and in D every difference of G at two times falls, and A_i
keeps one sign where only one of the two differs from its nominal value. Then with steps of at most
`change` and speeds in a range of width `span`

    |sum| <= change sum |A_i| = change |tau - tau_0|,       |sum| <= span max |A_i|

the latter because A_i, averages over periods of the unimodal e^{-t / tau} - e^{-t / tau_0}, are
unimodal in i and so vary by 2 max |A_i| in all. What holds of a wheel holds of the body's speed and
yaw rate, for both wheels have the same lag and delay.

Source: new.
"""

from __future__ import annotations

from functools import lru_cache
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from sets.robot.actuation import FORGOTTEN, Actuation, Nominal, step_travel

LAG_CELLS = 128
"""Pieces into which the interval of the lag is cut on either side of the nominal one."""
TIME_CELLS = 32
"""Pieces into which a period is cut."""
OUTWARDS = 1 + 1e-12
"""Factor that covers the rounding of sums of up to a thousand terms of size 1."""
WHOLE = np.ones(1)
"""The share of a period that is all of it."""


class UnknownTravel(NamedTuple):
    """Bounds of what an unknown lag and delay add to travel within a period, of each signal that
    wheels follow; m, or rad where the signal is a yaw rate.

    Attributes:
        total: over the whole period.
        variation: up and down.
        unevenness: at any time, beside the share of the whole that would have come by then at a
            constant speed.
    """

    total: Float[np.ndarray, " signals"]
    variation: Float[np.ndarray, " signals"]
    unevenness: Float[np.ndarray, " signals"]


class _Shares(NamedTuple):
    """What lag and delay do within a period, s: per change of a signal from one command to the
    next, and per width of its range."""

    total_of_change: float
    total_of_span: float
    variation_of_span: float
    uneven: float
    late: float


def bound_unknown_travel(
    actuation: Actuation,
    dt: float,
    span: Float[np.ndarray, " signals"],
    change: Float[np.ndarray, " signals"],
) -> UnknownTravel:
    """Bound what the unknown parts of lag and delay do.

    Args:
        actuation: what is known.
        dt: period, s.
        span: width of the range of each signal that is commanded, m/s or rad/s.
        change: greatest difference of it from one command to the next.
    """
    shares = _find_shares(actuation, dt)
    change = np.minimum(change, span)
    of_change = shares.total_of_change * change
    late = shares.late * change
    return UnknownTravel(
        total=OUTWARDS * (np.minimum(of_change, shares.total_of_span * span) + late),
        variation=OUTWARDS * (np.minimum(of_change, shares.variation_of_span * span) + late),
        unevenness=OUTWARDS * (shares.uneven * change + late),
    )


@lru_cache(maxsize=64)
def _find_shares(actuation: Actuation, dt: float) -> _Shares:
    """Return the shares of the lag, where every command comes after the nominal delay, and of the
    delay."""
    nominal = actuation.nominal(dt)
    count = _count_blocks(actuation, dt)
    shares = _Shares(0.0, 0.0, 0.0, 0.0, _sum_late_shares(actuation, dt))
    for end in set(actuation.lag) - {nominal.lag}:
        blocks = _block_travel(end, nominal.delay, dt, count)
        blocks = blocks - _block_travel(nominal.lag, nominal.delay, dt, count)
        of_end = _Shares(
            total_of_change=abs(end - nominal.lag),
            total_of_span=float(np.abs(blocks).max()),
            variation_of_span=dt * _greatest_gap(end, nominal.lag),
            uneven=_sum_uneven_shares(end, nominal, dt, count),
            late=0.0,
        )
        shares = _Shares(*map(max, shares, of_end))
    return shares


def _count_blocks(actuation: Actuation, dt: float) -> int:
    """Return after how many periods every step is done but for its rounding."""
    return int(np.ceil((FORGOTTEN * actuation.lag[1] + actuation.delay[1]) / dt)) + 2


def _block_travel(
    lag: float, delay: float, dt: float, count: int, shares: Float[np.ndarray, " shares"] = WHOLE
) -> Float[np.ndarray, "shares blocks"]:
    """Return the travel that a unit step brings within shares of each of the first periods, m."""
    begin = dt * np.arange(count)
    end = begin + dt * shares[:, None]
    return step_travel(end - delay, lag) - step_travel(begin - delay, lag)


def _greatest_gap(lag: float, other: float) -> float:
    """Return the greatest difference of e^{-t / tau} between two lags."""
    if min(lag, other) == 0:
        return 1.0
    time = np.log(lag / other) * lag * other / (lag - other)
    return float(abs(np.exp(-time / lag) - np.exp(-time / other)))


def _sum_uneven_shares(end: float, nominal: Nominal, dt: float, count: int) -> float:
    """Bound sum_i |A_i(f T) - f A_i| over all shares f of a period and all lags from the nominal
    one to an end.

    A_i falls with the lag and is monotone in f: its values at the corners of a cell of both enclose
    it.
    """
    shares = np.linspace(0.0, 1.0, TIME_CELLS + 1)
    lags = np.linspace(nominal.lag, end, LAG_CELLS + 1)
    travel = np.stack([_block_travel(lag, nominal.delay, dt, count, shares) for lag in lags])
    extra = travel - travel[0]
    even = extra[:, -1:, :] * shares[:, None]
    corners = np.stack([_corners(extra), _corners(even)])
    most = corners.max(axis=1)
    least = corners.min(axis=1)
    uneven = np.maximum(most[0] - least[1], most[1] - least[0])
    return float(uneven.sum(axis=-1).max())


def _corners(values: Float[np.ndarray, "a b blocks"]) -> Float[np.ndarray, "4 a-1 b-1 blocks"]:
    """Return the values at the four corners of every cell of a grid."""
    low = values[:-1]
    high = values[1:]
    return np.stack([low[:, :-1], low[:, 1:], high[:, :-1], high[:, 1:]])


def _sum_late_shares(actuation: Actuation, dt: float) -> float:
    """Bound sum_i max |A_i| over all delays of every command and all lags, the lag being known.

    What comes early and what comes late add up to half the width of the interval each; a period may
    have some of both.
    """
    delay = actuation.nominal(dt).delay
    count = _count_blocks(actuation, dt)
    lags = np.linspace(*actuation.lag, LAG_CELLS + 1)
    if actuation.lag[0] == actuation.lag[1]:
        lags = lags[:2]
    of_lag = [
        [
            _block_travel(lag, when, dt, count)[0]
            for when in (actuation.delay[0], delay, actuation.delay[1])
        ]
        for lag in lags
    ]
    early, middle, late = np.moveaxis(np.array(of_lag), 1, 0)
    sooner = early[:-1] - middle[1:]
    later = middle[:-1] - late[1:]
    together = np.maximum(sooner, later).sum(axis=1).max()
    return float(min(together, actuation.delay[1] - actuation.delay[0]))
