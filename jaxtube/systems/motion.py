"""A nonlinear motion of a user's own, and what it adds to a linear model, bounded by intervals.

    x+ = f(x, u, th, d),    d in D
    W holds f(x, u, th, d) - A(th) x - B(th) u    for all x in E, u in U, d in D and every th

The hull is found by subdivision in outward-rounded intervals (`sets.supremum`), so W is proved, not
sampled. Mixtures th on the unit simplex are written as th_1 = s_1, th_2 = (1 - s_1) s_2, .. with
every s in [0, 1].

Source: Moore, Kearfott, Cloud 2009, Introduction to Interval Analysis, chapters 5 and 6.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Float

from jaxtube.scenario.refusal import ScenarioError
from jaxtube.systems.checks import read_set, refuse
from sets.polytope import Polytope
from sets.supremum import suprema

if TYPE_CHECKING:
    from jaxtube.systems.system import LinearSystem

Function = Callable[[Sequence[Any], Sequence[Any], Sequence[Any], Sequence[Any]], Sequence[Any]]
"""Takes (x, u, th, d), each a sequence of numbers, and returns x+, one number a state."""

TOLERANCE = 0.01
"""Relative gap at which a bound is taken."""
PIECES = 4
"""Pieces that each share of a mixture is cut into at first: over all mixtures at once a weighted
sum of positive numbers, such as a speed or a length, would seem to reach 0."""
NEGLIGIBLE = 1e-12
"""Gap at which it is taken anyway, as a share of E."""


@dataclass(frozen=True, eq=False)
class Motion:
    """The motion x+ = f(x, u, th, d) of a period.

    The same function is proved, simulated and attacked: it is called with intervals, with floats,
    and with arrays of JAX. So it uses +, -, *, /, and of `sets.interval` sin, cos, tan, sinc (sin x
    / x), square and reciprocal; angles stay within a quarter turn, and there is no `if` on values.

    Attributes:
        function: f; th are the weights of the vertices, d the uncertainties.
        uncertainty: half widths of D, the box of the uncertainties.
        shares: how many of these, the last ones, make a mixture (see `without_schedule`).
    """

    function: Function
    uncertainty: Float[np.ndarray, " q"]
    shares: int = 0

    def __post_init__(self):
        half = np.atleast_1d(np.asarray(self.uncertainty, float))
        if half.ndim != 1 or not np.all(np.isfinite(half)) or np.any(half < 0):
            raise refuse("motion.uncertainty", half, "is no half widths", "give numbers >= 0")
        object.__setattr__(self, "uncertainty", half)

    @property
    def corners(self) -> Float[np.ndarray, "2^q q"]:
        """The corners of D."""
        return read_set("uncertainty", self.uncertainty, len(self.uncertainty)).vertices()

    def without_schedule(self, vertices: int) -> Motion:
        """Return the motion whose mixture of so many vertices is uncertain, too."""
        known = len(self.uncertainty)

        def move(x: Sequence[Any], u: Sequence[Any], th: Sequence[Any], d: Sequence[Any]):
            shares = [share * 0.5 + 0.5 for share in d[known:]]
            return self.function(x, u, mix(shares), d[:known])

        uncertainty = np.concatenate([self.uncertainty, np.ones(vertices - 1)])
        return Motion(move, uncertainty, self.shares + vertices - 1)

    def __call__(
        self,
        x: Float[np.ndarray, "n batch"],
        u: Float[np.ndarray, "m batch"],
        th: Float[np.ndarray, "v batch"],
        d: Float[np.ndarray, "q batch"],
    ) -> Float[np.ndarray, "n batch"]:
        """Return the states after a period, of many at once, coordinates first."""
        parts = self.function(list(x), list(u), list(th), list(d))
        return np.stack([np.asarray(part) for part in parts])


def prove_disturbance(system: LinearSystem, motion: Motion) -> Polytope:
    """Return the least box, to 1 %, that is proved to hold what a motion adds to the linear model
    of a system.

    Raises:
        ScenarioError: where an operation of the function cannot be bounded over E and U, or it
            returns another number of states.
    """
    states = system.states
    lower, upper = _find_boxes(system, motion)
    sizes = system.E.support(np.eye(states))

    def add_to_model(variables: Sequence[Any]) -> list[Any]:
        x, u, th, d = _split(system, motion, variables)
        following = motion.function(x, u, th, d)
        if len(following) != states:
            raise refuse(
                "motion", len(following), "is how many states it returns", f"give {states}"
            )
        predicted = _predict(system, x, u, th)
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
    system: LinearSystem, motion: Motion
) -> tuple[Float[np.ndarray, "variables boxes"], Float[np.ndarray, "variables boxes"]]:
    """Return boxes of all variables, x, u, s, d: together they hold E and U and every mixture."""
    shares = len(system.A) - 1
    upper = []
    lower = []
    for polytope in (system.E, system.U):
        identity = np.eye(polytope.dimension)
        upper.append(polytope.support(identity))
        lower.append(-polytope.support(-identity))
    least = np.concatenate([*lower, np.zeros(shares), -motion.uncertainty])
    most = np.concatenate([*upper, np.ones(shares), motion.uncertainty])
    # Cut are the shares that are known, and those that are uncertain, which come last.
    first = system.states + system.inputs
    cut = [*range(first, first + shares), *range(len(least) - motion.shares, len(least))]
    count = PIECES ** len(cut)
    pieces = np.reshape(list(itertools.product(range(PIECES), repeat=len(cut))), (count, len(cut)))
    below = np.repeat(least[:, None], count, axis=1)
    above = np.repeat(most[:, None], count, axis=1)
    # Quarters are exact, so that no number is left between two pieces.
    quarter = (most - least)[cut, None] / PIECES
    below[cut] = least[cut, None] + quarter * pieces.T
    above[cut] = least[cut, None] + quarter * (pieces.T + 1)
    return below, above


def _split(system: LinearSystem, motion: Motion, variables: Sequence[Any]) -> tuple[list, ...]:
    """Return x, u, th and d."""
    ends = np.cumsum([system.states, system.inputs, len(system.A) - 1])
    first = [0, *ends.tolist()]
    last = [*ends.tolist(), len(variables)]
    parts = [list(variables[a:b]) for a, b in zip(first, last, strict=True)]
    return parts[0], parts[1], mix(parts[2]), parts[3]


def mix(shares: Sequence[Any]) -> list[Any]:
    """Return the mixture th of numbers s in [0, 1], one more than these (see the module)."""
    weights = []
    left: Any = 1.0
    for share in shares:
        weights.append(share * left)
        left = left - share * left
    return [*weights, left]


def _predict(
    system: LinearSystem, x: Sequence[Any], u: Sequence[Any], th: Sequence[Any]
) -> list[Any]:
    """Return A(th) x + B(th) u; th counts only in rows that depend on it."""
    values = [*x, *u]
    matrices = np.concatenate([system.A, system.B], axis=2)
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
