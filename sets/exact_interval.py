"""Interval arithmetic on integers, which trusts neither the rounding of floats nor a library's
sines.

Ends are integers, in units of 1/GRID: sums are exact, products are rounded outwards by a unit, and
functions of an angle are summed up term by term,

    f(x) = factor x^power (1 - r_1 y (1 - r_2 y (1 - ...))),    y = x^2,    r_k = ratio(k).

So is e^{-x}, x halved until it is below 1 and the sum squared as often.

Source: Moore, Kearfott, Cloud 2009, Introduction to Interval Analysis.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from fractions import Fraction
from functools import lru_cache
from math import ceil, floor
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from sets.interval import Interval, reciprocal

BITS = 80
"""Binary digits after the point."""

GRID = 2**BITS
"""Units in 1."""

SERIES_UNITS = 256
"""Units granted to a series. Within a quarter turn r_1 y is below 1.3 and r_k y below 0.3 for
k > 1, so that the three units of each level come to less than ten; two more are left out, and a
factor x^power of at most 4 makes less than fifty of them."""


class ExactInterval(Interval):
    """Arrays of closed intervals whose ends are integers, in units of 1/GRID; a float operand
    stands for the binary rational it is."""

    __slots__ = ()
    unit = GRID

    def __neg__(self) -> ExactInterval:
        return ExactInterval(-self.upper, -self.lower)

    def __add__(self, other) -> ExactInterval:
        added = _promote(other)
        return ExactInterval(self.lower + added.lower, self.upper + added.upper)

    def __sub__(self, other) -> ExactInterval:
        return self + (-other)

    def __rsub__(self, other) -> ExactInterval:
        return -self + other

    def __mul__(self, other) -> Any:
        if isinstance(other, Gradient):
            return other * self
        least, most = _multiply(self, _promote(other))
        return ExactInterval(least >> BITS, -(-most >> BITS))

    __radd__ = __add__
    __rmul__ = __mul__

    def __truediv__(self, other) -> ExactInterval:
        return self * reciprocal(_promote(other))

    def invert(self) -> ExactInterval:
        """Enclose 1 / x, x of one sign."""
        return ExactInterval(GRID * GRID // self.upper, -(-GRID * GRID // self.lower))

    def enclose(self, name: str, low, high) -> ExactInterval:
        """Enclose a function of an angle between its values at two points."""
        series = _SERIES[name]
        return ExactInterval(series.add_up(low) - SERIES_UNITS, series.add_up(high) + SERIES_UNITS)


def _multiply(one: Interval, other: Interval) -> tuple[Any, Any]:
    """Return the ends of the products of members, in units of GRID^-2.

    Where all of one factor's members have one sign, two products are the ends.
    """
    for x, y in ((one, other), (other, one)):
        if np.min(y.lower) >= 0:
            return (
                _choose(x.lower >= 0, y.lower, y.upper) * x.lower,
                _choose(x.upper >= 0, y.upper, y.lower) * x.upper,
            )
        if np.max(y.upper) <= 0:
            return (
                _choose(x.upper >= 0, y.lower, y.upper) * x.upper,
                _choose(x.lower >= 0, y.upper, y.lower) * x.lower,
            )
    low_low = one.lower * other.lower
    high_high = one.upper * other.upper
    low_high = one.lower * other.upper
    high_low = one.upper * other.lower
    return (
        np.minimum(np.minimum(low_low, low_high), np.minimum(high_low, high_high)),
        np.maximum(np.maximum(low_low, low_high), np.maximum(high_low, high_high)),
    )


def _choose(first_where, first, second) -> Any:
    """Return the first integers where a condition holds, else the second."""
    if first is second:
        return first
    return np.where(first_where, np.asarray(first, object), np.asarray(second, object))


class Gradient:
    """Derivatives by some variables, by their numbers; those by all others are zero."""

    __slots__ = ("rows",)

    def __init__(self, rows: dict[int, ExactInterval]):
        self.rows = rows

    def __neg__(self) -> Gradient:
        return Gradient({variable: -row for variable, row in self.rows.items()})

    def __add__(self, other: Gradient) -> Gradient:
        rows = self.rows | other.rows
        for variable in self.rows.keys() & other.rows.keys():
            rows[variable] = self.rows[variable] + other.rows[variable]
        return Gradient(rows)

    def __sub__(self, other: Gradient) -> Gradient:
        return self + -other

    def __mul__(self, factor) -> Gradient:
        return Gradient({variable: row * factor for variable, row in self.rows.items()})

    __rmul__ = __mul__

    def __truediv__(self, divisor) -> Gradient:
        return Gradient({variable: row / divisor for variable, row in self.rows.items()})


def enclose_numbers(numbers: Sequence) -> ExactInterval:
    """Return an array of numbers as intervals."""
    exact = np.asarray(numbers, dtype=object)
    return ExactInterval(scale_down(exact), scale_up(exact))


def decay(x: ExactInterval) -> ExactInterval:
    """Enclose e^{-x}, x not negative."""
    halvings = (int(np.max(x.upper)) // GRID).bit_length()
    least = _sum_decay(-(-x.upper >> halvings))
    most = _sum_decay(x.lower >> halvings)
    value = ExactInterval(least - SERIES_UNITS, most + SERIES_UNITS)
    for _ in range(halvings):
        value = value * value
    return value


def _sum_decay(x) -> Any:
    """Return e^{-x} at points from 0 to 1, up to `SERIES_UNITS`, all in units of 1/GRID."""
    term = 0 * x + GRID
    total = term
    k = 0
    while np.any(term):
        k += 1
        term = (term * x >> BITS) // k
        total = total + (-1) ** k * term
    return total


def scale_down(numbers: Float[np.ndarray, "..."]) -> np.ndarray:
    """Return floats in units of 1/GRID, rounded down where they lie between two."""
    return _scale(numbers, floor)


def scale_up(numbers: Float[np.ndarray, "..."]) -> np.ndarray:
    """Return floats in units of 1/GRID, rounded up where they lie between two."""
    return _scale(numbers, ceil)


def _scale(numbers, rounded: Callable[[Fraction], int]) -> np.ndarray:
    scaled = np.empty(np.shape(numbers), dtype=object)
    for place, number in np.ndenumerate(numbers):
        scaled[place] = rounded(Fraction(number) * GRID)
    return scaled


def _promote(number: Any) -> Any:
    """Return a number as an interval."""
    return number if isinstance(number, Interval) else _enclose_number(number)


@lru_cache(maxsize=256)
def _enclose_number(number: float | Fraction) -> ExactInterval:
    units = Fraction(number) * GRID
    low = np.array(floor(units), dtype=object)
    return ExactInterval(low, low if low == units else low + 1)


class _Series(NamedTuple):
    """A function of an angle by its series: see the module docstring."""

    factor: Fraction
    power: int
    ratio: Callable[[int], tuple[int, int]]

    def add_up(self, x):
        """Return the sum at points, up to `SERIES_UNITS`; all are in units of 1/GRID."""
        y = x * x >> BITS
        total = 0 * y + GRID
        for k in range(self._count_terms(int(np.max(y, initial=0))), 0, -1):
            above, below = self.ratio(k)
            total = GRID - (total * y >> BITS) * above // below
        for _ in range(self.power):
            total = total * x >> BITS
        return total * self.factor.numerator // self.factor.denominator

    def _count_terms(self, y: int) -> int:
        """Return after how many terms those of the greatest y are below a unit."""
        term = GRID
        k = 0
        while term:
            k += 1
            above, below = self.ratio(k)
            term = (term * y >> BITS) * above // below
        return k


def _ratio_of_cubic(k: int) -> tuple[int, int]:
    return 1, (2 * k + 2) * (2 * k + 3)


_SERIES = {
    "sin": _Series(Fraction(1), 1, lambda k: (1, 2 * k * (2 * k + 1))),
    "cos": _Series(Fraction(1), 0, lambda k: (1, (2 * k - 1) * 2 * k)),
    "sinc": _Series(Fraction(1), 0, lambda k: (1, 2 * k * (2 * k + 1))),
    "sinc_slope": _Series(Fraction(-1, 3), 1, lambda k: (1, 2 * k * (2 * k + 3))),
    "sinc_curvature": _Series(
        Fraction(-1, 3), 0, lambda k: (2 * k + 1, 2 * k * (2 * k - 1) * (2 * k + 3))
    ),
    "sine_excess": _Series(Fraction(-1, 6), 3, _ratio_of_cubic),
    "lag": _Series(Fraction(1, 6), 1, _ratio_of_cubic),
    "lag_slope": _Series(
        Fraction(1, 6), 0, lambda k: (2 * k + 1, (2 * k - 1) * (2 * k + 2) * (2 * k + 3))
    ),
}
