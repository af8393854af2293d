"""What robots do without a plan: the last one goes on, and after its end the terminal gain.

Each robot drives along wheel speeds of its own; `control.mpc` does the same along one reference.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float

from jaxtube.simulation.governing import Plans
from jaxtube.synthesis.parts import Design


class Backup:
    """The memory of several robots: the last plan of each, its input that is due, and the error
    that it predicts, (m, m, rad)."""

    def __init__(self, design: Design, errors: Float[np.ndarray, "robots 3"]):
        """Begin without a plan."""
        self._model = design.problem.model
        self._tube_gain = design.tube_gain
        self._terminal_gain = design.terminal.gains
        self._horizon = design.problem.horizon
        self._inputs = np.zeros((len(errors), self._horizon, 2))
        self._stage = np.full(len(errors), self._horizon)
        self.predicted = errors.copy()

    def act(
        self,
        plans: Plans,
        has_plan: Bool[np.ndarray, " robots"],
        errors: Float[np.ndarray, "robots 3"],
        wheels: Float[np.ndarray, "robots 2"],
    ) -> Float[np.ndarray, "robots 2"]:
        """Return the virtual inputs of a period, the first ones of new plans where there are some.

        Args:
            plans: made at its start.
            has_plan: whose are to be followed.
            errors: measured, (m, m, rad).
            wheels: of the reference in this period, m/s.
        """
        self._inputs[has_plan] = plans.inputs[has_plan]
        self._stage[has_plan] = 0
        self.predicted[has_plan] = errors[has_plan]
        robots = np.arange(len(errors))
        is_planned = self._stage < self._horizon
        planned = self._inputs[robots, np.minimum(self._stage, self._horizon - 1)]
        of_terminal = self._terminal_gain.along(wheels)
        gains = np.where(is_planned[:, None, None], self._tube_gain.along(wheels), of_terminal)
        beyond = np.einsum("rij,rj->ri", of_terminal, self.predicted)
        due = np.where(is_planned[:, None], planned, beyond)
        inputs = due + np.einsum("rij,rj->ri", gains, errors - self.predicted)
        transitions, input_matrices = self._model.matrices(wheels)
        free = np.einsum("rij,rj->ri", transitions, self.predicted)
        self.predicted = free + np.einsum("rij,rj->ri", input_matrices, due)
        self._stage = np.minimum(self._stage + 1, self._horizon)
        return inputs
