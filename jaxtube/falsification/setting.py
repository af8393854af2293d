"""What `falsify` searches: the closed loop of a design, its limits, and the starts.

Tubes are judged at plans that restart at the measured error, for which their growing sections are
meant.
"""

from __future__ import annotations

import dataclasses
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from jaxtube.control.laws import TubeMpc
from jaxtube.control.protocol import Controller
from jaxtube.falsification import climb as attack
from jaxtube.plant.protocol import SearchablePlant
from jaxtube.scenario import Scenario, ScenarioError
from jaxtube.simulation import closed_loop, usage
from jaxtube.simulation.rollout import realisation_keys
from jaxtube.simulation.starts import uniform_start
from jaxtube.simulation.usage import Limit, Limits
from jaxtube.synthesis.design import Design, design, refuse_infeasible_start
from jaxtube.synthesis.feasible import true_starts
from sets.polytope import hull_vertices

INSIDE = 0.999
"""Share of the feasible set that starts may take: its very edge is a matter of rounding."""

POOL = 4096
"""Starts that drawn laps choose from."""


class Setting(NamedTuple):
    """A closed loop and what is searched of it."""

    found: Design
    controller_name: str
    controller: Controller
    planner: TubeMpc | None  # the same, its plans restarted: those that are followed
    plant: SearchablePlant
    lap_limits: Limits
    tube_limits: Limits
    windows: Int[np.ndarray, " windows"]
    starts: Float[np.ndarray, "k 3"]

    def limits(self, name: str) -> Limits:
        """Return the limits that are judged together with one."""
        return self.tube_limits if name == "tube" else self.lap_limits

    def loop(self, name: str) -> Controller:
        """Return the controller on which one limit is searched."""
        if name != "tube":
            return self.controller
        assert self.planner is not None
        return self.planner


def make_setting(
    scenario: Scenario, controller: str, plant: str, starts: str, seed: int
) -> Setting:
    """Design a scenario and set up what is searched.

    Raises:
        ScenarioError: for a start without a plan, or a slip process that is not searched.
    """
    found = design(scenario)
    if starts == "scenario":
        refuse_infeasible_start(found)
    loop = closed_loop.controllers(found)[controller]
    acting = (
        closed_loop.linear_plant(found) if plant == "linear" else closed_loop.slipping_robot(found)
    )
    vertices = (
        found.problem.initial_error[None]
        if starts == "scenario"
        else feasible_vertices(found, seed)
    )
    try:
        attack.find_uncertainties(acting, vertices)
    except ValueError as error:
        raise ScenarioError(f"scenario: {error}") from None
    limits, tube, windows = lap_limits(found), {}, np.zeros(1, int)
    if plant == "linear":
        del limits["wheels"]
    planner = None
    if isinstance(loop, TubeMpc):
        planner = dataclasses.replace(loop, restart=True)
        tube, windows = {"tube": tube_limit(found)}, followed_windows(found)
        if not len(windows):
            steps, horizon = found.problem.reference.steps, found.problem.horizon
            raise ScenarioError(
                f"scenario: reference.duration_s = {scenario.reference.duration_s}: {steps} steps are fewer than "
                f"controller.horizon = {horizon}, so that no plan can be followed; run for longer"
            )
    return Setting(found, controller, loop, planner, acting, limits, tube, windows, vertices)


def feasible_vertices(found: Design, seed: int) -> Float[np.ndarray, "k 3"]:
    """Return the vertices of a polytope of starts from which the tube-MPC has a plan."""
    points = true_starts(found.tube_window, int(found.windows.index[0]), found.problem, seed=seed)
    return INSIDE * hull_vertices(points)


def lap_limits(found: Design) -> Limits:
    """Return E, U and the wheels' limits."""
    problem, robot = found.problem, found.problem.robot
    identity, middle = np.eye(2), (robot.wheel_speed_min + robot.wheel_speed_max) / 2
    speeds = [robot.wheel_speed_max] * 2 + [-robot.wheel_speed_min] * 2
    return {
        "error": usage.limit(problem.error_set.normals, problem.error_set.offsets),
        "input": usage.limit(problem.input_set.normals, problem.input_set.offsets),
        "wheels": usage.limit(np.vstack([identity, -identity]), speeds, [middle] * 2),
    }


def tube_limit(found: Design) -> Limit:
    """Return R_1 .. R_N of the tube in use; of `sequence` those of the widest window."""
    sections = [section.polytope() for section in found.tube[1:]]
    return usage.tube_limit([(section.normals, section.offsets) for section in sections])


def drawn_starts(setting: Setting, seed: int) -> Float[np.ndarray, "count 3"]:
    """Return the pool that drawn laps start from: the one start, or starts uniform in the hull that
    is searched."""
    if len(setting.starts) == 1:
        return setting.starts
    return np.asarray(uniform_start(setting.starts).draw(realisation_keys(seed, 0, POOL)))


def followed_windows(found: Design) -> np.ndarray:
    """Return the steps at which a plan may begin that is judged: of the tube `sequence` those of
    its widest window."""
    steps = np.arange(found.problem.reference.steps - found.problem.horizon + 1)
    return steps[found.tube.shows(found.windows.index[steps])]
