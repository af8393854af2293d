"""The programs that `bench gpu` times, compiled ahead in threads of their own.

A program runs one block of the Monte Carlo whose laps all run side by side, so its checks are those
of `montecarlo`; or it runs bare laps, the closed loop and nothing else.
No array of the size of the laps enters or leaves it: there is no buffer to donate.

Source: new.
"""

from __future__ import annotations

import queue
import threading
import time
from collections.abc import Callable
from concurrent.futures import Future
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import Array
from jaxtyping import Float, Key, UInt32

from jaxtube.columns import loop_by_columns
from jaxtube.plant.slip import realisation_key
from jaxtube.simulation.rollout import begin, rollout, run_period
from jaxtube.statistics.run import BlockSize, Task, simulate_block

GPU_COMPILER = {"xla_gpu_autotune_level": 0, "xla_gpu_enable_triton_gemm": False}
"""Products are small and few here; to time variants of each takes minutes of the GPU."""
QUICK_COMPILER = {"xla_backend_optimization_level": 0, "xla_llvm_disable_expensive_passes": True}
"""For programs on a processor, whose speed nobody asks for."""


class Program(NamedTuple):
    """A compiled program: how it is called, and what it costs before and beside its arguments."""

    call: Callable[..., Any]
    seconds: float  # to trace and to compile
    megabytes: float  # of temporary memory


Build = Callable[[], Program]


def compile_laps(task: Task, laps: int) -> Program:
    """Return the program of laps side by side, every period checked: call(task, first lap)."""
    return _compile(simulate_laps, (task, jnp.uint32(0)), laps=laps)


def compile_bare_laps(task: Task, laps: int) -> Program:
    """Return the program of laps side by side, without checks: call(task, first lap)."""
    return _compile(run_bare_laps, (task, jnp.uint32(0)), size=BlockSize(laps, laps))


def compile_trajectories(
    task: Task, keys: Key[Array, " laps"], errors: Float[Array, "laps 3"]
) -> Program:
    """Return the program that records laps: call(controller, plant, keys, errors)."""
    return _compile(rollout, (task.controller, task.plant, keys, errors))


@partial(jax.jit, static_argnames="laps")
def simulate_laps(task: Task, first: UInt32[Array, ""], laps: int) -> dict[str, Array]:
    """Return the statistics of laps that run side by side, from number `first` below 2^32 on."""
    words = jnp.stack([jnp.zeros_like(first), first])
    count = jnp.int32(laps)
    number = jnp.int32(0)
    return simulate_block(task, words, count, number, BlockSize(laps, laps))


@partial(jax.jit, static_argnames="size")
def run_bare_laps(
    task: Task, first: UInt32[Array, ""], size: BlockSize
) -> Float[Array, "tiles tile 3"]:
    """Run laps from number `first` below 2^32 on, tile by tile, with nothing checked; return their
    last errors."""
    steps = len(task.plant.reference_wheels)

    def run_tile(place):
        low = first + place * size.tile + jnp.arange(size.tile, dtype=jnp.uint32)
        keys = jax.vmap(lambda word: realisation_key(task.seed_key, jnp.uint32(0), word))(low)
        start = begin(task.controller, task.plant, keys, task.starts.draw(keys))

        def period(step, state):
            return run_period(task.controller, task.plant, keys, step, state)[0]

        return loop_by_columns(jnp.int32(0), jnp.int32(steps), period, start).errors

    return jax.lax.map(run_tile, jnp.arange(size.block // size.tile, dtype=jnp.uint32))


def _compile(function, arguments: tuple, **static) -> Program:
    begin = time.perf_counter()
    options = QUICK_COMPILER if jax.default_backend() == "cpu" else GPU_COMPILER
    compiled = function.lower(*arguments, **static).compile(compiler_options=options)
    analysis = compiled.memory_analysis()
    megabytes = analysis.temp_size_in_bytes / 1e6 if analysis else float("nan")
    return Program(compiled, time.perf_counter() - begin, megabytes)


def in_single_precision(task: Task) -> Task:
    """Return a task whose real numbers are rounded to float32."""
    return jax.tree.map(_round, task)


def _round(leaf):
    is_double = getattr(leaf, "dtype", None) == jnp.float64
    return leaf.astype(jnp.float32) if is_double else leaf


class Ahead:
    """Programs in the making, begun in the order in which they are asked for."""

    def __init__(self, threads: int):
        """Start the threads; they end with the process, whatever they are at."""
        self._waiting: queue.SimpleQueue[tuple[Build, Future]] = queue.SimpleQueue()
        for _ in range(threads):
            threading.Thread(target=self._work, daemon=True).start()

    def ask(self, build: Build) -> Future[Program]:
        """Return the program to be."""
        future: Future[Program] = Future()
        self._waiting.put((build, future))
        return future

    def _work(self) -> None:
        while True:
            build, future = self._waiting.get()
            try:
                future.set_result(build())
            except Exception as error:  # told where the program is waited for
                future.set_exception(error)
