"""`bench loop`: periods a second of the closed loop with the tube-MPC, bare and with all checks of
`montecarlo`, beside an exact solver that is called for the programs of the same laps.

The exact solver solves the programs alone, recorded beforehand: no robot, no draws, no checks.

Source: new.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from jaxtube import qp
from jaxtube.control.laws import TubeMpc
from jaxtube.control.planning import take_qp
from jaxtube.experiments.bench.accuracy import count_wrong
from jaxtube.experiments.bench.peers.active_set import (
    DaqpModel,
    make_daqp_data,
    read_daqp,
    read_daqp_clock,
    set_up_daqp,
)
from jaxtube.experiments.bench.peers.catalogue import EXACT
from jaxtube.experiments.bench.peers.problems import Solver, one_by_one
from jaxtube.experiments.bench.programs import run_bare_laps
from jaxtube.experiments.bench.recorded import Record, pose, record_laps
from jaxtube.experiments.bench.rounds import OwnClock, time_rounds
from jaxtube.progress import progress
from jaxtube.scenario.tree import Scenario
from jaxtube.statistics.montecarlo import make_closed_loop_task
from jaxtube.statistics.run import BLOCK, TILE, BlockSize, Run
from jaxtube.synthesis.design import design as make_design

DAQP = "DAQP update+solve"
CLOCK = "DAQP own clock"


class Extent(NamedTuple):
    """How much is measured: laps whose programs the exact solver gets, and rounds."""

    laps: int
    rounds: int


FULL = Extent(laps=64, rounds=7)
QUICK = Extent(laps=2, rounds=2)


class LoopResult(NamedTuple):
    """What was measured of one closed loop.

    Attributes:
        scenario, starts: of the laps.
        periods: of a block of laps, and of those whose programs the exact solver got.
        seconds: of a period, by what was timed and by rounds: "bare", "checked", and those of DAQP
            where it is installed.
        active: share of the recorded periods with an active row.
        unsolved, largest_residual: of the recorded periods: those without an answer, and the
            largest residual of the others.
        wrong: recorded plans away from DAQP's; None without it.
    """

    scenario: str
    starts: str
    periods: tuple[int, int]
    seconds: dict[str, Float[np.ndarray, " rounds"]]
    active: float
    unsolved: int
    largest_residual: float
    wrong: int | None


def measure(
    scenarios: Sequence[tuple[str, str, Scenario]], seed: int, extent: Extent
) -> list[LoopResult]:
    """Measure closed loops of (name, starts, scenario) each."""
    total = len(scenarios) * extent.rounds
    results = []
    with progress(total, "running laps", "rounds") as bar:
        for name, starts, scenario in scenarios:
            results.append(measure_loop(name, starts, scenario, seed, extent, bar.update))
    return results


def measure_loop(
    name: str,
    starts: str,
    scenario: Scenario,
    seed: int,
    extent: Extent,
    tick: Callable[[], object],
) -> LoopResult:
    """Measure one closed loop, `tick` being called after every round."""
    design = make_design(scenario)
    task = make_closed_loop_task(design, "tube_mpc", "robot", starts, None, seed)
    controller = task.controller
    assert isinstance(controller, TubeMpc)
    run = Run(task, BLOCK, 1, tuple(jax.local_devices()[:1]))
    first = jnp.uint32(0)
    size = BlockSize(BLOCK, TILE)
    record = record_laps(controller, task.plant, task.starts, seed, range(extent.laps))
    work: dict[str, Callable[[], object]] = {
        "bare": lambda: jax.block_until_ready(run_bare_laps(task, first, size)),
        "checked": lambda: jax.block_until_ready(run.dispatch([0])),
    }
    clock = None
    wrong = None
    if EXACT[0].is_installed:
        solver = make_daqp_of_laps(controller, record)
        assert solver.clock
        clock = OwnClock(solver.clock)
        work |= {DAQP: solver.run, CLOCK: clock.run}
        wrong = count_wrong(*select_solved(record, solver.answer().x))
    seconds = time_rounds(work, extent.rounds, tick)
    steps, laps = record.status.shape
    periods = {"bare": steps * BLOCK, "checked": steps * BLOCK, DAQP: steps * laps}
    by_period = {name: seconds[name] / periods[name] for name in periods if name in seconds}
    if clock:
        by_period[CLOCK] = clock.seconds
    solved = record.status == qp.SOLVED
    return LoopResult(
        name,
        starts,
        (steps * BLOCK, steps * laps),
        by_period,
        active=float(np.mean(record.active)),
        unsolved=int(np.sum(~solved)),
        largest_residual=float(np.max(record.residual[solved])),
        wrong=wrong,
    )


def make_daqp_of_laps(controller: TubeMpc, record: Record) -> Solver:
    """Return DAQP with the programs of laps, lap by lap, one model for each window.

    Each program starts with the rows that were active in the last one of its window: in the period
    before, mostly.
    """
    steps, laps = record.status.shape
    index = np.asarray(controller.index)
    models: dict[int, DaqpModel] = {}
    data: list[list[tuple]] = []
    for step in range(steps):
        window = int(index[step])
        condensed = take_qp(controller.qps, window)
        problems = pose(condensed, record.starts[step])
        if window not in models:
            models[window] = set_up_daqp(problems)
        data.append([(models[window].model, *each) for each in make_daqp_data(problems)])

    def solve(model, q, lower, upper, models=models):
        model.update(f=q, blower=lower, bupper=upper)
        return model.solve()

    lap_by_lap = [data[step][lap] for lap in range(laps) for step in range(steps)]
    return one_by_one(lap_by_lap, solve, read_daqp, read_daqp_clock)


def select_solved(
    record: Record, exact: Float[np.ndarray, "periods n"]
) -> tuple[Float[np.ndarray, "k n"], Float[np.ndarray, "k n"]]:
    """Return plans of the periods that were solved, and those of DAQP, which come lap by lap."""
    solved = record.status.T.ravel() == qp.SOLVED
    plans = np.swapaxes(record.plans, 0, 1).reshape(exact.shape)
    return plans[solved], exact[solved]
