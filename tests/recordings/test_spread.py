"""Laws of robust spreads: scipy's median absolute deviation, about zero."""

import numpy as np
import pytest
from scipy.stats import median_abs_deviation

from jaxtube.recordings.spread import find_spread


@pytest.mark.parametrize("axis", [None, 0, 1])
def test_a_spread_about_zero_is_that_of_scipy(axis):
    misses = np.random.default_rng(0).normal(0.3, 2.0, (40, 3))
    expected = median_abs_deviation(
        misses, axis=axis, center=lambda values, axis: 0.0 * values.mean(axis), scale="normal"
    )
    np.testing.assert_allclose(find_spread(misses, axis), expected, rtol=2e-6)


def test_a_spread_is_the_standard_deviation_of_normal_numbers_whatever_a_few_are():
    misses = np.random.default_rng(0).normal(0.0, 2.0, 100_000)
    misses[:50] = 1e9
    assert find_spread(misses) == pytest.approx(2.0, rel=0.02)
