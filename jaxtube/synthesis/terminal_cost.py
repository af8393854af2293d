"""Cost and gain of the terminal controller.

Source: Gonzalez, Fiacchini, Guzman, Alamo 2009, eqs. (32)-(41).
"""

from __future__ import annotations

import numpy as np

from jaxtube.synthesis.bands import banded_gain
from jaxtube.synthesis.gains import Gain, given_gain, vertex_gain
from jaxtube.synthesis.problem import Problem
from sets.lmi import TerminalCost, terminal_cost
from sets.lyapunov import cost_of_gains


def terminal_cost_and_gain(problem: Problem) -> tuple[TerminalCost, Gain]:
    """Return cost and gain of the terminal controller: the scenario's gains where it gives some,
    else those of the LMI.

    Raises:
        RuntimeError, ValueError: where there is no such cost.
    """
    Q = problem.error_weight
    R = problem.input_weight
    if len(problem.given_gains):
        gain = _given_gain(problem)
        P = cost_of_gains(*gain.pairs, Q, R)
        none = np.zeros((0, 0, 0))
        vertices = gain.vertices.reshape(-1, 2, 3)
        return TerminalCost(P, vertices, none, "trace_p", float(np.trace(P))), gain
    model = problem.model
    objective = problem.scenario.controller.lmi_objective
    cost = terminal_cost(*model.matrices(model.vertices), Q, R, objective)
    return cost, vertex_gain(problem, cost.gains)


def _given_gain(problem: Problem) -> Gain:
    """Return the gain of the scenario's numbers, by band where it has bands."""
    numbers = problem.given_gains
    if problem.scenario.operating.bands:
        return banded_gain(problem, numbers.reshape(-1, 3))
    return given_gain(problem, numbers)
