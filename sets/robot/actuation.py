"""Wheels that lag and commands that come late: what is known of their times, and how a wheel
follows a step.

A command c_k is given at k T, reaches the wheels after a delay D and is followed with a lag tau of
first order, v' = (c - v) / tau. Of a unit step given at 0 a wheel has travelled by the time t

    G(t - D),    G(x) = x - tau (1 - e^{-x / tau}) for x > 0, else 0

so that t - G is still to come, at last D + tau. The lag is constant over a run and the same for
both wheels, the delay may change from one command to the next. The nominal lag has the mean of the
two effects that the ends of its interval have on a period, the nominal delay is the middle.

Source: Franklin, Powell, Workman 1998, Digital Control of Dynamic Systems, section 4.3, for lags;
else new.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

FORGOTTEN = 37.0
"""Time constants after which e^{-t / tau} is below the rounding of 1."""
BISECTIONS = 60
"""Halvings after which the nominal lag is as exact as a float."""


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
