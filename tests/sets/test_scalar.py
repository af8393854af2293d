"""Laws of invariant intervals."""

import numpy as np
import pytest

from sets.polytope import Polytope
from sets.scalar import maximal_interval


def step_worst(factor, interval, w):
    """Return the ends of what an interval becomes."""
    low, high = sorted(factor * end for end in interval)
    return low + w[0], high + w[1]


@pytest.mark.parametrize("factors", [(0.5,), (-0.9,), (0.8, -0.6), (1.2, 0.5), (0.0,), (-1.1,)])
@pytest.mark.parametrize("w", [(-0.1, 0.2), (-0.05, 0.05), (0.0, 0.0)])
def test_the_maximal_interval_is_invariant_and_no_greater_one_on_a_grid_is(factors, w):
    limits = (-2.0, 3.0)
    loops = np.reshape(factors, (-1, 1, 1))
    W = Polytope.box(np.array([w[0]]), np.array([w[1]]))
    constraints = Polytope.box(np.array([limits[0]]), np.array([limits[1]]))
    found = maximal_interval(loops, constraints, W).polytope

    def is_invariant(interval):
        for factor in factors:
            low, high = step_worst(factor, interval, w)
            if low < interval[0] - 1e-9 or high > interval[1] + 1e-9:
                return False
        return True

    lows = np.linspace(limits[0], 0, 41)
    highs = np.linspace(0, limits[1], 61)
    invariant = [(low, high) for low in lows for high in highs if is_invariant((low, high))]
    if found is None:
        assert not set(invariant) - {(0.0, 0.0)}  # the origin alone is no interval
        return
    high, low = found.support(np.array([[1.0], [-1.0]])) * [1, -1]
    assert is_invariant((low, high))
    assert all(low <= one + 1e-5 and high >= other - 1e-5 for one, other in invariant)
