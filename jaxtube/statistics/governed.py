"""Closed loops of many robots, each governed along a reference of its own, and what they show.

The plant is the slipping robot of the scenario, its slips and noise those of `jt.simulate`. Every
period is compared with the sets of the certificate.
"""

from __future__ import annotations

import dataclasses
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float

from jaxtube import qp
from jaxtube.control.protocol import WheelMap
from jaxtube.plant.protocol import Advance, Measurement
from jaxtube.plant.reference import drive
from jaxtube.plant.slip import SlipProcess
from jaxtube.plant.slipping import SlipMemory, SlippingRobot
from jaxtube.precision import in_64_bits
from jaxtube.simulation import components
from jaxtube.simulation.backup import Backup
from jaxtube.simulation.governing import Governed, LivePlanner, govern, shift
from jaxtube.simulation.rollout import realisation_keys
from jaxtube.statistics.checks import OUTSIDE
from jaxtube.synthesis.parts import Design
from sets.polytope import Polytope

Wish = Callable[[int, Float[np.ndarray, "robots 3"]], Float[np.ndarray, "robots horizon 2"]]
"""From a period and what is measured at its start to the wheel speeds that each robot is asked for
from then on, within the certified box, m/s."""

Decide = Callable[..., Governed]
"""Who decides what of a revision is accepted: `govern`, or another with its arguments."""


@dataclass
class GovernedRun:
    """What the periods of governed robots came to.

    Attributes:
        periods: how many, over all robots.
        without_plan: how many of them had no plan.
        outside: how many left what is promised: true errors "E", measured errors and inputs "U",
            disturbances "W", wheel speeds their "limits".
        shares: how many accepted what share of a revision.
        errors: true errors of every robot at last, (m, m, rad).
    """

    periods: int = 0
    without_plan: int = 0
    outside: Counter[str] = field(default_factory=Counter)
    shares: Counter[float] = field(default_factory=Counter)
    errors: Float[np.ndarray, "robots 3"] = field(default_factory=lambda: np.zeros((0, 3)))

    def count_outside(self, name: str, is_inside: Bool[np.ndarray, " robots"]) -> None:
        """Book who left a set."""
        self.outside[name] += int(np.sum(~is_inside))


@in_64_bits
def run_governed(
    design: Design,
    starts: Float[np.ndarray, "robots 3"],
    first: Float[np.ndarray, "horizon 2"],
    wish: Wish,
    periods: int,
    seed: int = 0,
    process: str | SlipProcess | None = None,
    decide: Decide = govern,
) -> GovernedRun:
    """Run one closed loop a start, for some periods.

    Args:
        design: certified for wheel speeds in any order, without an observer.
        starts: true errors, (m, m, rad).
        first: window committed to every robot before the first wish, m/s: starts have a plan along
            it, or not.
        wish: what is asked for, period by period.
        periods: of every robot.
        seed: of every draw.
        process: of the slips, the scenario's unless given.
        decide: the governor.
    """
    loop = _Loop(design, starts, first, seed, process, decide)
    for period in range(periods):
        loop.advance(period, wish)
    loop.run.errors = np.asarray(loop.errors)
    return loop.run


class _Loop:
    """Robots, what is committed to each, and what was booked."""

    def __init__(self, design: Design, starts, first, seed: int, process, decide: Decide):
        self._problem = design.problem
        self._planner = LivePlanner(design)
        self._decide = decide
        self._plant = components.bare_robot(design.problem, process)
        self._wheel_map = components.make_wheel_map(design.problem)
        self._keys = realisation_keys(seed, 0, len(starts))
        self._memory = self._plant.initial(self._keys, jnp.asarray(starts))
        self._poses = np.zeros((len(starts), 3))  # of the references
        self._backup = Backup(design, starts)
        self._committed = np.tile(first, (len(starts), 1, 1))
        self._expected = None  # of the model, without disturbance
        self.errors = jnp.asarray(starts)
        self.run = GovernedRun()

    def advance(self, period: int, wish: Wish) -> None:
        """Run one period and book what happened."""
        committed = self._committed
        plant = _along(self._plant, committed[:, 0], self._poses)
        measurement, memory = _sense(plant, self._keys, period, self._memory, self.errors)
        errors = np.asarray(measurement.errors)
        self._book_disturbances(errors)
        wished = wish(period, errors)
        decided = self._decide(self._planner, errors, committed, wished)
        now = decided.windows[:, 0]
        has_plan = decided.plans.status == qp.SOLVED
        inputs = self._backup.act(decided.plans, has_plan, errors, now)
        plant = _along(self._plant, now, self._poses)
        moved, asked = _advance(
            plant, self._wheel_map, self._keys, period, memory, self.errors, measurement, inputs
        )
        transitions, input_matrices = self._problem.model.matrices(now)
        forced = np.einsum("rij,rj->ri", input_matrices, inputs)
        self._expected = np.einsum("rij,rj->ri", transitions, errors) + forced
        self._committed = shift(decided.windows, wished[:, -1])
        self._poses = drive(
            self._poses, now, self._problem.reference.dt, self._plant.robot.track_width
        )
        self._memory = moved.memory
        self.errors = moved.errors
        self.run.periods += len(errors)
        self.run.without_plan += int(np.sum(~has_plan))
        self.run.shares.update(decided.shares.tolist())
        self._book(errors, inputs, np.asarray(asked))

    def _book_disturbances(self, errors: Float[np.ndarray, "robots 3"]) -> None:
        if self._expected is not None:
            inside = _is_inside(self._problem.disturbance_set, errors - self._expected)
            self.run.count_outside("W", inside)

    def _book(self, measured, inputs, wheels) -> None:
        """Book true errors at the end of the period, and what was asked for in it."""
        rows = self._problem.input_rows
        used = inputs @ rows.inputs.T + measured @ rows.errors.T
        robot = self._problem.robot
        within = (wheels >= robot.wheel_speed_min) & (wheels <= robot.wheel_speed_max)
        self.run.count_outside("E", _is_inside(self._problem.error_set, np.asarray(self.errors)))
        self.run.count_outside("U", np.all(used <= rows.offsets + OUTSIDE, axis=1))
        self.run.count_outside("limits", within.all(axis=1))


def _is_inside(
    polytope: Polytope, points: Float[np.ndarray, "robots n"]
) -> Bool[np.ndarray, " robots"]:
    """Return which points a set holds; NaN is outside."""
    return np.all(points @ polytope.normals.T <= polytope.offsets + OUTSIDE, axis=1)


def _along(plant: SlippingRobot, wheels, poses) -> SlippingRobot:
    """Return the plant whose reference is another one for each robot, in one period alone: an index
    beyond its end, which JAX takes for the last, means that period."""
    return dataclasses.replace(
        plant, reference_wheels=jnp.asarray(wheels)[None], reference_poses=jnp.asarray(poses)[None]
    )


@jax.jit
def _sense(plant: SlippingRobot, keys, period, memory: SlipMemory, errors):
    """Return what is measured at the start of a period, and the memory with its slips."""
    return plant.sense(keys, period, memory, errors)


@jax.jit
def _advance(
    plant: SlippingRobot,
    wheel_map: WheelMap,
    keys,
    period,
    memory: SlipMemory,
    errors,
    measurement: Measurement,
    inputs,
) -> tuple[Advance, jax.Array]:
    """Return where a period leads, and the wheel speeds that were asked for."""
    command = wheel_map.command(inputs, measurement, plant.reference_wheels[0])
    return plant.advance(keys, period, memory, errors, command), command.wheels
