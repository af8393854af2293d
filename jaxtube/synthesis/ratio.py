"""Whether anything can be guaranteed at one slip error, speed range and period, for three ways to
choose a design.

    ratio = max  h_R(row) / offset  over the rows of E_op, U and the coupling,
            R the minimal RPI set of the gain

below 1 the caps hold an invariant set. W is computed for the slipping robot, over every order of
wheel speeds.

* `paper`      the paper's weights, model and input map; its gain of section III-B or that of its
               LMI, under the wheel limits and E alone, unless W is hopeless there, or under all
               caps of the scenario; whichever fills least
* `weighted`   LMI gains of diag(1, 3, 1) and 0.3 I for the `consistent` model under `x_exact`, the
               scenario's caps, the objective that fills least
* `optimised`  caps and tracking gains of `jaxtube.synthesis.optimise` for the exact Jacobian under
               `x_exact`

Source: Gonzalez, Fiacchini, Guzman, Alamo 2009, sections III-B, III-E and IV, for `paper`; the
others are new.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import msgspec
import numpy as np

from jaxtube.scenario.error_box import error_vector
from jaxtube.scenario.tree import Scenario
from jaxtube.synthesis.certificate.existence import OBJECTIVES
from jaxtube.synthesis.certificate.fill import cap_shares
from jaxtube.synthesis.disturbance import complete_problem
from jaxtube.synthesis.gains import Gain, compensating_gain, decoupled_gain
from jaxtube.synthesis.levers import SLIP
from jaxtube.synthesis.optimise import optimise, wheel_excess
from jaxtube.synthesis.problem import Problem, make_problem
from jaxtube.synthesis.starts import caps_and_gains
from jaxtube.synthesis.terminal_cost import terminal_cost_and_gain

ERROR_WEIGHT = (1.0, 3.0, 1.0)
INPUT_WEIGHT = (0.3, 0.3)
"""Weights of `weighted`."""
HOPELESS = 0.5
"""A disturbance of so much of a limit in a single step leaves no guarantee: its tube is not
computed."""


class OperatingPoint(NamedTuple):
    """What a guarantee is asked for: slip error, as of `find_slip_error`, least wheel speed of the
    reference in m/s, period in s."""

    slip_error: float
    slowest_mps: float
    dt_s: float


class DesignCandidate(NamedTuple):
    """One gain for one problem, by its name; without them, why there are none."""

    choice: str
    problem: Problem | None = None
    gain: Gain | None = None
    reason: str = ""


@dataclass(frozen=True)
class Guarantee:
    """The least ratio of one way to choose a design; without a ratio none was found, for the reason
    given.

    `wheels` is the greatest ground speed that may be commanded, as a share of what the wheels can
    do under every slip. `caps_and_gains`, of `optimised`, start a search nearby; they are those of
    the search's own start where none was found.
    """

    ratio: float | None = None
    wheels: float | None = None
    binding: str = ""
    choice: str = ""
    reason: str = ""
    caps_and_gains: tuple[float, ...] | None = None

    @property
    def holds(self) -> bool:
        """Whether an invariant set lies inside all caps, and the wheels can do what it asks for."""
        if self.ratio is None or self.wheels is None:
            return False
        return self.ratio < 1 and self.wheels <= 1


def find_slip_error(scenario: Scenario) -> float:
    """Return what is not known of the slips of a scenario, as one number: relative_error, of
    measured slips their error, of intervals the half width of the right one."""
    return SLIP.measure(scenario) if SLIP.values(scenario, 1.0) else 0.0


def name_slip_error(scenario: Scenario) -> str:
    """Return what `find_slip_error` is of a scenario, in words."""
    slip = scenario.slip
    if slip.is_measured:
        return "error of measured slip"
    if not slip.has_intervals:
        return "slip error"
    is_same = slip.right == slip.left and slip.nominal_right == slip.nominal_left
    return "half width of slip interval" if is_same else "half width of right slip interval"


def set_slip_error(scenario: Scenario, error: float) -> Scenario:
    """Return a scenario with another slip error; the errors or intervals of both wheels go along.

    Raises:
        ScenarioError: where no scenario may have that.
    """
    own = find_slip_error(scenario)
    if error == own:
        return scenario
    slip = scenario.slip
    if not slip.has_intervals:
        slip = msgspec.structs.replace(slip, relative_error=error)
        return msgspec.structs.replace(scenario, slip=slip)
    return SLIP.scale(scenario, error / own)


def set_point(scenario: Scenario, point: OperatingPoint) -> Scenario:
    """Return the scenario at an operating point: W computed, any order of wheel speeds in the box.

    The path, which no ratio depends on, is followed for a whole number of periods.
    """
    change = msgspec.structs.replace
    T = point.dt_s
    duration = scenario.reference.duration_s
    whole_periods = None if duration is None else max(round(duration / T), 1) * T
    reference = change(
        scenario.reference,
        wheel_speed_min_mps=point.slowest_mps,
        certified_for="box",
        duration_s=whole_periods,
    )
    return change(
        set_slip_error(scenario, point.slip_error),
        reference=reference,
        controller=change(scenario.controller, dt_s=T),
        disturbance=change(scenario.disturbance, bound="computed"),
    )


def guarantee(design: str, scenario: Scenario, start: Sequence[float] | None = None) -> Guarantee:
    """Return the least ratio of a design under the conditions of a scenario.

    Args:
        design: "paper", "weighted" or "optimised".
        scenario: gives conditions and, but for "optimised", caps.
        start: caps and gains that the search starts from, None for those of `optimise`; only
            "optimised" asks.
    """
    if design == "optimised":
        return _search_optimum(scenario, start)
    candidates = {"paper": _list_paper_candidates, "weighted": _list_weighted_candidates}[design]
    return _find_least(candidates(scenario))


def _find_least(candidates: Iterator[DesignCandidate]) -> Guarantee:
    """Return the guarantee of the candidate of least ratio, or the reason of the last one where all
    fail."""
    best = Guarantee()
    for candidate in candidates:
        if candidate.problem is None or candidate.gain is None:
            of_candidate = Guarantee(reason=candidate.reason)
        else:
            of_candidate = _compute_guarantee(candidate.choice, candidate.problem, candidate.gain)
        is_less = of_candidate.ratio is not None and (
            best.ratio is None or of_candidate.ratio < best.ratio
        )
        if best.ratio is None or is_less:
            best = of_candidate
    return best


def _compute_guarantee(choice: str, problem: Problem, gain: Gain) -> Guarantee:
    shares = cap_shares(problem, gain)
    binding = max(shares, key=lambda name: shares[name])
    if not np.isfinite(shares[binding]):
        return Guarantee(reason="the loops have no bounded tube")
    # Without caps, U is exactly the wheel limits; a bounding box of U would overstate the speeds.
    has_caps = problem.scenario.operating.yaw_rate_deficit_radps is not None
    wheels = wheel_excess(problem) if has_caps else 1.0
    return Guarantee(shares[binding], wheels, binding, choice)


def _list_paper_candidates(scenario: Scenario) -> Iterator[DesignCandidate]:
    change = msgspec.structs.replace
    usual = Scenario()
    controller = change(
        usual.controller, dt_s=scenario.controller.dt_s, horizon=scenario.controller.horizon
    )
    for limits, operating in (("wheel limits", usual.operating), ("caps", scenario.operating)):
        try:
            problem = complete_problem(change(scenario, controller=controller, operating=operating))
            widest = problem.disturbance_set.support(np.eye(3)[:2])
            if np.any(widest > HOPELESS * error_vector(scenario.constraints)[:2]):
                reason = f"{limits}: disturbances of up to {widest.max():.3g} m in a step"
                yield DesignCandidate(limits, reason=reason)
                continue
            lmi_gain = terminal_cost_and_gain(problem)[1]
            local_gain = compensating_gain(problem)
        except (ValueError, RuntimeError) as error:
            yield DesignCandidate(limits, reason=str(error))
            continue
        yield DesignCandidate(f"{limits}, LMI", problem, lmi_gain)
        yield DesignCandidate(f"{limits}, section III-B", problem, local_gain)


def _list_weighted_candidates(scenario: Scenario) -> Iterator[DesignCandidate]:
    change = msgspec.structs.replace
    controller = change(
        scenario.controller,
        model="consistent",
        discretisation="euler",
        input_map="x_exact",
        tracking_gains=(),
        error_weight=ERROR_WEIGHT,
        input_weight=INPUT_WEIGHT,
    )
    scenario = change(scenario, controller=controller)
    try:
        problem = complete_problem(scenario)
    except ValueError as error:
        yield DesignCandidate("", reason=str(error))
        return
    for objective in OBJECTIVES:
        controller = change(scenario.controller, lmi_objective=objective)
        own = replace(problem, scenario=change(scenario, controller=controller))
        try:
            yield DesignCandidate(objective, own, terminal_cost_and_gain(own)[1])
        except (ValueError, RuntimeError) as error:
            yield DesignCandidate(objective, reason=str(error))


def _search_optimum(scenario: Scenario, start: Sequence[float] | None) -> Guarantee:
    """Search near the start; where that leads to no design, from starts of the search's own."""
    change = msgspec.structs.replace
    controller = change(
        scenario.controller,
        model="exact_jacobian",
        input_map="x_exact",
        tracking_gains=(),
        terminal="T-A",
        tube="sequence",
    )
    scenario = change(scenario, controller=controller)
    nothing = None if start is None else tuple(start)
    try:
        found = optimise(make_problem(scenario), near=start)
        if not found.keeps_limits:
            return Guarantee(reason=found.describe_binding(), caps_and_gains=nothing)
        problem = complete_problem(found.scenario)
    except ValueError as error:
        return Guarantee(reason=str(error), caps_and_gains=nothing)
    gain = decoupled_gain(problem, found.scenario.controller.tracking_gains)
    best = _compute_guarantee("", problem, gain)
    if best.ratio is None:
        return replace(best, caps_and_gains=nothing)
    return replace(best, caps_and_gains=caps_and_gains(found.scenario))
