"""`beyond`: how far a robot may be from what its certificate assumes before W, and before the
limits, are left.

For each imperfection of `jaxtube.plant.imperfect` the level is doubled until a lap fails, then
halved towards the first level at which one does; the same for the first w outside W. Every level
meets the same draws: laps under four slip processes, from the scenario's start. What no lap of
these does is not proved; what one does is a fact.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from jaxtube import qp
from jaxtube.experiments.beyond import figures as beyond_figures
from jaxtube.experiments.options import BeyondOptions
from jaxtube.experiments.run import folder as run_folder
from jaxtube.experiments.run.progress import progress
from jaxtube.experiments.run.table import Column, format_table, left
from jaxtube.plant.imperfect import Imperfections, ImperfectRobot, shifted_preview
from jaxtube.scenario import Scenario
from jaxtube.simulation import closed_loop
from jaxtube.simulation.rollout import Trajectory, realisation_keys, rollout
from jaxtube.synthesis.design import Design, design, refuse_infeasible_start

PROCESSES = ("iid", "vertex", "constant", "adversarial")
DOUBLINGS, HALVINGS = 8, 5
ROUNDING = 1e-9
"""Usage beyond 1 that is rounding."""
ERRORS = ("longitudinal error", "lateral error", "heading error")


class Imperfection(NamedTuple):
    """One way to be imperfect: levels run from 0 up to `most`, in steps of one where they are
    whole."""

    title: str
    unit: str  # as printed
    key: str  # of a level in metrics.json
    most: float
    whole: bool = False


IMPERFECTIONS = {
    "lag": Imperfection("actuator lag", "s", "lag_s", 1.0),
    "delay": Imperfection("late commands", "periods", "delay_periods", 1.0),
    "sluggishness": Imperfection(
        "limited acceleration, inverse", "s²/m", "inverse_acceleration_s2_per_m", 4.0
    ),
    "sideslip": Imperfection("sideslip, by speed", "m/m", "sideslip_m_per_m", 0.5),
    "slip_change": Imperfection("slip changing in a period", "share", "slip_change_share", 1.0),
    "preview": Imperfection(
        "reference changes off their time", "periods", "preview_shift_periods", np.inf, True
    ),
}


class Usage(NamedTuple):
    """What laps at one level used, by slip process; above 1 is outside."""

    error: Float[np.ndarray, "processes 3"]  # of E, by coordinate, true errors
    disturbance: Float[np.ndarray, " processes"]  # of W
    wheels: Float[np.ndarray, " processes"]  # of the range of speeds, as asked for
    without_plan: Float[np.ndarray, " processes"]  # periods

    @property
    def leaves_disturbance_set(self) -> bool:
        """Tell whether some w lies outside W; NaN is outside."""
        return not np.all(self.disturbance <= 1 + ROUNDING)

    @property
    def violations(self) -> list[str]:
        """Name what was violated, and under which slips; NaN is a violation."""
        rows = {name: self.error[:, i] for i, name in enumerate(ERRORS)}
        rows |= {"wheel speed": self.wheels, "no plan": self.without_plan + 1}
        failed = {name: ~(values <= 1 + ROUNDING) for name, values in rows.items()}
        return [
            f"{name} ({', '.join(np.array(PROCESSES)[processes])})"
            for name, processes in failed.items()
            if processes.any()
        ]


class Search(NamedTuple):
    """What was found for one imperfection; None where no level up to `most` does it."""

    usages: dict[float, Usage]  # by level
    disturbance: float | None  # first level with a w outside W
    violation: float | None  # first level with a violation
    most: float


def run(scenario: Scenario, options: BeyondOptions) -> int:
    """Run the command."""
    found = design(scenario)
    refuse_infeasible_start(found)
    folder = run_folder.create(scenario, options)
    laps = Laps(found, options.realisations, options.seed)
    searches, planned = {}, {name: levels(found, name) for name in IMPERFECTIONS}
    with progress(sum(most_tried(*each) for each in planned.values()), "driving", "levels") as bar:
        for name, tried in planned.items():
            searches[name] = search(laps.at(name, bar.update), *tried)
            bar.total -= most_tried(*tried) - len(searches[name].usages)
    folder.save_metrics(metrics(searches, options.realisations))
    folder.save_figure(beyond_figures.usages(panels(searches)), "beyond")
    folder.report(table(searches, options.realisations))
    print(f"\nwritten to {folder.path}/")
    return 0


class Laps:
    """Laps of a design's tube-MPC on its robot made imperfect, which compile once a slip process."""

    def __init__(self, design: Design, realisations: int, seed: int):
        """Prepare the closed loops."""
        self.design, self.seed = design, seed
        self.starts = np.tile(design.problem.initial_error, (realisations, 1))
        self.controller = closed_loop.make_tube_mpc(design)
        self.ideal = [closed_loop.slipping_robot(design, process) for process in PROCESSES]

    def at(self, name: str, tried: Callable[[], Any] | None = None) -> Callable[[float], Usage]:
        """Return the usage as a function of the level of one imperfection; of a preview the worse
        of its signs."""

        def usage(level: float) -> Usage:
            if name == "preview":
                both = [self.usage(Imperfections(), sign * int(level)) for sign in (-1, 1)]
                found = Usage(*(np.maximum(*pair) for pair in zip(*both, strict=True)))
            else:
                found = self.usage(Imperfections()._replace(**{name: level}))
            if tried:
                tried()
            return found

        return usage

    def usage(self, imperfections: Imperfections, shift: int = 0) -> Usage:
        """Return what laps with these imperfections use, whose controller expects changes `shift`
        periods early."""
        # Arrays of one type: another mixture of numbers and arrays would be another program.
        level = Imperfections(*(jnp.asarray(each, float) for each in imperfections))
        index = shifted_preview(self.controller.index, self.ideal[0].reference_wheels, shift)
        controller = dataclasses.replace(self.controller, index=index)
        plants = [ImperfectRobot(ideal, level) for ideal in self.ideal]
        used = [lap_usage(self.design, self._simulate(controller, plant)) for plant in plants]
        return Usage(*(np.array(each) for each in zip(*used, strict=True)))

    def _simulate(self, controller, plant) -> Trajectory:
        if len(self.starts) >= closed_loop.BLOCK:
            return closed_loop.run_realisations(controller, plant, self.starts, self.seed)
        # Without the padding of a block: a quick look stays quick.
        keys = realisation_keys(self.seed, 0, len(self.starts))
        return jax.tree.map(np.asarray, rollout(controller, plant, keys, jnp.asarray(self.starts)))


def lap_usage(design: Design, trajectory: Trajectory) -> tuple:
    """Return the fields of a `Usage` for one process."""
    problem = design.problem
    robot, disturbance = problem.robot, problem.disturbance_set
    error = np.max(np.abs(trajectory.errors), axis=(0, 1)) / problem.error_set.offsets[:3]
    residuals = closed_loop.model_residuals(design, trajectory) @ disturbance.normals.T
    middle = (robot.wheel_speed_max + robot.wheel_speed_min) / 2
    range_ = (robot.wheel_speed_max - robot.wheel_speed_min) / 2
    wheels = np.max(np.abs(trajectory.demanded - middle)) / range_
    without_plan = float(np.sum(trajectory.diagnostics.status != qp.SOLVED))
    return error, np.max(residuals / disturbance.offsets), wheels, without_plan


def levels(design: Design, name: str) -> tuple[list[float], bool]:
    """Return (levels from the least to the greatest, whether only whole ones make sense)."""
    imperfection = IMPERFECTIONS[name]
    if imperfection.whole:
        return [float(level) for level in range(1, design.problem.horizon + 1)], True
    return [imperfection.most * 0.5**halved for halved in range(DOUBLINGS, -1, -1)], False


def most_tried(levels: list[float], whole: bool) -> int:
    """Return how many levels a search tries at most."""
    return 1 + len(levels) + (0 if whole else 2 * HALVINGS)


def search(usage: Callable[[float], Usage], levels: list[float], whole: bool) -> Search:
    """Find the first level with a w outside W and the first with a violation.

    Args:
        usage: what laps at a level use.
        levels: that are tried, increasing, until one has both.
        whole: nothing lies between two levels.

    Returns:
        Levels that do it, whose next lower one tried does not: 2^-HALVINGS of the last gap apart.
        Where failing is not monotone in the level, one of the places where it begins.
    """
    usages = {0.0: usage(0.0)}
    kinds = (lambda found: found.leaves_disturbance_set), (lambda found: bool(found.violations))
    for level in levels:
        if all(any(fails(found) for found in usages.values()) for fails in kinds):
            break
        usages[level] = usage(level)
    disturbance, violation = (
        _refine(usage, usages, fails, 0 if whole else HALVINGS) for fails in kinds
    )
    return Search(dict(sorted(usages.items())), disturbance, violation, levels[-1])


def _refine(
    usage, usages: dict[float, Usage], fails: Callable[[Usage], bool], halvings: int
) -> float | None:
    """Halve the gap below the least level that fails; what is tried is added to `usages`."""
    failing = [level for level, found in usages.items() if fails(found)]
    if not failing or min(failing) == 0.0:
        return min(failing, default=None)
    high = min(failing)
    low = max(level for level in usages if level < high)
    for _ in range(halvings):
        middle = (low + high) / 2
        usages[middle] = usage(middle)
        low, high = (low, middle) if fails(usages[middle]) else (middle, high)
    return high


def metrics(searches: dict[str, Search], realisations: int) -> dict:
    """Return what was found, by imperfection; a level that was not found is null."""
    found: dict[str, Any] = {
        "laps_at_a_level": realisations * len(PROCESSES),
        "processes": PROCESSES,
    }
    for name, search in searches.items():
        key = IMPERFECTIONS[name].key
        found[name] = {
            f"first_w_outside_W_{key}": search.disturbance,
            f"first_violation_{key}": search.violation,
            "violated": search.usages[search.violation].violations
            if search.violation is not None
            else [],
            f"greatest_tried_{key}": max(search.usages),
            "levels": [
                {
                    key: level,
                    "usage_of_E": usage.error.max(axis=0),
                    "usage_of_W": usage.disturbance.max(),
                    "usage_of_wheel_speeds": usage.wheels.max(),
                    "periods_without_plan": usage.without_plan.max(),
                }
                for level, usage in search.usages.items()
            ],
        }
    return found


def panels(searches: dict[str, Search]) -> list[beyond_figures.Panel]:
    """Return what the figure shows of the searches."""
    shown = []
    for name, search in searches.items():
        kind = IMPERFECTIONS[name]
        error = np.array([usage.error.max(axis=0) for usage in search.usages.values()])
        disturbance = np.array([usage.disturbance.max() for usage in search.usages.values()])
        tried = np.array(list(search.usages))
        shown.append(
            beyond_figures.Panel(
                name, kind.title, kind.whole, tried, error, disturbance, search.violation
            )
        )
    return shown


def table(searches: dict[str, Search], realisations: int) -> str:
    """Return what was found as a table."""
    columns = [
        left("imperfection"),
        Column("first w outside W"),
        Column("first violation"),
        left("unit"),
        left("violated"),
    ]
    rows = [_row(IMPERFECTIONS[name], search) for name, search in searches.items()]
    return (
        f"{format_table(columns, rows)}\n\n{realisations:,} laps of each slip process: "
        f"{', '.join(PROCESSES)}. A limit of acceleration is 1 / level."
    )


def _row(imperfection: Imperfection, search: Search) -> list[str]:
    violated = "nothing"
    if search.violation is not None:
        violated = "; ".join(search.usages[search.violation].violations)
    return [
        imperfection.title,
        _level(search.disturbance, search.most),
        _level(search.violation, search.most),
        imperfection.unit,
        violated,
    ]


def _level(level: float | None, most: float) -> str:
    return f"none to {most:g}" if level is None else f"{level:.3g}"
