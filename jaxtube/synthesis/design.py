"""Design: from a scenario to gains, tubes, terminal set, condensed controllers and their
certificate.

Everything here is offline, numpy float64; the windows of a `Design` are pytrees for the device.
"""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import replace
from typing import overload

import numpy as np
from jaxtyping import Float

from jaxtube.coordinates import ERROR_NAMES
from jaxtube.scenario.refusal import ScenarioError
from jaxtube.scenario.tree import Scenario, require_scenario
from jaxtube.storage import refuse_differences
from jaxtube.synthesis import condense
from jaxtube.synthesis.advice import say_what_helps
from jaxtube.synthesis.certificate.certify import certify
from jaxtube.synthesis.disturbance import complete_problem
from jaxtube.synthesis.feasible import noise_corners, reach_of_ray, shortfall
from jaxtube.synthesis.gains import compensating_gain
from jaxtube.synthesis.linear_design import design_linear
from jaxtube.synthesis.parts import Condensed, Design, LinearDesign
from jaxtube.synthesis.problem import Problem
from jaxtube.synthesis.terminal import make_terminal
from jaxtube.synthesis.terminal_cost import terminal_cost_and_gain
from jaxtube.synthesis.tightening import EmptySetError, refuse_empty, tighten
from jaxtube.synthesis.tubes import make_tubes
from jaxtube.synthesis.windows import make_windows
from jaxtube.systems.system import LinearSystem
from sets.certificate import ROUNDING

__all__ = [
    "Design",
    "EmptySetError",
    "design",
    "finish",
    "prepare",
    "refuse_infeasible_start",
    "refuse_start_outside_limits",
    "restore_design",
]

SHORT = 1e-9
"""What the rows may lack before a start has no plan: the accuracy of the linear programs."""
PERCENT = 0.01
"""The step in which shares of a refused start are told."""
NO_START = "no start in this direction has a plan"
PRINTED = 0.01
"""What rounding to four digits may add to a whole percentage."""


class Clock:
    """Seconds by part."""

    def __init__(self):
        self.seconds = {}
        self._last = time.perf_counter()

    def lap(self, part: str) -> None:
        """Book the time since the last call under `part`."""
        now = time.perf_counter()
        self.seconds[part] = now - self._last
        self._last = now


@overload
def design(scenario: Scenario) -> Design: ...


@overload
def design(scenario: LinearSystem) -> LinearDesign: ...


def design(scenario: Scenario | LinearSystem) -> Design | LinearDesign:
    """Compute sets, gains, terminal ingredients, condensed controllers and certificate.

    Args:
        scenario: a robot's, or a linear system of your own.

    Raises:
        ScenarioError: for data no controller can be built from, in one line.
        EmptySetError: where a tightened set E_j or U_j is empty.
    """
    if isinstance(scenario, LinearSystem):
        return design_linear(scenario)
    clock = Clock()
    return finish(_begin(scenario, clock), clock)


def restore_design(scenario: Scenario, arrays: Mapping[str, np.ndarray]) -> Design:
    """Return the design of a scenario with the `Design.arrays` that it once had, to the bit, and
    certify it anew on them; raises as `design`.

    It takes about as long as to design the scenario: what is no part of the arrays, sets and
    proofs, is computed again.

    Raises:
        ScenarioError: also where the scenario now gives other arrays, beyond rounding.
    """
    clock = Clock()
    made = _begin(scenario, clock)
    refuse_differences(arrays, made.arrays())
    return finish(made.with_arrays(arrays), clock)


def _begin(scenario: Scenario, clock: Clock) -> Design:
    """Compute all of a design but the certificate."""
    require_scenario(scenario)
    problem = complete_problem(scenario)
    clock.lap("problem")
    return prepare(problem, clock)


def prepare(problem: Problem, clock: Clock | None = None) -> Design:
    """Compute gains, tubes and terminal ingredients of a problem whose disturbance set is known,
    without a certificate; raises as `design`."""
    settings = problem.scenario.controller
    clock = clock or Clock()
    try:
        cost, terminal_gain = terminal_cost_and_gain(problem)
        local_gain = compensating_gain(problem)
    except (RuntimeError, ValueError) as error:
        raise ScenarioError(f"scenario: controller: {error}") from None
    clock.lap("lmi")
    tube_gain = terminal_gain if settings.tube_has_terminal_gain else local_gain
    windows = make_windows(problem, tube_gain)
    tubes = make_tubes(problem, tube_gain, windows)
    if settings.tube not in tubes:
        raise ScenarioError(
            f"scenario: controller.tube = {settings.tube}: eq. (27) needs loops affine in the "
            'schedule; choose "hull", "summed" or "sequence", or discretisation = "euler" with '
            "another terminal"
        )
    tube = tubes[settings.tube]
    tightening = tighten(problem, tube, windows)
    refuse_empty(problem, tightening, windows)
    clock.lap("tubes")
    terminal = make_terminal(problem, tube, terminal_gain, tightening)
    clock.lap("terminal_set")
    bounds = condense.tube_bounds(problem, windows, tightening, terminal)
    return Design(
        problem=problem,
        lqr_gain=local_gain.nominal,
        tube_gain=tube_gain,
        cost=cost,
        windows=windows,
        tubes=tubes,
        tightening=tightening,
        terminal=terminal,
        bounds=bounds,
        condensed=Condensed(problem, windows, terminal, cost.cost, bounds),
    )


def finish(prepared: Design, clock: Clock | None = None) -> Design:
    """Condense the controllers of a prepared design and certify it."""
    clock = clock or Clock()
    _ = prepared.tube_qps  # condensed here, so that its time is booked as such
    clock.lap("condensing")
    certificate = certify(prepared)
    clock.lap("certificate")
    return replace(prepared, certificate=certificate, seconds=clock.seconds)


def refuse_start_outside_limits(problem: Problem) -> None:
    """Raise ScenarioError where what may be measured of the scenario's start leaves the caps.

    This needs no design, so it is known before one is computed.
    """
    error = problem.initial_error
    used = _use_of_caps(problem, error)
    if np.max(used) > 1:
        share = _share_within_caps(problem, error)
        raise ScenarioError(f"{_say_what_leaves(error, used)}; {_say_how_near(error, share)}")


def refuse_infeasible_start(design: Design, error: Float[np.ndarray, "3"] | None = None) -> None:
    """Raise ScenarioError where what may be measured of a start leaves the caps, or has no plan.

    The start's true error is the scenario's, or the one given; the feasible set is convex, so the
    corners of the noise around it decide.
    """
    problem = design.problem
    error = problem.initial_error if error is None else error
    used = _use_of_caps(problem, error)
    missing = _find_missing(design, error)
    if np.max(used) <= 1 and missing <= SHORT:
        _refuse_quick_start(problem, error)
        return
    share = _share_with_plan(design, error)
    cure = _say_how_near(error, share)
    if np.max(used) > 1:
        raise ScenarioError(f"{_say_what_leaves(error, used)}; {cure}")
    others = "or lengthen controller.horizon"
    if cure == NO_START:
        others = f"lengthen controller.horizon, or {say_what_helps(problem)}"
    raise ScenarioError(
        f"scenario: {_say_pose(error)}: the start lies outside the feasible set of the tube-MPC "
        f"(constraints short by {missing:.3g}); {cure}; {others}"
    )


def _refuse_quick_start(problem: Problem, error: Float[np.ndarray, "3"]) -> None:
    """Refuse a start of wheels that lag whose first command may pass their acceleration."""
    first = problem.first_command
    if first is None or problem.scenario.robot.obeys_at_once:
        return
    noise = noise_corners(problem)
    if np.max(first.use(error + noise)) <= 1:
        return
    limit = problem.scenario.robot.wheel_acceleration_max_mps2
    # The bound is convex along the way to the start, the noise being the same.
    at_origin = np.max(first.use(noise))
    share = (1 - at_origin) / (np.max(first.use(error + noise)) - at_origin)
    raise ScenarioError(
        f"scenario: {_say_pose(error)}: the first command may change by more than "
        f"robot.wheel_acceleration_max_mps2 = {limit:g} "
        f"allows; {_say_how_near(error, share)}"
    )


def find_share_of_start(design: Design) -> float:
    """Return the largest share of the scenario's start, at most 1, that lies within the caps and
    has a plan."""
    error = design.problem.initial_error
    used = _use_of_caps(design.problem, error)
    if np.max(used) <= 1 and _find_missing(design, error) <= SHORT:
        return 1.0
    return _share_with_plan(design, error)


def _find_missing(design: Design, error: Float[np.ndarray, "3"]) -> float:
    """Return by how much constraints are short for what may be measured of a start, at worst."""
    corners = error + noise_corners(design.problem)
    index = design.first_window
    return max(shortfall(design.tube_qps, index, corner) for corner in corners)


def _use_of_caps(problem: Problem, error: Float[np.ndarray, "3"]) -> Float[np.ndarray, "3"]:
    """Return what share of each cap the largest error that may be measured of a start uses."""
    caps = problem.operating_set.support(np.eye(3))
    return (np.abs(error) + problem.noise) / caps


def _share_within_caps(problem: Problem, error: Float[np.ndarray, "3"]) -> float:
    """Return the largest share of an error, at most 1, that stays within the caps."""
    room = problem.operating_set.support(np.eye(3)) - problem.noise
    sizes = np.abs(error)
    moved = sizes > 0
    return float(np.min(room[moved] / sizes[moved], initial=1.0))


def _share_with_plan(design: Design, error: Float[np.ndarray, "3"]) -> float:
    """Return the largest share of an error, at most 1, within the caps and with a plan."""
    reaches = [
        reach_of_ray(design.tube_qps, design.first_window, error, noise)
        for noise in noise_corners(design.problem)
    ]
    return min(_share_within_caps(design.problem, error), *reaches)


def _say_what_leaves(error: Float[np.ndarray, "3"], used: Float[np.ndarray, "3"]) -> str:
    worst = int(np.argmax(used))
    return (
        f"scenario: {_say_pose(error)}: the {ERROR_NAMES[worst]} of the start lies outside "
        f"[constraints] or [operating], {used[worst]:.3g} times as far as it may"
    )


def _say_how_near(error: Float[np.ndarray, "3"], share: float) -> str:
    """Return the start at a whole percentage of an error, in words."""
    percent = int(np.floor(share / PERCENT - PRINTED))
    if percent <= 0:
        return NO_START
    return f"start at most {percent}% as far away: {_say_pose(PERCENT * percent * error)}"


def _say_pose(error: Float[np.ndarray, "3"]) -> str:
    """Return the keys of the start that has an error: eq. (3) solved for the pose."""
    cosine = np.cos(error[2])
    sine = np.sin(error[2])
    # The robot heads e_th to the right of the reference, which is at the origin.
    x = -(cosine * error[0] + sine * error[1])
    y = -(cosine * error[1] - sine * error[0])
    heading = -np.rad2deg(error[2])
    keys = {"x_m": x, "y_m": y, "heading_deg": heading}
    return ", ".join(f"initial.{key} = {_shorten(value)}" for key, value in keys.items())


def _shorten(value: float) -> str:
    """Return a number of four significant digits; what rounding left of 0 is 0."""
    return f"{value:.4g}" if abs(value) > ROUNDING else "0"
