"""Laps a second of one program after the other, each as soon as it is compiled, within a time.

    checked   the Monte Carlo: every period checked, plans followed
    bare      the closed loop alone, of the most laps at once

Source: new.
"""

from __future__ import annotations

import textwrap
import time
from collections.abc import Callable
from concurrent.futures import Future
from typing import NamedTuple

import jax
import jax.numpy as jnp

from jaxtube.experiments.bench.programs import Program
from jaxtube.experiments.bench.watch import Watch
from jaxtube.statistics.run import Task

ROUNDS = 20
"""Of a program at most."""
LONG_S = 5.0
"""A round that needs no other one."""
GROWTH = 4.0
"""By which larger batches may take longer to measure."""


class Case(NamedTuple):
    """A closed loop: its scenario, and the floats it computes in."""

    scenario: str
    bits: int

    @property
    def words(self) -> str:
        """As in tables."""
        return f"{self.scenario}, float{self.bits}"


class Row(NamedTuple):
    """What was measured of one program.

    Attributes:
        scenario, bits: of the case.
        laps_at_once: side by side.
        compile_s: to trace and compile.
        bare_steps_per_s, checked_steps_per_s: periods a second, laps together; bare of the most
            laps at once alone.
        laps_per_s: checked.
        utilisation_percent, memory_mb: of the GPU while laps were checked; None where not known.
        temporary_mb: of the program.
    """

    scenario: str
    bits: int
    laps_at_once: int
    compile_s: float
    bare_steps_per_s: float | None
    checked_steps_per_s: float
    laps_per_s: float
    utilisation_percent: float | None
    memory_mb: float | None
    temporary_mb: float


class Programs(NamedTuple):
    """Programs of a case in the making: with checks by laps at once, ascending, and bare of the
    most."""

    checked: dict[int, Future[Program]]
    bare: Future[Program]


class Clock(NamedTuple):
    """The time that all of it may take, and how long a program is timed."""

    end: float  # time.perf_counter
    timed_s: float

    @property
    def left(self) -> float:
        """Seconds left, 0 at least."""
        return max(self.end - time.perf_counter(), 0.0)


class Timing(NamedTuple):
    """The fastest round of a program, and from when to when rounds ran."""

    seconds: float
    begin: float
    end: float


def measure_case(
    case: Case,
    task: Task,
    programs: Programs,
    watch: Watch,
    clock: Clock,
    tell: Callable[[Row], object],
) -> str:
    """Measure the programs of a case, few laps first.

    Args:
        case: what it is called.
        task: the closed loop, on the device.
        programs: of the case.
        watch: of the GPU.
        clock: of the command.
        tell: called with each row.

    Returns:
        Why it ended before the last program; empty where it did not.
    """
    seconds = 0.0
    most = max(programs.checked)
    for laps, future in programs.checked.items():
        if GROWTH * seconds > clock.left:
            return f"{case.words}: {laps:,} laps at once: no time left"
        try:
            program = future.result(timeout=clock.left)
            begin = time.perf_counter()
            row = _measure(case, task, laps, program, watch, clock)
            if laps == most:
                bare = time_rounds(programs.bare.result(timeout=clock.left), task, laps, clock)
                steps = laps * len(task.checks.transitions)
                row = row._replace(bare_steps_per_s=steps / bare.seconds)
            seconds = time.perf_counter() - begin
        except TimeoutError:
            return f"{case.words}: {laps:,} laps at once: not compiled in time"
        except Exception as error:  # of a compiler or a device: the other cases go on
            return f"{case.words}: {laps:,} laps at once: {first_line(error)}"
        tell(row)
    return ""


def _measure(
    case: Case, task: Task, laps: int, program: Program, watch: Watch, clock: Clock
) -> Row:
    checked = time_rounds(program, task, laps, clock)
    periods = laps * len(task.checks.transitions)
    return Row(
        scenario=case.scenario,
        bits=case.bits,
        laps_at_once=laps,
        compile_s=program.seconds,
        bare_steps_per_s=None,
        checked_steps_per_s=periods / checked.seconds,
        laps_per_s=laps / checked.seconds,
        utilisation_percent=watch.mean_utilisation(checked.begin, checked.end),
        memory_mb=watch.most_memory(checked.begin, checked.end),
        temporary_mb=program.megabytes,
    )


def time_rounds(program: Program, task: Task, laps: int, clock: Clock) -> Timing:
    """Return the fastest of some rounds, each with laps of its own, after one that warms up.

    A round so long that warming up hardly counts is the only one.
    """
    seconds = []
    begin = time.perf_counter()
    for number in range(ROUNDS):
        start = time.perf_counter()
        _run(program, task, number * laps)
        seconds.append(time.perf_counter() - start)
        if seconds[0] > LONG_S or (number and sum(seconds[1:]) >= clock.timed_s):
            break
    return Timing(min(seconds), begin, time.perf_counter())


def _run(program: Program, task: Task, first: int) -> None:
    jax.block_until_ready(program.call(task, jnp.uint32(first % 2**32)))


def first_line(error: Exception) -> str:
    """Return what a library says of an error, in short."""
    line = str(error).partition("\n")[0]
    return textwrap.shorten(f"{type(error).__name__}: {line}", 160)
