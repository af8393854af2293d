"""Cost and gain of the terminal controller.

Source: Gonzalez, Fiacchini, Guzman, Alamo 2009, eqs. (32)-(41).
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from jaxtube.qp.regions import AnyArray
from jaxtube.synthesis.gains import Gain, given_gain, vertex_gain
from jaxtube.synthesis.problem import Problem
from sets.lmi import TerminalCost, terminal_cost
from sets.lyapunov import cost_of_gains


def in_shares(
    loops: Float[AnyArray, "v 3 3"],
    gains: Float[AnyArray, "v 2 3"],
    error_weight: Float[AnyArray, "3 3"],
    limits: Float[AnyArray, "3"],
) -> tuple[AnyArray, AnyArray, AnyArray]:
    """Return loops, gains and the weight of errors that are divided by their limits; a cost x' P x
    of these has its trace in one unit, so that no choice of units decides which is least."""
    return (
        loops * limits / limits[:, None],
        gains * limits,
        error_weight * limits * limits[:, None],
    )


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
        limits = problem.operating_set.offsets[:3]
        loops, gains = gain.pairs
        P = cost_of_gains(*in_shares(loops, gains, Q, limits), R) / np.outer(limits, limits)
        none = np.zeros((0, 0, 0))
        return TerminalCost(P, gain.vertices, none, "trace_p", float(np.trace(P))), gain
    model = problem.model
    objective = problem.scenario.controller.lmi_objective
    cost = terminal_cost(*model.matrices(model.vertices), Q, R, objective)
    return cost, vertex_gain(problem, cost.gains)
