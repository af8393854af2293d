"""Laps of a design as an exported controller meets them: poses and slips in, wheel speeds out."""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int, Key

from jaxtube.columns import scan_by_columns, use_twice
from jaxtube.control.laws import TubeMpc
from jaxtube.plant.error_dynamics import world_pose
from jaxtube.plant.lagging import LaggingRobot
from jaxtube.plant.motions import join
from jaxtube.plant.observed import robot_behind
from jaxtube.plant.protocol import Plant
from jaxtube.precision import in_64_bits
from jaxtube.qp.regions import AnyArray
from jaxtube.simulation.choices import choose_starts
from jaxtube.simulation.components import make_tube_mpc, slipping_robot
from jaxtube.simulation.rollout import (
    begin,
    is_unsolved,
    realisation_keys,
    run_period,
    run_shortened,
)
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
    poses = jnp.asarray(design.problem.reference.poses)
    arguments = (slipping_robot(design), poses, keys, jnp.asarray(starts, float))
    recording = run_shortened(_record, _find_unsolved, make_tube_mpc(design), *arguments)
    return jax.tree.map(np.asarray, recording)


# Designs of one shape share the program: their numbers are arguments.
@jax.jit
def _record(
    controller: TubeMpc,
    plant: Plant,
    poses: Float[Array, "steps 3"],
    keys: Key[Array, " laps"],
    errors: Float[Array, "laps 3"],
) -> Recording:
    def period(state, step):
        state, before = use_twice(state)
        pose = _measure_poses(plant, keys, step, before, poses[step])
        following, happened = run_period(controller, plant, keys, step, state)
        seen = (pose, before.measurement.slip, before.measured)
        return following, (*seen, happened.inputs, happened.wheels, happened.diagnostics.status)

    start = begin(controller, plant, keys, errors)
    _, recorded = scan_by_columns(period, start, jnp.arange(len(plant.reference_wheels)))
    return Recording(*recorded)


def _find_unsolved(recording: Recording) -> Bool[np.ndarray, " laps"]:
    return is_unsolved(recording.status, recording.errors)


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
