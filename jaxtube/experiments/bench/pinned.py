"""Work in a process of its own that has a given number of cores, and one thread on each.

Libraries settle their threads when they are imported, so what is to be timed has to be imported
where cores and threads are already settled.

Source: new.
"""

from __future__ import annotations

import contextlib
import multiprocessing
import os
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from typing import ParamSpec, TypeVar

SINGLE_THREADS = {
    "OMP_NUM_THREADS": "1",
    "OPENBLAS_NUM_THREADS": "1",
    "MKL_NUM_THREADS": "1",
    "RAYON_NUM_THREADS": "1",
    "JAX_PLATFORMS": "cpu",
}
"""Variables by which libraries take one thread, and JAX the processor."""
XLA_SINGLE_THREAD = "--xla_cpu_multi_thread_eigen=false intra_op_parallelism_threads=1"

Arguments = ParamSpec("Arguments")
Result = TypeVar("Result")


def run_pinned(
    cores: int,
    function: Callable[Arguments, Result],
    *arguments: Arguments.args,
    **options: Arguments.kwargs,
) -> Result:
    """Return what a function of a module returns, computed on so many cores of this machine.

    Args:
        cores: how many, taken from those that this process may use, the last ones first; all of
            them where there are fewer.
        function: of a module, which is imported there.
        arguments, options: of the function; they and the result are pickled.

    Raises:
        Exception: what the function raises.
    """
    spawn = multiprocessing.get_context("spawn")
    with (
        _threads_settled(),
        ProcessPoolExecutor(1, mp_context=spawn, initializer=_settle, initargs=(cores,)) as process,
    ):
        return process.submit(function, *arguments, **options).result()


@contextlib.contextmanager
def _threads_settled() -> Iterator[None]:
    """Let processes that are started have one thread a library."""
    before = dict(os.environ)
    flags = f"{before.get('XLA_FLAGS', '')} {XLA_SINGLE_THREAD}".strip()
    os.environ.update(SINGLE_THREADS, XLA_FLAGS=flags)
    try:
        yield
    finally:
        os.environ.clear()
        os.environ.update(before)


def _settle(cores: int) -> None:
    """Take the last cores, away from the first one, on which interrupts are served; and let nothing
    be printed, as solvers do that are told not to."""
    if hasattr(os, "sched_setaffinity"):
        present = sorted(os.sched_getaffinity(0))
        os.sched_setaffinity(0, present[-cores:])
    os.environ["JAX_ENABLE_X64"] = "1"
    os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
