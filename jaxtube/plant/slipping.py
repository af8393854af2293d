"""The slipping robot: exact motion over each period, slip drawn by a process, bounded pose noise.

    measured error      that of the true pose + noise xi
    slips               of xi_true, xi_measured: `jaxtube.plant.slip_bounds`
    lateral velocity    sideslip xi v - lever_arm w, positive to the left

with xi in [-1, 1]. A `SlippingRobot` draws them (`jaxtube.plant.slip`), a `ScriptedRobot` is told
them. Noise in the robot's frame adds to the error. Noise of the pose (n_p, n_phi) in the world
makes of the position part of the error Rot(-n_phi) (e - Rot(-phi) n_p), and e_th - n_phi.

Source: Gonzalez, Fiacchini, Guzman, Alamo 2009, eqs. (1)-(4), and section IV for the slips;
sideslip and lever arm are new.
"""

from __future__ import annotations

import itertools
import operator
from dataclasses import dataclass
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Float, Key

from jaxtube.columns import each_coordinate
from jaxtube.plant import slip
from jaxtube.plant.error_dynamics import Sideslip, advance, tracking_error, world_pose
from jaxtube.plant.limited_slips import Limited
from jaxtube.plant.once import make_once
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
from jaxtube.plant.slip_bounds import SlipBounds
from jaxtube.plant.slip_processes import find_process

EXTREME = ("vertex", "adversarial")
"""Processes whose deviations are -1 or 1."""


class SlipMemory(NamedTuple):
    """What the slips leave from one period to the next, and those of the period that has begun."""

    process: Memory
    true: Float[Array, "batch 2"]  # deviations of the slips of this period, in [-1, 1]
    measured: Float[Array, "batch 2"]
    sideslip: Float[Array, " batch"] | None = None  # None for a robot without


@partial(
    jax.tree_util.register_dataclass,
    data_fields=[
        "robot",
        "dt",
        "reference_wheels",
        "reference_poses",
        "slips",
        "noise",
        "sideslip",
    ],
    meta_fields=["process", "noise_frame", "slip_steps"],
)
@dataclass(frozen=True)
class SlippingRobot:
    """The nonlinear plant.

    Attributes:
        robot: geometry and wheel limits.
        dt: period, s.
        reference_wheels: of every period, m/s.
        reference_poses: (x m, y m, heading rad) at the ends of the periods, world frame.
        slips: where true and measured slips may lie.
        noise: half widths (m, m, rad) of the pose noise, None for an exact measurement.
        sideslip: greatest lateral velocity, by the forward speed, None for none; the lever arm of
            the robot is then left out as well.
        process: how deviations evolve: a name of `slip_processes.PROCESSES`, or one of your own.
        noise_frame: whether the noise is a box in the frame of the "robot" or of the "world".
        slip_steps: greatest changes of the deviations of the slips (right, left) from one period to
            the next, which processes that have a name keep; None for any.
    """

    robot: Robot
    dt: float
    reference_wheels: Float[Array, "steps 2"]
    reference_poses: Float[Array, "steps+1 3"]
    slips: SlipBounds
    noise: Float[Array, "3"] | None = None
    sideslip: Float[Array, ""] | float | None = None
    process: str | slip.SlipProcess = "iid"
    noise_frame: str = "robot"
    slip_steps: tuple[float, float] | None = None

    has_wheels = True

    @property
    def slip_source(self) -> SlippingRobot:
        """What draws the slips."""
        return self

    @property
    def slip_process(self) -> slip.SlipProcess:
        """How deviations evolve. A process of one's own, or what was recorded, is taken as it is:
        what it does beyond the limit of its changes is meant."""
        process = find_process(self.process)
        if self.slip_steps is None or not isinstance(self.process, str):
            return process
        return Limited(process, self.slip_steps)

    @property
    def draws_extremes(self) -> bool:
        """Whether the process draws deviations of -1 or 1 only."""
        return self.process in EXTREME and self.slip_steps is None

    def initial(self, keys: Key[Array, " batch"], errors: Float[Array, "batch 3"]) -> SlipMemory:
        """Return the memory of the slip processes."""
        process = self.slip_process
        none = jnp.zeros_like(errors[:, :2])
        memory = jax.vmap(lambda key: slip.initial_slip(key, process, errors.dtype))(keys)
        if self.sideslip is None:
            return SlipMemory(memory, none, none)
        sideways = jax.vmap(lambda key: slip.initial_sideslip(key, process, errors.dtype))(keys)
        return SlipMemory((memory, sideways), none, none, none[:, 0])

    def sense(
        self, keys: Key[Array, " batch"], step, memory: SlipMemory, errors: Float[Array, "batch 3"]
    ) -> tuple[Measurement, SlipMemory]:
        """Draw the pose noise of an instant and the slips of the period that begins there."""
        memory = self.draw_slips(keys, step, memory, errors)
        measured = Measurement(self.measure_errors(keys, step, errors), self.measured_slip(memory))
        return measured, memory

    def measure_errors(
        self, keys: Key[Array, " batch"], step, errors: Float[Array, "batch 3"]
    ) -> Float[Array, "batch 3"]:
        """Return the tracking errors with the noise of an instant."""
        noise = self.noise
        if noise is None:
            return errors

        def draw():
            return jax.vmap(lambda key: slip.pose_noise(key, step, noise))(keys)

        return self.add_noise(step, errors, make_once(step, draw()))

    def add_noise(
        self, step, errors: Float[Array, "batch 3"], noise: Float[Array, "batch 3"]
    ) -> Float[Array, "batch 3"]:
        """Return what is measured of true tracking errors under noise (m, m, rad)."""
        if self.noise_frame == "robot":
            return each_coordinate(operator.add, errors, noise)
        reference_pose = self.reference_poses[step]
        noisy_pose = each_coordinate(operator.add, world_pose(errors, reference_pose), noise)
        return tracking_error(noisy_pose, reference_pose)

    def draw_slips(
        self, keys: Key[Array, " batch"], step, memory: SlipMemory, errors: Float[Array, "batch 3"]
    ) -> SlipMemory:
        """Draw the deviations of the slips of one period."""
        process = self.slip_process
        uncertain = self.slips.uncertain_slip

        def draw(key, memory_of_one, situation):
            return slip.draw_slip(key, step, memory_of_one, situation, process, uncertain)

        def draw_sideslip(key, memory_of_one, situation, slip_error):
            return slip.draw_sideslip(key, step, memory_of_one, situation, process, slip_error)

        situation = self.situation(step, errors)
        before = memory.process if self.sideslip is None else memory.process[0]
        true, measured, following = jax.vmap(draw)(keys, before, situation)
        if self.sideslip is None:
            return SlipMemory(following, true, measured)
        drawn = jax.vmap(draw_sideslip)(keys, memory.process[1], situation, true - measured)
        sideways, following_sideways = drawn
        return SlipMemory((following, following_sideways), true, measured, sideways)

    def situation(self, step, errors: Float[Array, "batch 3"]) -> slip.Situation:
        """Return what the slip processes may look at."""
        poses = world_pose(errors, self.reference_poses[step])
        return slip.Situation(wheel_positions(poses, self.robot.track_width), errors)

    def true_slip(self, memory: SlipMemory) -> Float[Array, "batch 2"]:
        """Return the true slips of the period that has begun."""
        return jnp.asarray(self.slips.true_slip(memory.true))

    def measured_slip(self, memory: SlipMemory) -> Float[Array, "batch 2"]:
        """Return the slips that are measured in the period that has begun."""
        return jnp.asarray(self.slips.measured_slip(memory.true, memory.measured))

    def advance(
        self,
        keys: Key[Array, " batch"],
        step,
        memory: SlipMemory,
        errors: Float[Array, "batch 3"],
        command: Command,
    ) -> Advance:
        """Move through one period under the slips that were drawn for it."""
        wheels = saturate(command.wheels, self.robot)
        following = self.move(step, errors, wheels, memory)
        return Advance(following, memory, wheels)

    def move(
        self,
        step,
        errors: Float[Array, "batch 3"],
        wheels: Float[Array, "batch 2"],
        memory: SlipMemory,
    ) -> Float[Array, "batch 3"]:
        """Return the tracking errors after one period.

        Args:
            step: of the reference.
            errors: true tracking errors at its start, (m, m, rad).
            wheels: speeds within the limits, m/s.
            memory: with the deviations of the period, in [-1, 1].
        """
        true = self.slips.true_slip(memory.true)
        reference = self.reference_wheels[step]
        width = self.robot.track_width
        sideslip = None
        if self.sideslip is not None and memory.sideslip is not None:
            sideslip = Sideslip(self.sideslip * memory.sideslip, self.robot.lever_arm)
        return advance(errors, wheels, true, reference, width, self.dt, sideslip)

    def uncertainties(self) -> dict[str, Uncertainty]:
        """Return slips and noise as boxes.

        Raises:
            ValueError: for a slip process that ties its deviations to each other or to the ground.
        """
        if self.process not in ("iid", "constant"):
            is_own = not isinstance(self.process, str)
            name = type(self.process).__name__ if is_own else self.process
            raise ValueError(
                f'slip.process = "{name}": is not searched; choose "iid", which contains all that '
                'is allowed, or "constant"'
            )
        steps = len(self.reference_wheels)
        times = steps if self.process == "iid" else 1
        uncertain = self.slips.uncertain_slip
        names = [name for name in ("true", "measured") if uncertain in (name, "both")]
        uncertainties = {name: Uncertainty(box_vertices(2), times) for name in names}
        if self.slip_steps is not None and "true" in names and self.process == "iid":
            uncertainties["true"] = Uncertainty(box_vertices(2), 1)
            uncertainties["change"] = Uncertainty(box_vertices(2), steps)
        if self.sideslip is not None:
            uncertainties["sideslip"] = Uncertainty(box_vertices(1), times)
        if self.noise is not None:
            uncertainties["noise"] = Uncertainty(box_vertices(3), steps + 1)
        return uncertainties

    def under_script(self, script: Script) -> ScriptedRobot:
        """Return the robot under given slips and noise (see `ScriptedRobot`).

        Raises:
            ValueError: for slips of several periods where their changes are limited.
        """
        given = len(script.get("true", ()))
        if self.slip_steps is not None and given > 1:
            raise ValueError(
                f"script: `true` has {given} entries, and changes of the slips are limited; give "
                "the first one, and `change` for those that follow"
            )
        return ScriptedRobot(self, script)


@partial(jax.tree_util.register_dataclass, data_fields=["robot", "script"], meta_fields=[])
@dataclass(frozen=True)
class ScriptedRobot:
    """The slipping robot under given slips and noise; keys are ignored.

    The script has deviations of the slips `true` and `measured`, (times, batch, 2), of the
    `sideslip`, (times, batch, 1), and the pose `noise`, (steps + 1, batch, 3), all in [-1, 1]. What
    it does not name does not deviate.

    Where changes of the slips are limited, `true` says where they begin, and `change`,
    (steps, batch, 2) in [-1, 1], how they go on from one period to the next, in shares of the
    greatest change: no script is faster, and a gradient finds its way over all periods.
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
        return SlipMemory((), none, none, None if self.robot.sideslip is None else none[:, 0])

    def sense(
        self, keys, step, memory: SlipMemory, errors: Float[Array, "batch 3"]
    ) -> tuple[Measurement, SlipMemory]:
        """Read noise and slips from the script."""
        robot = self.robot
        none = jnp.zeros_like(errors[:, :2])
        memory = SlipMemory(
            (),
            self._read_true(step, memory, none),
            self._read("measured", step, none),
            None if robot.sideslip is None else self._read("sideslip", step, none)[:, 0],
        )
        if "noise" in self.script:
            assert robot.noise is not None
            noise = robot.noise * script_entry(self.script["noise"], step)
            errors = robot.add_noise(step, errors, noise)
        return Measurement(errors, robot.measured_slip(memory)), memory

    def true_slip(self, memory: SlipMemory) -> Float[Array, "batch 2"]:
        """Return the true slips of the period that has begun."""
        return self.robot.true_slip(memory)

    def _read_true(self, step, memory: SlipMemory, default: Array) -> Array:
        """Return the deviations of the true slips in the period that begins."""
        given = self._read("true", step, default)
        if self.robot.slip_steps is None:
            return given
        most = jnp.asarray(self.robot.slip_steps, default.dtype)
        change = most * self._read("change", step, default)
        return jnp.where(step == 0, given, jnp.clip(memory.true + change, -1.0, 1.0))

    def _read(self, name: str, step, default: Array) -> Array:
        return script_entry(self.script[name], step) if name in self.script else default

    def advance(
        self, keys, step, memory: SlipMemory, errors: Float[Array, "batch 3"], command: Command
    ) -> Advance:
        """Move through one period under the slips of the script."""
        return self.robot.advance(keys, step, memory, errors, command)


def box_vertices(dimension: int) -> Float[np.ndarray, "v n"]:
    """Return the corners of the box [-1, 1]^n."""
    return np.array(list(itertools.product((-1.0, 1.0), repeat=dimension)))
