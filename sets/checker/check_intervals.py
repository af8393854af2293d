"""Arithmetic of `check_certificate`: intervals, rounded outwards, and formulas with their slopes;
of the standard library alone.

An interval is a pair (low, high) of integers, which count units of 2^-56. A sum, product or series
of intervals holds that of all numbers in them; what the last unit leaves out is added outwards.

A formula is noted step by step, once, and then followed for any intervals of its variables. Going
back over its steps gives the slopes of the result by every variable over these intervals, too
(reverse differentiation; Moore, Kearfott, Cloud 2009, chapter 6).
"""

from fractions import Fraction
from math import factorial

BITS = 56
ONE = 1 << BITS
ZERO = (0, 0)
HALF = (ONE >> 1, ONE >> 1)
TERMS = 20  # of x^j / j! where |x| <= 1: what is left out is less than a unit
# How many of every other term are left out, besides, of |x| < 2^(bits - 56), by bits: those from
# j on, which come to less than a unit, x apart, as x^(j - 1) / j! is below half of one.
SKIPPED = [
    sum((bits - BITS) * (j - 1) + BITS + 1 < factorial(j).bit_length() for j in range(2, TERMS, 2))
    for bits in range(BITS + 2)
]


class Refused(Exception):
    """Something is not proved."""


def require(holds, sentence):
    """Refuse what does not hold."""
    if not holds:
        raise Refused(sentence)


def pick(table, *names):
    """Return the entries of these names."""
    return [table[name] for name in names]


def read_index(number):
    """Return a number that counts."""
    require(number >= 0 and number == int(number), f"{number} counts nothing")
    return int(number)


def scale(value):
    """Return the interval around a fraction."""
    units = value.numerator << BITS
    return units // value.denominator, -(-units // value.denominator)


def scale_all(values):
    """Return the intervals around fractions, in lists as they were."""
    return [scale_all(each) if isinstance(each, list | tuple) else scale(each) for each in values]


def read_units(units):
    """Return a number of units as a fraction."""
    return Fraction(units, ONE)


def multiply(left, right):
    """Return the product of two intervals."""
    a, b = left
    c, d = right
    if a >= 0:
        low = a * c if c >= 0 else b * c
        high = b * d if d >= 0 else a * d
    elif b <= 0:
        low = a * d if d >= 0 else b * d
        high = b * c if c >= 0 else a * c
    elif c >= 0:
        low = a * d
        high = b * d
    elif d <= 0:
        low = b * c
        high = a * c
    else:
        low = min(a * d, b * c)
        high = max(a * c, b * d)
    return low >> BITS, -(-high >> BITS)


def add(left, right):
    """Return the sum of two intervals."""
    return left[0] + right[0], left[1] + right[1]


def subtract(left, right):
    """Return the difference of two intervals."""
    return left[0] - right[1], left[1] - right[0]


def invert(ends, _=None):
    """Return one over a positive interval."""
    require(ends[0] > 0, "a divisor may be zero")
    return ONE * ONE // ends[1], -(-ONE * ONE // ends[0])


def dot(left, right):
    """Return the sum of products of intervals."""
    parts = [multiply(*pair) for pair in zip(left, right, strict=True)]
    return sum(low for low, _ in parts), sum(high for _, high in parts)


def times(row, matrix):
    """Return row @ matrix, of intervals."""
    return [dot(row, column) for column in zip(*matrix, strict=True)]


def size(ends):
    """Return the greatest magnitude in an interval, in units."""
    return max(-ends[0], ends[1])


def add_up(table, ends):
    """Return a power series over an interval."""
    low, high = ends
    require(low >= -ONE and high <= ONE, "an angle may exceed 1 rad, the end of the series")
    odd, coefficients = table
    least = 0 if low < 0 < high else min(low * low, high * high) >> BITS
    most = -(-max(low * low, high * high) >> BITS)
    bottom = 0
    top = 0
    for below, above in coefficients[SKIPPED[max(-low, high).bit_length()] :]:
        bottom = below + (bottom * (least if bottom >= 0 else most) >> BITS)
        top = above - (-top * (most if top >= 0 else least) >> BITS)
    total = (bottom - 1, top + 1)
    return multiply(total, ends) if odd else total


class Function:
    """A function by its power series, with two derivatives."""

    def __init__(self, coefficient):
        self.tables = []
        coefficients = [coefficient(j) for j in range(TERMS + 2)]
        for _ in range(3):
            odd = next(j for j, c in enumerate(coefficients) if c) % 2
            table = [scale(Fraction(c)) for c in reversed(coefficients[odd:TERMS:2])]
            self.tables.append((odd, table))
            coefficients = [j * c for j, c in enumerate(coefficients)][1:]

    def __call__(self, x):
        """Return f(x), of a number of a formula."""
        return Number(self.value, self.slope, x, x)

    def change(self, x, step):
        """Return f(x + step) - f(x), of numbers of a formula."""
        return Number(self.rise, self.slopes_of_rise, x, step)

    def value(self, x, _=None):
        """Return f over an interval."""
        return add_up(self.tables[0], x)

    def slope(self, x, _=None):
        """Return f' over an interval; by nothing else."""
        return add_up(self.tables[1], x), None

    def rise(self, x, step):
        """Return f(x + step) - f(x), which is step f' somewhere between them, too."""
        end = add(x, step)
        after = add_up(self.tables[0], end)
        before = add_up(self.tables[0], x)
        between = (min(x[0], end[0]), max(x[1], end[1]))
        least, most = multiply(step, add_up(self.tables[1], between))
        return max(least, after[0] - before[1]), min(most, after[1] - before[0])

    def slopes_of_rise(self, x, step):
        """Return the slopes of the same by x and by the step."""
        end = add(x, step)
        between = (min(x[0], end[0]), max(x[1], end[1]))
        return multiply(step, add_up(self.tables[2], between)), add_up(self.tables[1], end)


def alternate(j):
    """Return the coefficient of sin x at x^j, times j!."""
    return (0, 1, 0, -1)[j % 4]


SINE = Function(lambda j: Fraction(alternate(j), factorial(j)))
COSINE = Function(lambda j: Fraction(alternate(j + 1), factorial(j)))
EXCESS = Function(lambda j: Fraction(alternate(j) * (j > 1), factorial(j)))  # sin x - x
C = Function(lambda j: Fraction(alternate(j + 1), factorial(j + 1)))  # sin(x) / x
D = Function(lambda j: Fraction(alternate(j), factorial(j + 1)))  # (1 - cos x) / x


class Number:
    """A number of a formula: what an operation makes of two others, or, without one, a variable or
    a constant, whose ends are known. Operands may be intervals, too, or whole numbers."""

    def __init__(self, operation=None, slopes=None, *operands, ends=None):
        self.operation = operation
        self.slopes = slopes
        self.operands = [make_number(operand) for operand in operands]
        self.ends = ends

    def __add__(self, other):
        other = make_number(other)
        if ZERO in (self.ends, other.ends):
            return self if other.ends == ZERO else other
        return Number(add, None, self, other)

    def __sub__(self, other):
        return Number(subtract, None, self, other)

    def __neg__(self):
        return make_number(0) - self

    def __mul__(self, other):
        other = make_number(other)
        if ZERO in (self.ends, other.ends):
            return make_number(0)
        return Number(multiply, lambda left, right: (right, left), self, other)

    __radd__ = __add__
    __rmul__ = __mul__

    def inverse(self):
        """Return one over a positive number."""
        return Number(invert, find_slope_of_inverse, self, self)


def find_slope_of_inverse(ends, _):
    """Return the slope of 1/x, which is -1/x^2."""
    inverse = invert(ends)
    return multiply(inverse, (-inverse[1], -inverse[0])), None


def make_number(value):
    """Return a number of a formula; what is none is a constant."""
    if isinstance(value, Number):
        return value
    return Number(ends=value if isinstance(value, tuple) else (value * ONE, value * ONE))


class Formula:
    """A formula of some variables: constants, and steps in their order, each of which says what is
    made of the intervals at two places of a list that begins with constants and variables."""

    def __init__(self, result, variables):
        order = []
        self.list_operands(result, {id(each) for each in variables}, order)
        constants = [number for number in order if number.operation is None]
        made = [number for number in order if number.operation is not None]
        self.constants = [number.ends for number in constants]
        places = {id(each): i for i, each in enumerate([*constants, *variables, *made])}
        self.steps = [
            (each.operation, each.slopes, *(places[id(operand)] for operand in each.operands))
            for each in made
        ]

    def list_operands(self, number, known, order):
        """Add to an order what a number is made of, and then the number itself."""
        if id(number) not in known:
            known.add(id(number))
            for operand in number.operands:
                self.list_operands(operand, known, order)
            order.append(number)

    def follow(self, cell):
        """Return the intervals of all places, that of the result last."""
        ends = [*self.constants, *cell]
        for operation, _, left, right in self.steps:
            ends.append(operation(ends[left], ends[right]))
        return ends

    def find_slopes(self, cell, sign):
        """Return the slopes of sign times the result over a cell, by every variable."""
        ends = self.follow(cell)
        first = len(self.constants)
        place = len(ends)
        least = [0] * place
        most = [0] * place
        least[-1] = sign * ONE
        most[-1] = sign * ONE
        for operation, find, left, right in reversed(self.steps):
            place -= 1
            low = least[place]
            high = most[place]
            if find is None:
                least[left] += low
                most[left] += high
                least[right] += low if operation is add else -high
                most[right] += high if operation is add else -low
            elif low or high:
                by_left, by_right = find(ends[left], ends[right])
                for operand, by in ((left, by_left), (right, by_right)):
                    if by is not None and operand >= first:
                        below, above = multiply((low, high), by)
                        least[operand] += below
                        most[operand] += above
        return list(zip(least, most, strict=True))[first : first + len(cell)]
