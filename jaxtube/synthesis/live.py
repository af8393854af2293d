"""QPs of windows of wheel speeds that nobody knew when the design was made.

The certificate of a design for a box of wheel speeds, in any order, is about every window of N
pairs in that box: the terminal set is invariant under all their loops, and the tube along a window
is tightened for where the window leads. Only the numbers of a window's QP are missing, and those
take a millisecond: the functions here are those that condense the windows of a design.

Source: new.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from jaxtube.control.planning import CondensedQp
from jaxtube.scenario.refusal import ScenarioError
from jaxtube.synthesis import condense
from jaxtube.synthesis.certificate.terminal import ANY_ORDER
from jaxtube.synthesis.parts import Design
from jaxtube.synthesis.regimes import RegimesByAge
from jaxtube.synthesis.terminal import bound_last_errors
from jaxtube.synthesis.tightening import find_back_off, tighten
from jaxtube.synthesis.tubes import Tube, make_following_tube
from jaxtube.synthesis.windows import Windows


class LiveQps(NamedTuple):
    """Condensed QPs of windows, numpy float64, and in which of them a solved plan misses its rows
    by less than these are drawn in: what the certificate checks of the windows of the design."""

    qps: CondensedQp
    within_slack: Bool[np.ndarray, " windows"]


@dataclass(frozen=True, eq=False)
class LiveWindows:
    """The QPs of any windows within the certified wheel speeds of a design."""

    design: Design

    def __post_init__(self):
        require_any_order(self.design)

    @property
    def box(self) -> Float[np.ndarray, "2 2"]:
        """The certified wheel speeds, lower and upper (right, left), m/s."""
        return np.array(self.design.problem.model.box)

    def condense(self, schedules: Float[np.ndarray, "windows horizon 2"]) -> LiveQps:
        """Return the condensed QPs of windows.

        Args:
            schedules: wheel speeds (right, left) within the box, m/s.
        """
        design = self.design
        problem = design.problem
        gain = design.tube_gain
        count = len(schedules)
        windows = Windows(
            schedules=schedules,
            index=np.arange(count),
            loops=gain.loops_along(schedules),
            gains=gain.along(schedules),
            regimes=problem.rule.number(schedules.reshape(-1, 2)).reshape(schedules.shape[:2]),
        )
        tube = self._follow(windows)
        terminal = design.terminal
        invariant = terminal.invariant
        assert invariant is not None  # or else no order but one would be certified
        offsets = bound_last_errors(problem, invariant, terminal.disturbances, tube, count)
        terminal = dataclasses.replace(
            terminal, constraint_normals=invariant.normals, constraint_offsets=offsets
        )
        tightening = tighten(problem, tube, windows)
        bounds = condense.tube_bounds(problem, windows, tightening, terminal)
        qps = condense.condense(problem, windows, terminal, design.cost.cost, bounds)
        slack = condense.bound_solver_slack(problem, windows, bounds, qps)
        return LiveQps(qps, slack <= find_back_off(problem))

    def _follow(self, windows: Windows) -> Tube:
        design = self.design
        if not design.tube.follows_reference:
            return design.tube
        return make_following_tube(design.problem, design.tube_gain, windows)


def require_any_order(design: Design) -> None:
    """Refuse a design whose certificate is not about every window in a box of wheel speeds.

    Raises:
        ScenarioError: one line.
    """
    problem = design.problem
    scenario = problem.scenario
    robot = scenario.robot
    certificate = design.certificate
    order = certificate.conditions.get(ANY_ORDER)
    if scenario.reference.certified_for != "box":
        raise ScenarioError(
            f'scenario: reference.certified_for = "{scenario.reference.certified_for}": a governor '
            'revises wheel speeds within a box; set reference.certified_for = "box"'
        )
    if not certificate.holds_for_model or order is None or not order.holds:
        raise ScenarioError(
            f"scenario: certificate: {certificate.verdict}: a governor needs one for wheel speeds "
            'in any order; design "certified", or see design.certificate.table()'
        )
    if isinstance(problem.rule, RegimesByAge):
        raise ScenarioError(
            "scenario: slip: what is learnt of it makes the first windows of a run differ, and a "
            "governor knows one kind; leave slip.change_per_s out"
        )
    if not scenario.controller.restart:
        raise ScenarioError(
            "scenario: controller.restart = false: a governor asks for plans from the measured "
            "error; set controller.restart = true"
        )
    if not robot.obeys_at_once or robot.wheel_acceleration_max_mps2 is not None:
        raise ScenarioError(
            "scenario: robot.wheel_lag_s, command_delay_s, wheel_acceleration_max_mps2: a governor "
            "revises wheel speeds at once, of which wheels that lag or have a limit of "
            "acceleration know nothing; leave them out"
        )
