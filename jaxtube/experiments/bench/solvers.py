"""`bench qp`: programs with active rows, recorded from laps, solved cold by the batched solver and
by its peers, one after the other in every round.

Source: new.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from jaxtube import qp
from jaxtube.experiments.bench.accuracy import Accuracy, judge
from jaxtube.experiments.bench.peers.catalogue import EXACT, Peer, swept_peers, tight_peers
from jaxtube.experiments.bench.peers.problems import Answers, Problems, Solver
from jaxtube.experiments.bench.recorded import Family, collect_active
from jaxtube.experiments.bench.rounds import OwnClock, time_rounds
from jaxtube.progress import progress
from jaxtube.qp.parametric import solve_parametric
from jaxtube.scenario.tree import Scenario
from jaxtube.synthesis.design import design as make_design

OURS = "jaxtube"
KNOWING = "jaxtube, known regions"
DAQP = "DAQP"
CLOCK = "DAQP, its own clock"


class Extent(NamedTuple):
    """How much is measured: programs of a family, those that slow peers get, those of the sweep
    over tolerances, and rounds of both."""

    programs: int
    few: int
    swept: int
    rounds: int
    swept_rounds: int


FULL = Extent(programs=4096, few=1024, swept=512, rounds=7, swept_rounds=3)
QUICK = Extent(programs=256, few=64, swept=32, rounds=2, swept_rounds=1)


class Measured(NamedTuple):
    """What was measured of one solver.

    Attributes:
        name, settings: of the solver.
        tolerance: that it was given; None for one that is exact.
        programs: how many it solved in each round.
        microseconds: for one program, by rounds; one number for DAQP's own clock.
        accuracy: of its answers.
    """

    name: str
    settings: str
    tolerance: float | None
    programs: int
    microseconds: Float[np.ndarray, " rounds"]
    accuracy: Accuracy


class FamilyResult(NamedTuple):
    """What was measured on one family of programs; `active` is the mean number of active rows."""

    scenario: str
    starts: str
    n: int
    m: int
    programs: int
    active: float
    solvers: list[Measured]
    sweep: list[Measured]


class Entry(NamedTuple):
    """A solver that is ready: its programs, and the exact answers to them where they are known."""

    name: str
    settings: str
    tolerance: float | None
    problems: Problems
    exact: Answers | None
    solver: Solver


def measure(
    scenarios: Sequence[tuple[str, str, Scenario]], seed: int, extent: Extent
) -> list[FamilyResult]:
    """Measure families of programs, of (name, starts, scenario) each."""
    total = len(scenarios) * (extent.rounds + extent.swept_rounds)
    results = []
    with progress(total, "solving", "rounds", starting="recording laps, compiling") as bar:
        for name, starts, scenario in scenarios:
            family = collect_active(make_design(scenario), starts, seed, extent.programs)
            results.append(measure_family(name, starts, family, extent, bar.update))
    return results


def measure_family(
    name: str, starts: str, family: Family, extent: Extent, tick: Callable[[], object]
) -> FamilyResult:
    """Measure all solvers on one family, `tick` being called after every round."""
    problems = family.problems
    exact = solve_exactly(problems)
    ready = [*batched_entries(family, exact), *peer_entries(tight_peers(), problems, exact, extent)]
    solvers = time_entries(ready, extent.rounds, tick)
    few = problems.take(slice(extent.swept))
    few_exact = solve_exactly(few)
    swept = [prepare(peer, few, few_exact) for peer in swept_peers() if peer.is_installed]
    sweep = time_entries(swept, extent.swept_rounds, tick)
    m, n = problems.A.shape
    active = np.nan if exact is None else float(np.mean(np.sum(exact.multipliers != 0, axis=1)))
    return FamilyResult(name, starts, n, m, len(problems.q), active, solvers, sweep)


def solve_exactly(problems: Problems) -> Answers | None:
    """Return the answers of an exact peer; None where none is installed."""
    peer = next((peer for peer in EXACT if peer.is_installed), None)
    return None if peer is None else peer.make(problems).answer()


def batched_entries(family: Family, exact: Answers | None) -> list[Entry]:
    """Return the batched solver, alone and with the regions that the controller knows."""
    settings = f"a batch of {len(family.starts):,}"
    alone = make_batched(family, with_regions=False)
    entries = [Entry(OURS, settings, None, family.problems, exact, alone)]
    if family.condensed.regions is not None:
        knowing = make_batched(family, with_regions=True)
        entries.append(Entry(KNOWING, settings, None, family.problems, exact, knowing))
    return entries


def make_batched(family: Family, with_regions: bool) -> Solver:
    """Return the batched solver, its data on the device."""
    condensed = family.condensed
    if with_regions:
        errors = jnp.asarray(family.starts)
        everyone = jnp.ones(len(errors), bool)
        of_errors = (condensed.parametric, errors, everyone, condensed.regions)
        solve = partial(jax.jit(solve_parametric), condensed.factors, *of_errors)
    else:
        solve = partial(
            jax.jit(qp.solve), condensed.factors, *map(jnp.asarray, family.problems[2:])
        )

    def run():
        return jax.block_until_ready(solve())

    def answer() -> Answers:
        solution = run()
        solved = np.asarray(solution.status) == qp.SOLVED
        x = np.where(solved[:, None], solution.x, np.nan)
        return Answers(x, np.asarray(solution.multipliers))

    return Solver(run, answer)


def peer_entries(
    peers: Sequence[Peer], problems: Problems, exact: Answers | None, extent: Extent
) -> list[Entry]:
    """Return the peers that are installed; iterative ones, which are slow, get few programs."""
    few = problems.take(slice(extent.few))
    few_exact = None if exact is None else Answers(*(array[: extent.few] for array in exact))
    return [
        prepare(peer, problems, exact) if peer.tolerance is None else prepare(peer, few, few_exact)
        for peer in peers
        if peer.is_installed
    ]


def prepare(peer: Peer, problems: Problems, exact: Answers | None) -> Entry:
    """Return a peer with its programs."""
    solver = peer.make(problems)
    return Entry(peer.name, peer.settings, peer.tolerance, problems, exact, solver)


def time_entries(
    entries: Sequence[Entry], rounds: int, tick: Callable[[], object]
) -> list[Measured]:
    """Time solvers in rounds, DAQP also by its own clock."""
    work: dict[str, Callable[[], object]] = {}
    clocks: dict[int, OwnClock] = {}
    for number, entry in enumerate(entries):
        work[f"{number}"] = entry.solver.run
        if entry.solver.clock:
            clocks[number] = OwnClock(entry.solver.clock)
            work[f"{number} clock"] = clocks[number].run
    seconds = time_rounds(work, rounds, tick)
    measured = []
    for number, entry in enumerate(entries):
        accuracy = judge(entry.problems, entry.solver.answer(), entry.exact)
        count = len(entry.problems.q)
        of_rounds = 1e6 * seconds[f"{number}"] / count
        found = Measured(entry.name, entry.settings, entry.tolerance, count, of_rounds, accuracy)
        measured.append(found)
        if number in clocks:
            own = 1e6 * clocks[number].seconds
            measured.append(found._replace(name=CLOCK, microseconds=own))
    return measured
