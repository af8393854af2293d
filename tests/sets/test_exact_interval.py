"""Laws of interval arithmetic on integers: it encloses exact numbers, functions of an angle to 70
bits, and functions stay below levels where it says so."""

from fractions import Fraction

import mpmath
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from test_interval import FUNCTIONS, NAMES

from sets.exact_interval import GRID, SERIES_UNITS, ExactInterval, scale_down, scale_up
from sets.exact_supremum import find_room
from sets.interval import QUARTER_TURN, cos, reciprocal, square

PLACES = 2.0**-70
"""Width of what encloses a function at a point."""


def enclose(low, high) -> ExactInterval:
    return ExactInterval(scale_down(np.array(low)), scale_up(np.array(high)))


def ends(interval: ExactInterval) -> tuple[list[Fraction], list[Fraction]]:
    lower = np.atleast_1d(interval.lower)
    upper = np.atleast_1d(interval.upper)
    return [Fraction(int(a), GRID) for a in lower], [Fraction(int(a), GRID) for a in upper]


numbers = st.floats(-4, 4, allow_nan=False)


@given(st.tuples(numbers, numbers), st.tuples(numbers, numbers), st.floats(0, 1), st.floats(0, 1))
def test_results_hold_those_of_members(first, second, share, other_share):
    members = []
    intervals = []
    for pair, where in ((first, share), (second, other_share)):
        low = Fraction(min(pair))
        high = Fraction(max(pair))
        members.append(low + Fraction(where) * (high - low))
        intervals.append(enclose([float(low)], [float(high)]))
    a, b = members
    x, y = intervals
    results = [
        (x + y, a + b),
        (x - y, a - b),
        (x * y, a * b),
        (square(x), a * a),
        (x * 0.1, a * Fraction(0.1)),
        (1.5 - x, Fraction(3, 2) - a),
    ]
    if min(second) > 0.1 or max(second) < -0.1:
        results.append((x / y, a / b))
        results.append((reciprocal(y), 1 / b))
    for enclosure, exact in results:
        (lower,), (upper,) = ends(enclosure)
        assert lower <= exact <= upper


@pytest.mark.parametrize("function", FUNCTIONS, ids=NAMES)
def test_functions_of_an_angle_are_enclosed_tightly(function):
    angles = np.concatenate([np.linspace(-QUARTER_TURN, QUARTER_TURN, 41), [1e-9, -3e-5]])
    lower, upper = ends(function(enclose(angles, angles)))
    with mpmath.workdps(80):
        for angle, low, high in zip(angles, lower, upper, strict=True):
            exact = FUNCTIONS[function](mpmath.mpf(float(angle)))
            scaled = exact * GRID
            assert low * GRID <= scaled <= high * GRID
            assert float(high - low) < PLACES
            # Half of what is granted to a series is more than it needs.
            middle = mpmath.mpf(int((low + high) / 2 * GRID))
            assert abs(scaled - middle) < SERIES_UNITS / 2


@pytest.mark.parametrize("function", FUNCTIONS, ids=NAMES)
def test_functions_of_intervals_hold_those_of_members(function):
    rng = np.random.default_rng(0)
    pairs = np.sort(rng.uniform(-QUARTER_TURN, QUARTER_TURN, (2, 60)), axis=0)
    lower, upper = ends(function(enclose(*pairs)))
    for share in (0.0, 0.3, 1.0):
        inside = np.clip(pairs[0] + share * (pairs[1] - pairs[0]), *pairs)
        for angle, low, high in zip(inside, lower, upper, strict=True):
            with mpmath.workdps(80):
                exact = FUNCTIONS[function](mpmath.mpf(float(angle))) * GRID
                assert low * GRID <= exact <= high * GRID


def test_angles_beyond_a_quarter_turn_are_refused():
    with pytest.raises(ValueError, match="leaves"):
        cos(enclose([0.0], [1.6]))
    with pytest.raises(ValueError, match="holds 0"):
        reciprocal(enclose([-0.1], [0.1]))


def hill(variables):
    """Largest where x = 1/2 and y is at an end: 1/4 + 1/9."""
    x, y = variables
    return x - square(x) + square(y)


HILL = Fraction(1, 4) + Fraction(1, 9)
LOW = np.array([[0.0], [-0.2]])
HIGH = np.array([[1.0], [1 / 3]])


def test_what_stays_below_a_level_is_proved():
    room = find_room(hill, LOW, HIGH, HILL + Fraction(1, 10**6))
    assert 0 <= room.proved <= room.met


def test_what_passes_a_level_is_met():
    room = find_room(hill, LOW, HIGH, HILL - Fraction(1, 10**6))
    assert room.proved < 0
    assert room.met < 0


def test_a_search_that_gives_up_claims_nothing():
    room = find_room(hill, LOW, 1.1 * HIGH, HILL + Fraction(1, 10), most_cells=1)
    assert room.proved < 0 < room.met


def test_the_worst_of_all_boxes_counts():
    low = np.hstack([LOW, LOW])
    high = np.hstack([np.array([[0.1], [0.1]]), HIGH])
    assert find_room(hill, low, high, HILL - Fraction(1, 10**6)).met < 0
    assert find_room(hill, low[:, :1], high[:, :1], HILL - Fraction(1, 10**6)).proved > 0
