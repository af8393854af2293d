"""Closed loops: any controller on any plant, all realisations at once, scanned over time.

    measured error -> controller -> virtual input -> wheels (eqs. (7)-(8), measured slip) -> plant
    -> next error

A controller has `initial(errors)`, `act(step, state, errors, reference_wheels)`, `compensates` and
`input_map`; a plant has `initial(keys, errors)`, `measure(keys, step, errors)`, `acting(...)` and
`advance(...)`. The batch axis comes first everywhere, so that a controller can share matrices
across it. Draws depend on key and step alone.

Wheels follow Gonzalez, Fiacchini, Guzman, Alamo 2009, eqs. (7)-(8).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import Array
from jax.ad_checkpoint import checkpoint_name
from jaxtyping import Float, Int, Key

from jaxtube.control import mpc
from jaxtube.control.laws import TubeMpc
from jaxtube.control.mpc import Diagnostics
from jaxtube.plant import slip as slips
from jaxtube.plant.error_dynamics import advance, world_pose
from jaxtube.plant.input_maps import acting_input
from jaxtube.plant.robot import Robot, saturate, wheel_commands, wheel_positions
from jaxtube.plant.slip_processes import find_process

DRAWN = "drawn"
"""Name of what is drawn at random, for reverse mode to keep: to draw again costs more than all else
in a period."""


class Trajectory(NamedTuple):
    """What a rollout records; the leading axis is time, the next one the realisations."""

    errors: Float[Array, "steps+1 batch 3"]  # true tracking errors
    measured: Float[Array, "steps+1 batch 3"]  # what the controller saw
    inputs: Float[Array, "steps batch 2"]  # virtual inputs asked for
    wheels: Float[Array, "steps batch 2"]  # wheel speeds (right, left) after saturation, m/s
    demanded: Float[Array, "steps batch 2"]  # before saturation
    diagnostics: Diagnostics


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
    meta_fields=["process", "random"],
)
@dataclass(frozen=True)
class SlippingRobot:
    """The nonlinear plant: exact motion over each period, slip drawn by a process, bounded noise on
    the measured pose.

    `noise` holds half widths (m, m, rad) in the robot's frame, None for an exact measurement;
    `process` and `random` are names of `jaxtube.plant.slip`.
    """

    robot: Robot
    dt: float
    reference_wheels: Float[Array, "steps 2"]
    reference_poses: Float[Array, "steps+1 3"]
    nominal_slip: Float[Array, "2"]
    relative_error: float
    noise: Float[Array, "3"] | None = None
    process: str = "iid"
    random: str = "true"

    def initial(self, keys: Key[Array, " batch"], errors: Float[Array, "batch 3"]):
        """Return the memory of the slip processes."""
        process = find_process(self.process)
        return jax.vmap(lambda key: slips.initial_slip(key, process, errors.dtype))(keys)

    def measure(
        self, keys: Key[Array, " batch"], step, errors: Float[Array, "batch 3"]
    ) -> Float[Array, "batch 3"]:
        """Return the measured errors."""
        noise = self.noise
        if noise is None:
            return errors
        return errors + checkpoint_name(
            jax.vmap(lambda key: slips.pose_noise(key, step, noise))(keys), DRAWN
        )

    def acting(self, step, inputs, measured, controller):
        """Return the deficits (V - v, Om - om) that the controller's virtual inputs ask for."""
        reference, track_width = self.reference_wheels[step], self.robot.track_width
        return acting_input(controller.input_map, inputs, measured, reference, track_width, self.dt)

    def draw(self, keys, step, state, errors):
        """Return the deviations of true and measured slip of one period, in [-1, 1], and the next
        memory."""
        process = find_process(self.process)
        poses = world_pose(errors, self.reference_poses[step])
        places = wheel_positions(poses, self.robot.track_width)

        def of_one(key, memory, situation):
            return slips.draw_slip(key, step, memory, situation, process, self.random)

        return checkpoint_name(
            jax.vmap(of_one)(keys, state, slips.Situation(places, errors)), DRAWN
        )

    def advance(self, keys, step, state, errors, inputs, controller):
        """Return (next errors, next memory, wheels, wheels before saturation) of one period."""
        true, measured, state = self.draw(keys, step, state, errors)
        following, wheels, demanded = self.move(step, errors, inputs, true, measured, controller)
        return following, state, wheels, demanded

    def move(self, step, errors, inputs, true, measured, controller):
        """Return (next errors, wheels, wheels before saturation) for given deviations of the two
        slips, in [-1, 1]."""
        true_slip = slips.deviated(self.nominal_slip, self.relative_error, true)
        measured_slip = slips.deviated(self.nominal_slip, self.relative_error, measured)
        reference = self.reference_wheels[step]
        compensated = measured_slip if controller.compensates else jnp.zeros_like(measured_slip)
        demanded = wheel_commands(inputs, reference, compensated, self.robot.track_width)
        wheels = saturate(demanded, self.robot)
        following = advance(errors, wheels, true_slip, reference, self.robot.track_width, self.dt)
        return following, wheels, demanded


# The stream of disturbances of the linear plant, beside those of `jaxtube.plant.slip`.
DISTURBANCE = 3


@partial(
    jax.tree_util.register_dataclass,
    data_fields=["reference_wheels", "transitions", "input_matrices", "disturbance_vertices"],
    meta_fields=[],
)
@dataclass(frozen=True)
class LinearPlant:
    """The prediction model itself with w drawn in W: a vertex in half of the steps, inside W in the
    others."""

    reference_wheels: Float[Array, "steps 2"]
    transitions: Float[Array, "steps 3 3"]
    input_matrices: Float[Array, "steps 3 2"]
    disturbance_vertices: Float[Array, "v 3"]

    def initial(self, keys: Key[Array, " batch"], errors: Float[Array, "batch 3"]) -> tuple[()]:
        """Return no memory."""
        return ()

    def measure(
        self, keys: Key[Array, " batch"], step, errors: Float[Array, "batch 3"]
    ) -> Float[Array, "batch 3"]:
        """Return the errors themselves."""
        return errors

    def acting(self, step, inputs, measured, controller):
        """Return the virtual inputs themselves: the model knows no other."""
        return inputs

    def advance(self, keys, step, state, errors, inputs, controller):
        """Return (next errors, no memory, no wheels: NaN twice) of one period."""
        disturbances = jax.vmap(lambda key: self.disturbance(key, step))(keys)
        following = (
            errors @ self.transitions[step].T + inputs @ self.input_matrices[step].T + disturbances
        )
        no_wheels = jnp.full_like(inputs, jnp.nan)
        return following, state, no_wheels, no_wheels

    def disturbance(self, key: Key[Array, ""], step) -> Float[Array, "3"]:
        """Draw one w: weights on the vertices that are exponential (uniform on the simplex) or all
        on one vertex."""
        side, inside = jax.random.split(
            jax.random.fold_in(jax.random.fold_in(key, DISTURBANCE), step)
        )
        count, dtype = self.disturbance_vertices.shape[0], self.disturbance_vertices.dtype
        index = jax.random.randint(side, (), 0, 2 * count)
        mixed = jax.random.exponential(inside, (count,), dtype)
        corner = (jnp.arange(count) == index).astype(dtype)
        weights = jnp.where(index < count, corner, mixed / jnp.sum(mixed))
        return weights @ self.disturbance_vertices


class LoopState(NamedTuple):
    """A closed loop between two periods: true and measured errors, memory of the controller and of
    the plant."""

    errors: Float[Array, "batch 3"]
    measured: Float[Array, "batch 3"]
    memory: Any
    plant_memory: Any


class Period(NamedTuple):
    """What happened in one period: what was asked of the wheels, what they did, and how the
    controller found it."""

    inputs: Float[Array, "batch 2"]
    wheels: Float[Array, "batch 2"]
    demanded: Float[Array, "batch 2"]
    diagnostics: Diagnostics


def begin(
    controller, plant, keys: Key[Array, " batch"], errors: Float[Array, "batch 3"]
) -> LoopState:
    """Return the closed loop before its first period."""
    measured = plant.measure(keys, 0, errors)
    return LoopState(errors, measured, controller.initial(measured), plant.initial(keys, errors))


def run_period(
    controller, plant, keys: Key[Array, " batch"], step: Int[Array, ""], state: LoopState
) -> tuple[LoopState, Period]:
    """Run one period of the closed loop, the one that begins at `step`."""
    inputs, memory, diagnostics = controller.act(
        step, state.memory, state.measured, plant.reference_wheels[step]
    )
    following, wheels, demanded = _apply(controller, plant, keys, step, state, inputs)
    return following._replace(memory=memory), Period(inputs, wheels, demanded, diagnostics)


def _apply(controller, plant, keys, step, state: LoopState, inputs):
    """Let the plant run one period under virtual inputs, and measure; the controller's memory stays
    as it was."""
    acting = plant.acting(step, inputs, state.measured, controller)
    errors, plant_memory, wheels, demanded = plant.advance(
        keys, step, state.plant_memory, state.errors, acting, controller
    )
    measured = plant.measure(keys, step + 1, errors)
    return LoopState(errors, measured, state.memory, plant_memory), wheels, demanded


@jax.jit
def rollout(
    controller, plant, keys: Key[Array, " batch"], errors: Float[Array, "batch 3"]
) -> Trajectory:
    """Run every realisation through the whole reference.

    Args:
        controller: any (module docstring).
        plant: any.
        keys: one key a realisation.
        errors: initial tracking errors, (m, m, rad).

    Returns:
        The trajectory. Nothing raises: a QP without solution is the diagnostics' to tell.
    """

    def period(state, step):
        following, happened = run_period(controller, plant, keys, step, state)
        return following, (state.errors, state.measured, happened)

    start, steps = begin(controller, plant, keys, errors), plant.reference_wheels.shape[0]
    last, (before, measured, happened) = jax.lax.scan(period, start, jnp.arange(steps))
    errors, measured = (
        jnp.concatenate([before, last.errors[None]]),
        jnp.concatenate([measured, last.measured[None]]),
    )
    return Trajectory(errors, measured, *happened)


@jax.jit
def follow_plan(
    controller: TubeMpc,
    plant,
    keys: Key[Array, " batch"],
    state: LoopState,
    step: Int[Array, ""],
    found: mpc.Plan,
) -> Float[Array, "horizon batch 3"]:
    """Follow plans to their end, u = g_j + K(th) (e - e_nominal), without planning again: what the
    tube is about.

    Args:
        controller: the tube-MPC whose nominal model and tube gain are used.
        plant: any.
        keys: one key a realisation.
        state: the closed loop at `step`.
        step: where along the reference, at least a horizon before its end.
        found: the plans, made from the measured errors at `step`.

    Returns:
        e - e_nominal after 1 .. N steps, measured, to be compared with R_1 .. R_N where there was a
        plan.
    """

    def period(carry, ahead):
        state, nominal = carry
        offset, planned = ahead
        window = mpc.take_window(controller.windows, controller.index[step + offset])
        inputs = planned + (state.measured - nominal) @ window.tube_gain.T
        state, _, _ = _apply(controller, plant, keys, step + offset, state, inputs)
        nominal = nominal @ window.transition.T + planned @ window.input_matrix.T
        return (state, nominal), state.measured - nominal

    planned = jnp.moveaxis(found.inputs, 1, 0)
    offsets = jnp.arange(len(planned), dtype=step.dtype)
    _, deviations = jax.lax.scan(period, (state, state.measured), (offsets, planned))
    return deviations


def realisation_keys(seed: int, first: int, count: int) -> Key[Array, " count"]:
    """Return the keys of realisations first .. first + count - 1: functions of seed and index
    alone."""
    seed_key = jax.random.key(seed)
    indices = [first + i for i in range(count)]
    words = [
        jnp.array(word, jnp.uint32)
        for word in ([i >> 32 for i in indices], [i & 0xFFFFFFFF for i in indices])
    ]
    return jax.vmap(lambda high, low: slips.realisation_key(seed_key, high, low))(*words)
