"""Laws of the search for a border, on ratios that are known: what is bracketed, how narrowly, in
how few attempts; and where there is none."""

import math

import pytest

from jaxtube.synthesis.attempt import Attempt
from jaxtube.synthesis.border import (
    FARTHEST,
    Border,
    find_border,
    find_certified,
    find_nearest_certified,
)

PRECISION = math.log(1.01)
FEW = 9


def make_asker(level, holds=None, asked=None):
    """Return what attempts a factor whose logarithm has a known level of the ratio's logarithm."""

    def ask(factor, near) -> Attempt:
        place = math.log(factor)
        height = level(place)
        held = height <= 0 if holds is None else holds(place)
        if asked is not None:
            asked.append((place, near))
        return Attempt(factor, factor, math.exp(height), height, "row", (place,), held)

    return ask


def bracket_of(border: Border) -> tuple[float, float]:
    assert border.best is not None and border.beyond is not None
    return math.log(border.best.factor), math.log(border.beyond.factor)


LEVELS = {
    "proportional": lambda place: place - 0.3,
    "below the scenario": lambda place: place + 1.2,
    "flat, then steep": lambda place: -0.5 + 0.02 * place + math.exp(8 * (place - 0.4)),
    "steep, then flat": lambda place: math.tanh(6 * (place - 0.8)),
    "steps": lambda place: 0.2 * math.floor(8 * place) - 0.5,
}


@pytest.mark.parametrize("name", LEVELS)
@pytest.mark.parametrize("easier", [-1, 1])
def test_the_border_is_bracketed_narrowly_in_few_attempts(name, easier):
    def level(place):
        return LEVELS[name](-easier * place)

    border = find_border(make_asker(level), easier, PRECISION)
    held, denied = bracket_of(border)
    assert level(held) <= 0 < level(denied)
    assert 0 < -easier * (denied - held) <= PRECISION * (1 + 1e-9)
    assert len(border.attempts) <= 2 * FEW
    places = [-easier * math.log(attempt.factor) for attempt in border.attempts]
    assert places == sorted(places)


def test_a_certificate_that_fails_before_the_ratio_does_is_found_by_halving():
    ask = make_asker(lambda place: place - 1.0, lambda place: place <= 0.6)
    held, denied = bracket_of(find_border(ask, -1, PRECISION))
    assert held <= 0.6 < denied <= held + PRECISION * (1 + 1e-9)


def test_where_easier_is_no_better_the_search_ends_without_a_border():
    """Noise takes over at low speeds: the ratio has a least value above 1."""
    ask = make_asker(lambda place: 0.3 + (place + 0.5) ** 2)
    border = find_border(ask, -1, PRECISION)
    assert border.best is None
    assert len(border.attempts) <= FEW
    flat = find_border(make_asker(lambda place: 0.3), -1, PRECISION)
    assert flat.best is None and len(flat.attempts) == 3


def test_where_slower_is_harder_the_search_looks_the_other_way():
    """Wheels that must not be slow: what holds lies beyond the scenario."""
    ask = make_asker(lambda place: max(place - 0.9, 0.5 - place))
    held, denied = bracket_of(find_border(ask, -1, PRECISION))
    assert 0.5 <= held <= 0.9 < denied <= held + PRECISION * (1 + 1e-9)


def test_where_everything_holds_the_search_ends_as_far_as_it_goes():
    border = find_border(make_asker(lambda place: -1.0), -1, PRECISION)
    assert border.beyond is None and border.best is not None
    assert math.log(border.best.factor) == pytest.approx(FARTHEST)


def test_each_attempt_starts_from_the_closest_certified_one():
    asked = []
    find_border(make_asker(lambda place: place - 0.3, asked=asked), -1, PRECISION, near=(9.0,))
    assert asked[0] == (0.0, (9.0,))
    tried = [asked[0][0]]
    for place, near in asked[1:]:
        certified = [other for other in tried if other <= 0.3]
        assert near == (min(certified, key=lambda other: abs(other - place)),)
        tried.append(place)


def test_a_quick_search_ends_at_what_is_certified_or_with_nothing():
    search = make_asker(lambda place: place - 0.5)
    late = make_asker(lambda place: place - 0.5, lambda place: place <= 0.42)
    found = find_certified(search, late, -1, 0.02, 1.0, None)
    assert found is not None and 0.35 < math.log(found.factor) <= 0.42
    never = make_asker(lambda place: place - 0.5, lambda place: False)
    assert find_certified(search, never, -1, 0.02, 1.0, None) is None
    assert find_certified(make_asker(lambda place: 1.0), late, -1, 0.02, 1.0, None) is None


@pytest.mark.parametrize("easier", [-1, 1])
@pytest.mark.parametrize(("low", "high"), [(0.1, 0.7), (-0.7, -0.1)])
def test_what_holds_on_either_side_is_found_where_it_is_nearest(easier, low, high):
    """A speed may be too low, as wheels must not stand, or too high."""

    def level(place):
        return max(low - place, place - high)

    ask = make_asker(level)
    found = find_nearest_certified(ask, ask, easier, 0.01, 1.0, None)
    assert found is not None
    distance = abs(math.log(found.factor))
    assert 0.1 <= distance <= 0.11


def test_nothing_nearest_is_told_where_nothing_holds():
    ask = make_asker(lambda place: 1.0)
    assert find_nearest_certified(ask, ask, -1, 0.02, 1.0, None) is None
