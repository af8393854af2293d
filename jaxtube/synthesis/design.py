"""Design: from a scenario to gains, tubes, terminal set, condensed controllers and their
certificate.

The only package of jaxtube that uses `sets`. Everything here is offline, numpy float64; `tube_mpc`,
`plain_mpc` and the other controllers it returns are pytrees for the device.
"""

from __future__ import annotations

import time
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float

from jaxtube.control.mpc import Window
from jaxtube.scenario import Scenario, ScenarioError
from jaxtube.synthesis import condense
from jaxtube.synthesis.certificate.certify import certify
from jaxtube.synthesis.condense import Bounds
from jaxtube.synthesis.disturbance import complete_problem
from jaxtube.synthesis.feasible import reach_of_ray, shortfall
from jaxtube.synthesis.problem import Problem
from jaxtube.synthesis.terminal import Terminal, make_terminal, terminal_cost_and_gain
from jaxtube.synthesis.tightening import (
    EmptySetError,
    LocalGain,
    Tightening,
    Windows,
    compensating_gain,
    make_tubes,
    make_windows,
    refuse_empty,
    tighten,
)
from sets.certificate import Certificate
from sets.lmi import TerminalCost
from sets.tubes import Section

__all__ = [
    "Design",
    "EmptySetError",
    "Ingredients",
    "design",
    "finish",
    "prepare",
    "refuse_infeasible_start",
]


@dataclass(frozen=True, eq=False)
class Ingredients:
    """Gains, costs and sets of one problem: a design without its controllers and its certificate."""

    problem: Problem
    lqr_gain: Float[np.ndarray, "2 3"]  # K^n at the centre of the box
    tube_gain: LocalGain
    cost: TerminalCost
    windows: Windows
    tubes: dict[str, list[Section]]
    tightening: Tightening
    terminal: Terminal
    bounds: Bounds


@dataclass(frozen=True, eq=False)
class Design(Ingredients):
    """Everything computed offline for one scenario."""

    tube_window: Window
    plain_window: Window
    certificate: Certificate
    seconds: dict[str, float] = field(default_factory=dict)


class Clock:
    """Seconds by part."""

    def __init__(self):
        self.seconds, self._last = {}, time.perf_counter()

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
    if scenario.operating.bands:
        raise ScenarioError(
            "scenario: operating.bands: only the command `design` knows gains and caps by speed; leave them out"
        )
    clock = Clock()
    problem = complete_problem(scenario)
    clock.lap("problem")
    return finish(prepare(problem, clock), clock)


def prepare(problem: Problem, clock: Clock | None = None) -> Ingredients:
    """Compute gains, tubes and terminal ingredients of a problem whose disturbance set is known;
    raises as `design`."""
    settings, clock = problem.scenario.controller, clock or Clock()
    try:
        cost, terminal_gain = terminal_cost_and_gain(problem)
    except (RuntimeError, ValueError) as error:
        raise ScenarioError(f"scenario: controller: {error}") from None
    clock.lap("lmi")
    local_gain = compensating_gain(problem)
    tube_gain = terminal_gain if settings.terminal == "T-A" else local_gain
    windows = make_windows(problem, tube_gain)
    sections = make_tubes(problem, tube_gain, windows)
    if settings.tube not in sections:
        raise ScenarioError(
            f"scenario: controller.tube = {settings.tube}: eq. (27) needs loops affine in the schedule; "
            'choose "hull", "summed" or "sequence", or discretisation = "euler" with another terminal'
        )
    tightening = tighten(problem, tube_gain, windows, sections[settings.tube], settings.tube)
    refuse_empty(problem, tightening)
    clock.lap("tubes")
    terminal = make_terminal(problem, tube_gain, terminal_gain, windows, tightening)
    clock.lap("terminal_set")
    bounds = condense.tube_bounds(problem, tightening, terminal)
    return Ingredients(
        problem,
        local_gain.nominal,
        tube_gain,
        cost,
        windows,
        sections,
        tightening,
        terminal,
        bounds,
    )


def finish(found: Ingredients, clock: Clock | None = None) -> Design:
    """Condense the controllers of prepared ingredients and certify them."""
    clock, problem, windows, terminal = (
        clock or Clock(),
        found.problem,
        found.windows,
        found.terminal,
    )
    P, untightened = found.cost.cost, condense.plain_bounds(problem, windows, terminal)
    tube_window = condense.condense(problem, windows, terminal, P, found.bounds)
    plain_window = condense.condense(problem, windows, terminal, P, untightened)
    clock.lap("condensing")
    residual = condense.residual_bound(problem, tube_window)
    certificate = certify(
        problem, found.tube_gain, found.cost, windows, terminal, found.bounds, residual
    )
    clock.lap("certificate")
    return Design(
        **vars(found),
        tube_window=tube_window,
        plain_window=plain_window,
        certificate=certificate,
        seconds=clock.seconds,
    )


def refuse_infeasible_start(found: Design, error: Float[np.ndarray, "3"] | None = None) -> None:
    """Raise ScenarioError where the tube-MPC has no plan from the scenario's start."""
    problem, index = found.problem, int(found.windows.index[0])
    error = problem.initial_error if error is None else error
    section = problem.scenario.initial
    start = f"scenario: initial = ({section.x_m} m, {section.y_m} m, {section.heading_deg} deg)"
    noise = problem.error_set.support(np.eye(3)) - problem.operating_set.support(np.eye(3))
    # What is measured of the start decides, and the feasible set is convex: the corners of the
    # noise tell.
    corners = (
        error + noise * np.array(np.meshgrid(*[[-1, 1]] * 3)).reshape(3, -1).T
        if noise.any()
        else error[None]
    )
    largest = float(
        np.max(corners @ problem.operating_set.normals.T / problem.operating_set.offsets)
    )
    missing = max(shortfall(found.tube_window, index, corner) for corner in corners)
    if largest <= 1 and missing <= 1e-9:
        return
    # Both limits at once: a start that is merely inside [constraints] might be refused again.
    share = min(reach_of_ray(found.tube_window, index, error), 1 / max(largest, 1.0))
    cure = f"start at most {share:.0%} as far away" if share > 0 else "no start has a plan"
    if largest > 1:
        raise ScenarioError(
            f"{start}: the error of the start lies outside [constraints] or [operating]; {cure}"
        )
    raise ScenarioError(
        f"{start}: lies outside the feasible set of the tube-MPC (constraints short by {missing:.3g}); {cure}; "
        "lengthen controller.horizon or shrink [disturbance]"
    )
