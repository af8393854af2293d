"""Wheels that lag and commands that come late: how far the wheels' true travel strays from what a
nominal lag and delay let expect.

A command c_k is given at k T, reaches a wheel after a delay D and is followed by a lag tau of first
order, v' = (c - v) / tau. Of a unit step given at 0 the wheel has travelled by the time t

    G(t - D),    G(x) = x - tau (1 - e^{-x / tau}) for x > 0, else 0

so that t - G is still to come, at last D + tau. By superposition over the steps d_j = c_j - c_{j-1}
the wheel travels more in period k than the nominal one by

    sum_i d_{k-i} A_i,      A_i = [G((i + 1) T - D) - G(i T - D)] - [the same, nominal].

The lag is constant over a run, the delay may change from one command to the next. In tau and in D
every difference of G at two times falls, and A_i keeps one sign where only one of the two differs
from its nominal value. Then with steps of at most `change` and speeds in a range of width `span`

    |sum| <= change sum |A_i| = change |tau - tau_0|,       |sum| <= span max |A_i|

the latter because A_i, averages over periods of the unimodal e^{-t / tau} - e^{-t / tau_0}, are
unimodal in i and so vary by 2 max |A_i| in all. The nominal lag has the mean of the two effects
that the ends of its interval have on a period, the nominal delay is the middle.

Source: new; the lag is that of Franklin, Powell, Workman 1998, Digital Control of Dynamic Systems,
section 4.3.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

LAG_CELLS = 128
"""Pieces into which the interval of the lag is cut on either side of the nominal one."""
TIME_CELLS = 32
"""Pieces into which a period is cut."""
BISECTIONS = 60
FORGOTTEN = 37.0
"""Time constants after which e^{-t / tau} is below the rounding of 1."""
OUTWARDS = 1 + 1e-12
"""Factor that covers the rounding of sums of up to a thousand terms of size 1."""
WHOLE = np.ones(1)
"""The share of a period that is all of it."""


@dataclass(frozen=True)
class Actuation:
    """How late wheels do what they are told.

    Attributes:
        lag: least and greatest time constant, s.
        delay: least and greatest time until a command arrives, s.
    """

    lag: tuple[float, float] = (0.0, 0.0)
    delay: tuple[float, float] = (0.0, 0.0)

    def __post_init__(self):
        for name in ("lag", "delay"):
            low, high = getattr(self, name)
            if not 0 <= low <= high < np.inf:
                raise ValueError(
                    f"{name}: [{low}, {high}] s is no interval of times; give [least, greatest]"
                )

    @property
    def is_ideal(self) -> bool:
        """Whether the wheels obey at once."""
        return self.lag[1] == 0 and self.delay[1] == 0

    def nominal(self, dt: float) -> Nominal:
        """Return the lag and the delay that a controller of period dt, s, counts on.

        Raises:
            ValueError: where a command may overtake the one before it.
        """
        low, high = self.delay
        if high - low > dt:
            raise ValueError(
                f"delay: [{low}, {high}] s is wider than the period of {dt} s, so that a command "
                "may overtake the one before it; narrow it or lengthen the period"
            )
        return Nominal(_find_middle_lag(*self.lag, dt), (low + high) / 2)


NO_LAG = Actuation()
"""Wheels that obey at once."""


class Nominal(NamedTuple):
    """The lag and the delay that a controller counts on, s."""

    lag: float
    delay: float

    @property
    def latency(self) -> float:
        """By how much the robot runs behind its commands, s."""
        return self.lag + self.delay


class UnknownTravel(NamedTuple):
    """Bounds of what an unknown lag and delay add to the travel of each wheel within a period, m.

    Attributes:
        total: over the whole period.
        variation: up and down.
        unevenness: at any time, beside the share of the whole that would have come by then at a
            constant speed.
    """

    total: Float[np.ndarray, " wheels"]
    variation: Float[np.ndarray, " wheels"]
    unevenness: Float[np.ndarray, " wheels"]


def held_back(lag: float, dt: float) -> float:
    """Return the share of a step of speed that a wheel at constant command does not yet travel in
    the first period dt, s: tau (1 - e^{-T / tau}) / T."""
    return lag * closed_share(lag, dt) / dt


def _find_middle_lag(least: float, most: float, dt: float) -> float:
    """Return the lag that holds back the mean of what two lags do, by bisection."""
    middle = (held_back(least, dt) + held_back(most, dt)) / 2
    for _ in range(BISECTIONS):
        lag = (least + most) / 2
        if held_back(lag, dt) < middle:
            least = lag
        else:
            most = lag
    return (least + most) / 2


def closed_share(lag: float, time: float) -> float:
    """Return 1 - e^{-t / tau}, what a wheel has made up of a step after some time, s."""
    return float(-np.expm1(-time / lag)) if lag > 0 else 1.0


def step_travel(times: Float[np.ndarray, "..."], lag: float) -> Float[np.ndarray, "..."]:
    """Return G, the travel of a wheel since a unit step arrived, m; 0 before."""
    after = np.maximum(times, 0.0)
    return after + lag * np.expm1(-after / lag) if lag > 0 else after


class _Shares(NamedTuple):
    """What lag and delay do to a wheel's travel in a period, s: per change of its command from one
    period to the next, and per width of the range of commands."""

    total_of_change: float
    total_of_span: float
    variation_of_span: float
    uneven: float
    late: float


def bound_unknown_travel(
    actuation: Actuation,
    dt: float,
    span: Float[np.ndarray, " wheels"],
    change: Float[np.ndarray, " wheels"],
) -> UnknownTravel:
    """Bound what the unknown parts of lag and delay do to the travel of wheels.

    Args:
        actuation: what is known.
        dt: period, s.
        span: width of the range of each wheel's commanded speeds, m/s.
        change: greatest difference of successive commands, m/s.
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
