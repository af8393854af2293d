"""What laps of any closed loop have in common: their arrays, QPs and RMS errors."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from jaxtube import qp
from jaxtube.simulation.rollout import Trajectory
from jaxtube.synthesis.parts import TubeDesign


@dataclass(frozen=True, eq=False, repr=False)
class RecordedLaps:
    """Simulated laps; arrays are numpy, time first, then the laps.

    Attributes:
        design: whose closed loop they are of.
        controller: its name; of a user's own what `simulate` was told, or what Python calls it.
        plant: its name, "own" for a user's.
        seed: of every draw.
        trajectory: errors (steps + 1, laps, n), inputs and diagnostics.
        solves_qp: whether the controller solves QPs.
    """

    design: TubeDesign
    controller: str
    plant: str
    seed: int
    trajectory: Trajectory
    solves_qp: bool = True

    @property
    def errors(self) -> Float[np.ndarray, "steps+1 laps n"]:
        """True errors; of a linear system its states."""
        return np.asarray(self.trajectory.errors)

    @property
    def statuses(self) -> dict[int, int]:
        """How many QPs have each status that occurs (`jaxtube.qp.describe` has the words)."""
        values, counts = np.unique(self.trajectory.diagnostics.status, return_counts=True)
        return dict(zip(values.tolist(), counts.tolist(), strict=True))

    @property
    def without_plan(self) -> int:
        """How many QPs were not solved."""
        return sum(count for status, count in self.statuses.items() if status != qp.SOLVED)

    @property
    def rms(self) -> Float[np.ndarray, " n"]:
        """RMS errors over all laps and the whole reference."""
        return np.sqrt(np.mean(self.errors**2, axis=(0, 1)))
