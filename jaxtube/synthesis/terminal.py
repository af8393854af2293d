"""Terminal sets: the maximal RPI set of the terminal gains, its few-facet stand-in, and the
constraint on e_N.

With the terminal gains Gamma(th) bilinear in the schedule and Omega invariant for A_i + B Gamma_i:

* `paper`  Omega for W, in E with Gamma_i Omega in U;      e_N in Omega - R_N        (eq. (30))
* `T-A`    the same with K = Gamma and `sequence` tubes;   e_N in Omega - R_{N|k}    (then the plan stays feasible)
* `T-B`    Omega' for D, which contains Psi_{N-1} W for every product of N - 1 tube loops, in E - R_{N-1} with
           Gamma_i Omega' in U - K R_{N-1};                e_N in Omega' - D         (then the plan stays feasible)

Where the set is empty, e_N in E - R_N takes its place and the design says so. Sources: Gonzalez,
Fiacchini, Guzman, Alamo 2009, section III-E; Kolmanovsky and Gilbert 1998; Blanchini 1999.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

import numpy as np
from jaxtyping import Float

from jaxtube.synthesis.problem import Problem
from jaxtube.synthesis.tightening import (
    BACK_OFF,
    LocalGain,
    Tightening,
    Windows,
    gains_at_corners,
    given_gain,
    vertex_loops,
    vertex_pairs,
)
from sets import tubes
from sets.invariant import MaximalRpi, SupportFunction, few_facet_rpi, maximal_rpi
from sets.lmi import TerminalCost, terminal_cost
from sets.lyapunov import cost_of_gains
from sets.polytope import Polytope

TRIED = (1, 2)
"""Facets that the invariant set used on line may have, times `terminal_facets`: every one of them
is a row of every QP, so it is twice as many only where so few carry none."""


@dataclass(frozen=True, eq=False)
class Terminal:
    """The terminal ingredients of a design.

    `constraint_offsets[w]` bound `constraint_normals` e_N in window w; `fallback` says that they
    are E - R_N because no invariant set was found, or nothing of it is left once the tube is taken
    off.
    """

    kind: str
    gains: LocalGain
    loops: Float[np.ndarray, "v 3 3"]
    disturbance: tubes.Section  # W, or D for T-B
    admissible: Polytope  # what the invariant set must lie in: errors, and errors whose terminal input is admissible
    maximal: MaximalRpi
    invariant: Polytope | None
    constraint_normals: Float[np.ndarray, "facets 3"]
    constraint_offsets: Float[np.ndarray, "windows facets"]
    fallback: bool

    @property
    def volume_share(self) -> float | None:
        """Volume of the invariant set used as a share of the maximal one's, None where there is
        none."""
        if self.maximal.polytope is None or self.invariant is None:
            return None
        return self.invariant.volume() / self.maximal.polytope.volume()


def admissible_set(
    problem: Problem,
    gain: LocalGain,
    error_offsets: Float[np.ndarray, " 6"] | None = None,
    input_offsets: Float[np.ndarray, " k"] | None = None,
) -> Polytope:
    """Return {e in E : Gamma e in U at every corner}, with offsets of E and of the input rows
    tightened where given."""
    E, rows = problem.operating_set, problem.input_rows
    under = rows.under(np.unique(gains_at_corners(problem, gain), axis=0))
    input_offsets = rows.offsets if input_offsets is None else input_offsets
    offsets = [
        E.offsets if error_offsets is None else error_offsets,
        *([input_offsets] * len(under)),
    ]
    return Polytope(np.concatenate([E.normals, *under]), np.concatenate(offsets))


def terminal_cost_and_gain(problem: Problem) -> tuple[TerminalCost, LocalGain]:
    """Return cost and gain of the terminal controller: the scenario's gains where it gives some,
    else those of the LMI.

    Raises RuntimeError or ValueError where there is no such cost.
    """
    settings, weights = problem.scenario.controller, (problem.error_weight, problem.input_weight)
    if len(problem.given_gains):
        gain = given_gain(problem, problem.given_gains)
        P = cost_of_gains(*vertex_pairs(problem, gain), *weights)
        return TerminalCost(
            P, gain.vertices, np.zeros((0, 0, 0)), "trace_p", float(np.trace(P))
        ), gain
    cost = terminal_cost(
        *problem.model.matrices(problem.model.vertices), *weights, settings.lmi_objective
    )
    return cost, LocalGain(cost.gains.mean(axis=0), cost.gains)


def make_terminal(
    problem: Problem,
    tube_gain: LocalGain,
    gains: LocalGain,
    windows: Windows,
    tightening: Tightening,
) -> Terminal:
    """Return the terminal set of the scenario's choice, or its stand-in."""
    kind, N = problem.scenario.controller.terminal, problem.horizon
    loops = vertex_loops(problem, gains)
    disturbance = tubes.Section((problem.disturbance_set.vertices(),), 3)
    admissible = admissible_set(problem, gains)
    if kind == "T-B":
        tube_loops = vertex_loops(problem, tube_gain)
        disturbance = tubes.propagated(tube_loops, problem.disturbance_set, N - 1)[-1]
        last_errors = problem.operating_set.offsets - tightening.error_reach[:, N - 1].max(axis=0)
        last_inputs = problem.input_rows.offsets - tightening.input_reach[:, N - 1].max(axis=0)
        admissible = admissible_set(problem, gains, last_errors, last_inputs)
    # The constraints used on line are backed off, so what the plan must return to is smaller by as
    # much: the set is built inside backed-off constraints, for a disturbance that is wider by more
    # than the last back-off.
    back_off = set_back_off(problem)
    inner = Polytope(
        admissible.normals,
        admissible.offsets - back_off * (1 + np.linalg.norm(admissible.normals, axis=1)),
    )
    widened = partial(_widened, disturbance, back_off)
    maximal = _maximal(loops, inner, widened)
    invariant = None
    if maximal.polytope is not None:
        counts = (problem.scenario.controller.terminal_facets * times for times in TRIED)
        sets = (few_facet_rpi(loops, inner, widened, maximal.polytope, facets) for facets in counts)
        invariant = next((found for found in sets if found is not None), None)
    constraint = _constraint(problem, kind, invariant, disturbance, windows, tightening)
    fallback = constraint is None
    normals, offsets = constraint or (
        problem.operating_set.normals,
        problem.operating_set.offsets - tightening.error_reach[:, N],
    )
    return Terminal(
        kind, gains, loops, disturbance, admissible, maximal, invariant, normals, offsets, fallback
    )


def set_back_off(problem: Problem) -> float:
    """Return by how much the invariant set stays inside the limits, and the disturbance is widened."""
    return (problem.horizon + 2) * BACK_OFF


def _widened(
    disturbance: tubes.Section, by: float, rows: Float[np.ndarray, "k 3"]
) -> Float[np.ndarray, " k"]:
    """Return the support numbers of the disturbance and a ball."""
    return disturbance.support(rows) + by * np.linalg.norm(rows, axis=1)


def _maximal(loops, admissible: Polytope, disturbance: SupportFunction) -> MaximalRpi:
    if np.any(admissible.offsets <= 0):
        return MaximalRpi(None, None, 0)
    return maximal_rpi(loops, admissible, disturbance)


def _constraint(
    problem, kind, invariant: Polytope | None, disturbance, windows: Windows, tightening: Tightening
):
    """Return (normals, offsets a window) of the constraint on e_N, None where nothing is left."""
    if invariant is None:
        return None
    if kind == "T-B":
        taken = np.broadcast_to(
            disturbance.support(invariant.normals), (len(windows.loops), len(invariant.offsets))
        )
    else:
        taken = tube_support(problem, windows, tightening, invariant.normals)
    offsets = invariant.offsets - taken
    least = Polytope(invariant.normals, offsets.min(axis=0))
    if least.is_empty():
        return None
    # A row that is implied in the smallest of the sets may still cut another, so only constant sets
    # lose rows.
    if len(np.unique(offsets.round(15), axis=0)) == 1:
        least = least.reduce()
        return least.normals, np.broadcast_to(
            least.offsets, (len(windows.loops), len(least.offsets))
        )
    return invariant.normals, offsets


def tube_support(
    problem: Problem, windows: Windows, tightening: Tightening, normals
) -> Float[np.ndarray, "w k"]:
    """Return the support numbers of R_N along any normals, window by window."""
    if tightening.sections is None:
        rows = np.broadcast_to(normals, (len(windows.loops), *normals.shape))
        return tubes.sequence_support(windows.loops, problem.disturbance_set, rows, problem.horizon)
    support = tightening.sections[problem.horizon].support(normals)
    return np.broadcast_to(support, (len(windows.loops), len(normals)))
