"""A nonlinear motion of a user's own: x+ = f(x, u, th, d), d in a box.

Mixtures th on the unit simplex are written as th_1 = s_1, th_2 = (1 - s_1) s_2, .. with every s in
[0, 1].
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float

from jaxtube.systems.checks import read_set, refuse

Function = Callable[[Sequence[Any], Sequence[Any], Sequence[Any], Sequence[Any]], Sequence[Any]]
"""Takes (x, u, th, d), each a sequence of numbers, and returns x+, one number a state."""


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


def mix(shares: Sequence[Any]) -> list[Any]:
    """Return the mixture th of numbers s in [0, 1], one more than these (see the module)."""
    weights = []
    left: Any = 1.0
    for share in shares:
        weights.append(share * left)
        left = left - share * left
    return [*weights, left]
