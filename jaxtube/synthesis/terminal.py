"""Terminal sets: the maximal RPI set of the terminal gains, its few-facet stand-in, and the
constraint on e_N.

With the terminal gains Gamma(th) bilinear in the schedule and Omega invariant for A_i + B Gamma_i:

* `paper`  Omega for W, in E with Gamma_i Omega in U;      e_N in Omega - R_N        (eq. (30))
* `T-A`    the same with K = Gamma and `sequence` tubes;   e_N in Omega - R_{N|k}
* `T-B`    Omega' for D, which contains Psi_{N-1} W for every product of N - 1 tube loops, in
           E - R_{N-1} with Gamma_i Omega' in U - K R_{N-1};   e_N in Omega' - D

With `T-A` and `T-B` the plan stays feasible. Where the set is empty, e_N in E - R_N takes its place
and the design says so. Where there are several regimes, Omega is invariant under the W of each that
lasts (`regimes`).

Sources: Gonzalez, Fiacchini, Guzman, Alamo 2009, section III-E; Kolmanovsky and Gilbert 1998;
Blanchini 1999.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

import numpy as np
from jaxtyping import Float

from jaxtube.synthesis.gains import Gain
from jaxtube.synthesis.problem import Problem
from jaxtube.synthesis.tightening import Tightening, find_back_off
from jaxtube.synthesis.tubes import Tube
from sets import tubes
from sets.few_facets import few_facet_rpi
from sets.invariant import Disturbance, MaximalRpi, maximal_rpi
from sets.polytope import Polytope

FACET_MULTIPLES = (1, 2)
"""Facets that the invariant set used on line may have, times `terminal_facets`. Each facet is a row
of every QP, so the limit is doubled only if no invariant set with that many facets is found."""


@dataclass(frozen=True, eq=False)
class Terminal:
    """The terminal ingredients of a design.

    `constraint_offsets[w]` bound `constraint_normals` e_N in window w; `fallback` says that they
    are E - R_N because no invariant set was found, or nothing of it is left once the tube is taken
    off.
    """

    gains: Gain
    # Loops of the terminal gains that the set is invariant under, and W of each, or D for T-B.
    loops: Float[np.ndarray, "v 3 3"]
    disturbances: tuple[tubes.Section, ...]
    admissible: Polytope  # errors in E whose terminal input is admissible: holds the invariant set
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
    gain: Gain,
    error_offsets: Float[np.ndarray, " 6"] | None = None,
    input_offsets: Float[np.ndarray, " k"] | None = None,
) -> Polytope:
    """Return {e in E : Gamma e in U at every corner}, with offsets of E and of the input rows
    tightened where given."""
    E = problem.operating_set
    rows = problem.input_rows
    by_gain = rows.on_errors(np.unique(gain.corner_gains, axis=0))
    errors = E.offsets if error_offsets is None else error_offsets
    inputs = rows.offsets if input_offsets is None else input_offsets
    return Polytope(
        np.concatenate([E.normals, *by_gain]),
        np.concatenate([errors, np.tile(inputs, len(by_gain))]),
    )


def make_terminal(problem: Problem, tube: Tube, gains: Gain, tightening: Tightening) -> Terminal:
    """Return the terminal set of the scenario's choice, or its stand-in."""
    N = problem.horizon
    loops, disturbances = pair_lasting_loops(problem, gains)
    admissible = admissible_set(problem, gains)
    if problem.scenario.controller.terminal_set_holds_reach:
        reach = tubes.propagate(tube.gain.loops, problem.disturbance_set, N - 1)[-1]
        disturbances = (reach,) * len(loops)
        last_errors = problem.operating_set.offsets - tightening.error_reach[:, N - 1].max(axis=0)
        last_inputs = problem.input_rows.offsets - tightening.input_reach[:, N - 1].max(axis=0)
        admissible = admissible_set(problem, gains, last_errors, last_inputs)
    maximal, invariant = _find_invariant(problem, loops, disturbances, admissible)
    constraint = _constraint(problem, invariant, disturbances, tube, tightening)
    normals, offsets = constraint or (
        problem.operating_set.normals,
        problem.operating_set.offsets - tightening.error_reach[:, N],
    )
    return Terminal(
        gains,
        loops,
        disturbances,
        admissible,
        maximal,
        invariant,
        normals,
        offsets,
        fallback=constraint is None,
    )


def pair_lasting_loops(
    problem: Problem, gains: Gain
) -> tuple[Float[np.ndarray, "v 3 3"], tuple[tubes.Section, ...]]:
    """Return the loops that may act once a plan has ended, and the W of each: every loop under
    every regime that lasts."""
    loops = []
    disturbances = []
    for regime in problem.rule.lasting(problem.horizon):
        disturbance = tubes.Section((problem.disturbances[regime].vertices(),), 3)
        loops.append(gains.loops)
        disturbances += [disturbance] * len(gains.loops)
    return np.concatenate(loops), tuple(disturbances)


def set_back_off(problem: Problem) -> float:
    """Return by how much the invariant set stays inside the limits, and W is widened."""
    return (problem.horizon + 2) * find_back_off(problem)


def _find_invariant(
    problem: Problem,
    loops: Float[np.ndarray, "v 3 3"],
    disturbances: tuple[tubes.Section, ...],
    admissible: Polytope,
) -> tuple[MaximalRpi, Polytope | None]:
    """Return the maximal invariant set and the one used on line, of few facets.

    The constraints used on line are backed off, so what the plan must return to is smaller by as
    much: the set is built inside backed-off constraints, for a disturbance that is wider by more
    than the last back-off.
    """
    back_off = set_back_off(problem)
    inner = Polytope(
        admissible.normals,
        admissible.offsets - back_off * (1 + np.linalg.norm(admissible.normals, axis=1)),
    )
    distinct = {id(each): partial(_widened_support, each, back_off) for each in disturbances}
    widened = [distinct[id(each)] for each in disturbances]
    maximal = _maximal(loops, inner, widened)
    if maximal.polytope is None:
        return maximal, None
    for multiple in FACET_MULTIPLES:
        facets = multiple * problem.scenario.controller.terminal_facets
        few = few_facet_rpi(loops, inner, widened, maximal.polytope, facets)
        if few is not None:
            return maximal, few
    return maximal, None


def _widened_support(
    disturbance: tubes.Section, by: float, rows: Float[np.ndarray, "k 3"]
) -> Float[np.ndarray, " k"]:
    """Return the support numbers of the disturbance and a ball."""
    return disturbance.support(rows) + by * np.linalg.norm(rows, axis=1)


def _maximal(
    loops: Float[np.ndarray, "v 3 3"], admissible: Polytope, disturbance: Disturbance
) -> MaximalRpi:
    if np.any(admissible.offsets <= 0):
        return MaximalRpi(None, None, 0)
    return maximal_rpi(loops, admissible, disturbance)


def _constraint(
    problem: Problem,
    invariant: Polytope | None,
    disturbances: tuple[tubes.Section, ...],
    tube: Tube,
    tightening: Tightening,
) -> tuple[Float[np.ndarray, "facets 3"], Float[np.ndarray, "windows facets"]] | None:
    """Return (normals, offsets a window) of the constraint on e_N, None where nothing is left."""
    if invariant is None:
        return None
    windows = len(tightening.error_reach)
    facets = len(invariant.offsets)
    if problem.scenario.controller.terminal_set_holds_reach:
        taken = disturbances[0].support(invariant.normals)  # D, the same for every loop
    else:
        taken = tube.support(problem.horizon, invariant.normals)
    offsets = invariant.offsets - np.broadcast_to(taken, (windows, facets))
    least = Polytope(invariant.normals, offsets.min(axis=0))
    if least.is_empty():
        return None
    # A row that is implied in the smallest of the sets may still cut another, so only constant sets
    # lose rows.
    if len(np.unique(offsets.round(15), axis=0)) == 1:
        least = least.reduce()
        return least.normals, np.broadcast_to(least.offsets, (windows, len(least.offsets)))
    return invariant.normals, offsets
