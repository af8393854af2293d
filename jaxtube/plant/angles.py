"""Sine and cosine of an angle together, and sin(x) / x: fast where arrays of angles are long.

A processor calls its mathematical library for every float64 sine, one number at a time; the
polynomials here run over several numbers at once and are as exact, to two units in the last place.

    x = k pi/2 + r,  |r| <= pi/4      sin r and cos r by polynomials, their places and signs by k

The product of k with the leading 33 bits of pi/2 is exact up to |k| = 2^20; beyond some 1.6e6 rad
the angle that is meant is lost in rounding, and so is the answer's meaning, not its size.

Source: the polynomials and the splitting of pi/2 are those of fdlibm (Ng 1992, k_sin.c, k_cos.c,
e_rem_pio2.c); the reduction is that of Cody and Waite 1980, Software Manual for the Elementary
Functions, chapter 8.
"""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Float

SERIES_END = 0.3
"""Angle in rad below which `sinc` is a series: its first term left out is below 1e-16 there."""

PI_HALF_HEAD = 1.57079632673412561417
"""The leading 33 bits of pi/2."""
PI_HALF_TAIL = 6.07710050650619224932e-11
"""The rest."""
FARTHEST = 0.8
"""Just above pi/4, which remainders do not leave but by the rounding of angles without meaning."""

SINE = (
    -1.66666666666666324348e-01,
    8.33333333332248946124e-03,
    -1.98412698298579493134e-04,
    2.75573137070700676789e-06,
    -2.50507602534068634195e-08,
    1.58969099521155010221e-10,
)
"""(sin r - r) / r^3 by powers of r^2."""
COSINE = (
    4.16666666666666019037e-02,
    -1.38888888888741095749e-03,
    2.48015872894767294178e-05,
    -2.75573143513906633035e-07,
    2.08757232129817482790e-09,
    -1.13596475577881948265e-11,
)
"""(cos r - 1 + r^2 / 2) / r^4 by powers of r^2."""


@jax.custom_jvp
def sine_and_cosine(angle: Float[Array, "..."]) -> tuple[Float[Array, "..."], Float[Array, "..."]]:
    """Return (sin, cos) of an angle in rad; NaN for what is not finite."""
    if angle.dtype != jnp.float64:
        return jnp.sin(angle), jnp.cos(angle)
    quarter_turns = jnp.round(angle * (2 / np.pi))
    rest = (angle - quarter_turns * PI_HALF_HEAD) - quarter_turns * PI_HALF_TAIL
    rest = jnp.clip(rest, -FARTHEST, FARTHEST)
    square = rest * rest
    sine = rest + rest * square * _polynomial(SINE, square)
    cosine = 1.0 - (square / 2 - square * square * _polynomial(COSINE, square))
    quarter = quarter_turns.astype(jnp.int32)
    is_odd = (quarter & 1) == 1
    sine_sign = jnp.where((quarter & 2) == 0, 1.0, -1.0)
    cosine_sign = jnp.where(((quarter + 1) & 2) == 0, 1.0, -1.0)
    return (
        sine_sign * jnp.where(is_odd, cosine, sine),
        cosine_sign * jnp.where(is_odd, sine, cosine),
    )


@sine_and_cosine.defjvp
def _differentiate(primals, tangents):
    (angle,) = primals
    (tangent,) = tangents
    sine, cosine = sine_and_cosine(angle)
    return (sine, cosine), (cosine * tangent, -sine * tangent)


def sinc(
    x: Float[Array, "..."],
    known: tuple[Float[Array, "..."], Float[Array, "..."]] | None = None,
) -> Float[Array, "..."]:
    """Return sin(x) / x, x in rad; the value is exact to rounding, the derivative
    to 1e-14 absolute, also near zero.

    Args:
        x: in rad.
        known: (sine, cosine) of x, where these are known.
    """
    return _sinc(x, *(sine_and_cosine(x) if known is None else known))


@jax.custom_jvp
def _sinc(x, sine, cosine) -> Float[Array, "..."]:
    is_near = jnp.abs(x) < SERIES_END
    square = jnp.where(is_near, x, 0.0) ** 2
    series = 1.0 - square / 6.0 * (
        1.0 - square / 20.0 * (1.0 - square / 42.0 * (1.0 - square / 72.0 * (1.0 - square / 110.0)))
    )
    return jnp.where(is_near, series, sine / jnp.where(is_near, 1.0, x))


@_sinc.defjvp
def _differentiate_sinc(primals, tangents):
    x, _, cosine = primals
    # Sine and cosine change with x alone.
    tangent, *_ = tangents
    ratio = _sinc(*primals)
    is_near = jnp.abs(x) < SERIES_END
    near = jnp.where(is_near, x, 0.0)
    square = near**2
    series = (
        -near
        / 3.0
        * (
            1.0
            - square / 10.0 * (1.0 - square / 28.0 * (1.0 - square / 54.0 * (1.0 - square / 88.0)))
        )
    )
    slope = jnp.where(is_near, series, (cosine - ratio) / jnp.where(is_near, 1.0, x))
    return ratio, slope * tangent


def _polynomial(coefficients: tuple[float, ...], x: Float[Array, "..."]) -> Float[Array, "..."]:
    """Return the sum of coefficients[i] x^i."""
    *lower, last = coefficients
    value = jnp.full_like(x, last)
    for coefficient in reversed(lower):
        value = value * x + coefficient
    return value
