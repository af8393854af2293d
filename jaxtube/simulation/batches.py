"""Closed loops of a design run over many realisations, in batches of one size, and what their laps
show of w and of plans."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Float

from jaxtube import qp
from jaxtube.control import planning
from jaxtube.control.laws import TubeMpc
from jaxtube.control.protocol import Controller
from jaxtube.plant.protocol import Plant
from jaxtube.simulation.rollout import (
    Trajectory,
    begin,
    follow_plan,
    realisation_keys,
    run_laps,
)
from jaxtube.synthesis.parts import Design

BATCH = 256
"""Realisations a call: fixed, so that the length of a run changes no result."""

PLAN_DISTANCE = 10
"""Steps between plans that are followed to their end."""


def run_realisations(
    controller: Controller,
    plant: Plant,
    starts: Float[np.ndarray, "runs 3"],
    seed: int,
    on_progress: Callable[[int], object] | None = None,
) -> Trajectory:
    """Run one closed loop a start, and return numpy arrays (time, realisation, ..).

    Args:
        controller: any.
        plant: any.
        starts: true initial errors, (m, m, rad); realisation i starts from the i-th.
        seed: of every draw.
        on_progress: called with the number of realisations of each block that has been run.
    """
    blocks = []
    for first in range(0, len(starts), BATCH):
        block = starts[first : first + BATCH]
        missing = BATCH - len(block)
        padded = np.concatenate([block, np.repeat(block[-1:], missing, axis=0)])
        keys = realisation_keys(seed, first, BATCH)
        trajectory = run_laps(controller, plant, keys, jnp.asarray(padded))
        blocks.append(jax.tree.map(partial(_take_first, len(block)), trajectory))
        if on_progress:
            on_progress(len(block))
    return jax.tree.map(lambda *arrays: np.concatenate(arrays, axis=1), *blocks)


def _take_first(count: int, array: Array) -> np.ndarray:
    return np.asarray(array)[:, :count]


def model_disturbances(design: Design, trajectory: Trajectory) -> Float[np.ndarray, "steps runs 3"]:
    """Return w(k) = e(k+1) - A(th_k) e(k) - B u(k) of the measured errors."""
    problem = design.problem
    transitions, inputs = problem.model.matrices(problem.schedule[: problem.reference.steps])
    free = np.einsum("kij,kbj->kbi", transitions, trajectory.measured[:-1])
    forced = np.einsum("kij,kbj->kbi", inputs, trajectory.inputs)
    return trajectory.measured[1:] - free - forced


_make_plans = jax.jit(planning.plan)


def plan_deviations(
    design: Design, controller: TubeMpc, plant: Plant, trajectory: Trajectory, seed: int
) -> Float[np.ndarray, "horizon samples 3"]:
    """Return e - e_nominal of plans made along the laps and followed to their end.

    For a tube that follows the reference only at steps that have the window ahead whose sections
    are shown.
    """
    count = min(trajectory.errors.shape[1], BATCH)
    keys = realisation_keys(seed, 0, count)
    deviations = []
    for step in _planning_steps(design):
        errors = jnp.asarray(trajectory.errors[step, :count])
        now = jnp.asarray(int(step))
        state = begin(controller, plant, keys, errors, now)
        plans = _make_plans(controller.condensed_qp(now), state.measured)
        followed = follow_plan(controller, plant, keys, state, now, plans)
        deviations.append(np.asarray(followed)[:, np.asarray(plans.status == qp.SOLVED)])
    return np.concatenate(deviations, axis=1)


def _planning_steps(design: Design) -> Sequence[int]:
    """Return the steps at which plans are made: every PLAN_DISTANCE, or about as many that have the
    window ahead whose sections are shown."""
    last = max(design.problem.reference.steps - design.problem.horizon, 1)
    steps = range(0, last, PLAN_DISTANCE)
    if not design.tube.follows_reference:
        return steps
    shown = np.flatnonzero(design.tube.shows(design.windows.index))
    stride = max(len(shown) // len(steps), 1)
    return shown[shown < last][::stride].tolist()
