"""Rounds of what is compared, one after the other: A B C A B C ..., so that a machine that slows
down slows all of them.

What is counted is the processor's time of the process: it has one core, and what other processes do
on that core is not counted.

Source: new.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

Seconds = dict[str, Float[np.ndarray, " rounds"]]


class Spread(NamedTuple):
    """Median and quartiles of what was measured in several rounds."""

    median: float
    low: float
    high: float

    def __str__(self) -> str:
        """The median with its quartiles, such as 24.1 [23.8, 24.6]."""
        middle, low, high = map(write_number, self)
        return f"{middle} [{low}, {high}]"


def write_number(value: float, digits: int = 3) -> str:
    """Return a number with so many digits at least, without an exponent from 0.001 to 10
    million."""
    if not 1e-3 <= abs(value) < 1e7:
        return f"{value:.{digits}g}"
    whole = len(str(int(abs(value)))) if abs(value) >= 1 else 0
    return f"{value:,.{max(digits - whole, 0)}f}"


def spread(values: Float[np.ndarray, " rounds"]) -> Spread:
    """Return median and quartiles."""
    low, median, high = np.percentile(values, [25, 50, 75])
    return Spread(float(median), float(low), float(high))


class OwnClock:
    """Passes over programs by the clock of a solver itself.

    Each program counts at the median of its passes: one at which another process took the core
    would count for a thousand others.
    """

    def __init__(self, clock: Callable[[], Float[np.ndarray, " k"]]):
        """Take what solves all programs and returns the seconds of each."""
        self._clock = clock
        self._passes: list[Float[np.ndarray, " k"]] = []

    def run(self) -> None:
        """Make a pass."""
        self._passes.append(self._clock())

    @property
    def seconds(self) -> Float[np.ndarray, "1"]:
        """Seconds of a program in the mean over all; the first pass warms up."""
        return np.mean(np.median(self._passes[1:], axis=0), keepdims=True)


def time_rounds(
    work: Mapping[str, Callable[[], object]],
    rounds: int,
    tick: Callable[[], object],
    clock: Callable[[], float] = time.process_time,
) -> Seconds:
    """Return the seconds of everything in every round, after a round that is not timed.

    Args:
        work: by name, in the order of a round.
        rounds: how many.
        tick: called after every round.
        clock: tells seconds; `time.perf_counter` for work on several cores.
    """
    for act in work.values():
        act()
    seconds: dict[str, list[float]] = {name: [] for name in work}
    for _ in range(rounds):
        for name, act in work.items():
            start = clock()
            act()
            seconds[name].append(clock() - start)
        tick()
    return {name: np.array(values) for name, values in seconds.items()}
