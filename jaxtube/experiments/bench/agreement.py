"""The same laps on the GPU and on a processor: how far their trajectories are apart, and whether
the same events are counted.

The processor's laps are run by a process of its own that knows no GPU, so with the processor's own
programs.

Source: new.
"""

from __future__ import annotations

import multiprocessing
from collections.abc import Sequence
from concurrent.futures import Future, ProcessPoolExecutor
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Int

from jaxtube.experiments.bench.programs import in_single_precision, simulate_laps
from jaxtube.scenario.tree import Scenario
from jaxtube.simulation.rollout import Trajectory, realisation_keys, rollout
from jaxtube.statistics.montecarlo import make_closed_loop_task
from jaxtube.statistics.run import Task
from jaxtube.synthesis.design import design as make_design

LARGEST = ("errors", "inputs", "wheels")
"""Parts of a trajectory that are compared."""


class Laps(NamedTuple):
    """What is compared of laps."""

    trajectory: Trajectory  # of the first of them
    events: Int[np.ndarray, "events steps+1"]  # laps by event and number of periods that had it


class Amount(NamedTuple):
    """How many laps are compared, from the first on."""

    recorded: int
    counted: int


def make_tasks(scenario: Scenario, seed: int, bits: Sequence[int]) -> dict[int, Task]:
    """Return the Monte Carlo of a scenario's tube-MPC, by the bits of its floats: 64 or 32."""
    found = make_design(scenario)
    task = make_closed_loop_task(found, "tube_mpc", "robot", "scenario", None, seed)
    return {number: task if number == 64 else in_single_precision(task) for number in bits}


def on_a_processor() -> ProcessPoolExecutor:
    """Return a process that computes on the processor, whatever else this machine has."""
    spawn = multiprocessing.get_context("spawn")
    return ProcessPoolExecutor(1, mp_context=spawn, initializer=_settle_on_the_processor)


def _settle_on_the_processor() -> None:
    jax.config.update("jax_platforms", "cpu")
    jax.config.update("jax_enable_x64", True)
    # Its programs run once: they are compiled in a hurry.
    jax.config.update("jax_disable_most_optimizations", True)


def ask(
    process: ProcessPoolExecutor,
    scenario: Scenario,
    seed: int,
    bits: Sequence[int],
    amount: Amount,
) -> Future[dict[int, Laps]]:
    """Return the processor's laps to be, by the bits of their floats."""
    return process.submit(run_laps, scenario, seed, bits, amount)


def run_laps(scenario: Scenario, seed: int, bits: Sequence[int], amount: Amount) -> dict[int, Laps]:
    """Return laps 0, 1, .. of a scenario, run where this process computes."""
    keys = realisation_keys(seed, 0, amount.recorded)
    laps = {}
    for number, task in make_tasks(scenario, seed, bits).items():
        trajectory = rollout(task.controller, task.plant, keys, task.starts.draw(keys))
        found = simulate_laps(task, jnp.uint32(0), laps=amount.counted)
        laps[number] = Laps(jax.tree.map(np.asarray, trajectory), np.asarray(found["events"]))
    return laps


class Agreement(NamedTuple):
    """How far laps are apart on two devices.

    Attributes:
        largest: differences by part: true errors (m, m, rad), inputs and wheels (m/s, rad/s).
        other_diagnostics: periods of recorded laps with another status, another set of active rows
            than none, or another use of the backup.
        events_differ: counts of events that differ.
    """

    largest: dict[str, float]
    other_diagnostics: int
    events_differ: int


def compare(here: Laps, there: Laps) -> Agreement:
    """Return how far the same laps are apart on two devices; infinite where a number is NaN."""
    largest = {
        name: _largest_difference(getattr(here.trajectory, name), getattr(there.trajectory, name))
        for name in LARGEST
    }
    told = here.trajectory.diagnostics
    others = there.trajectory.diagnostics
    differs = (told.status != others.status) | (told.active != others.active)
    differs = differs | (told.backup != others.backup)
    events = int(np.sum(here.events != there.events))
    return Agreement(largest, int(np.sum(differs)), events)


def _largest_difference(one: np.ndarray, other: np.ndarray) -> float:
    apart = np.abs(one.astype(float) - other.astype(float))
    return float(np.max(np.where(np.isnan(apart), np.inf, apart)))
