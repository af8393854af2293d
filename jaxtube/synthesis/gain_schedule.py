"""Gains u = +K(th) e that are mixed from their values at the vertices of a model."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float

from jaxtube.synthesis.control_problem import ScheduledModel


@dataclass(frozen=True, eq=False)
class GainSchedule(ABC):
    """A gain u = +K(th) e, mixed by the model's weights, with the loops that it closes."""

    model: ScheduledModel
    nominal: Float[np.ndarray, "m n"]  # at the centre of the schedules
    vertices: Float[np.ndarray, "v m n"]

    def at(self, weights: Float[np.ndarray, "... v"]) -> Float[np.ndarray, "... m n"]:
        """Return the gain at the schedules with these weights."""
        return np.tensordot(weights, self.vertices, axes=1)

    def along(self, schedules: Float[np.ndarray, "... p"]) -> Float[np.ndarray, "... m n"]:
        """Return the gain at schedules."""
        return self.at(self.model.weights(schedules))

    def loops_along(self, schedules: Float[np.ndarray, "... p"]) -> Float[np.ndarray, "... n n"]:
        """Return the loops A + B K at schedules."""
        transitions, inputs = self.model.matrices(schedules)
        return transitions + inputs @ self.along(schedules)

    @property
    @abstractmethod
    def corner_gains(self) -> Float[np.ndarray, "k m n"]:
        """Gains whose mixtures hold every gain that may act."""

    @property
    @abstractmethod
    def pairs(self) -> tuple[Float[np.ndarray, "w n n"], Float[np.ndarray, "w m n"]]:
        """Loops and gains whose joint mixtures are to hold (A + B K, K) at every schedule."""

    def of_regime(self, regime: int) -> GainSchedule:
        """Return the gain that may act in a regime: itself, unless it knows better."""
        return self

    @cached_property
    def loops(self) -> Float[np.ndarray, "w n n"]:
        """Loops whose mixtures are to hold A + B K at every schedule, each once."""
        return distinct(self.pairs[0])


def distinct(matrices: Float[np.ndarray, "v m n"]) -> Float[np.ndarray, "w m n"]:
    """Return the matrices without repetitions, in the order of their first appearance."""
    first = np.unique(matrices.reshape(len(matrices), -1), axis=0, return_index=True)[1]
    return matrices[np.sort(first)]
