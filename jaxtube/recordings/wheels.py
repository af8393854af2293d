"""Wheel speeds in m/s from whatever a robot measures: speeds, turn rates, angles, encoder ticks.

Source: new. Mean speeds between two counts belong to the middle of their interval, so that
differencing adds no lag.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from jaxtube.recordings.hints import Hints

COUNTER_SIZES = (2.0**16, 2.0**32)
"""Counts after which usual encoder counters start again."""


class WheelSpeeds(NamedTuple):
    """Speeds of the wheels.

    Attributes:
        time: s, on the clock of the samples.
        speeds: (right, left), m/s.
        guesses: what was changed, a clause each.
    """

    time: Float[np.ndarray, "n"]
    speeds: Float[np.ndarray, "n 2"]
    guesses: tuple[str, ...]


def is_counted(unit: str) -> bool:
    """Say whether a unit is that of a path travelled, of which speeds are differences."""
    return unit in ("ticks", "rad")


def find_wheel_speeds(
    path: str,
    time: Float[np.ndarray, "n"],
    wheels: Float[np.ndarray, "n 2"],
    unit: str,
    hints: Hints,
) -> WheelSpeeds:
    """Return the ground speeds of the rolling wheels.

    Args:
        path: the file, for messages.
        time: of the samples, s, increasing.
        wheels: (right, left) as measured.
        unit: of both; ticks and rad are differenced.
        hints: with the sizes that units need.

    Returns:
        The speeds, at the middles of the intervals where they were differenced.

    Raises:
        ValueError: in one line, for a size that is needed and was not given.
    """
    scale = find_scale(path, unit, hints)
    if not is_counted(unit):
        return WheelSpeeds(time, scale * wheels, ())
    right, right_guesses = _unwrap(wheels[:, 0], unit)
    left, left_guesses = _unwrap(wheels[:, 1], unit)
    travelled = scale * np.column_stack([right, left])
    speeds = np.diff(travelled, axis=0) / np.diff(time)[:, None]
    guesses = tuple(dict.fromkeys((*right_guesses, *left_guesses)))
    return WheelSpeeds((time[:-1] + time[1:]) / 2.0, speeds, guesses)


def find_scale(path: str, unit: str, hints: Hints) -> float:
    """Return the metres, or metres per second, of one unit of a wheel."""
    if unit == "m/s":
        return 1.0
    radius = hints.require_radius(path, f"wheels are in {unit}")
    if unit == "rpm":
        return radius * 2.0 * np.pi / 60.0
    if unit == "ticks":
        return radius * 2.0 * np.pi / hints.require_ticks(path, "wheels are in ticks")
    return radius


def _unwrap(
    counts: Float[np.ndarray, "n"], unit: str
) -> tuple[Float[np.ndarray, "n"], tuple[str, ...]]:
    """Return counts without the jumps of a counter that starts again, and what was found."""
    if unit != "ticks":
        return counts, ()
    span = float(np.ptp(counts))
    size = next((size for size in COUNTER_SIZES if span < size), None)
    if size is None or np.abs(np.diff(counts)).max() <= size / 2.0:
        return counts, ()
    return np.unwrap(counts, period=size), (f"tick counters that start again after {size:.0f}",)
