"""Interval arithmetic and forward-mode derivatives, over arrays.

    Interval   [lower, upper]        every operation encloses the exact results for all members of its operands
    Dual       (value, gradient)     derivatives by the chain rule, over float arrays or over intervals alike

Float64 rounds each +, -, *, / to nearest, so a step outwards by 2^-52 of the result holds the exact
one; TINY covers underflow. Library sines are not correctly rounded: numpy's are within 4 units in
the last place, and so are the series below, within 8; UNITS are granted to all. Angles stay within
a quarter turn, where each function here is monotone in the angle or in its magnitude, so that its
values at the ends enclose it.

Source: Moore, Kearfott, Cloud 2009, Introduction to Interval Analysis.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from jaxtyping import Float

EPSILON = 2.0**-52
TINY = 1e-300
"""Above every error of underflow, yet a normal number, so that products of it cost no more than
others."""
UNITS = 16
"""Units in the last place granted to functions of an angle."""
QUARTER_TURN = np.pi / 2
"""Limit of every angle, rad."""


def _outwards(lower, upper, units: int = 1) -> Interval:
    """Enclose ends that are known to some units in the last place."""
    return Interval(
        lower - (np.abs(lower) * (units * EPSILON) + TINY),
        upper + (np.abs(upper) * (units * EPSILON) + TINY),
    )


class Interval:
    """Arrays of closed intervals; a float operand stands for that very number."""

    __slots__ = ("lower", "upper")
    __array_ufunc__ = None  # an array on the left leaves the operation to this class

    def __init__(self, lower: Float[np.ndarray, "..."], upper: Float[np.ndarray, "..."]):
        self.lower, self.upper = lower, upper

    def __neg__(self) -> Interval:
        return Interval(-self.upper, -self.lower)

    def __add__(self, other) -> Interval:
        if isinstance(other, Interval):
            return _outwards(self.lower + other.lower, self.upper + other.upper)
        return _outwards(self.lower + other, self.upper + other)

    def __sub__(self, other) -> Interval:
        return self + (-other)

    def __rsub__(self, other) -> Interval:
        return -self + other

    def __mul__(self, other) -> Interval:
        if isinstance(other, Interval):
            ends = (
                self.lower * other.lower,
                self.lower * other.upper,
                self.upper * other.lower,
                self.upper * other.upper,
            )
            lower = np.minimum(np.minimum(ends[0], ends[1]), np.minimum(ends[2], ends[3]))
            upper = np.maximum(np.maximum(ends[0], ends[1]), np.maximum(ends[2], ends[3]))
        else:
            ends = self.lower * other, self.upper * other
            lower, upper = np.minimum(*ends), np.maximum(*ends)
        return _outwards(lower, upper)

    __radd__, __rmul__ = __add__, __mul__

    def __truediv__(self, other) -> Interval:
        if isinstance(other, Interval):
            return self * reciprocal(other)
        ends = self.lower / other, self.upper / other
        return _outwards(np.minimum(*ends), np.maximum(*ends))

    def __rtruediv__(self, other) -> Interval:
        return reciprocal(self) * other

    def intersect(self, other: Interval) -> Interval:
        """Return what two enclosures of the same numbers have in common."""
        return Interval(np.maximum(self.lower, other.lower), np.minimum(self.upper, other.upper))

    @property
    def magnitudes(self) -> tuple[Float[np.ndarray, "..."], Float[np.ndarray, "..."]]:
        """Least and largest absolute value of the members."""
        return np.maximum(np.maximum(self.lower, -self.upper), 0.0), np.maximum(
            -self.lower, self.upper
        )


class Dual:
    """Values with their gradients: value (cells,), gradient (variables, cells), both float arrays
    or both intervals."""

    __slots__ = ("gradient", "value")
    __array_ufunc__ = None

    def __init__(self, value, gradient):
        self.value, self.gradient = value, gradient

    def __neg__(self) -> Dual:
        return Dual(-self.value, -self.gradient)

    def __add__(self, other) -> Dual:
        if isinstance(other, Dual):
            return Dual(self.value + other.value, self.gradient + other.gradient)
        return Dual(self.value + other, self.gradient)

    def __sub__(self, other) -> Dual:
        if isinstance(other, Dual):
            return Dual(self.value - other.value, self.gradient - other.gradient)
        return Dual(self.value - other, self.gradient)

    def __rsub__(self, other) -> Dual:
        return Dual(other - self.value, -self.gradient)

    def __mul__(self, other) -> Dual:
        if isinstance(other, Dual):
            return Dual(
                self.value * other.value, self.value * other.gradient + other.value * self.gradient
            )
        return Dual(self.value * other, self.gradient * other)

    __radd__, __rmul__ = __add__, __mul__

    def __truediv__(self, other) -> Dual:
        return (
            self * reciprocal(other)
            if isinstance(other, Dual)
            else Dual(self.value / other, self.gradient / other)
        )

    def __rtruediv__(self, other) -> Dual:
        return reciprocal(self) * other


def _increasing(function, x: Interval) -> Interval:
    return _outwards(function(_angle(x).lower), function(x.upper), UNITS)


def _decreasing(function, x: Interval) -> Interval:
    return _outwards(function(_angle(x).upper), function(x.lower), UNITS)


def _even_decreasing(function, x: Interval) -> Interval:
    """Enclose an even function that decreases with the magnitude."""
    near, far = _angle(x).magnitudes
    return _outwards(function(far), function(near), UNITS)


def _even_increasing(function, x: Interval) -> Interval:
    near, far = _angle(x).magnitudes
    return _outwards(function(near), function(far), UNITS)


def _angle(x: Interval) -> Interval:
    if np.any(x.lower < -QUARTER_TURN) or np.any(x.upper > QUARTER_TURN):
        low, high = np.min(x.lower), np.max(x.upper)
        raise ValueError(
            f"angle: [{low:.3f}, {high:.3f}] rad leaves +-pi/2; shrink errors, inputs, schedule or dt"
        )
    return x


def _squared(_, x: Interval) -> Interval:
    near, far = x.magnitudes
    enclosure = _outwards(near * near, far * far)
    return Interval(np.maximum(enclosure.lower, 0.0), enclosure.upper)


def _inverted(_, x: Interval) -> Interval:
    if np.any((x.lower <= 0) & (x.upper >= 0)):
        raise ValueError("divisor: an interval holds 0; shrink errors, inputs, schedule or dt")
    return _outwards(1.0 / x.upper, 1.0 / x.lower)


def _function(on_floats, enclose, derivative: Any = None):
    """Make a function of floats, intervals and duals from its values, its enclosure and its
    derivative."""

    def function(x):
        if isinstance(x, Dual):
            return Dual(function(x.value), derivative(x.value) * x.gradient)
        return enclose(on_floats, x) if isinstance(x, Interval) else on_floats(x)

    return function


def _series(x: Float[np.ndarray, "..."], ratio: Callable[[int], float]) -> Float[np.ndarray, "..."]:
    """Give 1 - r_1 y (1 - r_2 y (1 - ...)), y = x^2, with r_k = ratio(k), to 8 units in the last
    place.

    Within a quarter turn r_k y is below 0.2 for k > 1, so that each level damps the rounding of the
    one below it, and the terms left out are below 1e-17 of the sum.
    """
    y, total = x * x, 1.0
    for k in range(12, 0, -1):
        total = 1.0 - y * (ratio(k) * total)
    return np.asarray(total)


def _cubic_part(x):
    """Give 6 (x - sin x) / x^3."""
    return _series(x, lambda k: 1.0 / ((2 * k + 2) * (2 * k + 3)))


def _sinc(x):
    return 1.0 - x * x / 6.0 * _cubic_part(x)


def _sinc_slope(x):
    return -x / 3.0 * _series(x, lambda k: 1.0 / (2 * k * (2 * k + 3)))


def _sinc_curvature(x):
    return -1.0 / 3.0 * _series(x, lambda k: (2 * k + 1) / (2 * k * (2 * k - 1) * (2 * k + 3)))


def _sine_excess(x):
    return -x * (x * x) / 6.0 * _cubic_part(x)


def _lag(x):
    return x / 6.0 * _cubic_part(x)


def _lag_slope(x):
    return 1.0 / 6.0 * _series(x, lambda k: (2 * k + 1) / ((2 * k - 1) * (2 * k + 2) * (2 * k + 3)))


square = _function(np.square, _squared, lambda x: x * 2.0)  # never negative
reciprocal = _function(lambda x: 1.0 / x, _inverted, lambda x: -square(reciprocal(x)))
sin = _function(np.sin, _increasing, lambda x: cos(x))
cos = _function(np.cos, _even_decreasing, lambda x: -sin(x))
sinc = _function(_sinc, _even_decreasing, lambda x: sinc_slope(x))  # sin x / x
sinc_curvature = _function(_sinc_curvature, _even_increasing)
sinc_slope = _function(_sinc_slope, _decreasing, sinc_curvature)
sine_excess = _function(
    _sine_excess, _decreasing, lambda x: square(sin(x * 0.5)) * -2.0
)  # sin x - x
lag_slope = _function(_lag_slope, _even_decreasing)
lag = _function(_lag, _increasing, lag_slope)  # (x - sin x) / x^2


def sinc_change(x, step):
    """Give sinc(x + step) - sinc(x); over intervals it is zero where the step is, and so are its
    derivatives in x."""
    if isinstance(x, Dual):
        value, end = sinc_change(x.value, step.value), sinc_slope(x.value + step.value)
        return Dual(
            value,
            _change(sinc_slope, sinc_curvature, x.value, step.value) * x.gradient
            + end * step.gradient,
        )
    return _change(sinc, sinc_slope, x, step)


def _change(function, derivative, x, step):
    """Give function(x + step) - function(x), over intervals also by the mean value theorem."""
    end = x + step
    difference = function(end) - function(x)
    if not isinstance(x, Interval):
        return difference
    swept = Interval(np.minimum(x.lower, end.lower), np.maximum(x.upper, end.upper))
    return difference.intersect(step * derivative(swept))
