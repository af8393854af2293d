"""Cost and gain of the terminal controller.

Source: Gonzalez, Fiacchini, Guzman, Alamo 2009, eqs. (32)-(41).
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from jaxtube.qp.regions import AnyArray
from jaxtube.synthesis.bands import banded_gain
from jaxtube.synthesis.control_problem import ControlProblem
from jaxtube.synthesis.gain_schedule import GainSchedule
from jaxtube.synthesis.gains import Gain, given_gain, vertex_gain
from jaxtube.synthesis.linear_problem import LinearProblem, MixedGain, mix_gains
from jaxtube.synthesis.problem import Problem
from sets.lmi import TerminalCost, terminal_cost
from sets.lyapunov import cost_of_gains


def cost_and_gain_of_system(problem: LinearProblem) -> tuple[TerminalCost, MixedGain]:
    """Return cost and gain of a linear system: for the gains that it gives, else those of the LMI,
    one for all vertices where B varies.

    Raises:
        RuntimeError, ValueError: where there is no such cost.
    """
    system = problem.system
    if system.K is None:
        shares = not system.has_one_input_matrix
        cost = terminal_cost(system.A, system.B, system.Q, system.R, system.objective, shares)
        return cost, mix_gains(problem, cost.gains)
    gain = mix_gains(problem, system.K)
    return _find_cost(gain, problem), gain


def _find_cost(gain: GainSchedule, problem: ControlProblem) -> TerminalCost:
    """Return a cost for gains that are given."""
    limits = problem.error_widths
    loops, gains = gain.pairs
    scaled = in_shares(loops, gains, problem.error_weight, limits)
    P = cost_of_gains(*scaled, problem.input_weight) / np.outer(limits, limits)
    none = np.zeros((0, 0, 0))
    return TerminalCost(P, gain.vertices, none, "trace_p", float(np.trace(P)))


def in_shares(
    loops: Float[AnyArray, "v n n"],
    gains: Float[AnyArray, "v m n"],
    error_weight: Float[AnyArray, "n n"],
    limits: Float[AnyArray, " n"],
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
        gain = _given_gain(problem)
        return _find_cost(gain, problem), gain
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
