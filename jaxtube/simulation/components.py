"""Controllers and plants of a design, on the device."""

from __future__ import annotations

import dataclasses

import jax
import jax.numpy as jnp

from jaxtube.control import mpc
from jaxtube.control.laws import ScheduledGain, TrackingLaw, TubeMpc
from jaxtube.control.protocol import Controller, WheelMap
from jaxtube.plant.linear import LinearPlant
from jaxtube.plant.slip import SlipProcess
from jaxtube.plant.slipping import SlippingRobot
from jaxtube.precision import require_64_bits
from jaxtube.synthesis.parts import Design
from jaxtube.synthesis.problem import Problem, error_vector


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
    on_device = jax.device_put(qps)
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
