"""Cost and gain of the terminal controller.

Source: Gonzalez, Fiacchini, Guzman, Alamo 2009, eqs. (32)-(41).
"""

from __future__ import annotations

import numpy as np

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
        gain = given_gain(problem, problem.given_gains)
        P = cost_of_gains(*gain.pairs, Q, R)
        none = np.zeros((0, 0, 0))
        return TerminalCost(P, gain.vertices, none, "trace_p", float(np.trace(P))), gain
    model = problem.model
    objective = problem.scenario.controller.lmi_objective
    cost = terminal_cost(*model.matrices(model.vertices), Q, R, objective)
    return cost, vertex_gain(problem, cost.gains)
