"""`bench gpu`: what one GPU does of the Monte Carlo, within a few minutes.

Laps a second by laps at once, in float64 and float32, bare and with all checks; how busy the GPU
is; its laps beside the same ones of the processor; and how long a billion of them take. Programs
are compiled first, in threads, every row is printed and saved once it is measured, and the command
ends in time with what it has.

Without a GPU a small part of it runs on the processor, by the GPU's programs: that it works and
agrees is shown, and nothing of a GPU is measured.

Source: new.
"""

from __future__ import annotations

import concurrent.futures
import itertools
import os
from concurrent.futures import Future, ProcessPoolExecutor
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Float, Key

from jaxtube.experiments.bench import agreement
from jaxtube.experiments.bench.agreement import Amount, Laps
from jaxtube.experiments.bench.gpu_record import Record
from jaxtube.experiments.bench.programs import (
    Ahead,
    Program,
    compile_bare_laps,
    compile_laps,
    compile_trajectories,
)
from jaxtube.experiments.bench.sweep import Case, Clock, Programs, first_line, measure_case
from jaxtube.experiments.bench.watch import Watch
from jaxtube.experiments.environment import leave
from jaxtube.experiments.options import BenchOptions
from jaxtube.experiments.run import folder as run_folder
from jaxtube.qp.blocks import assume_accelerator
from jaxtube.scenario.reading import load
from jaxtube.scenario.tree import Scenario
from jaxtube.simulation.rollout import realisation_keys
from jaxtube.statistics.run import Task

BESIDE = ("certified", "tuned")
"""Scenarios that a GPU runs beside the one that is asked for."""


class Extent(NamedTuple):
    """How much is measured: kinds of floats, laps at once of the scenario that is asked for and of
    those beside it, laps compared, and how long a program is timed."""

    bits: tuple[int, ...]
    laps: tuple[int, ...]
    laps_beside: tuple[int, ...]
    compared: Amount
    timed_s: float


SHARE = 0.75
"""Of the time, that may pass before anything is timed."""

ON_GPU = Extent((64, 32), (2**16, 2**20, 2**21), (2**16, 2**20), Amount(1024, 2**16), 1.0)
ON_PROCESSOR = Extent((64,), (256,), (), Amount(64, 256), 0.0)


class Job(NamedTuple):
    """A case, its task on the device, its programs in the making, and the processor's laps."""

    task: Task
    programs: Programs
    trajectories: Future[Program]
    there: Future[dict[int, Laps]]


def run(scenario: Scenario, options: BenchOptions) -> int:
    """Run the command; what was measured is printed and saved at once."""
    # Else the memory that `nvidia-smi` tells would be what JAX took in advance.
    os.environ.setdefault("XLA_PYTHON_CLIENT_PREALLOCATE", "false")
    device = jax.local_devices()[0]
    has_gpu = device.platform != "cpu"
    if not has_gpu:
        assume_accelerator()
    record = Record(run_folder.create(scenario, options), device, has_gpu)
    with Watch() as watch:
        measure_all(name_scenarios(scenario, options, has_gpu), options, record, watch)
    if has_gpu:
        # What is still being compiled, and not needed any more, would be waited for.
        leave(0)
    return 0


def name_scenarios(scenario: Scenario, options: BenchOptions, has_gpu: bool) -> dict[str, Scenario]:
    """Return what is run, by name: the scenario of the options first."""
    others = [name for name in BESIDE if has_gpu and name != options.scenario]
    return {options.scenario: scenario} | {name: load(name) for name in others}


def measure_all(
    scenarios: dict[str, Scenario], options: BenchOptions, record: Record, watch: Watch
) -> None:
    """Measure and compare as many cases as the time allows, and report the best."""
    extent = ON_GPU if record.has_gpu else ON_PROCESSOR
    clock = Clock(record.begin + options.seconds, extent.timed_s)
    process = agreement.on_a_processor()
    jobs = begin_all(scenarios, options.seed, record.device, extent, process)
    wait_for(jobs, clock)
    record.begin_rows()
    for case, job in jobs.items():
        record.say(measure_case(case, job.task, job.programs, watch, clock, record.add_row))
    for case, job in jobs.items():
        compare_laps(case, job, extent.compared, options.seed, clock, record)
    record.end()
    process.shutdown(wait=not record.has_gpu, cancel_futures=True)


def begin_all(
    scenarios: dict[str, Scenario],
    seed: int,
    device: Any,
    extent: Extent,
    process: ProcessPoolExecutor,
) -> dict[Case, Job]:
    """Ask for all programs, and for the processor's laps, in the order in which they are needed."""
    threads = len(os.sched_getaffinity(0)) // 2
    ahead = Ahead(max(threads, 1))
    jobs = {}
    there = {
        name: agreement.ask(process, scenario, seed, extent.bits, extent.compared)
        for name, scenario in scenarios.items()
    }
    for name, scenario in scenarios.items():
        sizes = extent.laps_beside if jobs else extent.laps
        with jax.default_device(jax.local_devices(backend="cpu")[0]):
            tasks = agreement.make_tasks(scenario, seed, extent.bits)
        for bits, made in tasks.items():
            task = put(made, device)
            checked = {laps: ahead.ask(partial(compile_laps, task, laps)) for laps in sizes}
            bare = ahead.ask(partial(compile_bare_laps, task, max(sizes)))
            keys, errors = draw_starts(task, seed, extent.compared.recorded)
            trajectories = ahead.ask(partial(compile_trajectories, task, keys, errors))
            jobs[Case(name, bits)] = Job(task, Programs(checked, bare), trajectories, there[name])
    return jobs


def wait_for(jobs: dict[Case, Job], clock: Clock) -> None:
    """Wait until all programs are made: to make them takes the processor that feeds the GPU."""
    programs = [[*job.programs.checked.values(), job.programs.bare] for job in jobs.values()]
    concurrent.futures.wait(itertools.chain.from_iterable(programs), SHARE * clock.left)


def put(task: Task, device: Any) -> Task:
    """Return a task whose arrays are on a device."""

    def put_array(leaf):
        return jax.device_put(leaf, device) if hasattr(leaf, "dtype") else leaf

    return jax.tree.map(put_array, task)


def draw_starts(
    task: Task, seed: int, laps: int
) -> tuple[Key[Array, " laps"], Float[Array, "laps 3"]]:
    """Return the keys and the true initial errors, (m, m, rad), of the first laps."""
    keys = realisation_keys(seed, 0, laps)
    return keys, task.starts.draw(keys)


def compare_laps(
    case: Case, job: Job, amount: Amount, seed: int, clock: Clock, record: Record
) -> None:
    """Compare laps of a case with those of the processor, where both are there in time."""
    try:
        program = job.trajectories.result(timeout=clock.left)
        counting = job.programs.checked[amount.counted].result(timeout=clock.left)
        there = job.there.result(timeout=clock.left)
    except TimeoutError:
        record.say(f"{case.words}: not compared with the processor: no time left")
        return
    except Exception as error:  # of a compiler or a device: the other cases go on
        record.say(f"{case.words}: not compared with the processor: {first_line(error)}")
        return
    task = job.task
    trajectory = program.call(
        task.controller, task.plant, *draw_starts(task, seed, amount.recorded)
    )
    found = counting.call(task, jnp.uint32(0))
    here = Laps(jax.tree.map(np.asarray, trajectory), np.asarray(found["events"]))
    record.add_agreement(case, amount, agreement.compare(here, there[case.bits]))
