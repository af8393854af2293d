"""Whether anything can be guaranteed at one slip error, speed range and period, for three ways to
choose a design.

    ratio = max  h_R(row) / offset  over the rows of E_op, U and the coupling,    R the minimal RPI set of the gain

below 1 the caps hold an invariant set. W is computed for the slipping robot, over every order of
wheel speeds.

* `paper`      the paper's weights, model and input map; its gain of section III-B or that of its LMI, under the
               wheel limits and E alone, unless W is hopeless there, or under all caps of the scenario; what fills least
* `weighted`   LMI gains of diag(1, 3, 1) and 0.3 I for the `consistent` model under `x_exact`, the scenario's caps,
               the objective that leaves least
* `optimised`  caps and tracking gains of `jaxtube.synthesis.optimise` for the exact Jacobian under `x_exact`

Source: Gonzalez, Fiacchini, Guzman, Alamo 2009, sections III-B, III-E and IV, for `paper`; the
others are new.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import msgspec
import numpy as np

from jaxtube.scenario import Scenario
from jaxtube.synthesis.certificate.existence import OBJECTIVES
from jaxtube.synthesis.certificate.fill import cap_shares
from jaxtube.synthesis.disturbance import complete_problem
from jaxtube.synthesis.optimise import NAMES, STARTS, optimise, wheel_excess
from jaxtube.synthesis.problem import Problem, make_problem
from jaxtube.synthesis.terminal import terminal_cost_and_gain
from jaxtube.synthesis.tightening import LocalGain, compensating_gain, decoupled_gain

ERROR_WEIGHT, INPUT_WEIGHT = (1.0, 3.0, 1.0), (0.3, 0.3)
"""Weights of `weighted`."""
HOPELESS_M = 0.15
"""A disturbance of so much in a single step, half of E, leaves no guarantee: its tube is not
computed."""


class Condition(NamedTuple):
    """What a guarantee is asked for: slip error, least wheel speed of the reference in m/s, period
    in s."""

    slip_error: float
    slowest_mps: float
    dt_s: float


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
        """Whether an invariant set lies inside all caps, and the wheels can do what it may ask for."""
        return (
            self.ratio is not None
            and self.wheels is not None
            and self.ratio < 1
            and self.wheels <= 1
        )


def under(scenario: Scenario, condition: Condition) -> Scenario:
    """Return the scenario under a condition: W computed, every order of wheel speeds in the box.

    The path, which no ratio depends on, is followed for a whole number of periods.
    """
    change, T = msgspec.structs.replace, condition.dt_s
    followed = {
        "certified_for": "box",
        "duration_s": max(round(scenario.reference.duration_s / T), 1) * T,
    }
    return change(
        scenario,
        slip=change(scenario.slip, relative_error=condition.slip_error),
        reference=change(scenario.reference, wheel_speed_min_mps=condition.slowest_mps, **followed),
        controller=change(scenario.controller, dt_s=T),
        disturbance=change(scenario.disturbance, bound="computed"),
    )


def caps_and_gains(scenario: Scenario) -> tuple[float, ...] | None:
    """Return the scenario's own caps and tracking gains as a start of the search, None where any is
    missing."""
    caps = [getattr(scenario.operating, name) for name in NAMES]
    if None in caps or not scenario.controller.tracking_gains:
        return None
    return tuple(abs(cap) for cap in caps) + scenario.controller.tracking_gains


def guarantee(design: str, scenario: Scenario, start: Sequence[float] | None = None) -> Guarantee:
    """Return the least ratio of a design under the conditions of a scenario.

    Args:
        design: "paper", "weighted" or "optimised".
        scenario: gives conditions and, but for "optimised", caps.
        start: caps and gains that the search starts from, None for those of `optimise`; only
            "optimised" asks.
    """
    if design == "optimised":
        return _optimised(scenario, start)
    return _least({"paper": _paper, "weighted": _weighted}[design](scenario))


def _least(candidates: Iterator[tuple[str, Problem | Exception, LocalGain | None]]) -> Guarantee:
    """Return the guarantee of the candidate of least ratio, or the reason of the last one where all
    fail."""
    best = Guarantee()
    for choice, problem, gain in candidates:
        if isinstance(problem, Problem) and gain is not None:
            found = _guarantee(choice, problem, gain)
        else:
            found = Guarantee(reason=str(problem))
        if best.ratio is None or (found.ratio is not None and found.ratio < best.ratio):
            best = found
    return best


def _guarantee(choice: str, problem: Problem, gain: LocalGain) -> Guarantee:
    shares = cap_shares(problem, gain)
    binding = max(shares, key=lambda name: shares[name])
    if not np.isfinite(shares[binding]):
        return Guarantee(reason="the loops have no bounded tube")
    # Without caps U is what the wheel limits leave, to the last: its box of inputs would count too
    # much.
    wheels = (
        1.0 if problem.scenario.operating.yaw_rate_deficit_radps is None else wheel_excess(problem)
    )
    return Guarantee(shares[binding], wheels, binding, choice)


def _paper(scenario: Scenario) -> Iterator:
    change, usual = msgspec.structs.replace, Scenario()
    controller = change(
        usual.controller, dt_s=scenario.controller.dt_s, horizon=scenario.controller.horizon
    )
    for limits, operating in (("wheel limits", usual.operating), ("caps", scenario.operating)):
        try:
            problem = complete_problem(change(scenario, controller=controller, operating=operating))
            widest = float(np.max(problem.disturbance_set.support(np.eye(3)[:2])))
            if widest > HOPELESS_M:
                yield (
                    limits,
                    ValueError(f"{limits}: disturbances of up to {widest:.3g} m in a step"),
                    None,
                )
                continue
            gains = {
                "LMI": terminal_cost_and_gain(problem)[1],
                "section III-B": compensating_gain(problem),
            }
        except (ValueError, RuntimeError) as error:
            yield limits, error, None
            continue
        for name, gain in gains.items():
            yield f"{limits}, {name}", problem, gain


def _weighted(scenario: Scenario) -> Iterator:
    change = msgspec.structs.replace
    settings = {
        "model": "consistent",
        "discretisation": "euler",
        "input_map": "x_exact",
        "tracking_gains": (),
    }
    weights = {"error_weight": ERROR_WEIGHT, "input_weight": INPUT_WEIGHT}
    scenario = change(scenario, controller=change(scenario.controller, **settings, **weights))
    try:
        problem = complete_problem(scenario)
    except ValueError as error:
        yield "", error, None
        return
    for objective in OBJECTIVES:
        controller = change(scenario.controller, lmi_objective=objective)
        own = replace(problem, scenario=change(scenario, controller=controller))
        try:
            yield objective, own, terminal_cost_and_gain(own)[1]
        except (ValueError, RuntimeError) as error:
            yield objective, error, None


def _optimised(scenario: Scenario, start: Sequence[float] | None) -> Guarantee:
    """Search near the start; where that leads to nothing, from the optimiser's own."""
    change = msgspec.structs.replace
    settings = {
        "model": "exact_jacobian",
        "input_map": "x_exact",
        "tracking_gains": (),
        "terminal": "T-A",
    }
    scenario = change(scenario, controller=change(scenario.controller, **settings, tube="sequence"))
    reason = ""
    for starts in ([tuple(start)], STARTS) if start is not None else (STARTS,):
        try:
            optimum = optimise(make_problem(scenario), starts=starts).scenario
            problem = complete_problem(optimum)
        except ValueError as error:
            reason = str(error)
            continue
        found = _guarantee("", problem, decoupled_gain(problem, optimum.controller.tracking_gains))
        if found.ratio is not None:
            return replace(found, caps_and_gains=caps_and_gains(optimum))
        reason = found.reason
    return Guarantee(reason=reason, caps_and_gains=None if start is None else tuple(start))
