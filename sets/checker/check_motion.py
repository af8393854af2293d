"""The motion of a robot that slips, and proofs that what its model leaves out lies in W, for
`check_certificate`; of the standard library alone.

A robot drives for a period T with ground speeds g_r, g_l (right, left, b apart); its reference
drives an arc of length L = T V, V = (V_r + V_l)/2, that turns by A = T (V_r - V_l)/b. With the
error e = (x, y, th) of the reference in the robot's frame, z = x + i y, a = T (g_r - g_l)/b, way =
T (g_r + g_l)/2, S(a) = C(a) - i D(a), C = sin(a)/a and D = (1 - cos a)/a, the motion is exactly

    z+ = e^{-ia} z + L C(A/2) e^{i psi} - way S(a),   psi = th + A/2 - a,   th+ = th + A - a.

The input u = (u1, u2) asks for a = A - T u2, and for the way that makes x+ = x + A y + T u1. Then

    y+ = y - tan(a/2) (2 x + A y + T u1) + L C(A/2) sin(th + T u2/2) / cos(a/2).

Wheels keep 1 - d of the ground speed asked of each, and the body slides to the left at zeta v - r w
besides: the robot turns by a - kick. With h = tan(A/2), c = L C(A/2)/cos(A/2) the model

    e+ = M e + B u + w,  M = [1, A, 0; -2h, 1-hA, c; 0, 0, 1],  B = [T, 0; -hT, cT/2; 0, T]

the motion's Jacobian at e = u = 0, leaves out, of errors measured with noise n,

    w = (w_x, w_y, kick - n_th) + next n   in   W = {s (0, lean, 1): |s| <= yaw} + box.

That w_x and w_y - lean kick, beside the next n, and the kick keep their bounds is proved cell by
cell: a motion is largest at an end of a cell where its slope has one sign, and rises by no more
than slope times way from elsewhere (Moore, Kearfott, Cloud 2009, chapter 6).
"""

from fractions import Fraction
from math import ceil, factorial, floor
from typing import ClassVar

BITS = 56  # of integers, rounded outwards, that are the ends of intervals
ONE = 1 << BITS
UP = (ONE, ONE)
DOWN = (-ONE, -ONE)
TERMS = 20  # of x^j / j! where |x| <= 1: what is left out is less than a unit
HALF = (ONE >> 1, ONE >> 1)
VARIABLES = "abcdefghijklm"  # letters of those of `find_motion`, in its order: where cells are cut


class Refused(Exception):
    """Something is not proved."""


def require(holds, sentence):
    """Refuse what does not hold."""
    if not holds:
        raise Refused(sentence)


def scale(value):
    """Return the ends, in units, of a fraction; ends of an interval as they are."""
    return value if isinstance(value, tuple) else (floor(value * ONE), ceil(value * ONE))


def multiply(left, right):
    """Return the ends of the product of two intervals."""
    a, b = left
    c, d = right
    if a >= 0:
        low = a * c if c >= 0 else b * c
        high = b * d if d >= 0 else a * d
    elif b <= 0:
        low = a * d if d >= 0 else b * d
        high = b * c if c >= 0 else a * c
    elif c >= 0 or d <= 0:
        low = a * d if c >= 0 else b * c
        high = b * d if c >= 0 else a * c
    else:
        low = min(a * d, b * c)
        high = max(a * c, b * d)
    return low >> BITS, -(-high >> BITS)


class Number:
    """An interval [low, high] of units, with the (number, slope) pairs that it was made from; other
    operands are constants."""

    __slots__ = ("high", "low", "slope", "sources")
    made: ClassVar[list] = []

    def __init__(self, low, high, sources=()):
        self.low = low
        self.high = high
        self.sources = sources
        self.slope = (0, 0)
        Number.made.append(self)

    def __add__(self, other):
        if isinstance(other, Number):
            sources = ((self, UP), (other, UP))
            return Number(self.low + other.low, self.high + other.high, sources)
        low, high = scale(other)
        return Number(self.low + low, self.high + high, ((self, UP),))

    def __neg__(self):
        return Number(-self.high, -self.low, ((self, DOWN),))

    def __sub__(self, other):
        if isinstance(other, Number):
            sources = ((self, UP), (other, DOWN))
            return Number(self.low - other.high, self.high - other.low, sources)
        return self + -other

    def __mul__(self, other):
        own = (self.low, self.high)
        if isinstance(other, Number):
            ends = (other.low, other.high)
            return Number(*multiply(own, ends), ((self, ends), (other, own)))
        ends = scale(other)
        return Number(*multiply(own, ends), ((self, ends),))

    __radd__ = __add__
    __rmul__ = __mul__

    def inverse(self):
        """Return one over a positive number."""
        require(self.low > 0, "a divisor may be zero")
        ends = (ONE * ONE // self.high, -(-ONE * ONE // self.low))
        return Number(*ends, ((self, multiply(ends, (-ends[1], -ends[0]))),))


def tabulate(*coefficients):
    """Return of f, f' and f'' whether each is odd, and coefficients, the highest first."""
    tables = []
    for _ in range(3):
        odd = next(j for j, c in enumerate(coefficients) if c) % 2
        tables.append((odd, [scale(c) for c in reversed(coefficients[odd:TERMS:2])]))
        coefficients = [j * c for j, c in enumerate(coefficients)][1:]
    return tables


WAVE = [(0, 1, 0, -1)[j % 4] for j in range(TERMS + 3)]
SINE = tabulate(*(Fraction(WAVE[j], factorial(j)) for j in range(TERMS + 2)))
COSINE = tabulate(*(Fraction(WAVE[j + 1], factorial(j)) for j in range(TERMS + 2)))
EXCESS = tabulate(*(Fraction(WAVE[j] * (j > 1), factorial(j)) for j in range(TERMS + 2)))  # sin - x
C = tabulate(*(Fraction(WAVE[j + 1], factorial(j + 1)) for j in range(TERMS + 2)))
D = tabulate(*(Fraction(WAVE[j], factorial(j + 1)) for j in range(TERMS + 2)))


def add_up(table, ends):
    """Return the ends of a series over an interval."""
    low, high = ends
    require(low >= -ONE and high <= ONE, "an angle may exceed 1 rad, the end of the series")
    odd, coefficients = table
    least = 0 if low < 0 < high else min(low * low, high * high) >> BITS
    most = -(-max(low * low, high * high) >> BITS)
    bottom = 0
    top = 0
    # Of small angles the last terms come to less than a unit, too.
    skipped = 3 if 4 * max(-low, high) <= ONE else 2 if 2 * max(-low, high) <= ONE else 0
    for below, above in coefficients[skipped:]:
        bottom = below + (bottom * (least if bottom >= 0 else most) >> BITS)
        top = above - (-top * (most if top >= 0 else least) >> BITS)
    total = (bottom - 1, top + 1)
    return multiply(total, ends) if odd else total


def apply(function, x):
    """Return f(x)."""
    ends = (x.low, x.high)
    return Number(*add_up(function[0], ends), ((x, lambda: add_up(function[1], ends)),))


def change(function, x, step):
    """Return f(x + step) - f(x), which is step f' somewhere between them, too."""
    end = x + step
    ends = (end.low, end.high)
    between = (min(x.low, end.low), max(x.high, end.high))
    steps = (step.low, step.high)
    after = add_up(function[0], ends)
    before = add_up(function[0], (x.low, x.high))
    least, most = multiply(steps, add_up(function[1], between))
    low = max(least, after[0] - before[1])
    high = min(most, after[1] - before[0])
    of_x = (x, lambda: multiply(steps, add_up(function[2], between)))
    return Number(low, high, (of_x, (step, lambda: add_up(function[1], ends))))


def find_constants(robot, piece):
    """Return the ends of what is constant in `find_motion`."""
    T, b, lever, lean = robot
    values = (T, T / b, b / 2, 1 / b, lever, lean, *piece)
    return [None if value is None else scale(value) for value in values]


def find_motion(output, variables, constants):
    """Return w_x, w_y - lean kick, the kick, or the way of a wheel that is asked for."""
    share, y, th, u1, u2, first, second, d_r, d_l, zeta, n_x, n_y, n_th = variables
    T, turning, half_b, per_b, lever, lean, x_reach, x_slope, v_reach, v_slope = constants
    x = share * (u2 * x_slope + x_reach)
    if v_reach is None:
        middle = (first + second) * HALF
        A = (first - second) * turning
    else:
        middle = first
        A = second * (first * v_slope + v_reach) * turning * 2
    m = u2 * T
    a = A - m
    half_A = A * HALF
    half_a = a * HALF
    chord = middle * T * apply(C, half_A)
    psi = th - half_A + m
    sine = apply(SINE, half_a)
    ahead = chord * apply(COSINE, psi) - sine * sine * x * 2 + (apply(EXCESS, a) - m) * y - u1 * T
    way = ahead * apply(C, a).inverse()
    right = way + a * half_b
    left = way - a * half_b
    if output in ("right", "left"):
        return right if output == "right" else left
    kick = (right * d_r - left * d_l) * per_b
    if output == "kick":
        return kick
    lost = (right * d_r + left * d_l) * HALF
    turn = a - kick
    d_cos = change(COSINE, a, -kick)
    d_sin = change(SINE, a, -kick)
    cos_turn = apply(COSINE, turn)
    sin_turn = apply(SINE, turn)
    sideways = zeta * (way - lost) - turn * lever
    if output == "x":
        swing = d_cos * x + d_sin * y + chord * change(COSINE, psi, kick - n_th)
        slip = lost * apply(C, turn) - way * change(C, a, -kick) - sideways * apply(D, turn)
        return swing + slip - cos_turn * n_x - sin_turn * n_y
    secant_a = apply(COSINE, half_a).inverse()
    secants = secant_a * apply(COSINE, half_A).inverse()
    half_m = m * HALF
    ahead_th = th + half_m
    bent = apply(SINE, half_m) * secants * (x * 2 + A * y + u1 * T)
    curved = apply(EXCESS, ahead_th) * secant_a
    curved = curved - change(COSINE, half_A, -half_m) * secants * ahead_th
    swing = d_cos * y - d_sin * x + chord * change(SINE, psi, kick - n_th)
    slip = way * change(D, a, -kick) - lost * apply(D, turn) - sideways * apply(C, turn)
    return bent + chord * curved + swing + slip + sin_turn * n_x - cos_turn * n_y - kick * lean


def follow(output, cell, constants):
    """Return a motion over a cell and the variables, by which it may be differentiated."""
    Number.made.clear()
    variables = [Number(*ends) for ends in cell]
    result = find_motion(output, variables, constants)
    return result, variables


def find_slopes(output, sign, cell, constants):
    """Return the ends of the slopes of sign times a motion over a cell."""
    result, variables = follow(output, cell, constants)
    result.slope = (sign * ONE, sign * ONE)
    for number in reversed(Number.made):
        if number.slope == (0, 0):
            continue
        for source, slope in number.sources:
            ends = multiply(number.slope, slope() if callable(slope) else slope)
            source.slope = (source.slope[0] + ends[0], source.slope[1] + ends[1])
    return [variable.slope for variable in variables]


def shrink(cell, slopes):
    """Return what of a cell holds the greatest value: ends where a slope has one sign."""
    shrunk = []
    for (low, high), (least, most) in zip(cell, slopes, strict=True):
        shrunk.append((high, high) if least >= 0 else (low, low) if most <= 0 else (low, high))
    return shrunk


def bound(output, sign, cell, slopes, constants):
    """Return an upper bound of sign times a motion over a shrunk cell."""
    centre = []
    rise = 0
    for (low, high), (least, most) in zip(cell, slopes, strict=True):
        place = low if low == high else low + (high - low) * most // (most - least)
        rise += max(most * (high - place), least * (low - place)) if low < high else 0
        centre.append((place, place))
    value, _ = follow(output, centre, constants)
    return (value.high if sign > 0 else -value.low) - (-rise >> BITS)


def prove(output, sign, level, tree, cell, robot, piece):
    """Prove that sign times a motion is at most a level over a cell. A letter of the tree cuts a
    cell into halves along its variable, the lower one first, a small letter after it was shrunk; a
    dot stands for a cell that has to be proved."""
    constants = find_constants(robot, piece)
    cells = [cell]
    for letter in tree:
        require(cells, "a tree goes on where all cells are proved")
        cell = cells.pop()
        if not letter.isupper():
            slopes = find_slopes(output, sign, cell, constants)
            cell = shrink(cell, slopes)
        if letter == ".":
            missed = bound(output, sign, cell, slopes, constants) - level
            require(missed <= 0, f"{output} may exceed its bound by {missed / ONE:.3g}")
            continue
        index = VARIABLES.index(letter.lower())
        low, high = cell[index]
        middle = (low + high) // 2
        halves = ((middle, high), (low, middle))
        cells += [[*cell[:index], half, *cell[index + 1 :]] for half in halves]
    require(not cells, "cells are left that a tree does not prove")
