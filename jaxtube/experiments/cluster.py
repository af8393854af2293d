"""Blocks on the workers of a Dask cluster: a block is a task, and its statistics come back to the one writer.

    local:N          N workers on this machine, each on a processor of its own
    tcp://HOST:8786  the workers of a running scheduler

What a worker needs travels as arrays, so that all compute with the same bits; blocks of a lost worker are computed
again by others. A worker runs as many blocks at a time as it has threads, each thread on a device of its own.
"""

from __future__ import annotations

import dataclasses
import functools
import os
import threading
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Any

import jax
import numpy as np

from jaxtube.experiments.run_folder import source_hashes, version
from jaxtube.montecarlo import Run, Statistics
from jaxtube.scenario.refusal import refusal

IN_FLIGHT = 3
"""Tasks handed out for each thread of the cluster: enough to keep it busy, few enough to hold in memory."""
SECONDS_TO_CONNECT = 20
RETRIES = 20
"""How often a block is tried again when its worker is lost."""


class Cluster:
    """The workers that an option names; a context.

    at_once: blocks that they computed at a time when they were met.
    """

    def __init__(self, name: str, run: Run):
        """Connect.

        Args:
            name: "local:N" or the address of a scheduler.
            run: what to compute; its devices and chunk do not count here.

        Raises:
            ScenarioError: no such cluster, no Dask, or workers with other versions of the code.
        """
        try:
            import distributed
        except ImportError:
            raise _refuse(name, "needs Dask", "pip install 'jaxtube[cluster]'") from None
        self._distributed, self._name, self._local = distributed, name, None
        self._client = self._connect(name)
        versions = self._client.run(_versions)
        if strangers := sorted(worker for worker, found in versions.items() if found != _versions()):
            self.close()
            raise _refuse(name, f"{strangers[0]} has another version of jaxtube or jax", "install the same on all")
        # A task of its own, not data put on a worker: should that worker be lost, the scheduler can make it again.
        job = Job.of(run, pinned=name.startswith("local:"))
        self._job = self._client.submit(_same, job, retries=RETRIES, pure=False)
        self.at_once = max(sum(self._client.nthreads().values()), 1)

    def _connect(self, name: str):
        kind, _, count = name.partition(":")
        try:
            if kind == "local":
                workers = int(count)
                if workers < 1:
                    raise ValueError("no workers")
                self._local = self._distributed.LocalCluster(
                    n_workers=workers, threads_per_worker=1, dashboard_address=None
                )
                return self._distributed.Client(self._local)
            return self._distributed.Client(name, timeout=SECONDS_TO_CONNECT)
        except (OSError, ValueError, TimeoutError) as error:
            problem = f"cannot be reached ({error or type(error).__name__})"
            raise _refuse(name, problem, "write local:N, or the address of a running scheduler") from None

    def __enter__(self) -> Cluster:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Leave the scheduler; end the workers that were started here."""
        self._client.close()
        if self._local:
            self._local.close()

    def computed(self, blocks: Iterable[int]) -> Iterator[tuple[int, Statistics]]:
        """Yield the statistics of blocks as they are ready, in any order."""
        source, pending = iter(blocks), self._distributed.as_completed(with_results=True)

        def submit() -> bool:
            block = next(source, None)
            if block is not None:
                pending.add(self._client.submit(compute, self._job, block, retries=RETRIES, pure=False))
            return block is not None

        for _ in range(IN_FLIGHT * self.at_once):
            submit()
        for _, result in pending:
            submit()
            yield result


@dataclass(frozen=True, eq=False)
class Job:
    """A run as plain arrays, which every worker turns into the same program."""

    task: Any
    key_data: np.ndarray
    realisations: int
    bits: int
    pinned: bool

    @classmethod
    def of(cls, run: Run, pinned: bool) -> Job:
        """Take a run apart."""
        task = dataclasses.replace(run.task, seed_key=None)
        arrays = jax.tree.map(np.asarray, task)
        bits = jax.dtypes.canonicalize_dtype(float).itemsize * 8
        return cls(arrays, np.asarray(jax.random.key_data(run.task.seed_key)), run.realisations, bits, pinned)

    def on(self, device) -> Run:
        """Return the run on one device."""
        key = jax.random.wrap_key_data(jax.numpy.asarray(self.key_data))
        task = jax.device_put(dataclasses.replace(self.task, seed_key=key), device)
        return Run(task, self.realisations, 1, (device,))


def compute(job: Job, block: int) -> tuple[int, Statistics]:
    """Compute one block in a thread of a worker."""
    [found] = _run_of_thread(threading.get_ident(), job).computed([block])
    return found


_threads: dict[int, int] = {}


@functools.lru_cache(maxsize=64)
def _run_of_thread(thread: int, job: Job) -> Run:
    from distributed import get_worker

    if job.pinned:
        # The threads that JAX is about to start inherit the processor of the one that starts them.
        processors = sorted(os.sched_getaffinity(0))
        os.sched_setaffinity(0, {processors[int(get_worker().name) % len(processors)]})
    jax.config.update("jax_enable_x64", job.bits == 64)
    devices = jax.local_devices()
    return job.on(devices[_threads.setdefault(thread, len(_threads)) % len(devices)])


def _same(job: Job) -> Job:
    return job


def _versions() -> dict:
    return source_hashes() | {name: version(name) or "" for name in ("jax", "jaxlib", "numpy")}


def _refuse(name: str, problem: str, cure: str) -> Exception:
    return refusal("command line", "--cluster", name, problem, cure)
