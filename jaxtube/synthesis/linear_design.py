"""The design of a linear system: gains, tubes, terminal set, condensed tube-MPC and certificate, by
the functions that a robot's design is made by."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from jaxtube.synthesis import condense
from jaxtube.synthesis.certificate.linear import certify_linear
from jaxtube.synthesis.linear_problem import LinearProblem, MixedGain, make_linear_problem
from jaxtube.synthesis.parts import Condensed, LinearDesign
from jaxtube.synthesis.terminal import make_terminal
from jaxtube.synthesis.terminal_cost import cost_and_gain_of_system
from jaxtube.synthesis.tightening import refuse_empty, tighten
from jaxtube.synthesis.tubes import make_tubes
from jaxtube.synthesis.windows import make_windows
from jaxtube.systems.checks import refuse
from jaxtube.systems.system import LinearSystem
from sets.lmi import TerminalCost


def design_linear(system: LinearSystem) -> LinearDesign:
    """Compute gains, sets, tube-MPC and certificate of a linear system.

    Raises:
        ScenarioError: where no gain stabilises every vertex, or the weights cannot be used, in one
            line.
        EmptySetError: where a tightened set E_j or U_j is empty.
    """
    prepared = prepare_linear(make_linear_problem(system))
    _ = prepared.tube_qps  # condensed before the certificate compares them with the sets
    return replace(prepared, certificate=certify_linear(prepared))


def prepare_linear(problem: LinearProblem) -> LinearDesign:
    """Compute all of a design but the certificate; raises as `design_linear`."""
    cost, gain = _find_cost_and_gain(problem)
    windows = make_windows(problem, gain)
    tubes = make_tubes(problem, gain, windows)
    tube = tubes[problem.settings.tube]
    tightening = tighten(problem, tube, windows)
    refuse_empty(problem, tightening, windows)
    terminal = make_terminal(problem, tube, gain, tightening)
    bounds = condense.tube_bounds(problem, windows, tightening, terminal)
    return LinearDesign(
        problem=problem,
        tube_gain=gain,
        cost=cost,
        windows=windows,
        tubes=tubes,
        tightening=tightening,
        terminal=terminal,
        bounds=bounds,
        condensed=Condensed(problem, windows, terminal, cost.cost, bounds),
    )


def _find_cost_and_gain(problem: LinearProblem) -> tuple[TerminalCost, MixedGain]:
    system = problem.system
    try:
        return cost_and_gain_of_system(problem)
    except (RuntimeError, ValueError) as error:
        reason = " ".join(str(error).split())
    if system.K is not None:
        radius = float(np.abs(np.linalg.eigvals(system.A + system.B @ system.K)).max())
        raise refuse(
            "K",
            system.K,
            f"no quadratic cost decreases under all its loops, whose spectral radius is up to "
            f"{radius:.4g} at the vertices",
            "give other gains, or leave K out for those of the linear matrix inequality",
        )
    problem_words = f"no gain stabilises all {len(system.A)} vertices ({reason})"
    raise refuse("B", system.B, problem_words, "narrow the vertices, or add an actuator") from None
