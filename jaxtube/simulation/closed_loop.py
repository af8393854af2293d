"""Closed loops of a design: its controllers and its plants on the device, run in blocks."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Float

from jaxtube import qp
from jaxtube.control import mpc
from jaxtube.control.laws import ScheduledGain, TrackingLaw, TubeMpc
from jaxtube.control.protocol import Controller, WheelMap
from jaxtube.plant.linear import LinearPlant
from jaxtube.plant.protocol import Plant
from jaxtube.plant.slip import SlipProcess
from jaxtube.plant.slipping import SlippingRobot
from jaxtube.precision import require_64_bits
from jaxtube.simulation.rollout import (
    Trajectory,
    begin,
    follow_plan,
    realisation_keys,
    rollout,
)
from jaxtube.synthesis.parts import Design
from jaxtube.synthesis.problem import Problem, error_vector

BATCH = 256
"""Realisations a call: fixed, so that the length of a run changes no result."""

PLAN_DISTANCE = 10
"""Steps between plans that are followed to their end."""


def controllers(design: Design) -> dict[str, Controller]:
    """Return the controllers compared, by name.

    `local_gain` is the tube's u = K(th) e; `equal_gain` the static law that the MPC is while no row
    is active.
    """
    problem = design.problem
    weights = problem.model.weights(problem.schedule[: problem.reference.steps])
    local_gains = jnp.asarray(design.tube_gain.at(weights))
    plain_mpc = make_plain_mpc(design)
    equal_gains = plain_mpc.qps.free_inputs[plain_mpc.index][:, :2]
    wheel_map = make_wheel_map(problem)
    law_map = dataclasses.replace(wheel_map, input_map="paper")
    blind_map = dataclasses.replace(law_map, compensates=False)
    return {
        "uncompensated": TrackingLaw(blind_map),
        "compensated": TrackingLaw(law_map),
        "local_gain": ScheduledGain(local_gains, wheel_map),
        "equal_gain": ScheduledGain(equal_gains, wheel_map),
        "plain_mpc": plain_mpc,
        "tube_mpc": make_tube_mpc(design),
    }


def make_tube_mpc(design: Design) -> TubeMpc:
    """Return the tube-MPC of a design."""
    restart = design.problem.scenario.controller.restart
    return dataclasses.replace(_make_mpc(design, design.tube_qps), restart=restart)


def make_plain_mpc(design: Design) -> TubeMpc:
    """Return the MPC of a design without its tube: constraints untightened, no terminal set."""
    return _make_mpc(design, design.plain_qps)


def _make_mpc(design: Design, qps: mpc.CondensedQp) -> TubeMpc:
    require_64_bits("controllers of a design")
    on_device = jax.tree.map(jnp.asarray, qps)
    return TubeMpc(on_device, jnp.asarray(design.windows.index), make_wheel_map(design.problem))


def make_wheel_map(problem: Problem) -> WheelMap:
    """Return how the controllers of a problem turn virtual inputs into wheel speeds."""
    settings = problem.scenario.controller
    return WheelMap(problem.robot.track_width, problem.reference.dt, settings.input_map)


def slipping_robot(
    design: Design,
    process: str | SlipProcess | None = None,
    relative_error: float | None = None,
) -> SlippingRobot:
    """Return the nonlinear plant of the scenario, or with another slip process or slip error."""
    return robot_of(design.problem, process, relative_error)


def robot_of(
    problem: Problem,
    process: str | SlipProcess | None = None,
    relative_error: float | None = None,
) -> SlippingRobot:
    """Return the nonlinear plant of a problem, whatever its design."""
    slip = problem.scenario.slip
    steps = problem.reference.steps
    noise = error_vector(problem.scenario.noise)
    return SlippingRobot(
        robot=problem.robot,
        dt=problem.reference.dt,
        reference_wheels=jnp.asarray(problem.schedule[:steps]),
        reference_poses=jnp.asarray(problem.reference.poses[: steps + 1]),
        nominal_slip=jnp.array([slip.nominal_right, slip.nominal_left]),
        relative_error=slip.relative_error if relative_error is None else relative_error,
        noise=jnp.asarray(noise) if noise.any() else None,
        process=slip.process if process is None else process,
        uncertain_slip=slip.random,
    )


def exact_robot(design: Design) -> SlippingRobot:
    """Return the nonlinear plant whose slip is known exactly and whose pose is measured without
    noise."""
    return dataclasses.replace(slipping_robot(design, relative_error=0.0), noise=None)


def linear_plant(design: Design) -> LinearPlant:
    """Return the prediction model along the reference with w drawn in W."""
    problem = design.problem
    schedule = problem.schedule[: problem.reference.steps]
    transitions, inputs = problem.model.matrices(schedule)
    return LinearPlant(
        reference_wheels=jnp.asarray(schedule),
        transitions=jnp.asarray(transitions),
        input_matrices=jnp.asarray(inputs),
        disturbance_vertices=jnp.asarray(problem.disturbance_set.vertices()),
    )


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
        trajectory = rollout(controller, plant, keys, jnp.asarray(padded))
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


_make_plans = jax.jit(mpc.plan)


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
