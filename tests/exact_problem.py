"""A problem with decoupled gains that is certified: what the tests of the exact check share."""

import math
from fractions import Fraction
from functools import cache
from itertools import product

import numpy as np

from sets.exact import exact_row
from sets.invariant import maximal_rpi
from sets.polytope import Polytope
from sets.robot.exact_tube import exact_vertex_feedbacks, exact_vertex_loops, schedule_box

DT = 0.1
WIDTH = 0.5
GAINS = (3.0, 6.5, 6.5)
HORIZON = 5
SLOW = 1.224
FAST = 1.496
BOX = schedule_box((SLOW, SLOW), (FAST, FAST), DT, WIDTH)
LOOPS = exact_vertex_loops(GAINS, BOX, DT)
FEEDBACKS = exact_vertex_feedbacks(GAINS, BOX)
KICK = (Fraction(0), Fraction(0.0208) * Fraction(0.068), Fraction(0.0208))
NOISE = exact_row((8.90e-3, 19.26e-3, math.radians(0.04)))
W = [tuple(sign * kick + side * width for kick, side, width in zip(KICK, sides, NOISE, strict=True))
     for sign in (-1, 1) for sides in product((-1, 1), repeat=3)]  # fmt: skip
POINTS = np.array(W, dtype=float)
E = (np.vstack([np.eye(3), -np.eye(3)]), np.tile([0.12, 0.28, math.radians(18)], 2))
U = (np.vstack([np.eye(2), -np.eye(2)]), np.array([0.40, 0.9, 0.27, 0.9]))
STEP = 1e-6  # every further stage of the plan is backed off by as much more
Q = np.diag([1.0, 3.0, 1.0])
R = 0.3 * np.eye(2)


def floats(matrices) -> np.ndarray:
    return np.array(matrices, dtype=float)


def maximal(loops: np.ndarray, room: float) -> Polytope:
    """The maximal set inside constraints backed off by `room`, for W and a ball of twenty times
    that."""
    rows = np.vstack([E[0], *(U[0] @ gain for gain in floats(FEEDBACKS))])
    offsets = np.concatenate([E[1], U[1], U[1]]) - room * (1 + np.linalg.norm(rows, axis=1))

    def disturbance(normals):
        return np.max(normals @ POINTS.T, axis=1) + 20 * room * np.linalg.norm(normals, axis=1)

    found = maximal_rpi(loops, Polytope(rows, offsets), disturbance).polytope
    assert found is not None
    return found


@cache
def invariant(room: float) -> Polytope:
    """The same for the four loops of turn and speed apart."""
    return maximal(floats(LOOPS), room)


OMEGA = invariant(1e-10)
