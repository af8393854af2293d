"""The points of `maps`: a grid of operating points, computed by several processes, each point
saved as soon as it is known.

A search starts from the optimum of the neighbour that lies one step closer to the scenario's own:
along the speed range or the period first, then along the slip error. So the points form a tree, and
those whose start is known are computed side by side. The order in which they end changes no number:
a start is a function of the grid alone.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable
from concurrent.futures import FIRST_COMPLETED, Executor, ProcessPoolExecutor, wait
from dataclasses import asdict, dataclass
from multiprocessing import get_context
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from jaxtube.experiments.run.value_log import ValueLog
from jaxtube.progress import progress
from jaxtube.scenario.refusal import ScenarioError
from jaxtube.scenario.tree import Scenario
from jaxtube.synthesis.ratio import (
    Guarantee,
    OperatingPoint,
    find_slip_error,
    guarantee,
    set_point,
    set_slip_error,
)
from jaxtube.synthesis.starts import caps_and_gains

DESIGNS = ("optimised", "weighted", "paper")
"""In the order in which they are computed: the searches wait for each other, the others fill the
gaps."""
LARGEST_ERROR = 0.3
"""Of a slip, relative to it."""
WIDEST = (3.0, 2.0, 1.5)
"""Times the scenario's own up to which other slip errors go, the first one that slips allow."""
SLOWEST_MPS = 0.2
"""Where the lower end of the speed range starts; it ends at the slowest wheel of the reference."""
PERIODS_S = (0.05, 0.2)
APART = 0.1
"""Of the distance between values: one closer to the scenario's own gives way to it."""


class Point(NamedTuple):
    """One design at one operating point."""

    design: str
    operating_point: OperatingPoint


GuaranteeByPoint = dict[Point, Guarantee]


@dataclass(frozen=True)
class Grid:
    """Increasing values of the three coordinates, and the scenario's own, which is among them."""

    slip_errors: tuple[float, ...]
    slowest_mps: tuple[float, ...]
    periods_s: tuple[float, ...]
    own: OperatingPoint

    def operating_points(self) -> list[OperatingPoint]:
        """Return the operating points of both maps without repetitions, each after the
        one whose optimum it starts from."""
        pairs = [(slowest, self.own.dt_s) for slowest in self.slowest_mps]
        pairs += [(self.own.slowest_mps, period) for period in self.periods_s]
        operating_points = {
            OperatingPoint(error, *pair) for pair in pairs for error in self.slip_errors
        }
        return sorted(operating_points, key=lambda point: (self._steps(point), point))

    def points(self) -> list[Point]:
        """Return all points, designs in the order of `DESIGNS`."""
        return [
            Point(design, operating_point)
            for design in DESIGNS
            for operating_point in self.operating_points()
        ]

    def towards_own(self, operating_point: OperatingPoint) -> OperatingPoint | None:
        """Return the neighbour one step closer to the scenario's own point, None for it."""
        for name in ("slowest_mps", "dt_s", "slip_error"):
            values = self.axes[name]
            here = values.index(getattr(operating_point, name))
            own = values.index(getattr(self.own, name))
            if here != own:
                step = 1 if own > here else -1
                return operating_point._replace(**{name: values[here + step]})
        return None

    @property
    def axes(self) -> dict[str, tuple[float, ...]]:
        """The values by name, in the order of `OperatingPoint`."""
        return {
            "slip_error": self.slip_errors,
            "slowest_mps": self.slowest_mps,
            "dt_s": self.periods_s,
        }

    def _steps(self, operating_point: OperatingPoint) -> int:
        """Return the steps from an operating point to the scenario's own."""
        places = zip(self.axes.values(), operating_point, self.own, strict=True)
        return sum(abs(values.index(here) - values.index(own)) for values, here, own in places)


def make_grid(scenario: Scenario, slowest_wheel: float, count: int) -> Grid:
    """Return a grid of `count` values along each axis, and the scenario's own.

    Args:
        scenario: gives slip error, lower end of the speed range and period.
        slowest_wheel: of the reference, m/s: the speed range must hold it.
        count: at least 2.
    """
    own = OperatingPoint(
        find_slip_error(scenario),
        scenario.reference.wheel_speed_min_mps,
        float(scenario.controller.dt_s),
    )
    top = max(np.floor(1e3 * slowest_wheel + 1e-6) / 1e3, own.slowest_mps)
    bottom = min(SLOWEST_MPS, own.slowest_mps)
    return Grid(
        slip_errors=_make_axis(np.linspace(0.0, _find_top(scenario), count), own.slip_error),
        slowest_mps=_make_axis(np.linspace(bottom, top, count), own.slowest_mps),
        periods_s=_make_axis(np.geomspace(*PERIODS_S, count), own.dt_s),
        own=own,
    )


def _find_top(scenario: Scenario) -> float:
    """Return the largest slip error of the grid."""
    slip = scenario.slip
    if not slip.has_intervals:
        return LARGEST_ERROR
    own = find_slip_error(scenario)
    for factor in WIDEST:
        try:
            set_slip_error(scenario, factor * own)
        except ScenarioError:
            continue
        return factor * own
    return own


def _make_axis(values: Float[np.ndarray, " count"], own: float) -> tuple[float, ...]:
    """Return values with 4 decimals and the scenario's own, increasing."""
    apart = APART * float(np.min(np.diff(values)))
    others = [value for value in np.round(values, 4).tolist() if abs(value - own) > apart]
    return tuple(sorted({*others, float(own)}))


def compute(scenario: Scenario, grid: Grid, log: ValueLog) -> GuaranteeByPoint:
    """Compute the points that the log does not hold, each saved at once, and return all.

    Args:
        scenario: gives all that the grid does not vary.
        grid: the points.
        log: of an earlier run of the same scenario, grid and code, or empty.
    """
    results = dict(map(_from_record, log.records))
    waiting = [point for point in grid.points() if point not in results]
    if not waiting:
        return results
    with (
        progress(len(grid.points()), "designing", "points", len(results), "starting") as bar,
        _make_workers(len(waiting)) as workers,
    ):

        def keep(point: Point, result: Guarantee) -> None:
            results[point] = result
            log.append(
                {"design": point.design, **point.operating_point._asdict(), **asdict(result)}
            )
            bar.update()

        _work_through(scenario, grid, waiting, results, workers, keep)
    return results


def _from_record(record: dict) -> tuple[Point, Guarantee]:
    values = dict(record)
    design = values.pop("design")
    operating_point = OperatingPoint(*(values.pop(name) for name in OperatingPoint._fields))
    start = values.pop("caps_and_gains")
    result = Guarantee(**values, caps_and_gains=None if start is None else tuple(start))
    return Point(design, operating_point), result


def _work_through(
    scenario: Scenario,
    grid: Grid,
    waiting: list[Point],
    results: GuaranteeByPoint,
    workers: Executor,
    keep: Callable[[Point, Guarantee], None],
) -> None:
    """Give the workers two points each whose start is known, and keep what comes back."""
    running = {}
    most = 2 * _count_processors()
    try:
        while waiting or running:
            for point in _find_ready(grid, waiting, results)[: most - len(running)]:
                waiting.remove(point)
                scenario_there = set_point(scenario, point.operating_point)
                start = _find_start(scenario, grid, point, results)
                running[workers.submit(guarantee, point.design, scenario_there, start)] = point
            for done in wait(running, return_when=FIRST_COMPLETED).done:
                keep(running.pop(done), done.result())
    except BaseException:
        workers.shutdown(wait=False, cancel_futures=True)
        raise


def _find_ready(grid: Grid, waiting: Iterable[Point], results: GuaranteeByPoint) -> list[Point]:
    """Return the points whose start is known."""
    return [point for point in waiting if _has_start(grid, point, results)]


def _has_start(grid: Grid, point: Point, results: GuaranteeByPoint) -> bool:
    neighbour = grid.towards_own(point.operating_point)
    if point.design != "optimised" or neighbour is None:
        return True
    return point._replace(operating_point=neighbour) in results


def _find_start(
    scenario: Scenario, grid: Grid, point: Point, results: GuaranteeByPoint
) -> tuple[float, ...] | None:
    """Return caps and gains at which a search starts, None for the designs that need none."""
    if point.design != "optimised":
        return None
    neighbour = grid.towards_own(point.operating_point)
    if neighbour is None:
        return caps_and_gains(scenario)
    return results[Point("optimised", neighbour)].caps_and_gains


def _count_processors() -> int:
    """Return the processors that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def _make_workers(most: int) -> Executor:
    """Return a pool of processes, one for each processor but no more than `most`."""
    # One thread each: the matrices are small, and threads that wait for each other made a search
    # three times as long.
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
        os.environ[name] = "1"
    # Not forked: a fork copies the locks of JAX's threads.
    return ProcessPoolExecutor(min(_count_processors(), most), get_context("spawn"))
