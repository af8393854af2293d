"""Sine and cosine together: as the library of the processor has them, at every size of angle."""

import jax
import jax.numpy as jnp
import mpmath
import numpy as np
import pytest

from jaxtube.plant.angles import sinc, sine_and_cosine

GENERATOR = np.random.default_rng(3)
SIZES = (1e-300, 1e-9, 0.1, 1.0, 10.0, 1e3, 1e5)


@pytest.mark.parametrize("size", SIZES)
def test_both_are_those_of_the_library(size):
    angles = size * GENERATOR.uniform(-1.0, 1.0, 4096)
    sine, cosine = jax.jit(sine_and_cosine)(angles)
    unit = 4 * np.finfo(float).eps
    np.testing.assert_allclose(sine, np.sin(angles), rtol=unit, atol=1e-21 * size)
    np.testing.assert_allclose(cosine, np.cos(angles), rtol=unit, atol=unit / 4)


def test_multiples_of_a_quarter_turn_lose_nothing():
    angles = np.arange(-64, 65) * np.pi / 2
    sine, cosine = sine_and_cosine(jnp.asarray(angles))
    with mpmath.workdps(40):
        exact_sine = [float(mpmath.sin(mpmath.mpf(angle))) for angle in angles]
        exact_cosine = [float(mpmath.cos(mpmath.mpf(angle))) for angle in angles]
    np.testing.assert_allclose(sine, exact_sine, rtol=1e-15, atol=1e-24)
    np.testing.assert_allclose(cosine, exact_cosine, rtol=1e-15, atol=1e-24)


def test_angles_without_meaning_stay_bounded_and_those_without_a_value_are_nan():
    sine, cosine = sine_and_cosine(jnp.array([1e9, -1e300, np.inf, np.nan]))
    both = np.stack([sine, cosine])
    assert np.all(np.abs(both[:, :2]) <= 1.0)
    assert np.all(np.isnan(both[:, 2:]))


def test_the_derivatives_are_cosine_and_minus_sine():
    angle = 2.7
    for order in (jax.jacfwd, jax.jacrev):
        slopes = order(sine_and_cosine)(angle)
        np.testing.assert_allclose(slopes, [np.cos(angle), -np.sin(angle)], rtol=1e-15)
    curvature = jax.hessian(lambda x: sine_and_cosine(x)[0])(angle)
    np.testing.assert_allclose(curvature, -np.sin(angle), rtol=1e-15)


def test_single_precision_is_the_one_of_the_platform():
    angles = jnp.linspace(-9.0, 9.0, 101, dtype=jnp.float32)
    sine, cosine = sine_and_cosine(angles)
    assert sine.dtype == cosine.dtype == jnp.float32
    np.testing.assert_allclose(sine, np.sin(angles), atol=2e-7)


@pytest.mark.parametrize("x", [0.0, 1e-8, 0.2999, 0.3001, 2.0, -7.5])
def test_sinc_and_its_slope(x):
    def exact(y):
        return mpmath.sin(y) / y if y else mpmath.mpf(1)

    with mpmath.workdps(50):
        value = float(exact(mpmath.mpf(x)))
        slope = float(mpmath.diff(exact, mpmath.mpf(x))) if x else 0.0
    found, found_slope = jax.value_and_grad(sinc)(x)
    np.testing.assert_allclose(found, value, rtol=4e-16)
    np.testing.assert_allclose(found_slope, slope, atol=1e-14)
