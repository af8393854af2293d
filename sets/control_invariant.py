"""The maximal robust control invariant set: errors that some input, chosen anew each step, keeps
within all limits.

    C_0 = E,    C_{k+1} = the intersection over i of
    {e in E : some u has  D u + C e <= d  and  A_i e + B_i u + W in C_k}

for a controller that knows the pair (A_i, B_i) of the present step and none of the later ones,
whose order is arbitrary. Every C_k contains the maximal set for the pairs given and, all the more,
for any larger family of pairs; the sequence has converged where C_{k+1} = C_k. Each predecessor is
a polytope in (e, u) projected along u by its vertices.

Source: Bertsekas and Rhodes 1971; Kerrigan 2000, chapter 2; Blanchini 1999.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from sets.polytope import ConvexSet, Polytope, support_function

SETTLED = 1e-3
"""The sequence counts as converged where C_k lies in (1 + this) C_{k+1}: then that set is kept but
for this share."""

STEPS = 30
"""Steps after which the sequence ends, settled or not."""


@dataclass(frozen=True)
class ControlInvariant:
    """C_k of the last step, None where it is empty or flat; `volumes` of C_0 .. C_k, and whether
    they have settled."""

    polytope: Polytope | None
    volumes: tuple[float, ...]
    settled: bool


@dataclass(frozen=True, eq=False)
class Limits:
    """Constraints  inputs u + errors e <= offsets."""

    inputs: Float[np.ndarray, "k m"]
    errors: Float[np.ndarray, "k n"]
    offsets: Float[np.ndarray, " k"]


def maximal_rci(
    transitions: Float[np.ndarray, "v n n"],
    inputs: Float[np.ndarray, "v n m"],
    error_set: Polytope,
    limits: Limits,
    disturbance: ConvexSet,
) -> ControlInvariant:
    """Iterate C_k until it settles or `STEPS` are done.

    Args:
        transitions, inputs: the pairs (A_i, B_i).
        error_set: bounded, 0 inside.
        limits: bound the inputs from all sides.
        disturbance: W by its support numbers.

    Returns:
        A set that contains the maximal robust control invariant set; equal to it where the sequence
        ends exactly.

    Raises:
        ValueError: the inputs are unbounded.
    """
    support = support_function(disturbance, "disturbance")
    current = error_set
    volumes = [error_set.volume()]
    while len(volumes) <= STEPS:
        target = Polytope(current.normals, current.offsets - support(current.normals))
        following = error_set
        try:
            for A, B in zip(transitions, inputs, strict=True):
                following = following.intersect(predecessor(A, B, target, error_set, limits))
        except ArithmeticError:
            # Late in the sequence hundreds of facets hardly differ; the last set still contains
            # the maximal one.
            return ControlInvariant(current, tuple(volumes), False)
        if following.is_empty() or following.is_flat():
            return ControlInvariant(None, (*volumes, 0.0), True)
        following = following.reduce()
        volumes.append(following.volume())
        reach = current.support(following.normals)
        if np.all(reach <= (1 + SETTLED) * following.offsets):
            return ControlInvariant(following, tuple(volumes), True)
        current = following
    return ControlInvariant(current, tuple(volumes), False)


def predecessor(
    A: Float[np.ndarray, "n n"],
    B: Float[np.ndarray, "n m"],
    target: Polytope,
    within: Polytope,
    limits: Limits,
) -> Polytope:
    """Return {e in `within` : some u has  D u + C e <= d  and  A e + B u in the target}."""
    n, m = B.shape
    rows = [
        np.hstack([target.normals @ A, target.normals @ B]),
        np.hstack([limits.errors, limits.inputs]),
        np.hstack([within.normals, np.zeros((len(within.offsets), m))]),
    ]
    offsets = np.concatenate([target.offsets, limits.offsets, within.offsets])
    joint = Polytope(np.concatenate(rows), offsets)
    return joint.image(np.eye(n, n + m))
