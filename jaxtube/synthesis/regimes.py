"""Regimes: kinds of periods, each with a disturbance set of its own.

A problem has one regime unless it says otherwise: its W holds in every period. With several, a rule
says which of them each period of a run belongs to. Tubes, tightening, terminal set, certificate and
tally ask for the W of a period by the number of its regime.

    R_{j+1|k} = Phi(th_{k+j}) R_{j|k} + W_{m(k+j)},    m(k) the regime of period k

Source: new.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from jaxtyping import Float, Int

from sets.polytope import Polytope

CONTAINED = 1e-12
"""By how much a set may pass another one that holds it, m or rad: rounding."""


class RegimeRule(Protocol):
    """Which regime every period of a run belongs to."""

    def number(self, wheels: Float[np.ndarray, "periods 2"]) -> Int[np.ndarray, " periods"]:
        """Return the regime of every period of a run along wheel speeds (right, left), m/s."""
        ...

    def lasting(self, horizon: int) -> tuple[int, ...]:
        """Return the regimes that a period may belong to which lies a horizon or more after the
        start of a run: those that a terminal set has to hold under."""
        ...


@dataclass(frozen=True)
class OneRegime:
    """The rule where all periods are alike."""

    def number(self, wheels: Float[np.ndarray, "periods 2"]) -> Int[np.ndarray, " periods"]:
        """Return zeros."""
        return np.zeros(len(wheels), int)

    def lasting(self, horizon: int) -> tuple[int, ...]:
        """Return the one regime."""
        return (0,)


ONE_REGIME = OneRegime()


@dataclass(frozen=True)
class RegimesByAge:
    """The rule of regimes that follow each other at the start of a run, a period each; the last one
    of `count` stays.

    Raises:
        ValueError: from `lasting`, where a plan ends before the last regime begins.
    """

    count: int

    def number(self, wheels: Float[np.ndarray, "periods 2"]) -> Int[np.ndarray, " periods"]:
        """Return the number of each period, at most that of the last regime."""
        return np.minimum(np.arange(len(wheels)), self.count - 1)

    def lasting(self, horizon: int) -> tuple[int, ...]:
        """Return the last regime."""
        if horizon < self.count - 1:
            raise ValueError(
                f"horizon = {horizon}: the last regime begins after {self.count - 1} periods; "
                "lengthen controller.horizon"
            )
        return (self.count - 1,)


@dataclass(frozen=True, eq=False)
class Disturbances:
    """The disturbance sets of a problem, one a regime."""

    sets: tuple[Polytope, ...]

    def __getitem__(self, regime: int) -> Polytope:
        return self.sets[regime]

    def of_periods(self, regimes: Int[np.ndarray, " periods"]) -> list[Polytope]:
        """Return the W of every period."""
        return [self.sets[regime] for regime in regimes.tolist()]

    def vertices_of_periods(
        self, regimes: Int[np.ndarray, " periods"]
    ) -> list[Float[np.ndarray, "w 3"]]:
        """Return the vertices of the W of every period."""
        return [one.vertices() for one in self.of_periods(regimes)]

    def hull(self) -> Polytope:
        """Return a set that holds every W: one of them where it holds the others, else their convex
        hull."""
        for one in self.sets:
            if all(one.containment_margin(other) >= -CONTAINED for other in self.sets):
                return one
        return Polytope.from_vertices(np.concatenate([one.vertices() for one in self.sets]))

    def margin(
        self, regimes: Int[np.ndarray, " periods"], points: Float[np.ndarray, "periods k 3"]
    ) -> Float[np.ndarray, "periods k"]:
        """Return the distances of points of every period to the nearest facet of its W, negative
        outside."""
        found = np.zeros(points.shape[:2])
        for regime in np.unique(regimes):
            has_it = regimes == regime
            found[has_it] = self.sets[regime].margin(points[has_it])
        return found

    def support(
        self, regimes: Int[np.ndarray, " k"], rows: Float[np.ndarray, "k r 3"]
    ) -> Float[np.ndarray, "k r"]:
        """Return support numbers along rows, each stack of them of the W of its regime."""
        found = np.zeros(rows.shape[:2])
        for regime in np.unique(regimes):
            has_it = regimes == regime
            stacked = rows[has_it].reshape(-1, 3)
            found[has_it] = self.sets[regime].support(stacked).reshape(-1, rows.shape[1])
        return found
