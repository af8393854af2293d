"""What `falsify` searches: the closed loop of a design, its limits, and the starts.

Tubes are judged at plans that restart at the measured error, for which their growing sections are
meant.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Generic, NamedTuple, TypeVar, cast

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int

from jaxtube.control.laws import TubeMpc, planner_of
from jaxtube.control.protocol import Controller
from jaxtube.falsification.worst import Worst
from jaxtube.plant.protocol import Plant, SearchablePlant
from jaxtube.scenario.refusal import ScenarioError
from jaxtube.simulation import components
from jaxtube.simulation.choices import (
    ControllerChoice,
    PlantChoice,
    SlipChoice,
    choose_controller,
    choose_plant,
    name_choice,
)
from jaxtube.simulation.promise import limit_true_errors
from jaxtube.simulation.rollout import realisation_keys
from jaxtube.simulation.starts import uniform_start
from jaxtube.simulation.usage import (
    JudgedLoop,
    Limit,
    Limits,
    Replay,
    make_limit,
    make_tube_limit,
    replay,
)
from jaxtube.synthesis.design import refuse_infeasible_start
from jaxtube.synthesis.feasible import true_starts
from jaxtube.synthesis.limits import InputRows, find_command_step
from jaxtube.synthesis.parts import Design, TubeDesign
from jaxtube.synthesis.problem import Problem
from sets.polytope import hull_vertices

INSIDE = 0.999
"""Share of the feasible set that starts may take: its very edge is a matter of rounding."""

POOL = 4096
"""Starts that drawn laps choose from."""

TARGETS = {"error": ("error",), "input": ("input", "wheels", "acceleration"), "tube": ("tube",)}
"""The limits of each target."""


DesignType = TypeVar("DesignType", bound=TubeDesign)


class LoopLimits(NamedTuple, Generic[DesignType]):
    """The limits of a closed loop, and whose they are.

    Attributes:
        design: gives the limits.
        controller: its name, "own" for a user's.
        plant: its name, "own" for a user's.
        of_laps: E, U with its coupling to the error and, of a plant with wheels, their speeds and
            where these have a limit their changes.
        of_plans: R_1 .. R_N; empty for a controller that keeps no tube.
    """

    design: DesignType
    controller: str
    plant: str
    of_laps: Limits
    of_plans: Limits

    @property
    def all(self) -> Limits:
        """All limits by name."""
        return self.of_laps | self.of_plans

    def judged_with(self, name: str) -> Limits:
        """Return the limits that are judged together with one."""
        return self.of_plans if name in self.of_plans else self.of_laps

    def choose_names(self, target: str) -> list[str]:
        """Return the limits of a target that the closed loop has, in the order of the table.

        Raises:
            ValueError: for an unknown target, or the tube of a controller that keeps none.
        """
        choices = ["all", *TARGETS]
        if target not in choices:
            raise ValueError(f"target = {target!r}: is unknown; choose one of {choices}")
        if target == "tube" and not self.of_plans:
            raise ValueError(
                f'target = "tube": controller = {self.controller} keeps no tube; choose '
                '"tube_mpc", or another target'
            )
        groups = TARGETS.values() if target == "all" else [TARGETS[target]]
        return [name for group in groups for name in group if name in self.all]


class Setting(NamedTuple):
    """A closed loop and what is searched of it.

    Attributes:
        limits: that are searched.
        controller: that acts.
        planner: whose plans are followed, restarted at the measured error; None without a tube.
        plant: whose draws give way to the attack.
        plan_steps: at which a followed plan may begin.
        starts: vertices of the polytope of initial errors, (m, m, rad).
    """

    limits: LoopLimits
    controller: Controller
    planner: TubeMpc | None
    plant: SearchablePlant
    plan_steps: Int[np.ndarray, " k"]
    starts: Float[np.ndarray, "k 3"]

    def loop(self, name: str) -> JudgedLoop:
        """Return the closed loop on which one limit is searched, with those judged beside it."""
        controller = self.planner if name == "tube" else self.controller
        assert controller is not None
        return JudgedLoop(controller, self.plant, self.limits.judged_with(name), self.plan_steps)

    def replay(self, worst: Worst) -> Replay:
        """Play a worst case once more on its own."""
        loop = self.loop(worst.limit)
        return replay(loop.controller, loop.plant, worst.attack, worst.limit, worst.when)


def make_setting(
    design: Design,
    controller: ControllerChoice = "tube_mpc",
    plant: PlantChoice = "robot",
    starts: str = "scenario",
    slip: SlipChoice = None,
    seed: int = 0,
) -> Setting:
    """Set up what is searched.

    Args:
        design: whose limits are searched.
        controller, plant, slip: as for `simulate`; the plant says what bounds its draws.
        starts: "scenario", or "feasible", anywhere in the feasible set of the tube-MPC.
        seed: of the shape of the feasible set.

    Raises:
        ValueError: one line, for an unknown name, a slip process or a plant that is not searched.
        ScenarioError: for a start without a plan, or a reference too short for one.
    """
    if starts == "scenario" and isinstance(controller, str):
        refuse_infeasible_start(design)
    acting_controller = choose_controller(design, controller)
    acting_plant = require_searchable(choose_plant(design, plant, slip))
    try:
        acting_plant.uncertainties()
    except ValueError as error:
        is_of_scenario = slip is None and isinstance(plant, str)
        raise ScenarioError(f"scenario: {error}" if is_of_scenario else str(error)) from None
    planner = choose_planner(design, controller, acting_controller)
    names = ["error", "input"]
    if acting_plant.has_wheels:
        names += ["wheels", "acceleration"]
    if planner is not None:
        names.append("tube")
    return Setting(
        limits=make_loop_limits(design, name_choice(controller), name_choice(plant), names),
        controller=acting_controller,
        planner=planner,
        plant=acting_plant,
        plan_steps=find_plan_steps(design) if planner else np.zeros(1, int),
        starts=choose_start_vertices(design, starts, seed),
    )


def require_searchable(plant: Plant) -> SearchablePlant:
    """Return a plant whose draws can give way to an attack.

    Raises:
        ValueError: for a plant that does not say what bounds them.
    """
    members = ("has_wheels", "uncertainties", "under_script")
    missing = [member for member in members if not hasattr(plant, member)]
    if missing:
        raise ValueError(
            f"plant = {type(plant).__name__}: has no {', '.join(missing)}, which a search needs; "
            "add what jaxtube.plant.protocol.SearchablePlant asks, or choose "
            '"robot", "exact" or "linear"'
        )
    return cast(SearchablePlant, plant)


def choose_planner(
    design: Design, controller: ControllerChoice, acting_controller: Controller
) -> TubeMpc | None:
    """Return the tube-MPC whose plans the tube is judged at, restarted at the measured error; None
    for a controller that keeps no tube."""
    if not isinstance(controller, str):
        return planner_of(acting_controller)
    if controller != "tube_mpc":
        return None
    return dataclasses.replace(components.make_tube_mpc(design), restart=True)


def choose_start_vertices(design: TubeDesign, starts: str, seed: int) -> Float[np.ndarray, "k 3"]:
    """Return the vertices of the polytope of starts of a name.

    Raises:
        ValueError: for an unknown name, or where no start has a plan.
    """
    if starts == "scenario":
        return design.problem.initial_error[None]
    if starts == "feasible":
        return find_feasible_vertices(design, seed)
    raise ValueError(f'starts = {starts!r}: is unknown; choose "scenario" or "feasible"')


def find_feasible_vertices(design: TubeDesign, seed: int) -> Float[np.ndarray, "k 3"]:
    """Return the vertices of a polytope of starts from which the tube-MPC has a plan."""
    points = true_starts(design.tube_qps, design.first_window, design.problem, seed=seed)
    return INSIDE * hull_vertices(points)


def make_loop_limits(
    design: Design, controller: str, plant: str, names: Sequence[str]
) -> LoopLimits:
    """Return those limits of a design that a closed loop has, by their names."""
    judged = limit_true_errors(design, plant)
    of_laps = {name: limit for name, limit in make_lap_limits(judged).items() if name in names}
    of_plans = {"tube": make_tube_limits(design)} if "tube" in names else {}
    return LoopLimits(design, controller, plant, of_laps, of_plans)


def make_lap_limits(design: Design) -> Limits:
    """Return E, U with its coupling to the error, and the wheels' limits."""
    problem = design.problem
    robot = problem.robot
    identity = np.eye(2)
    speeds = [robot.wheel_speed_max] * 2 + [-robot.wheel_speed_min] * 2
    middle = [robot.wheel_speed_middle] * 2
    limits = {
        "error": make_limit(problem.error_set.normals, problem.error_set.offsets),
        "input": _limit_inputs(problem),
        "wheels": make_limit(np.vstack([identity, -identity]), speeds, middle),
    }
    step = find_command_step(problem.scenario)
    if step is not None:
        limits["acceleration"] = make_limit(np.vstack([identity, -identity]), [step] * 4)
    return limits


def _limit_inputs(problem: Problem) -> Limit:
    """Return the limit on inputs; of several regimes that of every step."""
    by_regime = [make_input_limit(regime.cap_rows) for regime in problem.every_regime]
    if len(by_regime) == 1:
        return by_regime[0]
    regimes = problem.period_regimes[: problem.reference.steps]
    normals = jnp.concatenate([limit.normals for limit in by_regime])
    offsets = jnp.concatenate([limit.offsets for limit in by_regime])
    return Limit(normals[regimes], offsets[regimes], by_regime[0].centre)


def make_input_limit(rows: InputRows) -> Limit:
    """Return the limit on (u, measured error): the rows as they are, those of the coupling in
    rad/s."""
    normals = np.concatenate([rows.inputs, rows.errors], axis=1)
    scale = np.where(rows.is_coupled, np.linalg.norm(rows.inputs, axis=1), 1.0)
    return make_limit(normals / scale[:, None], rows.offsets / scale)


def make_tube_limits(design: TubeDesign) -> Limit:
    """Return R_1 .. R_N of the tube in use; of `sequence` those of the widest window."""
    sections = [section.polytope() for section in design.tube[1:]]
    return make_tube_limit([(section.normals, section.offsets) for section in sections])


def find_plan_steps(design: Design) -> Int[np.ndarray, " k"]:
    """Return the steps at which a plan may begin that is judged: of the tube `sequence` those with
    the widest window ahead.

    Raises:
        ScenarioError: where there are none: the reference is shorter than a plan.
    """
    problem = design.problem
    steps = problem.reference.steps
    if steps < problem.horizon:
        raise ScenarioError(_say_too_short(design))
    starts = np.arange(steps - problem.horizon + 1)
    return starts[design.tube.shows(design.windows.index[starts])]


def _say_too_short(design: Design) -> str:
    steps = design.problem.reference.steps
    horizon = design.problem.horizon
    duration = design.problem.scenario.reference.duration_s
    if duration is None:
        what = f"reference.file: the {steps} steps of the recording"
        cure = "drive for longer"
    else:
        what = f"reference.duration_s = {duration}: {steps} steps"
        cure = "run for longer"
    return (
        f"scenario: {what} are fewer than controller.horizon = {horizon}, so that no plan can be "
        f"followed; {cure}, or shorten the horizon"
    )


def draw_starts(setting: Setting, seed: int) -> Float[np.ndarray, "count 3"]:
    """Return the pool that drawn laps start from: the one start, or starts uniform in the hull that
    is searched."""
    if len(setting.starts) == 1:
        return setting.starts
    return np.asarray(uniform_start(setting.starts).draw(realisation_keys(seed, 0, POOL)))
