"""What a plan costs against the share of a batch that has active rows.

The plans start where laps of a scenario had them, in the window with most active rows: so many with
an active row, the others without.

Source: new.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Float

from jaxtube import qp
from jaxtube.control import planning
from jaxtube.control.planning import CondensedQp, take_qp
from jaxtube.experiments.bench.peers.active_set import make_cold_daqp
from jaxtube.experiments.bench.peers.catalogue import EXACT
from jaxtube.experiments.bench.recorded import LAPS, pose, record_laps
from jaxtube.experiments.bench.rounds import OwnClock, time_rounds
from jaxtube.experiments.bench.solvers import CLOCK, DAQP, KNOWING
from jaxtube.progress import progress
from jaxtube.scenario.tree import Scenario
from jaxtube.simulation.choices import choose_starts
from jaxtube.simulation.components import make_tube_mpc, slipping_robot
from jaxtube.statistics.run import TILE
from jaxtube.synthesis.design import design as make_design

TILES = 8
"""Batches that are planned one after the other, so that to begin hardly counts."""


class Extent(NamedTuple):
    """How much is measured: shares of active instances in a batch, and rounds."""

    shares: tuple[float, ...]
    rounds: int


FULL = Extent((0.0, 0.002, 0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1.0), 7)
QUICK = Extent((0.0, 0.1, 1.0), 2)


class SharesResult(NamedTuple):
    """What was measured.

    Attributes:
        batch: plans that are made at once.
        shares: of them with an active row.
        microseconds: of a plan by solver: one array of rounds for each share.
        largest_residual: of all plans; infinite where one was not found.
    """

    batch: int
    shares: tuple[float, ...]
    microseconds: dict[str, list[Float[np.ndarray, " rounds"]]]
    largest_residual: float


def measure(scenario: Scenario, seed: int, extent: Extent) -> SharesResult:
    """Measure plans of a scenario."""
    condensed, active, free = record_starts(scenario, seed)
    batches = [mix(active, free, round(share * TILE)) for share in extent.shares]
    tiles = [jnp.asarray(starts.reshape(TILES, TILE, 3)) for starts in batches]
    make_plans = partial(plan_in_turn, condensed)
    work: dict[str, Callable[[], object]] = {}
    clocks = {}
    for number, starts in enumerate(batches):
        work[f"{KNOWING} {number}"] = partial(_run, make_plans, tiles[number])
        if EXACT[0].is_installed:
            solver = make_cold_daqp(pose(condensed, starts))
            assert solver.clock
            clocks[number] = OwnClock(solver.clock)
            work |= {f"{DAQP} {number}": solver.run, f"{CLOCK} {number}": clocks[number].run}
    with progress(extent.rounds, "planning", "rounds") as bar:
        seconds = time_rounds(work, extent.rounds, bar.update)
    microseconds = {}
    for name in (KNOWING, DAQP) if clocks else (KNOWING,):
        rounds = [seconds[f"{name} {number}"] for number in range(len(batches))]
        microseconds[name] = [1e6 * each / (TILES * TILE) for each in rounds]
    if clocks:
        microseconds[CLOCK] = [1e6 * clock.seconds for clock in clocks.values()]
    residual = max(find_residual(make_plans(each)) for each in tiles)
    return SharesResult(TILE, extent.shares, microseconds, residual)


def record_starts(
    scenario: Scenario, seed: int
) -> tuple[CondensedQp, Float[np.ndarray, "k 3"], Float[np.ndarray, "l 3"]]:
    """Return the window whose plans have most active rows in laps, with the starts of those plans,
    and of its others."""
    design = make_design(scenario)
    controller = make_tube_mpc(design)
    law = choose_starts(design, "scenario")
    record = record_laps(controller, slipping_robot(design), law, seed, range(LAPS))
    index = design.windows.index
    window = int(np.argmax(np.bincount(index, weights=record.active.sum(axis=1))))
    starts = record.starts[index == window]
    active = record.active[index == window]
    condensed = take_qp(controller.qps, window)
    return condensed, starts[active], starts[~active]


def mix(
    active: Float[np.ndarray, "k 3"], free: Float[np.ndarray, "l 3"], count: int
) -> Float[np.ndarray, "all 3"]:
    """Return starts batch by batch, so many of each with active rows, spread over it; rows are used
    again where there are too few."""
    generator = np.random.default_rng(0)
    is_active = np.tile(np.arange(TILE) < count, (TILES, 1))
    generator.permuted(is_active, axis=1, out=is_active)
    starts = np.resize(free, (TILES, TILE, 3))
    starts[is_active] = np.resize(active, (TILES * count, 3))
    return starts.reshape(-1, 3)


@jax.jit
def plan_in_turn(condensed: CondensedQp, starts: Float[Array, "tiles tile 3"]) -> planning.Plan:
    """Return the plans of batches, one after the other."""
    return jax.lax.map(partial(planning.plan, condensed), starts)


def find_residual(plan: planning.Plan) -> float:
    """Return the largest residual of plans; infinite where one was not found."""
    solved = np.asarray(plan.status) == qp.SOLVED
    return float(np.max(np.where(solved, plan.residual, np.inf)))


def _run(make_plans: Callable[..., planning.Plan], starts) -> None:
    jax.block_until_ready(make_plans(starts))
