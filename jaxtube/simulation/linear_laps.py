"""Laps of a linear system of a user's own."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float

from jaxtube import qp
from jaxtube.simulation.recorded import RecordedLaps
from jaxtube.synthesis.parts import LinearDesign
from sets.polytope import Polytope

if TYPE_CHECKING:
    from matplotlib.figure import Figure

OUTSIDE = 1e-12
"""Beyond a limit by more than this is outside of it, in the unit of its unit row."""


@dataclass(frozen=True, eq=False, repr=False)
class LinearLaps(RecordedLaps):
    """Simulated laps of a linear system, or of the motion that it stands for."""

    design: LinearDesign

    @property
    def states(self) -> Float[np.ndarray, "steps+1 laps n"]:
        """States, in the units of the system."""
        return self.errors

    @property
    def inputs(self) -> Float[np.ndarray, "steps laps m"]:
        """Inputs, in the units of the system."""
        return np.asarray(self.trajectory.inputs)

    @property
    def outside(self) -> int:
        """How many laps leave E; NaN counts as outside."""
        return self._count_outside(self.design.problem.error_set, self.states)

    @property
    def inputs_outside(self) -> int:
        """How many laps leave U; NaN counts as outside."""
        return self._count_outside(self.design.problem.input_set, self.inputs)

    def cost(
        self, Q: Float[np.ndarray, "n n"] | None = None, R: Float[np.ndarray, "m m"] | None = None
    ) -> Float[np.ndarray, " laps"]:
        """Return the mean of x'Qx + u'Ru over the periods of each lap, by the weights of the system
        unless others are given."""
        system = self.design.system
        of_states = _form(system.Q if Q is None else np.asarray(Q), self.states[:-1])
        of_inputs = _form(system.R if R is None else np.asarray(R), self.inputs)
        return np.mean(of_states + of_inputs, axis=0)

    def plot(self) -> Figure:
        """Draw states and inputs of all laps against time, with the limits that are a
        coordinate's; return the figure."""
        from jaxtube.figures.linear_laps import draw_linear_laps

        return draw_linear_laps(self)

    def _count_outside(self, limits: Polytope, points: Float[np.ndarray, "steps laps k"]) -> int:
        excess = points @ limits.normals.T - limits.offsets
        return int(np.sum(~np.all(excess <= OUTSIDE, axis=(0, 2))))

    def __repr__(self) -> str:
        count = self.states.shape[1]
        names = self.design.system.state_names
        sizes = ", ".join(f"{name} {rms:.3g}" for name, rms in zip(names, self.rms, strict=True))
        verdict = (
            f"<LinearLaps: {self.outside:,} of {count:,} laps leave E, {self.inputs_outside:,} U; "
            f"{self.controller} on the {self.plant}; RMS {sizes}"
        )
        if not self.solves_qp:
            return f"{verdict}>"
        verdict += f"; {self.without_plan} QPs without a plan"
        return "\n".join([verdict, *qp.describe_unsolved(self.statuses)]) + ">"


def _form(
    weight: Float[np.ndarray, "k k"], points: Float[np.ndarray, "steps laps k"]
) -> np.ndarray:
    return np.einsum("tli,ij,tlj->tl", points, weight, points)
