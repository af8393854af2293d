"""Controllers and plants of a design, on the device."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import TypeVar, cast

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from jaxtube.control import planning
from jaxtube.control.laws import ScheduledGain, TrackingLaw, TubeMpc
from jaxtube.control.protocol import Controller, DirectInputs, WheelMap
from jaxtube.plant.estimating import EstimatingRobot
from jaxtube.plant.forecast import Forecast
from jaxtube.plant.lagging import BareRobot, LaggingRobot, SlipSource
from jaxtube.plant.lagging_body import LaggingBody
from jaxtube.plant.learning import LearningRobot, SlippingPlant
from jaxtube.plant.linear import LinearPlant
from jaxtube.plant.own_motion import OwnMotion
from jaxtube.plant.protocol import Plant
from jaxtube.plant.recorded_slips import make_recorded
from jaxtube.plant.slip import SlipProcess
from jaxtube.plant.slip_bounds import slip_bounds, slip_steps
from jaxtube.plant.slipping import SlippingRobot
from jaxtube.precision import require_64_bits
from jaxtube.scenario.error_box import error_vector
from jaxtube.simulation.starts import FixedStart, Starts
from jaxtube.synthesis.control_problem import ControlProblem
from jaxtube.synthesis.disturbance import find_actuation
from jaxtube.synthesis.free_region import find_free_regions
from jaxtube.synthesis.learnt_slips import make_slip_observer
from jaxtube.synthesis.linear_problem import LinearProblem, make_linear_problem
from jaxtube.synthesis.parts import Design, LinearDesign, TubeDesign
from jaxtube.synthesis.problem import Problem
from jaxtube.synthesis.regions import find_regions
from jaxtube.systems.system import LinearSystem

PlantType = TypeVar("PlantType", bound=Plant)

SourceType = TypeVar("SourceType", bound=SlipSource)

LINEAR_CONTROLLERS = ("equal_gain", "local_gain", "plain_mpc", "tube_mpc")
"""Names of the controllers of a linear system."""

Robot = BareRobot | EstimatingRobot[BareRobot] | LearningRobot[SlippingPlant]
"""The same, with or without an estimate of its errors, or an observer of its slips."""


def controllers(design: Design) -> dict[str, Controller]:
    """Return the controllers compared, by name."""
    return {name: make() for name, make in controller_makers(design).items()}


def controller_makers(
    design: Design, starts: Starts | None = None
) -> dict[str, Callable[[], Controller]]:
    """Return what makes each of the controllers compared, by name; `starts` as for `make_tube_mpc`.

    `local_gain` is the tube's u = K(th) e; `equal_gain` the static law that the MPC is while no row
    is active.
    """
    wheel_map = make_wheel_map(design.problem)
    law_map = dataclasses.replace(wheel_map, input_map="paper")
    blind_map = dataclasses.replace(law_map, compensates=False)
    return {
        "uncompensated": lambda: TrackingLaw(blind_map),
        "compensated": lambda: TrackingLaw(law_map),
        "local_gain": lambda: _make_local_gain(design),
        "equal_gain": lambda: _make_equal_gain(design),
        "plain_mpc": lambda: make_plain_mpc(design),
        "tube_mpc": lambda: make_tube_mpc(design, starts),
    }


def _make_local_gain(design: Design) -> ScheduledGain:
    problem = design.problem
    gains = design.tube_gain.along(problem.schedule[: problem.reference.steps])
    return ScheduledGain(jnp.asarray(gains), make_wheel_map(problem))


def _make_equal_gain(design: Design) -> ScheduledGain:
    plain_mpc = make_plain_mpc(design)
    gains = plain_mpc.qps.free_inputs[plain_mpc.index][:, :2]
    return ScheduledGain(gains, plain_mpc.wheel_map)


def make_tube_mpc(design: Design, starts: Starts | None = None) -> TubeMpc:
    """Return the tube-MPC of a design.

    Args:
        design: a design.
        starts: what laps start from, the scenario's start unless given: plans that such laps meet
            are known beforehand. It decides how fast plans are found, not which.
    """
    problem = design.problem
    free_region, _ = find_free_regions(design.tube_qps, design.plain_qps)
    qps = design.tube_qps._replace(free_region=free_region)
    if not problem.scenario.controller.restart:
        return dataclasses.replace(_make_mpc(design, qps), restart=False)
    law = FixedStart(jnp.asarray(problem.initial_error)) if starts is None else starts
    regions = find_regions(
        qps,
        design.windows.index,
        law.sample,
        problem.noise,
        problem.disturbance_set.vertices(),
    )
    return _make_mpc(design, qps._replace(regions=regions))


def make_plain_mpc(design: Design) -> TubeMpc:
    """Return the MPC of a design without its tube: constraints untightened, no terminal set."""
    _, free_region = find_free_regions(design.tube_qps, design.plain_qps)
    return _make_mpc(design, design.plain_qps._replace(free_region=free_region))


def _make_mpc(design: Design, qps: planning.CondensedQp) -> TubeMpc:
    require_64_bits("controllers of a design")
    return TubeMpc(
        jax.device_put(qps), jnp.asarray(design.windows.index), make_wheel_map(design.problem)
    )


def make_linear_controller(design: LinearDesign, name: str) -> Controller:
    """Return the controller of a linear system by its name.

    Raises:
        ValueError: for an unknown name.
    """
    tube_region, plain_region = find_free_regions(design.tube_qps, design.plain_qps)
    tube_mpc = _make_direct_mpc(design, design.tube_qps._replace(free_region=tube_region))
    plain_mpc = _make_direct_mpc(design, design.plain_qps._replace(free_region=plain_region))
    match name:
        case "tube_mpc":
            return tube_mpc
        case "plain_mpc":
            return plain_mpc
        case "equal_gain":
            gains = plain_mpc.qps.free_inputs[plain_mpc.index][:, : design.system.inputs]
            return ScheduledGain(gains, DirectInputs())
        case "local_gain":
            schedule = design.problem.schedule[: design.problem.reference.steps]
            return ScheduledGain(jnp.asarray(design.tube_gain.along(schedule)), DirectInputs())
    raise ValueError(f"controller = {name!r}: is unknown; choose one of {list(LINEAR_CONTROLLERS)}")


def _make_direct_mpc(design: LinearDesign, qps: planning.CondensedQp) -> TubeMpc:
    require_64_bits("controllers of a design")
    return TubeMpc(jax.device_put(qps), jnp.asarray(design.windows.index), DirectInputs())


def plant_of_system(design: LinearDesign, system: LinearSystem) -> LinearPlant | OwnMotion:
    """Return another system, its motion where it has one, along the schedule of a design.

    Raises:
        ValueError: where its sizes are others.
    """
    own = design.system
    if system.B.shape != own.B.shape:
        raise ValueError(
            f"plant: has (vertices, states, inputs) {system.B.shape}; give {own.B.shape}, as the "
            "design has"
        )
    steps = design.problem.reference.steps
    problem = make_linear_problem(system).along(design.problem.schedule, steps)
    if system.motion is None:
        return _make_linear_plant(problem)
    return own_motion(problem)


def own_motion(problem: LinearProblem) -> OwnMotion:
    """Return the motion of a linear system's own as a plant.

    Raises:
        ValueError: where it has none.
    """
    motion = problem.system.motion
    if motion is None:
        raise ValueError(
            'plant = "motion": the system has none; give jt.LinearSystem(..., motion=...), or '
            'choose "linear"'
        )
    return OwnMotion(
        reference_wheels=jnp.asarray(problem.schedule[: problem.reference.steps]),
        disturbance_vertices=jnp.asarray(motion.corners),
        function=motion.function,
    )


def make_wheel_map(problem: Problem) -> WheelMap:
    """Return how the controllers of a problem turn virtual inputs into wheel speeds."""
    settings = problem.scenario.controller
    return WheelMap(problem.robot.track_width, problem.reference.dt, settings.input_map)


def slipping_robot(design: Design, process: str | SlipProcess | None = None) -> Robot:
    """Return the nonlinear plant of the scenario, or with another slip process."""
    return robot_of(design.problem, process)


def robot_of(problem: Problem, process: str | SlipProcess | None = None) -> Robot:
    """Return the nonlinear plant of a problem, whatever its design."""
    ideal = bare_robot(problem, process)
    return with_estimate(problem, with_lag(problem, ideal, ideal))


def with_estimate(
    problem: Problem, plant: PlantType
) -> PlantType | EstimatingRobot[PlantType] | LearningRobot[SlippingPlant]:
    """Return a robot with the estimate that the scenario's controller acts on, or with the observer
    of its slips; the robot itself where that acts on what is measured."""
    settings = problem.scenario.controller
    if problem.scenario.slip.is_learnt:
        # A scenario whose slips are learnt has wheels that obey at once: such robots know them.
        return LearningRobot(cast(SlippingPlant, plant), make_slip_observer(problem))
    if not settings.has_observer:
        return plant
    gain = jnp.asarray(settings.observer_gain)
    return EstimatingRobot(plant, gain, problem.robot.track_width, problem.reference.dt)


def with_lag(
    problem: Problem, ideal: SlippingRobot, source: SourceType
) -> SourceType | LaggingRobot:
    """Return a robot with lag and delay of its wheels, `source` drawing its slips; that itself
    where wheels obey at once."""
    actuation = find_actuation(problem.scenario)
    if actuation.is_ideal:
        return source
    dt = problem.reference.dt
    forecast = Forecast.of(*actuation.nominal(dt), problem.robot.track_width, dt)
    body = LaggingBody.of(ideal, forecast, actuation.lag, actuation.delay)
    return LaggingRobot(body, source)


def bare_robot(problem: Problem, process: str | SlipProcess | None = None) -> SlippingRobot:
    """Return the nonlinear plant of a problem, whose wheels obey at once and whose measured errors
    nobody filters."""
    steps = problem.reference.steps
    return make_robot(
        problem, process, problem.schedule[:steps], problem.reference.poses[: steps + 1]
    )


def make_robot(
    problem: Problem,
    process: str | SlipProcess | None,
    reference_wheels: Float[np.ndarray, "steps 2"],
    reference_poses: Float[np.ndarray, "steps+1 3"],
) -> SlippingRobot:
    """Return the nonlinear plant of a problem along a reference of its own."""
    slip = problem.scenario.slip
    noise = error_vector(problem.scenario.noise)
    slides = slip.sideslip > 0 or problem.robot.lever_arm != 0
    chosen = slip.process if process is None else process
    return SlippingRobot(
        robot=problem.robot,
        dt=problem.reference.dt,
        reference_wheels=jnp.asarray(reference_wheels),
        reference_poses=jnp.asarray(reference_poses),
        slips=jax.tree.map(jnp.asarray, slip_bounds(slip)),
        noise=jnp.asarray(noise) if noise.any() else None,
        sideslip=slip.sideslip if slides else None,
        process=make_recorded(problem.scenario) if chosen == "recorded" else chosen,
        noise_frame=problem.scenario.noise.frame,
        slip_steps=slip_steps(slip, problem.reference.dt),
    )


def exact_robot(design: Design) -> BareRobot:
    """Return the nonlinear plant whose slips, lag and delay are the nominal ones and known, whose
    pose is measured without noise, and whose body does not slip sideways: an estimate of its errors
    is exact."""
    problem = design.problem
    plant = bare_robot(problem)
    sideslip = None if plant.sideslip is None else 0.0
    slips = plant.slips.without_errors()
    exact = dataclasses.replace(plant, slips=slips, noise=None, sideslip=sideslip)
    robot = with_lag(problem, exact, exact)
    return robot.with_nominal_times() if isinstance(robot, LaggingRobot) else robot


def linear_plant(design: TubeDesign) -> LinearPlant:
    """Return the prediction model along the reference with w drawn in W."""
    return _make_linear_plant(design.problem)


def _make_linear_plant(problem: ControlProblem) -> LinearPlant:
    schedule = problem.schedule[: problem.reference.steps]
    transitions, inputs = problem.model.matrices(schedule)
    return LinearPlant(
        reference_wheels=jnp.asarray(schedule),
        transitions=jnp.asarray(transitions),
        input_matrices=jnp.asarray(inputs),
        disturbance_vertices=jnp.asarray(_find_disturbance_vertices(problem)),
    )


def _find_disturbance_vertices(
    problem: ControlProblem,
) -> Float[np.ndarray, "v n"] | Float[np.ndarray, "steps v n"]:
    """Return the vertices of W, of several regimes those of every step; the last vertex fills up
    the sets that have fewer."""
    if not problem.regimes:
        return problem.disturbance_set.vertices()
    by_regime = [one.vertices() for one in problem.disturbances.sets]
    most = max(map(len, by_regime))
    padded = [np.pad(each, ((0, most - len(each)), (0, 0)), "edge") for each in by_regime]
    return np.stack(padded)[problem.period_regimes[: problem.reference.steps]]
