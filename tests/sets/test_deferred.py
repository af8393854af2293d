"""Laws of deferred numbers: they are what they would be at once, and each is computed once at most,
if it is read."""

import numpy as np
import pytest

from sets.deferred import defer, force
from sets.exact_interval import GRID, Gradient, enclose_numbers
from sets.interval import Dual, Interval, cos, sin, sinc_change


class Counted:
    """A number that counts the products that were made of it."""

    def __init__(self, value: float):
        self.value = value
        self.products = 0

    def __mul__(self, factor: float) -> float:
        self.products += 1
        return self.value * factor

    __rmul__ = __mul__


def test_formulas_give_the_numbers_that_they_give_at_once():
    def formula(x, y):
        way = cos(x) * y + 2.0 * x - y / x
        return (1.0 - way) / y + (3.0 + sin(x)) * -y + sinc_change(x, y) + 1.0 / x

    at_once = formula(0.3, 0.7)
    assert force(formula(*defer([0.3, 0.7]))) == at_once
    x = Interval(np.array([0.3]), np.array([0.4]))
    y = Interval(np.array([0.6]), np.array([0.7]))
    enclosed = force(formula(*defer([x, y])))
    assert enclosed.lower == formula(x, y).lower
    assert enclosed.upper == formula(x, y).upper


def test_what_is_written_twice_is_computed_once():
    counted = Counted(2.0)
    (x,) = defer([counted])
    assert force(x * 3.0 + x * 3.0 + 3.0 * x) == 18.0
    assert counted.products == 2  # x * 3 and 3 * x are two products
    assert x * 3.0 is x * 3.0


def test_what_nobody_reads_is_not_computed():
    counted = Counted(2.0)
    (x,) = defer([counted])
    parts = (x * 5.0, x * 7.0)
    assert force(parts[1]) == 14.0
    assert counted.products == 1


def test_a_refusal_is_raised_where_the_number_is_read():
    (x,) = defer([Interval(np.array([0.0]), np.array([3.0]))])
    refused = cos(x)
    with pytest.raises(ValueError, match="leaves"):
        force(refused)


def test_derivatives_that_are_left_out_are_zero():
    low = [enclose_numbers([value]) for value in (0.3, 0.7)]
    one = enclose_numbers([1])
    none = enclose_numbers([0])
    sparse = [Dual(x, Gradient({index: one})) for index, x in enumerate(low)]
    full = [Dual(x, Gradient({index: one, 1 - index: none})) for index, x in enumerate(low)]

    def formula(x, y):
        return cos(x * 0.5) * y - (2.0 - x) / y + -x

    rows = formula(*sparse).gradient.rows
    expected = formula(*full).gradient.rows
    assert rows.keys() == expected.keys() == {0, 1}
    for variable, row in rows.items():
        assert (row.lower, row.upper) == (expected[variable].lower, expected[variable].upper)
    slope = -np.sin(0.15) * 0.5 * 0.7 + 1 / 0.7 - 1
    assert float(rows[0].lower[0]) / GRID == pytest.approx(slope)
