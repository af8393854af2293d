"""The border of what can be certified along one quantity of a scenario: the largest speed, the
smallest limits, the widest slip.

    hardness x = -easier log(factor),    factor of the quantity, `easier` as of its lever

An attempt at x (`synthesis.attempt`) begins with the caps and gains of the nearest one that has
some. Attempts bracket the border: one that holds below, one that does not above. Its place is
predicted from the logarithms of ratios, a secant kept inside the bracket, until the bracket is as
narrow as asked for. Nothing says that no design exists beyond: none was found.

Source: new.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from jaxtube.synthesis.attempt import Attempt

FARTHEST = math.log(32.0)
"""How far from the scenario's own quantity a border is searched, in logarithms."""
FIRST_STEP = math.log(1.25)
"""Step where nothing predicts the border; at most twice as much where something does."""
AIM = math.log(0.995)
"""Logarithm of the ratio that predictions aim at: the estimate is not the last word."""
LEAST_STEP = 0.03
"""Step at least, where a bracket has only one end."""
MOST_ATTEMPTS = 20
"""Attempts at one border at most."""
EASED = (0.0, 0.03, 0.1)
"""Steps from the border of the estimate to what is certified, in logarithms."""
LOOKED_BACK = 2
"""Easiest attempts, one of which has to be the best one for easier ones to be worth it."""
GAINED = 0.01
"""What the logarithm of the ratio gains where another attempt is worth it."""
INSIDE = 0.9
"""Share of the precision that an attempt keeps from the ends of its bracket."""


Ask = Callable[[float, Sequence[float] | None], Attempt]
"""Attempts a factor, from caps and gains nearby."""


@dataclass(frozen=True)
class Border:
    """What attempts say of a border, the easiest first.

    Attributes:
        attempts: all of them.
        best: the hardest one that holds, None where none does.
        beyond: the easiest one that is harder than `best` and does not hold, None where there is
            none as far as was searched.
    """

    attempts: tuple[Attempt, ...]
    best: Attempt | None
    beyond: Attempt | None


def find_border(
    ask: Ask,
    easier: int,
    precision: float,
    first: float = 1.0,
    near: tuple[float, ...] | None = None,
) -> Border:
    """Bracket a border.

    Args:
        ask: makes an attempt.
        easier: as of the lever.
        precision: width of the bracket, in logarithms.
        first: the factor to begin with.
        near: caps and gains for the first attempt.
    """
    place: float | None = -easier * math.log(first)
    attempts: dict[float, Attempt] = {}
    while place is not None and len(attempts) < MOST_ATTEMPTS:
        attempts[place] = ask(math.exp(-easier * place), _find_near(attempts, place) or near)
        place = _find_next(attempts, precision)
    ordered = tuple(attempts[place] for place in sorted(attempts))
    lower, upper = _bracket(attempts)
    return Border(ordered, attempts.get(lower), attempts.get(upper))


def _bracket(attempts: dict[float, Attempt]) -> tuple[float, float]:
    """Return the hardest place that holds and the easiest one beyond that does not; infinite where
    there is none."""
    held = [place for place, attempt in attempts.items() if attempt.holds]
    lower = max(held, default=-math.inf)
    return lower, min((place for place in attempts if place > lower), default=math.inf)


def _find_next(attempts: dict[float, Attempt], precision: float) -> float | None:
    """Return the place to try next, None where the bracket is narrow or the search far."""
    lower, upper = _bracket(attempts)
    if upper - lower <= precision or upper <= -FARTHEST or lower >= FARTHEST:
        return None
    if math.isinf(lower):
        return _step_down(attempts)
    if math.isinf(upper):
        return _step_on(attempts, lower, 1)
    kept = INSIDE * precision
    if upper - lower <= 2 * kept or not _has_halved(attempts):
        return (lower + upper) / 2
    return float(np.clip(_predict(attempts, lower, upper), lower + kept, upper - kept))


def _step_on(attempts: dict[float, Attempt], end: float, direction: int) -> float:
    """Return a place beyond the last one, where the ratio is predicted to be as aimed at, but not
    farther than two steps."""
    places = sorted(attempts)[::direction]
    level = _find_level(attempts[end])
    step = 2 * FIRST_STEP
    if math.isfinite(level) and (level - AIM) * direction < 0:
        slope = 1.0
        if len(places) > 1 and math.isfinite(_find_level(attempts[places[-2]])):
            slope = (level - _find_level(attempts[places[-2]])) / (end - places[-2])
        if slope > 0:
            step = min(max((AIM - level) / slope * direction, LEAST_STEP), step)
    return float(np.clip(end + direction * step, -FARTHEST, FARTHEST))


def _step_down(attempts: dict[float, Attempt]) -> float | None:
    """Return the place to try where none holds: an easier one; where that gains nothing, as
    slower wheels may not, a harder one; None where the least level lies between two others."""
    places = sorted(attempts)
    levels = [_find_level(attempts[place]) for place in places]
    easiest = min(levels[:LOOKED_BACK])
    others = min(levels[LOOKED_BACK:], default=math.inf)
    if easiest < others - GAINED or not math.isfinite(others):
        return _step_on(attempts, places[0], -1)
    if levels[-1] < min(levels[:-1]) - GAINED and places[-1] < FARTHEST:
        return places[-1] + FIRST_STEP
    return None


def _has_halved(attempts: dict[float, Attempt]) -> bool:
    """Whether the last attempt made the bracket half as wide, or was the first within it."""
    *earlier, _ = attempts
    lower, upper = _bracket({place: attempts[place] for place in earlier})
    now = _bracket(attempts)
    return now[1] - now[0] <= (upper - lower) / 2


def _predict(attempts: dict[float, Attempt], lower: float, upper: float) -> float:
    """Return where, between two places, the ratio is expected to be as aimed at: their middle where
    it is not the ratio that says no."""
    levels = [_find_level(attempts[place]) for place in (lower, upper)]
    if not levels[0] < AIM < levels[1] < math.inf:
        return (lower + upper) / 2
    return float(np.interp(AIM, levels, [lower, upper]))


def _find_level(attempt: Attempt) -> float:
    """Return the level of an attempt, infinite where there is none."""
    return math.inf if attempt.level is None else attempt.level


def _find_near(attempts: dict[float, Attempt], place: float) -> tuple[float, ...] | None:
    """Return caps and gains of the attempt closest to a place, those that hold before others."""
    with_caps = [
        (not attempt.holds, abs(other - place), attempt.caps_and_gains)
        for other, attempt in attempts.items()
        if attempt.caps_and_gains is not None
    ]
    return min(with_caps)[2] if with_caps else None


def find_certified(
    search: Ask,
    certify: Ask,
    easier: int,
    precision: float,
    first: float,
    near: tuple[float, ...] | None,
) -> Attempt | None:
    """Return a certified attempt near the border of a quantity, quickly: the border of what the
    estimate lets hold, and from there on what is easier; None where none was found.

    Args:
        search: as `attempt_search`.
        certify: as `attempt_design`.
        easier, precision, first, near: as of `find_border`.
    """
    border = find_border(search, easier, precision, first, near)
    return None if border.best is None else _certify_from(border.best, certify, easier)


def find_nearest_certified(
    search: Ask,
    certify: Ask,
    easier: int,
    precision: float,
    first: float,
    near: tuple[float, ...] | None,
) -> Attempt | None:
    """Return a certified attempt near a factor that does not hold, None where none was found; as
    `find_certified`, which is after the hardest one: that may be far away on the harder side."""
    border = find_border(search, easier, precision, first, near)
    held = [attempt for attempt in border.attempts if attempt.holds]
    if border.best is None or not held:
        return None
    nearest = min(held, key=lambda attempt: abs(math.log(attempt.factor / first)))
    away = 1 if nearest.factor > first else -1
    if nearest is not border.best or away != easier:
        border = find_border(search, away, precision, nearest.factor, nearest.caps_and_gains)
    return _certify_from(border.best or nearest, certify, away)


def _certify_from(best: Attempt, certify: Ask, easier: int) -> Attempt | None:
    """Return the first certified attempt from one that the estimate lets hold on, None where there
    is none nearby."""
    for step in EASED:
        tried = certify(best.factor * math.exp(easier * step), best.caps_and_gains)
        if tried.holds:
            return tried
    return None
