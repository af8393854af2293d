"""What laps of a design's tube-MPC use of E, W and the wheels on a robot made imperfect."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float

from jaxtube import qp
from jaxtube.control.laws import TubeMpc
from jaxtube.coordinates import NAMES
from jaxtube.plant.imperfect import Imperfections, ImperfectRobot, shifted_preview
from jaxtube.plant.protocol import Plant
from jaxtube.plant.slip_processes import TEST_PROCESSES
from jaxtube.simulation import batches, components
from jaxtube.simulation.rollout import Trajectory, realisation_keys, run_laps
from jaxtube.synthesis.parts import Design

ROUNDING = 1e-9
"""Usage beyond 1 that is rounding."""


class ProcessUsage(NamedTuple):
    """What laps under one slip process used; above 1 is outside."""

    error: Float[np.ndarray, "3"]  # of E, by coordinate, true errors
    disturbance: float  # of W
    wheels: float  # of the range of speeds, as asked for
    without_plan: float  # periods


class LapUsage(NamedTuple):
    """What laps at one level used, by slip process; above 1 is outside."""

    error: Float[np.ndarray, "processes 3"]  # of E, by coordinate, true errors
    disturbance: Float[np.ndarray, " processes"]  # of W
    wheels: Float[np.ndarray, " processes"]  # of the range of speeds, as asked for
    without_plan: Float[np.ndarray, " processes"]  # periods

    @property
    def leaves_disturbance_set(self) -> bool:
        """Whether some w lies outside W; NaN counts as outside."""
        return bool(np.any(_is_outside(self.disturbance)))

    @property
    def violations(self) -> list[str]:
        """What was violated, and under which slips; NaN is a violation."""
        failed = {f"{name} error": _is_outside(self.error[:, i]) for i, name in enumerate(NAMES)}
        failed["wheel speed"] = _is_outside(self.wheels)
        failed["no plan"] = ~(self.without_plan == 0)
        return [
            f"{name} ({', '.join(np.array(TEST_PROCESSES)[processes])})"
            for name, processes in failed.items()
            if processes.any()
        ]


def _is_outside(usage: Float[np.ndarray, " processes"]) -> Bool[np.ndarray, " processes"]:
    """Return where a usage is above 1; NaN is."""
    return ~(usage <= 1 + ROUNDING)


class ImperfectLaps:
    """Laps of a design's tube-MPC on its robot made imperfect; each slip process compiles once."""

    def __init__(self, design: Design, realisations: int, seed: int):
        """Prepare the closed loops."""
        self.design = design
        self.seed = seed
        self.starts = np.tile(design.problem.initial_error, (realisations, 1))
        self.controller = components.make_tube_mpc(design)
        self.ideal = [components.bare_robot(design.problem, process) for process in TEST_PROCESSES]

    def at(
        self, name: str, on_progress: Callable[[], object] = lambda: None
    ) -> Callable[[float], LapUsage]:
        """Return the usage as a function of the level of one imperfection.

        Args:
            name: of the imperfection; of a "preview" the worse of its signs counts.
            on_progress: called after each level.
        """

        def usage(level: float) -> LapUsage:
            """Return the usage at one level, of a preview the larger of early and late."""
            if name == "preview":
                early = self.usage(Imperfections(), -int(level))
                late = self.usage(Imperfections(), int(level))
                used = LapUsage(*map(np.maximum, early, late))
            else:
                used = self.usage(Imperfections()._replace(**{name: level}))
            on_progress()
            return used

        return usage

    def usage(self, imperfections: Imperfections, shift: int = 0) -> LapUsage:
        """Return what laps with these imperfections use, whose controller expects changes `shift`
        periods early."""
        # Arrays of one type: another mixture of numbers and arrays would be another program.
        level = Imperfections(*(jnp.asarray(value, float) for value in imperfections))
        index = shifted_preview(self.controller.index, self.ideal[0].reference_wheels, shift)
        controller = dataclasses.replace(self.controller, index=index)
        by_process = []
        for ideal in self.ideal:
            robot = components.with_estimate(self.design.problem, ImperfectRobot(ideal, level))
            trajectory = self._simulate(controller, robot)
            by_process.append(lap_usage(self.design, trajectory))
        return LapUsage(*map(np.array, zip(*by_process, strict=True)))

    def _simulate(self, controller: TubeMpc, plant: Plant) -> Trajectory:
        if len(self.starts) >= batches.BATCH:
            return batches.run_realisations(controller, plant, self.starts, self.seed)
        # Without the padding of a block: a quick look stays quick.
        keys = realisation_keys(self.seed, 0, len(self.starts))
        return jax.tree.map(np.asarray, run_laps(controller, plant, keys, jnp.asarray(self.starts)))


def lap_usage(design: Design, trajectory: Trajectory) -> ProcessUsage:
    """Return what laps under one process used."""
    problem = design.problem
    robot = problem.robot
    error = np.max(np.abs(trajectory.errors), axis=(0, 1)) / problem.error_set.offsets[:3]
    disturbances = batches.model_disturbances(design, trajectory)
    used = problem.disturbances.shares(problem.period_regimes[: len(disturbances)], disturbances)
    widest = np.max(np.abs(trajectory.demanded - robot.wheel_speed_middle))
    wheels = widest / robot.wheel_speed_half_range
    without_plan = float(np.sum(trajectory.diagnostics.status != qp.SOLVED))
    return ProcessUsage(error, np.max(used), wheels, without_plan)
