"""Closed loops: any controller on any plant, all realisations at once, scanned over time.

    measured error -> controller -> virtual input -> wheels (eqs. (7)-(8), measured slip) -> plant -> next error

A controller has `initial(errors)`, `act(step, state, errors, reference_wheels)`, `compensates` and `cosine_free`; a
plant has `initial(keys, errors)`, `measure(keys, step, errors)` and `advance(...)`. The batch axis comes first
everywhere, so that a controller can share matrices across it. Draws depend on key and step alone.

Wheels follow Gonzalez, Fiacchini, Guzman, Alamo 2009, eqs. (7)-(8).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import Array
from jaxtyping import Bool, Float, Int, Key

from jaxtube import mpc
from jaxtube import slip as slips
from jaxtube.controllers import TubeMpc
from jaxtube.error_dynamics import advance, world_pose
from jaxtube.mpc import Diagnostics
from jaxtube.robot import Robot, cosine_free_input, saturate, wheel_commands, wheel_positions


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
    data_fields=["robot", "dt", "reference_wheels", "reference_poses", "nominal_slip", "relative_error", "noise"],
    meta_fields=["process", "random"],
)
@dataclass(frozen=True)
class SlippingRobot:
    """The nonlinear plant: exact motion over each period, slip drawn by a process, bounded noise on the measured pose.

    `noise` holds half widths (m, m, rad) in the robot's frame; `process` and `random` are names of `jaxtube.slip`.
    """

    robot: Robot
    dt: float
    reference_wheels: Float[Array, "steps 2"]
    reference_poses: Float[Array, "steps+1 3"]
    nominal_slip: Float[Array, "2"]
    relative_error: float
    noise: Float[Array, "3"]
    process: str = "iid"
    random: str = "true"

    def initial(self, keys: Key[Array, " batch"], errors: Float[Array, "batch 3"]):
        """Return the memory of the slip processes."""
        process = slips.PROCESSES[self.process]()
        return jax.vmap(lambda key: slips.initial_slip(key, process, errors.dtype))(keys)

    def measure(self, keys: Key[Array, " batch"], step, errors: Float[Array, "batch 3"]) -> Float[Array, "batch 3"]:
        """Return the measured errors."""
        return errors + jax.vmap(lambda key: slips.pose_noise(key, step, self.noise))(keys)

    def advance(self, keys, step, state, errors, inputs, controller):
        """Return (next errors, next memory, wheels, wheels before saturation) of one period."""
        process = slips.PROCESSES[self.process]()
        poses = world_pose(errors, self.reference_poses[step])
        places = wheel_positions(poses, self.robot.track_width)

        def draw(key, memory, positions):
            return slips.draw_slip(key, step, memory, positions, process, self.random)

        true, measured, state = jax.vmap(draw)(keys, state, places)
        true_slip = slips.deviated(self.nominal_slip, self.relative_error, true)
        measured_slip = slips.deviated(self.nominal_slip, self.relative_error, measured)
        reference = self.reference_wheels[step]
        compensated = measured_slip if controller.compensates else jnp.zeros_like(measured_slip)
        demanded = wheel_commands(inputs, reference, compensated, self.robot.track_width)
        wheels = saturate(demanded, self.robot)
        following = advance(errors, wheels, true_slip, reference, self.robot.track_width, self.dt)
        return following, state, wheels, demanded


# The stream of disturbances of the linear plant, beside those of `jaxtube.slip`.
DISTURBANCE = 3


@partial(
    jax.tree_util.register_dataclass,
    data_fields=["reference_wheels", "transitions", "input_matrices", "disturbance_vertices"],
    meta_fields=[],
)
@dataclass(frozen=True)
class LinearPlant:
    """The prediction model itself with w drawn in W: a vertex in half of the steps, inside W in the others."""

    reference_wheels: Float[Array, "steps 2"]
    transitions: Float[Array, "steps 3 3"]
    input_matrices: Float[Array, "steps 3 2"]
    disturbance_vertices: Float[Array, "v 3"]

    def initial(self, keys: Key[Array, " batch"], errors: Float[Array, "batch 3"]) -> tuple[()]:
        """Return no memory."""
        return ()

    def measure(self, keys: Key[Array, " batch"], step, errors: Float[Array, "batch 3"]) -> Float[Array, "batch 3"]:
        """Return the errors themselves."""
        return errors

    def advance(self, keys, step, state, errors, inputs, controller):
        """Return (next errors, no memory, no wheels: NaN twice) of one period."""
        disturbances = jax.vmap(lambda key: self.disturbance(key, step))(keys)
        following = errors @ self.transitions[step].T + inputs @ self.input_matrices[step].T + disturbances
        no_wheels = jnp.full_like(inputs, jnp.nan)
        return following, state, no_wheels, no_wheels

    def disturbance(self, key: Key[Array, ""], step) -> Float[Array, "3"]:
        """Draw one w: weights on the vertices that are exponential (uniform on the simplex) or all on one vertex."""
        side, inside = jax.random.split(jax.random.fold_in(jax.random.fold_in(key, DISTURBANCE), step))
        count, dtype = self.disturbance_vertices.shape[0], self.disturbance_vertices.dtype
        index = jax.random.randint(side, (), 0, 2 * count)
        mixed = jax.random.exponential(inside, (count,), dtype)
        corner = (jnp.arange(count) == index).astype(dtype)
        weights = jnp.where(index < count, corner, mixed / jnp.sum(mixed))
        return weights @ self.disturbance_vertices


@jax.jit
def rollout(controller, plant, keys: Key[Array, " batch"], errors: Float[Array, "batch 3"]) -> Trajectory:
    """Run every realisation through the whole reference.

    Args:
        controller: any (module docstring).
        plant: any.
        keys: one key a realisation.
        errors: initial tracking errors, (m, m, rad).

    Returns:
        The trajectory. Nothing raises: a QP without solution is the diagnostics' to tell.
    """
    steps = plant.reference_wheels.shape[0]

    def period(carry, step):
        errors, memory, plant_memory = carry
        measured = plant.measure(keys, step, errors)
        reference = plant.reference_wheels[step]
        inputs, memory, diagnostics = controller.act(step, memory, measured, reference)
        acting = cosine_free_input(inputs, measured[:, 2], reference) if controller.cosine_free else inputs
        following, plant_memory, wheels, demanded = plant.advance(keys, step, plant_memory, errors, acting, controller)
        return (following, memory, plant_memory), (errors, measured, inputs, wheels, demanded, diagnostics)

    start = (errors, controller.initial(errors), plant.initial(keys, errors))
    (last, _, _), (before, measured, *rest) = jax.lax.scan(period, start, jnp.arange(steps))
    last_measured = plant.measure(keys, steps, last)
    return Trajectory(jnp.concatenate([before, last[None]]), jnp.concatenate([measured, last_measured[None]]), *rest)


@jax.jit
def follow_plan(
    controller: TubeMpc, plant, keys: Key[Array, " batch"], errors: Float[Array, "batch 3"], step: Int[Array, ""]
) -> tuple[Float[Array, "horizon batch 3"], Bool[Array, " batch"]]:
    """Plan once and follow the plan to its end, u = g_j + K(th) (e - e_nominal): what the tube is about.

    Args:
        controller: the tube-MPC whose plan, nominal model and tube gain are used.
        plant: any.
        keys: one key a realisation.
        errors: tracking errors at `step`, (m, m, rad).
        step: where along the reference, at least a horizon before its end.

    Returns:
        (e - e_nominal after 1 .. N steps, to be compared with R_1 .. R_N; whether there was a plan to follow).
    """
    horizon = controller.windows.plan_errors.shape[1]
    solution, planned = mpc.plan(mpc.take_window(controller.windows, controller.index[step]), errors)
    planned_inputs = jnp.moveaxis(solution.x.reshape(-1, horizon, 2), 1, 0)

    def period(carry, ahead):
        errors, nominal, memory = carry
        offset, planned_input = ahead
        window = mpc.take_window(controller.windows, controller.index[step + offset])
        reference = plant.reference_wheels[step + offset]
        inputs = planned_input + (errors - nominal) @ window.tube_gain.T
        acting = cosine_free_input(inputs, errors[:, 2], reference) if controller.cosine_free else inputs
        errors, memory, _, _ = plant.advance(keys, step + offset, memory, errors, acting, controller)
        nominal = nominal @ window.transition.T + planned_input @ window.input_matrix.T
        return (errors, nominal, memory), errors - nominal

    start = (errors, errors, plant.initial(keys, errors))
    _, deviations = jax.lax.scan(period, start, (jnp.arange(horizon), planned_inputs))
    return deviations, planned


def realisation_keys(seed: int, first: int, count: int) -> Key[Array, " count"]:
    """Return the keys of realisations first .. first + count - 1: functions of seed and index alone."""
    seed_key = jax.random.key(seed)
    indices = [first + i for i in range(count)]
    words = [jnp.array(word, jnp.uint32) for word in ([i >> 32 for i in indices], [i & 0xFFFFFFFF for i in indices])]
    return jax.vmap(lambda high, low: slips.realisation_key(seed_key, high, low))(*words)
