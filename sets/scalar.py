"""Robust positively invariant intervals of scalar loops x+ = phi_i x + w, w in W.

An interval -a <= x <= b is invariant when for every loop

    phi b + w_max <= b  and  phi a - w_min <= a      where phi >= 0,
    |phi| a + w_max <= b  and  |phi| b - w_min <= a  where phi < 0,

so that each bound that is missed gives way to what the others leave of it, until none is missed.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from sets.invariant import INFLATION, MOST_ITERATIONS, MaximalRpi
from sets.polytope import ConvexSet, Polytope, support_function


def maximal_interval(
    loops: Float[np.ndarray, "v 1 1"], constraints: Polytope, disturbance: ConvexSet
) -> MaximalRpi:
    """Return the maximal robust positively invariant interval inside constraints that hold the
    origin, or that none was found.

    As `sets.invariant.maximal_rpi`, for one dimension; an escape is not told.
    """
    ends = np.array([[1.0], [-1.0]])
    limits = constraints.support(ends)
    pushes = (1 + INFLATION) * support_function(disturbance, "disturbance")(ends)
    factors = loops[:, 0, 0]
    for iteration in range(MOST_ITERATIONS):
        if np.any(limits < pushes):
            return MaximalRpi(None, None, iteration)
        before = limits
        for factor in factors[factors != 0]:
            # What is left of both ends once w is taken off, by the end that the loop maps to it.
            left = (limits - pushes) / abs(factor)
            limits = np.minimum(limits, left if factor > 0 else left[::-1])
        if np.all(limits == before):
            return MaximalRpi(Polytope(ends, limits), None, iteration)
    return MaximalRpi(None, None, MOST_ITERATIONS)
