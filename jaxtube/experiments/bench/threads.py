"""Laps a second on one core and on two: by the devices of one process, each with a thread of its
own, and by the workers of a cluster.

Source: new.
"""

from __future__ import annotations

import contextlib
import os
import time
import warnings
from collections.abc import Callable, Iterator
from functools import partial
from typing import NamedTuple

import jax
import numpy as np
from jaxtyping import Float

from jaxtube.experiments.bench.rounds import time_rounds
from jaxtube.experiments.run.blocks import use_devices
from jaxtube.experiments.run.cluster import Cluster
from jaxtube.progress import progress
from jaxtube.scenario.tree import Scenario
from jaxtube.statistics.montecarlo import make_closed_loop_task
from jaxtube.statistics.run import BLOCK, Run, Task
from jaxtube.synthesis.design import design as make_design

UNLIMITED = 10**12
"""Laps of a run that is timed: more than it will do."""


class Extent(NamedTuple):
    """How much is measured: blocks of a round, and rounds."""

    blocks: int
    rounds: int


FULL = Extent(blocks=8, rounds=5)
QUICK = Extent(blocks=2, rounds=2)


class ThreadsResult(NamedTuple):
    """What was measured.

    Attributes:
        cores: that this process had.
        laps: of a round.
        load: processes that wanted a core of this machine when it began, those of others.
        seconds: of a round by kind ("devices", "workers") and how many of them.
    """

    cores: int
    laps: int
    load: float
    seconds: dict[tuple[str, int], Float[np.ndarray, " rounds"]]


def measure(scenario: Scenario, seed: int, extent: Extent, kinds: tuple[str, ...]) -> ThreadsResult:
    """Measure laps of the tube-MPC of a scenario, every period checked, on one and on two of every
    kind."""
    load = os.getloadavg()[0]
    use_devices(0)
    design = make_design(scenario)
    task = make_closed_loop_task(design, "tube_mpc", "robot", "scenario", None, seed)
    seconds = {}
    with progress(len(kinds) * extent.rounds, "running laps", "rounds") as bar:
        for kind in kinds:
            with SOURCES[kind](task) as sources:
                work = {f"{count}": partial(_run, each, extent) for count, each in sources.items()}
                timed = time_rounds(work, extent.rounds, bar.update, time.perf_counter)
            seconds |= {(kind, int(count)): each for count, each in timed.items()}
    cores = len(os.sched_getaffinity(0))
    return ThreadsResult(cores, extent.blocks * BLOCK, load, seconds)


Sources = dict[int, "Run | Cluster"]


@contextlib.contextmanager
def _open_devices(task: Task) -> Iterator[Sources]:
    devices = tuple(jax.local_devices())
    yield {
        count: Run(task, UNLIMITED, 1, devices[:count]) for count in sorted({1, len(devices[:2])})
    }


@contextlib.contextmanager
def _open_workers(task: Task) -> Iterator[Sources]:
    run = Run(task, UNLIMITED, 1, tuple(jax.local_devices()[:1]))
    # Dask tells that the second cluster's pages are not where the first one's are.
    warnings.filterwarnings("ignore", r"Port \d+ is already in use")
    with Cluster("local:1", run) as one, Cluster("local:2", run) as two:
        yield {1: one, 2: two}


SOURCES: dict[str, Callable[[Task], contextlib.AbstractContextManager[Sources]]] = {
    "devices": _open_devices,
    "workers": _open_workers,
}


def _run(source: Run | Cluster, extent: Extent) -> None:
    for _ in source.compute(range(extent.blocks)):
        pass
