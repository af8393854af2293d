"""Blocks on the workers of a Dask cluster: a block is a task, and its statistics come back to the
one writer.

    local:N          N workers on this machine, each on a processor of its own
    tcp://HOST:8786  the workers of a running scheduler

What a worker needs travels as arrays, so that all compute with the same bits; blocks of a lost
worker are computed again by others. A worker runs as many blocks at a time as it has threads, each
thread on a device of its own.
"""

from __future__ import annotations

import asyncio
import dataclasses
import functools
import itertools
import os
import threading
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from types import ModuleType
from typing import Any

import jax
import numpy as np

from jaxtube.experiments.run.folder import source_hashes, version
from jaxtube.plant.random_keys import wrap_key
from jaxtube.scenario.refusal import refusal
from jaxtube.statistics.run import Run, Statistics

IN_FLIGHT = 3
"""Tasks handed out for each thread of the cluster: enough to keep it busy, few enough to hold in
memory."""
SECONDS_TO_CONNECT = 20
LOSSES = 20
"""Workers that may be lost while they compute the same block, before the run gives up."""


def import_distributed(name: str) -> ModuleType:
    """Return Dask's library of clusters.

    Args:
        name: what `--cluster` gives.

    Raises:
        ScenarioError: where it is not installed.
    """
    try:
        import distributed
    except ImportError:
        raise _refuse(name, "needs Dask", "pip install 'jaxtube[cluster]'") from None
    return distributed


class Cluster:
    """The workers that an option names; a context."""

    def __init__(self, name: str, run: Run):
        """Connect.

        Args:
            name: "local:N" or the address of a scheduler.
            run: what to compute; its devices and chunk do not count here.

        Raises:
            ScenarioError: no such cluster, or no Dask; later, for a worker with another version of
                the code.
        """
        self._distributed = import_distributed(name)
        self._name = name
        self._local = None
        self._client = self._connect()
        self._client.wait_for_workers(1)
        # A task of its own, not data put on a worker: should that worker be lost, the scheduler can
        # make it again.
        job = Job.from_run(run, pinned=self._is_local)
        self._job = self._client.submit(_return, job, pure=False)

    def __enter__(self) -> Cluster:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Leave the scheduler; end the workers that were started here."""
        self._client.close()
        if self._local:
            self._local.close()

    def compute(self, blocks: Iterable[int]) -> Iterator[tuple[int, Statistics]]:
        """Yield the statistics of blocks as they are ready, in any order."""
        pending = self._distributed.as_completed(
            loop=self._client.loop, with_results=True, raise_errors=False
        )
        source = iter(blocks)
        block_of = {}

        def submit(block: int) -> None:
            future = self._client.submit(compute, self._job, block, pure=False)
            block_of[future] = block
            pending.add(future)

        def top_up() -> None:
            # Workers come and go: how many there are is asked each time.
            room = IN_FLIGHT * self.at_once - len(block_of)
            for block in itertools.islice(source, max(room, 0)):
                submit(block)

        top_up()
        for future, result in pending:
            block = block_of.pop(future)
            if future.status == "finished":
                top_up()
                yield result
            elif isinstance(future.exception(), self._distributed.KilledWorker):
                submit(block)
            else:
                raise self._explain(future.exception())

    @property
    def at_once(self) -> int:
        """Blocks that the workers there are now compute at a time."""
        return max(sum(self._client.nthreads().values()), 1)

    @property
    def _is_local(self) -> bool:
        return self._name.partition(":")[0] == "local"

    def _connect(self) -> Any:
        from dask.config import set as configure

        # The profiler of a worker looks at its threads a hundred times a second; blocks take a
        # second each.
        settings = {
            "distributed.scheduler.allowed-failures": LOSSES,
            "distributed.worker.profile.enabled": False,
        }
        configure(settings)
        try:
            address = self._start_workers() if self._is_local else self._check_scheduler()
            # Not the process's default: xarray would ask it for its locks.
            return self._distributed.Client(
                address, timeout=SECONDS_TO_CONNECT, set_as_default=False
            )
        except (OSError, ValueError) as error:
            problem = f"cannot be reached ({str(error) or type(error).__name__})"
            cure = "write local:N, or the address of a running scheduler"
            raise _refuse(self._name, problem, cure) from None

    def _start_workers(self) -> Any:
        """Start workers on this machine.

        Raises:
            ValueError: for what is no number of workers.
        """
        count = int(self._name.partition(":")[2])
        if count < 1:
            raise ValueError("no workers")
        self._local = self._distributed.LocalCluster(
            n_workers=count, threads_per_worker=1, dashboard_address=None
        )
        return self._local

    def _check_scheduler(self) -> str:
        """Ask the address whether a scheduler is there, and return it.

        A client that fails to connect waits longer than it was told, and prints a traceback later.

        Raises:
            OSError: where no scheduler answers; TimeoutError is one.
            ValueError: for what is no address.
        """

        async def ask() -> str:
            async with self._distributed.rpc(self._name) as scheduler:
                return (await scheduler.identity())["type"]

        kind = asyncio.run(asyncio.wait_for(ask(), SECONDS_TO_CONNECT))
        if kind != "Scheduler":
            raise ValueError(f"a {kind.lower()} answers there")
        return self._name

    def _explain(self, failure: BaseException) -> BaseException:
        """Return what to raise for a block that failed."""
        if not isinstance(failure, StrangerError):
            return failure
        cure = "install the same jaxtube and jax on all, of the same kind"
        return _refuse(self._name, str(failure), cure)


class StrangerError(RuntimeError):
    """A worker that would compute other bits than this process."""


@dataclass(frozen=True, eq=False)
class Job:
    """A run as plain arrays, which every worker turns into the same program."""

    task: Any
    key_data: np.ndarray
    realisations: int
    versions: dict[str, str]
    pinned: bool

    @classmethod
    def from_run(cls, run: Run, pinned: bool) -> Job:
        """Take a run apart."""
        task = dataclasses.replace(run.task, seed_key=None)
        arrays = jax.tree.map(np.asarray, task)
        key_data = np.asarray(jax.random.key_data(run.task.seed_key))
        return cls(arrays, key_data, run.realisations, _find_versions(), pinned)

    def make_run(self, device) -> Run:
        """Return the run on one device."""
        key = wrap_key(jax.numpy.asarray(self.key_data))
        task = jax.device_put(dataclasses.replace(self.task, seed_key=key), device)
        return Run(task, self.realisations, 1, (device,))


def compute(job: Job, block: int) -> tuple[int, Statistics]:
    """Compute one block in a thread of a worker."""
    run = _run_of_thread(threading.get_ident(), job)
    [result] = run.compute([block])
    return result


_threads: dict[int, int] = {}
"""Number of each thread of this worker, in the order in which they started."""


@functools.lru_cache(maxsize=64)
def _run_of_thread(thread: int, job: Job) -> Run:
    from distributed import get_worker

    if job.pinned:
        # The threads that JAX is about to start inherit the processor of the one that starts them.
        processors = sorted(os.sched_getaffinity(0))
        number = int(get_worker().name) % len(processors)
        os.sched_setaffinity(0, {processors[number]})
    jax.config.update("jax_enable_x64", job.versions["bits"] == "64")
    if _find_versions() != job.versions:
        raise StrangerError(
            f"{get_worker().address} has another version of jaxtube or jax, or other devices"
        )
    devices = jax.local_devices()
    number = _threads.setdefault(thread, len(_threads)) % len(devices)
    return job.make_run(devices[number])


def _return(job: Job) -> Job:
    return job


def _find_versions() -> dict[str, str]:
    packages = {name: version(name) or "" for name in ("jax", "jaxlib", "numpy")}
    bits = str(jax.dtypes.canonicalize_dtype(float).itemsize * 8)
    return source_hashes() | packages | {"backend": jax.default_backend(), "bits": bits}


def _refuse(name: str, problem: str, cure: str) -> Exception:
    return refusal("command line", "--cluster", name, problem, cure)
