"""The first level of an imperfection at which laps leave W, and the first at which they violate a
limit.

The level is doubled until laps do both, then the gap below each first level is halved.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from jaxtube.experiments.beyond.laps import LapUsage

DOUBLINGS = 8
HALVINGS = 5


class Imperfection(NamedTuple):
    """One way to be imperfect: levels run from 0 up to `most`, in steps of one where they are
    whole."""

    title: str
    unit: str  # as printed
    key: str  # of a level in metrics.json
    most: float
    whole: bool = False


IMPERFECTIONS = {
    "lag": Imperfection("actuator lag", "s", "lag_s", 1.0),
    "delay": Imperfection("late commands", "periods", "delay_periods", 1.0),
    "sluggishness": Imperfection(
        "limited acceleration, inverse", "s²/m", "inverse_acceleration_s2_per_m", 4.0
    ),
    "sideslip": Imperfection("sideslip, by speed", "m/m", "sideslip_m_per_m", 0.5),
    "slip_change": Imperfection("slip changing in a period", "share", "slip_change_share", 1.0),
    "preview": Imperfection(
        "reference changes off their time", "periods", "preview_shift_periods", np.inf, True
    ),
}


class LevelSearch(NamedTuple):
    """What was found for one imperfection; None where no level up to `most` does it."""

    usages: dict[float, LapUsage]  # by level, increasing
    disturbance: float | None  # first level with a w outside W
    violation: float | None  # first level with a violation
    most: float


def levels(imperfection: Imperfection, horizon: int) -> list[float]:
    """Return the levels to try, from the least to the greatest; whole ones up to the horizon."""
    if imperfection.whole:
        return [float(level) for level in range(1, horizon + 1)]
    return [imperfection.most * 0.5**halved for halved in range(DOUBLINGS, -1, -1)]


def most_tried(levels: list[float], whole: bool) -> int:
    """Return how many levels a search tries at most."""
    return 1 + len(levels) + (0 if whole else 2 * HALVINGS)


def search(usage: Callable[[float], LapUsage], levels: list[float], whole: bool) -> LevelSearch:
    """Find the first level with a w outside W and the first with a violation.

    Args:
        usage: what laps at a level use.
        levels: that are tried, increasing, until one has both.
        whole: nothing lies between two levels.

    Returns:
        Levels that do it, whose next lower one tried does not: 2^-HALVINGS of the last gap apart.
        Where failing is not monotone in the level, one of the places where it begins.
    """
    usages = {0.0: usage(0.0)}
    for level in levels:
        tried = usages.values()
        if any(map(_leaves_disturbance_set, tried)) and any(map(_has_violation, tried)):
            break
        usages[level] = usage(level)
    halvings = 0 if whole else HALVINGS
    disturbance = _refine(usage, usages, _leaves_disturbance_set, halvings)
    violation = _refine(usage, usages, _has_violation, halvings)
    return LevelSearch(dict(sorted(usages.items())), disturbance, violation, levels[-1])


def _leaves_disturbance_set(usage: LapUsage) -> bool:
    return usage.leaves_disturbance_set


def _has_violation(usage: LapUsage) -> bool:
    return bool(usage.violations)


def _refine(
    usage: Callable[[float], LapUsage],
    usages: dict[float, LapUsage],
    fails: Callable[[LapUsage], bool],
    halvings: int,
) -> float | None:
    """Halve the gap below the least level that fails; what is tried is added to `usages`."""
    failing = [level for level, used in usages.items() if fails(used)]
    if not failing or min(failing) == 0.0:
        return min(failing, default=None)
    high = min(failing)
    low = max(level for level in usages if level < high)
    for _ in range(halvings):
        middle = (low + high) / 2
        usages[middle] = usage(middle)
        if fails(usages[middle]):
            high = middle
        else:
            low = middle
    return high
