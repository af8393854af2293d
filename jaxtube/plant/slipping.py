"""The slipping robot: exact motion over each period, slip drawn by a process, bounded pose noise.

    measured error  e + noise xi        true slip, measured slip  nominal (1 + relative_error xi)

with every xi in [-1, 1]. A `SlippingRobot` draws them (`jaxtube.plant.slip`), a `ScriptedRobot` is
told them.

Source: Gonzalez, Fiacchini, Guzman, Alamo 2009, eqs. (1)-(4), and section IV for the slips.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.ad_checkpoint import checkpoint_name
from jaxtyping import Float, Key

from jaxtube.plant import slip as slips
from jaxtube.plant.error_dynamics import advance, world_pose
from jaxtube.plant.protocol import (
    Advance,
    Command,
    Measurement,
    Memory,
    Script,
    Uncertainty,
    script_entry,
)
from jaxtube.plant.robot import Robot, saturate, wheel_positions
from jaxtube.plant.slip_processes import find_process

DRAWN = "drawn"
"""Name of what is drawn at random, for reverse mode to keep: drawing again costs more than all else
in a period."""


class SlipMemory(NamedTuple):
    """What the slips leave from one period to the next, and those of the period that has begun."""

    process: Memory
    true: Float[Array, "batch 2"]  # deviations of the slips of this period, in [-1, 1]
    measured: Float[Array, "batch 2"]


@partial(
    jax.tree_util.register_dataclass,
    data_fields=[
        "robot",
        "dt",
        "reference_wheels",
        "reference_poses",
        "nominal_slip",
        "relative_error",
        "noise",
    ],
    meta_fields=["process", "uncertain_slip"],
)
@dataclass(frozen=True)
class SlippingRobot:
    """The nonlinear plant.

    Attributes:
        robot: geometry and wheel limits.
        dt: period, s.
        reference_wheels: of every period, m/s.
        reference_poses: (x m, y m, heading rad) at the ends of the periods, world frame.
        nominal_slip: (right, left).
        relative_error: greatest deviation of a slip, as a fraction of the nominal one.
        noise: half widths (m, m, rad) of the pose noise in the robot's frame, None for an exact
            measurement.
        process: how deviations evolve: a name of `slip_processes.PROCESSES`, or one of your own.
        uncertain_slip: which slip deviates, "true", "measured" or "both".
    """

    robot: Robot
    dt: float
    reference_wheels: Float[Array, "steps 2"]
    reference_poses: Float[Array, "steps+1 3"]
    nominal_slip: Float[Array, "2"]
    relative_error: float
    noise: Float[Array, "3"] | None = None
    process: str | slips.SlipProcess = "iid"
    uncertain_slip: str = "true"

    has_wheels = True

    def initial(self, keys: Key[Array, " batch"], errors: Float[Array, "batch 3"]) -> SlipMemory:
        """Return the memory of the slip processes."""
        process = find_process(self.process)
        memory = jax.vmap(lambda key: slips.initial_slip(key, process, errors.dtype))(keys)
        none = jnp.zeros_like(errors[:, :2])
        return SlipMemory(memory, none, none)

    def sense(
        self, keys: Key[Array, " batch"], step, memory: SlipMemory, errors: Float[Array, "batch 3"]
    ) -> tuple[Measurement, SlipMemory]:
        """Draw the pose noise of an instant and the slips of the period that begins there."""
        memory = self.draw_slips(keys, step, memory, errors)
        measured = Measurement(self.measure_errors(keys, step, errors), self.slip(memory.measured))
        return measured, memory

    def measure_errors(
        self, keys: Key[Array, " batch"], step, errors: Float[Array, "batch 3"]
    ) -> Float[Array, "batch 3"]:
        """Return the tracking errors with the noise of an instant."""
        noise = self.noise
        if noise is None:
            return errors
        drawn = jax.vmap(lambda key: slips.pose_noise(key, step, noise))(keys)
        return errors + checkpoint_name(drawn, DRAWN)

    def draw_slips(
        self, keys: Key[Array, " batch"], step, memory: SlipMemory, errors: Float[Array, "batch 3"]
    ) -> SlipMemory:
        """Draw the deviations of the slips of one period."""
        process = find_process(self.process)

        def draw(key, memory_of_one, situation):
            return slips.draw_slip(
                key, step, memory_of_one, situation, process, self.uncertain_slip
            )

        drawn = jax.vmap(draw)(keys, memory.process, self.situation(step, errors))
        true, measured, following = checkpoint_name(drawn, DRAWN)
        return SlipMemory(following, true, measured)

    def situation(self, step, errors: Float[Array, "batch 3"]) -> slips.Situation:
        """Return what the slip processes may look at."""
        poses = world_pose(errors, self.reference_poses[step])
        return slips.Situation(wheel_positions(poses, self.robot.track_width), errors)

    def slip(self, deviation: Float[Array, "batch 2"]) -> Float[Array, "batch 2"]:
        """Return the slips that deviate so much, in [-1, 1], from the nominal ones."""
        return slips.deviate(self.nominal_slip, self.relative_error, deviation)

    def advance(
        self,
        keys: Key[Array, " batch"],
        step,
        memory: SlipMemory,
        errors: Float[Array, "batch 3"],
        command: Command,
    ) -> Advance:
        """Move through one period under the slips that were drawn for it."""
        following, wheels = self.move(step, errors, command.wheels, memory.true)
        return Advance(following, memory, wheels)

    def move(
        self,
        step,
        errors: Float[Array, "batch 3"],
        demanded: Float[Array, "batch 2"],
        true: Float[Array, "batch 2"],
    ) -> tuple[Float[Array, "batch 3"], Float[Array, "batch 2"]]:
        """Move through one period under given slips.

        Args:
            step: of the reference.
            errors: true tracking errors at its start, (m, m, rad).
            demanded: wheel speeds asked for, m/s.
            true: deviations of the true slips, in [-1, 1].

        Returns:
            (tracking errors at its end, wheel speeds within the limits m/s).
        """
        wheels = saturate(demanded, self.robot)
        reference = self.reference_wheels[step]
        width = self.robot.track_width
        following = advance(errors, wheels, self.slip(true), reference, width, self.dt)
        return following, wheels

    def uncertainties(self) -> dict[str, Uncertainty]:
        """Return slips and noise as boxes.

        Raises:
            ValueError: for a slip process that ties its deviations to each other or to the ground.
        """
        if self.process not in ("iid", "constant"):
            is_own = not isinstance(self.process, str)
            name = type(self.process).__name__ if is_own else self.process
            raise ValueError(
                f'slip.process = "{name}": is not searched; choose "iid", which contains '
                'it, or "constant"'
            )
        steps = len(self.reference_wheels)
        times = steps if self.process == "iid" else 1
        names = [name for name in ("true", "measured") if self.uncertain_slip in (name, "both")]
        uncertainties = {name: Uncertainty(_box_vertices(2), times) for name in names}
        if self.noise is not None:
            uncertainties["noise"] = Uncertainty(_box_vertices(3), steps + 1)
        return uncertainties

    def under_script(self, script: Script) -> ScriptedRobot:
        """Return the robot under given slips and noise (see `ScriptedRobot`)."""
        return ScriptedRobot(self, script)


@partial(jax.tree_util.register_dataclass, data_fields=["robot", "script"], meta_fields=[])
@dataclass(frozen=True)
class ScriptedRobot:
    """The slipping robot under given slips and noise; keys are ignored.

    The script has deviations of the slips `true` and `measured`, (times, batch, 2), and the pose
    `noise`, (steps + 1, batch, 3), all in [-1, 1]. What it does not name does not deviate.
    """

    robot: SlippingRobot
    script: Script

    @property
    def reference_wheels(self) -> Float[Array, "steps 2"]:
        """The reference, m/s."""
        return self.robot.reference_wheels

    def initial(self, keys, errors: Float[Array, "batch 3"]) -> SlipMemory:
        """Return a memory of nothing."""
        none = jnp.zeros_like(errors[:, :2])
        return SlipMemory((), none, none)

    def sense(
        self, keys, step, memory: SlipMemory, errors: Float[Array, "batch 3"]
    ) -> tuple[Measurement, SlipMemory]:
        """Read noise and slips from the script."""
        robot = self.robot
        true = self._deviation("true", step, errors)
        measured = self._deviation("measured", step, errors)
        if "noise" in self.script:
            assert robot.noise is not None
            errors = errors + robot.noise * script_entry(self.script["noise"], step)
        return Measurement(errors, robot.slip(measured)), SlipMemory((), true, measured)

    def _deviation(self, name: str, step, errors: Float[Array, "batch 3"]):
        if name not in self.script:
            return jnp.zeros_like(errors[:, :2])
        return script_entry(self.script[name], step)

    def advance(
        self, keys, step, memory: SlipMemory, errors: Float[Array, "batch 3"], command: Command
    ) -> Advance:
        """Move through one period under the slips of the script."""
        return self.robot.advance(keys, step, memory, errors, command)


def _box_vertices(dimension: int) -> Float[np.ndarray, "v n"]:
    return np.array(list(itertools.product((-1.0, 1.0), repeat=dimension)))
