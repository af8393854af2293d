"""What a program costs against the horizon N: n = 2 N inputs, and rows for every period of it.

The programs are those of a design's first window from the edge of its feasible set, where rows are
active; nothing is certified here, and only that window is condensed.

Source: new.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import NamedTuple

import jax
import numpy as np
from jaxtyping import Float

from jaxtube.control.planning import CondensedQp
from jaxtube.experiments.bench.peers.catalogue import EXACT, KINDS, at_tolerance
from jaxtube.experiments.bench.recorded import Family, pose
from jaxtube.experiments.bench.rounds import spread
from jaxtube.experiments.bench.solvers import Extent as SolverExtent
from jaxtube.experiments.bench.solvers import (
    Measured,
    batched_entries,
    peer_entries,
    solve_exactly,
    time_entries,
)
from jaxtube.progress import progress
from jaxtube.scenario.tree import Scenario
from jaxtube.synthesis.condense import condense
from jaxtube.synthesis.design import prepare
from jaxtube.synthesis.disturbance import complete_problem
from jaxtube.synthesis.feasible import boundary, spread_starts
from jaxtube.synthesis.parts import Design
from jaxtube.synthesis.tightening import EmptySetError

BOUNDARY = 60
"""Rays by which the edge of a feasible set is found."""
PEERS = (EXACT[0], at_tolerance("OSQP", KINDS["OSQP"].meets))


class Extent(NamedTuple):
    """How much is measured: starts, and how many of their programs OSQP gets; rounds."""

    starts: int
    few: int
    rounds: int


FULL = Extent(starts=1024, few=64, rounds=5)
QUICK = Extent(starts=64, few=16, rounds=2)


class HorizonResult(NamedTuple):
    """What was measured at one horizon.

    Attributes:
        horizon: N.
        n, m: inputs and rows of a program.
        programs: those of the starts that have an active row; none where no tube fits.
        active: rows in the mean.
        solvers: jaxtube, and the peers that are installed.
    """

    horizon: int
    n: int
    m: int
    programs: int
    active: float
    solvers: list[Measured]


def measure(scenarios: Sequence[Scenario], seed: int, extent: Extent) -> list[HorizonResult]:
    """Measure the programs of scenarios that differ by their horizon."""
    total = len(scenarios) * extent.rounds
    with progress(total, "solving", "rounds", starting="designing, compiling") as bar:
        return [measure_horizon(scenario, seed, extent, bar.update) for scenario in scenarios]


def measure_horizon(
    scenario: Scenario, seed: int, extent: Extent, tick: Callable[[], object]
) -> HorizonResult:
    """Measure the programs of one scenario, `tick` being called after every round."""
    N = scenario.controller.horizon
    try:
        design = prepare(complete_problem(scenario))
    except EmptySetError:
        return HorizonResult(N, 2 * N, 0, 0, 0.0, [])
    family = choose_active(make_edge_family(design, extent.starts, seed))
    problems = family.problems
    exact = solve_exactly(problems)
    amount = SolverExtent(len(problems.q), extent.few, 0, extent.rounds, 0)
    entries = [*batched_entries(family, exact), *peer_entries(PEERS, problems, exact, amount)]
    solvers = time_entries(entries, extent.rounds, tick)
    active = np.nan if exact is None else float(np.mean(np.sum(exact.multipliers != 0, axis=1)))
    m, n = problems.A.shape
    return HorizonResult(N, n, m, len(problems.q), active, solvers)


def make_edge_family(design: Design, count: int, seed: int) -> Family:
    """Return the programs of the first window from starts all over the edge of its feasible set."""
    qps = condense_first(design)
    points = boundary(qps, 0, design.problem.operating_set, BOUNDARY)
    starts = spread_starts(points, count, seed, edge_share=1.0)
    condensed = jax.tree.map(lambda array: jax.numpy.asarray(array[0]), qps)
    return Family(design.first_window, condensed, starts, pose(condensed, starts))


def condense_first(design: Design) -> CondensedQp:
    """Return a stack of one: the condensed QP of the first window."""
    one = slice(design.first_window, design.first_window + 1)
    windows = replace(
        design.windows,
        schedules=design.windows.schedules[one],
        loops=design.windows.loops[one],
        gains=design.windows.gains[one],
        regimes=design.windows.regimes[one],
    )
    bounds = replace(
        design.bounds,
        errors=design.bounds.errors[one],
        inputs=design.bounds.inputs[one],
        terminal=design.bounds.terminal[one],
    )
    return condense(design.problem, windows, design.terminal, design.cost.cost, bounds)


def choose_active(family: Family) -> Family:
    """Return the programs whose answer without constraints breaks some row."""
    problems = family.problems
    free = -np.linalg.solve(problems.P, problems.q.T).T @ problems.A.T
    is_active = np.any((free < problems.l) | (free > problems.u), axis=1)
    chosen = problems._replace(
        q=problems.q[is_active], l=problems.l[is_active], u=problems.u[is_active]
    )
    return family._replace(starts=family.starts[is_active], problems=chosen)


def fit_exponents(results: Sequence[HorizonResult]) -> dict[str, float]:
    """Return p of the law  time ~ N^p  by solvers, least squares of the logarithms."""
    points: dict[str, list[tuple[float, float]]] = {}
    for result in results:
        for solver in result.solvers:
            place = (float(result.horizon), spread(solver.microseconds).median)
            points.setdefault(solver.name, []).append(place)
    return {name: fit_exponent(np.array(each)) for name, each in points.items() if len(each) > 1}


def fit_exponent(points: Float[np.ndarray, "k 2"]) -> float:
    """Return the slope of log y over log x."""
    x, y = np.log(points).T
    return float(np.polyfit(x, y, 1)[0])
