"""Laps of a design as an exported controller meets them: poses and slips in, wheel speeds out."""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from jaxtube.columns import use_twice
from jaxtube.plant.error_dynamics import world_pose
from jaxtube.plant.lagging import LaggingRobot
from jaxtube.plant.motions import join
from jaxtube.plant.observed import robot_behind
from jaxtube.precision import in_64_bits
from jaxtube.qp.regions import AnyArray
from jaxtube.simulation.choices import choose_starts
from jaxtube.simulation.components import make_tube_mpc, slipping_robot
from jaxtube.simulation.rollout import begin, realisation_keys, run_period
from jaxtube.synthesis.parts import Design


class Recording(NamedTuple):
    """What a lap shows, step by step; time first, then the laps."""

    poses: Float[AnyArray, "steps laps 3"]  # measured, (x m, y m, heading rad) in the world
    slips: Float[AnyArray, "steps laps 2"]  # measured
    errors: Float[AnyArray, "steps laps 3"]  # that the controller acted on, (m, m, rad)
    inputs: Float[AnyArray, "steps laps 2"]
    wheels: Float[AnyArray, "steps laps 2"]  # within the limits, m/s
    status: Int[AnyArray, "steps laps"]


@in_64_bits
def draw_starts(design: Design, laps: int, seed: int = 0) -> Float[np.ndarray, "2*laps 3"]:
    """Return true errors to start from: the scenario's start, and as many on the edge of the
    feasible set."""
    keys = realisation_keys(seed, 0, laps)
    laws = [choose_starts(design, name) for name in ("scenario", "edge")]
    return np.concatenate([law.draw(keys) for law in laws])


@in_64_bits
def record_laps(design: Design, starts: Float[np.ndarray, "laps 3"], seed: int = 0) -> Recording:
    """Run laps of the tube-MPC on the robot of a design, and record what it measures and commands.

    Args:
        design: a design.
        starts: true errors, (m, m, rad), one a lap.
        seed: of every draw.
    """
    keys = realisation_keys(seed, 0, len(starts))
    errors = jnp.asarray(starts, float)
    controller = make_tube_mpc(design)
    plant = slipping_robot(design)
    poses = jnp.asarray(design.problem.reference.poses)

    @jax.jit
    def run(keys, errors):
        def period(state, step):
            state, before = use_twice(state)
            pose = _measure_poses(plant, keys, step, before, poses[step])
            following, happened = run_period(controller, plant, keys, step, state)
            seen = (pose, before.measurement.slip, before.measured)
            return following, (*seen, happened.inputs, happened.wheels, happened.diagnostics.status)

        start = begin(controller, plant, keys, errors)
        _, recorded = jax.lax.scan(period, start, jnp.arange(len(plant.reference_wheels)))
        return Recording(*recorded)

    return jax.tree.map(np.asarray, run(keys, errors))


def _measure_poses(
    plant, keys, step, state, reference_pose: Float[Array, "3"]
) -> Float[Array, "batch 3"]:
    """Return the poses that are measured at an instant: their noise depends on key and step alone,
    so that to sense twice is to sense the same."""
    robot = robot_behind(plant)
    memory = state.plant_memory if robot is plant else state.plant_memory.plant
    measurement, _ = robot.sense(keys, step, memory, state.errors)
    errors = measurement.errors
    if isinstance(robot, LaggingRobot):
        # Errors are those of the committed pose, from which the pose lies the motion ahead behind.
        ahead = robot.body.forecast.motion_ahead(memory.expected, memory.intended)
        errors = join(ahead, errors)
    return world_pose(errors, reference_pose)
