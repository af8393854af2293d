"""`bench latency`: how long one step of one robot takes, call by call.

The errors are those of laps that were recorded beforehand. A step is all that a robot waits for:
from its errors to a command that Python has; of DAQP from its errors to a plan. Beside the wall
clock stands the processor's time of this process, in which other processes do not count.

Source: new.
"""

from __future__ import annotations

import os
import time
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple, Protocol

import jax
import numpy as np
from jax import monitoring
from jaxtyping import Float

from jaxtube.control.laws import TubeMpc
from jaxtube.control.planning import take_qp
from jaxtube.experiments.bench.peers.active_set import DaqpModel, set_up_daqp
from jaxtube.experiments.bench.peers.catalogue import EXACT
from jaxtube.experiments.bench.peers.problems import INFINITE
from jaxtube.experiments.bench.recorded import Record, pose, record_laps
from jaxtube.progress import progress
from jaxtube.scenario.tree import Scenario
from jaxtube.simulation.choices import choose_starts
from jaxtube.simulation.components import make_tube_mpc, slipping_robot
from jaxtube.simulation.stepper import Stepper
from jaxtube.synthesis.design import design as make_design

OURS = "jaxtube"
DAQP = "DAQP from Python"
COMPILING = "/jax/core/compile/"
"""Events that JAX tells when it traces a function or compiles a program begin so."""


class Extent(NamedTuple):
    """How many steps are timed, after how many that warm up."""

    steps: int
    warm_up: int


FULL = Extent(steps=20_000, warm_up=2_000)
QUICK = Extent(steps=600, warm_up=300)


class LatencyResult(NamedTuple):
    """What was measured of one closed loop.

    Attributes:
        scenario, starts: of its laps.
        microseconds: of every step after those that warm up, by controller: wall clock.
        own: the same by the processor's time of this process.
        load: processes that wanted a core of this machine when it began.
        active: share of the steps with an active row.
        compilations: how often JAX traced or compiled after warming up.
        grown_kib: memory that this process has more after those steps than before.
        largest_residual: of the recorded steps that were solved.
    """

    scenario: str
    starts: str
    microseconds: dict[str, Float[np.ndarray, " steps"]]
    own: dict[str, Float[np.ndarray, " steps"]]
    load: float
    active: float
    compilations: int
    grown_kib: float
    largest_residual: float


class OneRobot(Protocol):
    """A controller of one robot."""

    def restart(self) -> None:
        """Begin a lap."""
        ...

    def __call__(self, errors: Float[np.ndarray, "3"]) -> Any:
        """Return what the next period is to do."""
        ...


def measure(
    scenarios: Sequence[tuple[str, str, Scenario]], seed: int, extent: Extent
) -> list[LatencyResult]:
    """Measure closed loops of (name, starts, scenario) each."""
    with progress(len(scenarios), "stepping", "scenarios") as bar:
        results = []
        for name, starts, scenario in scenarios:
            results.append(measure_loop(name, starts, scenario, seed, extent))
            bar.update()
    return results


def measure_loop(
    name: str, starts: str, scenario: Scenario, seed: int, extent: Extent
) -> LatencyResult:
    """Measure one closed loop, the controllers taking turns lap by lap."""
    design = make_design(scenario)
    law = choose_starts(design, starts)
    controller = make_tube_mpc(design)
    steps = len(design.windows.index)
    laps = -(-(extent.steps + extent.warm_up) // steps)
    record = record_laps(controller, slipping_robot(design), law, seed, range(laps))
    robots: dict[str, OneRobot] = {OURS: Stepper(design, controller)}
    if EXACT[0].is_installed:
        robots[DAQP] = DaqpStepper(controller, record)
    times = {each: np.zeros((2, laps * steps)) for each in robots}
    load = os.getloadavg()[0]
    warm = -(-extent.warm_up // steps)
    run = partial(run_laps, robots, record.starts, times)
    run(range(warm))
    before = read_memory()
    with CountCompilations() as counted:
        run(range(warm, laps))
    return LatencyResult(
        name,
        starts,
        {each: 1e6 * seconds[0, warm * steps :] for each, seconds in times.items()},
        {each: 1e6 * seconds[1, warm * steps :] for each, seconds in times.items()},
        load,
        active=float(np.mean(record.active[:, warm:])),
        compilations=counted.count,
        grown_kib=(read_memory() - before) / 1024,
        largest_residual=float(np.max(record.residual)),
    )


def run_laps(
    robots: dict[str, OneRobot],
    errors: Float[np.ndarray, "steps laps 3"],
    times: dict[str, Float[np.ndarray, "2 all"]],
    laps: range,
) -> None:
    """Run laps, and note the seconds of every step: of the wall clock, and of this process."""
    steps = len(errors)
    for lap in laps:
        for name, robot in robots.items():
            robot.restart()
            seconds = times[name][:, lap * steps : (lap + 1) * steps]
            for step in range(steps):
                own = time.process_time()
                start = time.perf_counter()
                robot(errors[step, lap])
                seconds[0, step] = time.perf_counter() - start
                seconds[1, step] = time.process_time() - own


class DaqpStepper:
    """DAQP with one model a window, started at the rows that were active last."""

    def __init__(self, controller: TubeMpc, record: Record):
        """Set up the models with the programs of the first lap."""
        self._index = np.asarray(controller.index).tolist()
        self._windows: dict[int, _DaqpWindow] = {}
        for step, window in enumerate(self._index):
            if window not in self._windows:
                condensed = take_qp(controller.qps, window)
                self._windows[window] = _DaqpWindow(condensed, record.starts[step, :1])
        self.restart()

    def restart(self) -> None:
        """Begin a lap."""
        self._period = 0

    def __call__(self, errors: Float[np.ndarray, "3"]) -> Float[np.ndarray, "2"]:
        """Return the first input of the plan."""
        window = self._windows[self._index[self._period]]
        self._period += 1
        return window.plan(errors)[:2]


class _DaqpWindow:
    """The condensed QP of a window, and DAQP's model of it."""

    def __init__(self, condensed, errors: Float[np.ndarray, "1 3"]):
        qp = jax.tree.map(np.asarray, condensed)
        self._linear = qp.linear
        self._row_errors = qp.row_errors
        self._lower = np.clip(qp.lower, -INFINITE, INFINITE)
        self._upper = np.clip(qp.upper, -INFINITE, INFINITE)
        self._daqp: DaqpModel = set_up_daqp(pose(condensed, errors))

    def plan(self, errors: Float[np.ndarray, "3"]) -> Float[np.ndarray, " n"]:
        """Return the plan from these errors."""
        shift = self._row_errors @ errors
        # Names keep the arrays alive until it has solved.
        gradient = self._linear @ errors
        lower = self._lower - shift
        upper = self._upper - shift
        model = self._daqp.model
        model.update(f=gradient, blower=lower, bupper=upper)
        return model.solve()[0]


class CountCompilations:
    """How often JAX traces or compiles meanwhile; a context."""

    def __init__(self):
        """Count from 0."""
        self.count = 0

    def __enter__(self) -> CountCompilations:
        monitoring.register_event_duration_secs_listener(self._hear)
        return self

    def __exit__(self, *_: object) -> None:
        monitoring.unregister_event_duration_listener(self._hear)

    def _hear(self, event: str, duration_secs: float, **kwargs: str | int) -> None:
        self.count += event.startswith(COMPILING)


def read_memory() -> float:
    """Return the bytes of memory that this process has; NaN where the system does not tell."""
    status = Path("/proc/self/statm")
    if not status.exists():
        return np.nan
    return int(status.read_text().split()[1]) * 4096.0
