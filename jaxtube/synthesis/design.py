"""Design: from a scenario to gains, tubes, terminal set, condensed controllers and their
certificate.

Everything here is offline, numpy float64; the windows of a `Design` are pytrees for the device.
"""

from __future__ import annotations

import time
from dataclasses import replace

import numpy as np
from jaxtyping import Float

from jaxtube.scenario.refusal import ScenarioError
from jaxtube.scenario.tree import Scenario, require_scenario
from jaxtube.synthesis import condense
from jaxtube.synthesis.advice import say_what_helps
from jaxtube.synthesis.certificate.certify import certify
from jaxtube.synthesis.disturbance import complete_problem
from jaxtube.synthesis.feasible import noise_corners, reach_of_ray, shortfall
from jaxtube.synthesis.gains import compensating_gain
from jaxtube.synthesis.parts import Condensed, Design
from jaxtube.synthesis.problem import Problem
from jaxtube.synthesis.terminal import make_terminal, terminal_cost_and_gain
from jaxtube.synthesis.tightening import EmptySetError, refuse_empty, tighten
from jaxtube.synthesis.tubes import make_tubes
from jaxtube.synthesis.windows import make_windows

__all__ = [
    "Design",
    "EmptySetError",
    "design",
    "finish",
    "prepare",
    "refuse_infeasible_start",
]

SHORT = 1e-9
"""What the rows may lack before a start has no plan: the accuracy of the linear programs."""


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


def design(scenario: Scenario) -> Design:
    """Compute sets, gains, terminal ingredients, condensed controllers and certificate.

    Raises:
        ScenarioError: for data no controller can be built from, in one line.
        EmptySetError: where a tightened set E_j or U_j is empty.
    """
    require_scenario(scenario)
    if scenario.operating.bands:
        raise ScenarioError(
            "scenario: operating.bands: only the command `design` knows gains and caps by speed; "
            "leave them out"
        )
    clock = Clock()
    problem = complete_problem(scenario)
    clock.lap("problem")
    return finish(prepare(problem, clock), clock)


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
    tightening = tighten(problem, tube, len(windows.schedules))
    refuse_empty(problem, tightening)
    clock.lap("tubes")
    terminal = make_terminal(problem, tube, terminal_gain, tightening)
    clock.lap("terminal_set")
    bounds = condense.tube_bounds(problem, tightening, terminal)
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


def refuse_infeasible_start(design: Design, error: Float[np.ndarray, "3"] | None = None) -> None:
    """Raise ScenarioError where what may be measured of a start leaves the caps, or has no plan.

    The start's true error is the scenario's, or the one given; the feasible set is convex, so the
    corners of the noise around it decide.
    """
    problem = design.problem
    error = problem.initial_error if error is None else error
    measured = error + noise_corners(problem)
    limits = problem.operating_set
    widest = float(np.max(measured @ limits.normals.T / limits.offsets))
    index = design.first_window
    missing = max(shortfall(design.tube_qps, index, corner) for corner in measured)
    if widest <= 1 and missing <= SHORT:
        return
    section = problem.scenario.initial
    start = f"scenario: initial = ({section.x_m} m, {section.y_m} m, {section.heading_deg} deg)"
    cure = _say_how_near(design, error)
    if widest > 1:
        raise ScenarioError(
            f"{start}: the error of the start lies outside [constraints] or [operating], "
            f"{widest:.3g} times as far as it may; {cure}"
        )
    raise ScenarioError(
        f"{start}: lies outside the feasible set of the tube-MPC (constraints short by "
        f"{missing:.3g}); {cure}; lengthen controller.horizon, or {say_what_helps(problem)}"
    )


def _say_how_near(design: Design, error: Float[np.ndarray, "3"]) -> str:
    """Return what share of an error both the caps and the feasible set leave, in words."""
    problem = design.problem
    limits = problem.operating_set
    share = 1.0
    for noise in noise_corners(problem):
        reach = reach_of_ray(design.tube_qps, design.first_window, error, noise)
        rows = limits.normals @ error
        room = limits.offsets - limits.normals @ noise
        capped = np.min(room[rows > 0] / rows[rows > 0], initial=np.inf)
        share = min(share, reach, float(capped))
    percent = int(np.floor(100 * max(share, 0.0)))
    if percent == 0:
        return "no start in this direction has a plan"
    return f"start at most {percent}% as far away"
