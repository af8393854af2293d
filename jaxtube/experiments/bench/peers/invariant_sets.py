"""Maximal robust invariant sets by the package `polytope`: the textbook's iteration with its
reduction and its test of inclusion.

    O_0 = constraints,   O_{k+1} = O_k and {x : Phi_i x + (1 + INFLATION) W in O_k for every i}

until O_k lies in O_{k+1}. Supports of W are those of `sets`: `polytope` reduces, and tests.

Source: Kolmanovsky and Gilbert 1998, algorithm 6.2; Filippidis et al., `polytope` (TuLiP).
"""

from __future__ import annotations

import importlib
import importlib.util
import logging
import time
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from sets.invariant import INFLATION, PRUNING
from sets.polytope import ConvexSet, Polytope, support_function

CURE = "not installed: pip install polytope"


class PeerSet(NamedTuple):
    """What the iteration came to: the set where it ended, None where it was stopped; steps, and
    seconds of this process."""

    polytope: Polytope | None
    steps: int
    seconds: float


def is_installed() -> bool:
    """Return whether `polytope` is there."""
    return importlib.util.find_spec("polytope") is not None


def find_maximal_rpi(
    loops: Float[np.ndarray, "v n n"],
    constraints: Polytope,
    disturbance: ConvexSet,
    longest_s: float,
) -> PeerSet:
    """Return the largest robust invariant set inside constraints, by `polytope`.

    Args:
        loops, constraints, disturbance: as of `sets.invariant.maximal_rpi`.
        longest_s: seconds after which no further step is begun.
    """
    # It would tell that it has no other solver of linear programs.
    logging.getLogger("polytope").setLevel(logging.ERROR)
    polytope: Any = importlib.import_module("polytope")
    support = support_function(disturbance, "disturbance")
    begin = time.process_time()
    given = polytope.Polytope(constraints.normals, constraints.offsets)
    current = polytope.reduce(given, abs_tol=PRUNING)
    steps = 0
    while time.process_time() - begin < longest_s:
        steps += 1
        room = current.b - (1 + INFLATION) * support(current.A)
        normals = np.concatenate([current.A, *(current.A @ loop for loop in loops)])
        offsets = np.concatenate([current.b, *[room] * len(loops)])
        following = polytope.reduce(polytope.Polytope(normals, offsets), abs_tol=PRUNING)
        if polytope.is_subset(current, following, abs_tol=PRUNING):
            found = Polytope(following.A, following.b)
            return PeerSet(found, steps, time.process_time() - begin)
        current = following
    return PeerSet(None, steps, time.process_time() - begin)
