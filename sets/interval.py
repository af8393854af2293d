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
    unit = 1
    """Of the ends, in 1."""
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
        return type(self)(np.maximum(self.lower, other.lower), np.minimum(self.upper, other.upper))

    def invert(self) -> Interval:
        """Enclose 1 / x, x of one sign."""
        return _round_outwards(1.0 / self.upper, 1.0 / self.lower)

    def enclose(self, name: str, low, high) -> Interval:
        """Enclose a function of an angle between its values at two points."""
        function = _ON_FLOATS[name]
        return _round_outwards(function(low), function(high), UNITS)

    @property
    def magnitudes(self) -> tuple[Float[np.ndarray, "..."], Float[np.ndarray, "..."]]:
        """Least and largest absolute value of the members."""
        near = np.maximum(np.maximum(self.lower, -self.upper), 0)
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


def _enclose_increasing(name: str, x: Interval) -> Interval:
    _check_angle(x)
    return x.enclose(name, x.lower, x.upper)


def _enclose_decreasing(name: str, x: Interval) -> Interval:
    _check_angle(x)
    return x.enclose(name, x.upper, x.lower)


def _enclose_even_decreasing(name: str, x: Interval) -> Interval:
    """Enclose an even function that decreases with the magnitude."""
    _check_angle(x)
    near, far = x.magnitudes
    return x.enclose(name, far, near)


def _enclose_even_increasing(name: str, x: Interval) -> Interval:
    """Enclose an even function that increases with the magnitude."""
    _check_angle(x)
    near, far = x.magnitudes
    return x.enclose(name, near, far)


def _check_angle(x: Interval) -> None:
    """Refuse angles beyond a quarter turn."""
    limit = QUARTER_TURN * x.unit
    if np.any(x.lower < -limit) or np.any(x.upper > limit):
        low = np.min(x.lower) / x.unit
        high = np.max(x.upper) / x.unit
        raise ValueError(
            f"angle: [{low:.3f}, {high:.3f}] rad leaves +-pi/2; "
            "shrink errors, inputs, schedule or dt"
        )


def _enclose_square(_, x: Interval) -> Interval:
    near, far = x.magnitudes
    of_near = type(x)(near, near) * type(x)(near, near)
    of_far = type(x)(far, far) * type(x)(far, far)
    return type(x)(np.maximum(of_near.lower, 0), of_far.upper)


def _enclose_reciprocal(_, x: Interval) -> Interval:
    if np.any((x.lower <= 0) & (x.upper >= 0)):
        raise ValueError("divisor: an interval holds 0; shrink errors, inputs, schedule or dt")
    return x.invert()


def _make_function(name: str, enclose, derivative: Any = None) -> Callable[[Any], Any]:
    """Make a function of floats, intervals and duals from its enclosure and its derivative."""

    def function(x):
        if isinstance(x, Dual):
            return Dual(function(x.value), derivative(x.value) * x.gradient)
        if hasattr(x, "apply"):  # a deferred number
            return x.apply(function)
        return enclose(name, x) if isinstance(x, Interval) else _ON_FLOATS[name](x)

    function.__name__ = name
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


_ON_FLOATS: dict[str, Callable] = {
    "square": np.square,
    "reciprocal": lambda x: 1.0 / x,
    "sin": np.sin,
    "cos": np.cos,
    "tan": np.tan,
    "sinc": _sinc,
    "sinc_slope": _sinc_slope,
    "sinc_curvature": _sinc_curvature,
    "sine_excess": _sine_excess,
    "lag": _lag,
    "lag_slope": _lag_slope,
}

square = _make_function("square", _enclose_square, lambda x: x * 2.0)
"""x^2, never negative."""

reciprocal = _make_function("reciprocal", _enclose_reciprocal, lambda x: -square(reciprocal(x)))
"""1 / x, refused where an interval holds 0."""

sin = _make_function("sin", _enclose_increasing, lambda x: cos(x))
cos = _make_function("cos", _enclose_even_decreasing, lambda x: -sin(x))
tan = _make_function("tan", _enclose_increasing, lambda x: square(reciprocal(cos(x))))

sinc = _make_function("sinc", _enclose_even_decreasing, lambda x: sinc_slope(x))
"""sin x / x."""

sinc_curvature = _make_function("sinc_curvature", _enclose_even_increasing)
sinc_slope = _make_function("sinc_slope", _enclose_decreasing, sinc_curvature)

sine_excess = _make_function(
    "sine_excess", _enclose_decreasing, lambda x: square(sin(x * 0.5)) * -2.0
)
"""sin x - x."""

lag_slope = _make_function("lag_slope", _enclose_even_decreasing)
lag = _make_function("lag", _enclose_increasing, lag_slope)
"""(x - sin x) / x^2."""


def sinc_change(x, step) -> Any:
    """Return sinc(x + step) - sinc(x); over intervals it is zero where the step is, and so are its
    derivatives in x."""
    if hasattr(x, "apply"):  # a deferred number
        return x.apply(sinc_change, step)
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
    swept = type(x)(np.minimum(x.lower, end.lower), np.maximum(x.upper, end.upper))
    return difference.intersect(step * derivative(swept))
