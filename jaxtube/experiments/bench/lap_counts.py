"""Laps a second against how many laps a Monte Carlo has, and against how many run side by side.

Source: new.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from jaxtube.experiments.bench.programs import run_bare_laps
from jaxtube.experiments.bench.rounds import Seconds, time_rounds
from jaxtube.progress import progress
from jaxtube.scenario.tree import Scenario
from jaxtube.statistics.montecarlo import make_closed_loop_task
from jaxtube.statistics.run import BLOCK, BlockSize, Run, Task
from jaxtube.synthesis.design import design as make_design


class Extent(NamedTuple):
    """How much is measured: laps of a Monte Carlo, laps side by side, rounds, and the seconds that
    the longest Monte Carlo may take."""

    laps: tuple[int, ...]
    tiles: tuple[int, ...]
    rounds: int
    longest_s: float


FULL = Extent((1_000, 10_000, 100_000, 1_000_000), (64, 256, 512, 1024, 4096), 3, 60.0)
QUICK = Extent((1_000, 4_096), (256, 512), 2, 10.0)


class LapsResult(NamedTuple):
    """What was measured.

    Attributes:
        checked: laps a second by laps of a Monte Carlo, every period checked, by rounds; those of
            one round took too long for more.
        left_out: seconds that a Monte Carlo would have taken, by laps, where that was too long.
        bare: laps a second without checks by laps side by side.
    """

    checked: dict[int, Float[np.ndarray, " rounds"]]
    left_out: dict[int, float]
    bare: dict[int, Float[np.ndarray, " rounds"]]


def measure(scenario: Scenario, seed: int, extent: Extent) -> LapsResult:
    """Measure laps of the tube-MPC of a scenario."""
    design = make_design(scenario)
    task = make_closed_loop_task(design, "tube_mpc", "robot", "scenario", None, seed)
    with progress(2 * extent.rounds, "running laps", "rounds") as bar:
        plan = plan_counts(task, extent)
        work = {f"{laps}": partial(run_checked, task, laps) for laps in plan.in_rounds}
        seconds = time_rounds(work, extent.rounds, bar.update)
        for laps in plan.once:
            seconds[f"{laps}"] = np.array([time_checked(task, laps)])
        checked = {int(laps): int(laps) / each for laps, each in seconds.items()}
        bare = time_rounds(bare_work(task, extent.tiles), extent.rounds, bar.update)
    return LapsResult(checked, plan.left_out, laps_per_second(bare))


class Plan(NamedTuple):
    """Counts of laps that are run in every round, and once; seconds that the others would take."""

    in_rounds: list[int]
    once: list[int]
    left_out: dict[int, float]


def plan_counts(task: Task, extent: Extent) -> Plan:
    """Return what there is time for, by the time of one block."""
    run_checked(task, BLOCK)
    of_a_lap = time_checked(task, BLOCK) / BLOCK
    plan = Plan([], [], {})
    for laps in extent.laps:
        seconds = of_a_lap * laps
        if extent.rounds * seconds <= extent.longest_s:
            plan.in_rounds.append(laps)
        elif seconds <= extent.longest_s:
            plan.once.append(laps)
        else:
            plan.left_out[laps] = seconds
    return plan


def run_checked(task: Task, laps: int) -> None:
    """Run so many laps as `montecarlo` does, on one device, block by block."""
    run = Run(task, laps, 1, tuple(jax.local_devices()[:1]))
    for _ in run.compute(range(-(-laps // BLOCK))):
        pass


def time_checked(task: Task, laps: int) -> float:
    """Return the seconds that so many laps take."""
    start = time.process_time()
    run_checked(task, laps)
    return time.process_time() - start


def bare_work(task: Task, tiles: tuple[int, ...]) -> dict[str, Callable[[], object]]:
    """Return what runs a block, by how many of its laps run side by side."""
    first = jnp.uint32(0)
    sizes = {f"{tile}": BlockSize(BLOCK, tile) for tile in tiles}
    return {
        name: lambda size=size: jax.block_until_ready(run_bare_laps(task, first, size))
        for name, size in sizes.items()
    }


def laps_per_second(seconds: Seconds) -> dict[int, Float[np.ndarray, " rounds"]]:
    """Return speeds of a block by laps side by side."""
    return {int(tile): BLOCK / each for tile, each in seconds.items()}
