"""What a motion adds to a linear model, bounded by intervals.

    W holds f(x, u, th, d) - A(th) x - B(th) u    for all x in E, u in U, d in D and every th

The hull is found by subdivision in outward-rounded intervals (`sets.supremum`), so W is proved, not
sampled.

Source: Moore, Kearfott, Cloud 2009, Introduction to Interval Analysis, chapters 5 and 6.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float

from jaxtube.scenario.refusal import ScenarioError
from jaxtube.systems.checks import refuse
from jaxtube.systems.motion import Motion, mix
from sets.polytope import Polytope
from sets.supremum import suprema

TOLERANCE = 0.01
"""Relative gap at which a bound is taken."""
PIECES = 4
"""Pieces that each share of a mixture is cut into at first: over all mixtures at once a weighted
sum of positive numbers, such as a speed or a length, would seem to reach 0."""
NEGLIGIBLE = 1e-12
"""Gap at which it is taken anyway, as a share of E."""


@dataclass(frozen=True, eq=False)
class Claim:
    """What a proof is about: a motion beside the vertices of a model, over E and U."""

    motion: Motion
    A: Float[np.ndarray, "v n n"]
    B: Float[np.ndarray, "v n m"]
    E: Polytope
    U: Polytope

    @property
    def arrays(self) -> tuple[np.ndarray, ...]:
        """All its numbers but those of the motion."""
        return (
            self.A,
            self.B,
            self.E.normals,
            self.E.offsets,
            self.U.normals,
            self.U.offsets,
        )


@dataclass(frozen=True, eq=False)
class Proof:
    """What is proved of a motion beside a linear model, over limits.

    Attributes:
        disturbance_set: holds all that the motion adds to the model.
        claim: what it is about.
    """

    disturbance_set: Polytope
    claim: Claim

    @classmethod
    def of(cls, claim: Claim) -> Proof:
        """Prove what a motion adds to a model."""
        return cls(prove_disturbance(claim), claim)

    def is_of(self, claim: Claim) -> bool:
        """Whether it is about the same motion, model and limits."""
        same = map(np.array_equal, self.claim.arrays, claim.arrays)
        return self.claim.motion is claim.motion and all(same)


def prove_disturbance(claim: Claim) -> Polytope:
    """Return the least box, to 1 %, that is proved to hold what a motion adds to a linear model.

    Raises:
        ScenarioError: where an operation of the function cannot be bounded over E and U, or it
            returns another number of states.
    """
    motion = claim.motion
    states = claim.E.dimension
    lower, upper = _find_boxes(claim)
    sizes = claim.E.support(np.eye(states))

    def add_to_model(variables: Sequence[Any]) -> list[Any]:
        x, u, th, d = _split(claim, variables)
        following = motion.function(x, u, th, d)
        if len(following) != states:
            raise refuse(
                "motion", len(following), "is how many states it returns", f"give {states}"
            )
        predicted = _predict(claim, x, u, th)
        nothing = variables[0] * 0.0  # makes a number with a gradient of one that is constant
        # In shares of E, so that what is negligible has no unit.
        return [
            (moved - model + nothing) / float(size)
            for moved, model, size in zip(following, predicted, sizes, strict=True)
        ]

    objectives = [(row, sign, 2 * row + (sign < 0)) for row in range(states) for sign in (1, -1)]
    try:
        bounds, _ = suprema(add_to_model, lower, upper, objectives, TOLERANCE, NEGLIGIBLE)
    except ScenarioError:
        raise
    except ValueError as error:
        cannot = f"cannot be bounded ({error})"
        raise refuse("motion", "f(x, u, th, d)", cannot, "narrow E, U or D") from None
    except (TypeError, AttributeError) as error:
        cannot = f"cannot be bounded: intervals do not have what it does ({error})"
        cure = "use +, -, *, / and sin, cos, tan, sinc, square, reciprocal of sets.interval"
        raise refuse("motion", "f(x, u, th, d)", cannot, cure) from None
    # W holds the origin, the case of a motion that is its model.
    greatest = np.maximum(bounds[0::2], 0.0) * sizes
    least = np.maximum(bounds[1::2], 0.0) * sizes
    return Polytope.box(np.nextafter(-least, -np.inf), np.nextafter(greatest, np.inf))


def _find_boxes(
    claim: Claim,
) -> tuple[Float[np.ndarray, "variables boxes"], Float[np.ndarray, "variables boxes"]]:
    """Return boxes of all variables, x, u, s, d: together they hold E and U and every mixture."""
    shares = len(claim.A) - 1
    upper = []
    lower = []
    for polytope in (claim.E, claim.U):
        identity = np.eye(polytope.dimension)
        upper.append(polytope.support(identity))
        lower.append(-polytope.support(-identity))
    least = np.concatenate([*lower, np.zeros(shares), -claim.motion.uncertainty])
    most = np.concatenate([*upper, np.ones(shares), claim.motion.uncertainty])
    # Cut are the shares that are known, and those that are uncertain, which come last.
    first = claim.E.dimension + claim.U.dimension
    cut = [*range(first, first + shares), *range(len(least) - claim.motion.shares, len(least))]
    count = PIECES ** len(cut)
    pieces = np.reshape(list(itertools.product(range(PIECES), repeat=len(cut))), (count, len(cut)))
    below = np.repeat(least[:, None], count, axis=1)
    above = np.repeat(most[:, None], count, axis=1)
    # Quarters are exact, so that no number is left between two pieces.
    quarter = (most - least)[cut, None] / PIECES
    below[cut] = least[cut, None] + quarter * pieces.T
    above[cut] = least[cut, None] + quarter * (pieces.T + 1)
    return below, above


def _split(claim: Claim, variables: Sequence[Any]) -> tuple[list, ...]:
    """Return x, u, th and d."""
    ends = np.cumsum([claim.E.dimension, claim.U.dimension, len(claim.A) - 1])
    first = [0, *ends.tolist()]
    last = [*ends.tolist(), len(variables)]
    parts = [list(variables[a:b]) for a, b in zip(first, last, strict=True)]
    return parts[0], parts[1], mix(parts[2]), parts[3]


def _predict(claim: Claim, x: Sequence[Any], u: Sequence[Any], th: Sequence[Any]) -> list[Any]:
    """Return A(th) x + B(th) u; th counts only in rows that depend on it."""
    values = [*x, *u]
    matrices = np.concatenate([claim.A, claim.B], axis=2)
    predicted = []
    for rows in matrices.swapaxes(0, 1):
        if np.all(rows == rows[0]):
            predicted.append(_weigh(rows[0], values))
            continue
        terms = [weight * _weigh(row, values) for weight, row in zip(th, rows, strict=True)]
        predicted.append(sum(terms[1:], start=terms[0]))
    return predicted


def _weigh(weights: Float[np.ndarray, " k"], values: Sequence[Any]) -> Any:
    """Return a weighted sum, without the terms whose weight is 0."""
    total: Any = 0.0
    for weight, value in zip(weights.tolist(), values, strict=True):
        if weight:
            total = value * weight + total
    return total
