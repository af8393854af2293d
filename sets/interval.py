"""Interval arithmetic and forward-mode derivatives, over arrays.

    Interval   [lower, upper]       every operation encloses the exact results for all members
    Dual       (value, gradient)    derivatives by the chain rule, over floats or intervals alike

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
"""Unit in the last place, relative."""

TINY = 1e-300
"""Above every error of underflow, yet a normal number, so that products of it cost no more than
others."""

UNITS = 16
"""Units in the last place granted to functions of an angle."""

QUARTER_TURN = np.pi / 2
"""Limit of every angle, rad."""


def _round_outwards(lower, upper, units: int = 1) -> Interval:
    """Enclose ends that are known to some units in the last place."""
    share = units * EPSILON
    return Interval(
        lower - (np.abs(lower) * share + TINY),
        upper + (np.abs(upper) * share + TINY),
    )


class Interval:
    """Arrays of closed intervals; a float operand stands for that very number."""

    __slots__ = ("lower", "upper")
    __array_ufunc__ = None  # an array on the left leaves the operation to this class

    def __init__(self, lower: Float[np.ndarray, "..."], upper: Float[np.ndarray, "..."]):
        self.lower = lower
        self.upper = upper

    def __neg__(self) -> Interval:
        return Interval(-self.upper, -self.lower)

    def __add__(self, other) -> Interval:
        if isinstance(other, Interval):
            return _round_outwards(self.lower + other.lower, self.upper + other.upper)
        return _round_outwards(self.lower + other, self.upper + other)

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
            return _round_outwards(lower, upper)
        return _enclose_ends(self.lower * other, self.upper * other)

    __radd__ = __add__
    __rmul__ = __mul__

    def __truediv__(self, other) -> Interval:
        if isinstance(other, Interval):
            return self * reciprocal(other)
        return _enclose_ends(self.lower / other, self.upper / other)

    def __rtruediv__(self, other) -> Interval:
        return reciprocal(self) * other

    def intersect(self, other: Interval) -> Interval:
        """Return what two enclosures of the same numbers have in common."""
        return Interval(np.maximum(self.lower, other.lower), np.minimum(self.upper, other.upper))

    @property
    def magnitudes(self) -> tuple[Float[np.ndarray, "..."], Float[np.ndarray, "..."]]:
        """Least and largest absolute value of the members."""
        near = np.maximum(np.maximum(self.lower, -self.upper), 0.0)
        far = np.maximum(-self.lower, self.upper)
        return near, far


def _enclose_ends(one, other) -> Interval:
    """Enclose two ends in either order."""
    return _round_outwards(np.minimum(one, other), np.maximum(one, other))


class Dual:
    """Values with their gradients: value (cells,), gradient (variables, cells), both float arrays
    or both intervals."""

    __slots__ = ("gradient", "value")
    __array_ufunc__ = None

    def __init__(self, value, gradient):
        self.value = value
        self.gradient = gradient

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
            gradient = self.value * other.gradient + other.value * self.gradient
            return Dual(self.value * other.value, gradient)
        return Dual(self.value * other, self.gradient * other)

    __radd__ = __add__
    __rmul__ = __mul__

    def __truediv__(self, other) -> Dual:
        if isinstance(other, Dual):
            return self * reciprocal(other)
        return Dual(self.value / other, self.gradient / other)

    def __rtruediv__(self, other) -> Dual:
        return reciprocal(self) * other


def _enclose_increasing(function, x: Interval) -> Interval:
    _check_angle(x)
    return _round_outwards(function(x.lower), function(x.upper), UNITS)


def _enclose_decreasing(function, x: Interval) -> Interval:
    _check_angle(x)
    return _round_outwards(function(x.upper), function(x.lower), UNITS)


def _enclose_even_decreasing(function, x: Interval) -> Interval:
    """Enclose an even function that decreases with the magnitude."""
    _check_angle(x)
    near, far = x.magnitudes
    return _round_outwards(function(far), function(near), UNITS)


def _enclose_even_increasing(function, x: Interval) -> Interval:
    """Enclose an even function that increases with the magnitude."""
    _check_angle(x)
    near, far = x.magnitudes
    return _round_outwards(function(near), function(far), UNITS)


def _check_angle(x: Interval) -> None:
    """Refuse angles beyond a quarter turn."""
    if np.any(x.lower < -QUARTER_TURN) or np.any(x.upper > QUARTER_TURN):
        low = np.min(x.lower)
        high = np.max(x.upper)
        raise ValueError(
            f"angle: [{low:.3f}, {high:.3f}] rad leaves +-pi/2; "
            "shrink errors, inputs, schedule or dt"
        )


def _enclose_square(_, x: Interval) -> Interval:
    near, far = x.magnitudes
    enclosure = _round_outwards(near * near, far * far)
    return Interval(np.maximum(enclosure.lower, 0.0), enclosure.upper)


def _enclose_reciprocal(_, x: Interval) -> Interval:
    if np.any((x.lower <= 0) & (x.upper >= 0)):
        raise ValueError("divisor: an interval holds 0; shrink errors, inputs, schedule or dt")
    return _round_outwards(1.0 / x.upper, 1.0 / x.lower)


def _make_function(on_floats, enclose, derivative: Any = None) -> Callable[[Any], Any]:
    """Make a function of floats, intervals and duals from its values, its enclosure and its
    derivative."""

    def function(x):
        if isinstance(x, Dual):
            return Dual(function(x.value), derivative(x.value) * x.gradient)
        return enclose(on_floats, x) if isinstance(x, Interval) else on_floats(x)

    return function


def _series(x: Float[np.ndarray, "..."], ratio: Callable[[int], float]) -> Float[np.ndarray, "..."]:
    """Return 1 - r_1 y (1 - r_2 y (1 - ...)), y = x^2, with r_k = ratio(k), to 8 units in the last
    place.

    Within a quarter turn r_k y is below 0.2 for k > 1, so that each level damps the rounding of the
    one below it, and the terms left out are below 1e-17 of the sum.
    """
    y = x * x
    total = 1.0
    for k in range(12, 0, -1):
        total = 1.0 - y * (ratio(k) * total)
    return np.asarray(total)


def _cubic_part(x) -> Float[np.ndarray, "..."]:
    """Return 6 (x - sin x) / x^3."""
    return _series(x, lambda k: 1.0 / ((2 * k + 2) * (2 * k + 3)))


def _sinc(x) -> Float[np.ndarray, "..."]:
    return 1.0 - x * x / 6.0 * _cubic_part(x)


def _sinc_slope(x) -> Float[np.ndarray, "..."]:
    return -x / 3.0 * _series(x, lambda k: 1.0 / (2 * k * (2 * k + 3)))


def _sinc_curvature(x) -> Float[np.ndarray, "..."]:
    return -1.0 / 3.0 * _series(x, lambda k: (2 * k + 1) / (2 * k * (2 * k - 1) * (2 * k + 3)))


def _sine_excess(x) -> Float[np.ndarray, "..."]:
    return -x * (x * x) / 6.0 * _cubic_part(x)


def _lag(x) -> Float[np.ndarray, "..."]:
    return x / 6.0 * _cubic_part(x)


def _lag_slope(x) -> Float[np.ndarray, "..."]:
    return 1.0 / 6.0 * _series(x, lambda k: (2 * k + 1) / ((2 * k - 1) * (2 * k + 2) * (2 * k + 3)))


square = _make_function(np.square, _enclose_square, lambda x: x * 2.0)
"""x^2, never negative."""

reciprocal = _make_function(
    lambda x: 1.0 / x, _enclose_reciprocal, lambda x: -square(reciprocal(x))
)
"""1 / x, refused where an interval holds 0."""

sin = _make_function(np.sin, _enclose_increasing, lambda x: cos(x))
cos = _make_function(np.cos, _enclose_even_decreasing, lambda x: -sin(x))

sinc = _make_function(_sinc, _enclose_even_decreasing, lambda x: sinc_slope(x))
"""sin x / x."""

sinc_curvature = _make_function(_sinc_curvature, _enclose_even_increasing)
sinc_slope = _make_function(_sinc_slope, _enclose_decreasing, sinc_curvature)

sine_excess = _make_function(
    _sine_excess, _enclose_decreasing, lambda x: square(sin(x * 0.5)) * -2.0
)
"""sin x - x."""

lag_slope = _make_function(_lag_slope, _enclose_even_decreasing)
lag = _make_function(_lag, _enclose_increasing, lag_slope)
"""(x - sin x) / x^2."""


def sinc_change(x, step) -> Any:
    """Return sinc(x + step) - sinc(x); over intervals it is zero where the step is, and so are its
    derivatives in x."""
    if not isinstance(x, Dual):
        return _compute_change(sinc, sinc_slope, x, step)
    value = sinc_change(x.value, step.value)
    slope_change = _compute_change(sinc_slope, sinc_curvature, x.value, step.value)
    end_slope = sinc_slope(x.value + step.value)
    return Dual(value, slope_change * x.gradient + end_slope * step.gradient)


def _compute_change(function, derivative, x, step) -> Any:
    """Return function(x + step) - function(x), over intervals also by the mean value theorem."""
    end = x + step
    difference = function(end) - function(x)
    if not isinstance(x, Interval):
        return difference
    swept = Interval(np.minimum(x.lower, end.lower), np.maximum(x.upper, end.upper))
    return difference.intersect(step * derivative(swept))
