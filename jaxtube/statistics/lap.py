"""One lap of a run again, from its number alone, with what it used of E and W.

    w(k) = e(k+1) - A(th_k) e(k) - B(th_k) u(k)     of the measured or estimated errors
    usage  1 on a facet, more outside

Every draw is a function of seed, lap and step, so that the lap is the one of the run, to rounding,
whatever ran beside it there.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Bool, Float, Key

from jaxtube.control.laws import solves_qp
from jaxtube.plant.lagging import LaggingRobot, SlipSource
from jaxtube.plant.observed import robot_behind
from jaxtube.plant.slipping import SlippingRobot
from jaxtube.simulation import batches
from jaxtube.simulation.rollout import Trajectory, realisation_keys, run_laps
from jaxtube.statistics.checks import Facets, FacetsByRegime, Judgement, judge_points
from jaxtube.statistics.run import Task
from jaxtube.synthesis.parts import Design


class Usage(NamedTuple):
    """What a lap used of a set, after each period."""

    outside: Bool[np.ndarray, " steps"]
    by_coordinate: Bool[np.ndarray, "steps 3"]  # outside the box around the set
    share: Float[np.ndarray, " steps"]  # 1 on a facet, more outside


class Lap(NamedTuple):
    """One lap; time comes first, and there is no axis of realisations.

    Attributes:
        number: of the lap.
        plans: the controller solves QPs.
        trajectory: what was recorded.
        disturbance: w, (m, m, rad).
        slips: deviations of (true, measured) slip, (right, left), in [-1, 1]; None for a plant
            that draws none.
        of_error_set: what the lap used of E.
        of_disturbance_set: what it used of W.
    """

    number: int
    plans: bool
    trajectory: Trajectory
    disturbance: Float[np.ndarray, "steps 3"]
    slips: Float[np.ndarray, "steps 2 2"] | None
    of_error_set: Usage
    of_disturbance_set: Usage


def lap(design: Design, task: Task, seed: int, number: int) -> Lap:
    """Simulate lap `number`, from 0 to 2^64 - 1, of the run of a task and seed."""
    keys = realisation_keys(seed, number, 1)
    batch = _run(task, keys)
    trajectory = jax.tree.map(lambda array: array[:, 0], batch)
    disturbance = batches.model_disturbances(design, batch)[:, 0]
    slips = None
    robot = robot_behind(task.plant)
    if isinstance(robot, SlippingRobot | LaggingRobot):
        source = robot.slip_source
        slips = np.asarray(slip_deviations(source, keys, jnp.asarray(batch.errors)))[:, 0]
    return Lap(
        number,
        solves_qp(task.controller),
        trajectory,
        disturbance,
        slips,
        _usage(task.checks.error, trajectory.errors[1:]),
        _usage(task.checks.disturbance, disturbance),
    )


def run_numbered(task: Task, seed: int, numbers: Sequence[int]) -> Trajectory:
    """Simulate laps of a run by their numbers, and return numpy arrays (time, laps, ..)."""
    return _run(task, jnp.concatenate([realisation_keys(seed, number, 1) for number in numbers]))


def choose_numbers(summary: dict, count: int) -> list[int]:
    """Return numbers of laps of a run that are worth a look, in ascending order: those that used
    most of E and of W, and the first of the others.

    Args:
        summary: of the run.
        count: of laps; fewer where the run has fewer.
    """
    ranked = [*summary["worst"]["error"][:3], *summary["worst"]["disturbance"][:1]]
    chosen = dict.fromkeys(entry["lap"] for entry in ranked)
    chosen |= dict.fromkeys(range(min(count, summary["laps"])))
    return sorted(list(chosen)[: min(count, summary["laps"])])


def _run(task: Task, keys: Key[Array, " laps"]) -> Trajectory:
    laps = run_laps(task.controller, task.plant, keys, task.starts.draw(keys))
    return jax.tree.map(np.asarray, laps)


def _usage(facets: Facets | FacetsByRegime, points: Float[np.ndarray, "steps 3"]) -> Usage:
    judged = jax.tree.map(lambda array: np.asarray(array)[..., 0], _judge_steps(facets, points))
    return Usage(judged.outside, judged.outside_box, judged.usage)


@jax.jit
def _judge_steps(facets: Facets | FacetsByRegime, points: Float[Array, "steps 3"]) -> Judgement:
    """Return the judgement of one point a step, by the set that is due then; steps first."""

    def judge(step, point):
        return judge_points(facets.at(step), point[:, None])

    return jax.vmap(judge)(jnp.arange(len(points)), points)


@jax.jit
def slip_deviations(
    plant: SlipSource, keys: Key[Array, " batch"], errors: Float[Array, "steps+1 batch 3"]
) -> Float[Array, "steps batch 2 2"]:
    """Return the deviations of the (true, measured) slips, each (right, left), along the true
    errors of laps."""

    def period(memory, now):
        step, errors_now = now
        memory = plant.draw_slips(keys, step, memory, errors_now)
        return memory, jnp.stack([memory.true, memory.measured], axis=1)

    steps = jnp.arange(len(errors) - 1)
    return jax.lax.scan(period, plant.initial(keys, errors[0]), (steps, errors[:-1]))[1]
