"""The numbers of a Monte Carlo run: shares with bounds, quantiles, extremes.

Shares of laps have Clopper-Pearson intervals; shares of steps or plans, which depend on each other
within a lap, have intervals over laps (`jaxtube.statistics.intervals`). All hold for the one
sampling law of the run.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Int

from jaxtube.coordinates import KEYS, TO_DISPLAY
from jaxtube.plant.recorded_slips import describe_recording
from jaxtube.plant.reference import settled_step
from jaxtube.scenario.tree import Scenario
from jaxtube.statistics import histogram
from jaxtube.statistics.events import EVENTS
from jaxtube.statistics.intervals import CONFIDENCE, mean_interval, share_interval
from jaxtube.statistics.run import RANKED, Statistics
from jaxtube.statistics.tally import STAGE_EVENTS
from jaxtube.synthesis.feasible import RAYS
from jaxtube.synthesis.parts import Design
from jaxtube.synthesis.problem import Problem

QUANTILES = {"median": 0.5, "p95": 0.95, "p999": 0.999}

STARTS = {
    "scenario": "the scenario's start",
    "feasible": f"starts uniform in the hull of {RAYS} boundary points of the feasible set",
    "edge": f"starts on the hull of {RAYS} boundary points of the feasible set",
}
"""Initial errors by name, in words."""


class SamplingLaw(NamedTuple):
    """What laps are drawn from, by name; every bound holds for it alone.

    Attributes:
        controller: a name, or "own".
        plant: "robot", "linear", "exact" or "own".
        starts: "scenario", "feasible" or "edge".
        process: of the slips: the scenario's, or a name, or "own".
        solves_qp: whether the controller solves QPs, some of which may have no solution.
        input_map: in whose sense the controller's u is meant, where that is not the scenario's.
    """

    controller: str
    plant: str
    starts: str
    process: str
    solves_qp: bool = True
    input_map: str = ""

    def describe(self, scenario: Scenario) -> str:
        """Return the law in words."""
        where = STARTS[self.starts]
        controller = self._describe_controller()
        if self.plant == "linear":
            return (
                f"{controller} on the linear model, w in W (half of the draws at its "
                f"vertices), {where}"
            )
        if self.plant == "own":
            return f"{controller} on a plant of the user's, {where}"
        return f"{controller} on the slipping robot, {self._describe_slip(scenario)}, {where}"

    def _describe_controller(self) -> str:
        if not self.input_map:
            return self.controller
        return f"{self.controller} (its u is of the input map {self.input_map}, so w is not W's)"

    def _describe_slip(self, scenario: Scenario) -> str:
        noise = (
            scenario.noise.longitudinal_m,
            scenario.noise.lateral_m,
            scenario.noise.heading_deg,
        )
        if self.plant == "exact":
            return "slip known exactly, pose measured exactly"
        measured = "pose measured exactly"
        if any(noise):
            along, across, heading = noise
            measured = f"pose noise uniform within {along:.3g} m, {across:.3g} m, {heading:.3g} deg"
            if scenario.noise.frame == "world":
                measured += " in the world"
        if scenario.controller.has_observer:
            shares = ", ".join(f"{share:g}" for share in scenario.controller.observer_gain)
            measured += f", an observer of gain ({shares}) filters it"
        return f"{self._describe_slips(scenario)}, {measured}"

    def _describe_slips(self, scenario: Scenario) -> str:
        """Return how slips are drawn, in words."""
        if self.process == "recorded":
            return describe_recording(scenario)
        slip = scenario.slip
        is_extreme = self.process in ("vertex", "adversarial")
        sideways = ""
        if slip.sideslip:
            sideways = f", sideslip {'+-' if is_extreme else 'within +-'}{slip.sideslip:.3g}"
        if slip.has_intervals:
            spread = "at the ends of" if is_extreme else "uniform in"
            return f"true slip ({self.process}) {spread} {slip.say_intervals()}{sideways}"
        names = {"true": "true slip", "measured": "measured slip", "both": "true and measured slip"}
        spread = "at" if is_extreme else "uniform within"
        return (
            f"{names[slip.random]} ({self.process}) {spread} +-{slip.relative_error:.3g} of its "
            f"nominal value{sideways}"
        )


def summarise(design: Design, law: SamplingLaw, statistics: Statistics) -> dict:
    """Return the numbers of a run, plain, with units in the keys: functions of design, law and
    statistics alone."""
    problem = design.problem
    steps = statistics["events"].shape[1] - 1
    settled = settled_step(problem.reference)
    numbers = {
        "law": law.describe(problem.scenario),
        "certificate": design.certificate.verdict,
        "confidence": CONFIDENCE,
        "laps": int(statistics["laps"]),
        "steps_a_lap": steps,
        "settled_s": settled * problem.reference.dt,
        "events": _summarise_events(law, statistics, settled),
        # Beyond each facet, in m, rad, m/s; negative inside.
        "largest_excess": {
            name: statistics[f"excess/{name}"] for name in ("disturbance", "error", "input")
        },
        "ultimate_bound": _by_coordinate(statistics["ultimate_bound"] * TO_DISPLAY),
        "plans": int(statistics["plans"]),
        "peak_error": _quantiles(statistics["peak"]),
        "rms_error_settled": _quantiles(statistics["rms"]),
        "disturbance": _quantiles(statistics["disturbance"]),
        "worst": {name: _worst_laps(name, statistics) for name in RANKED},
    }
    if "acceleration_exceeded" in numbers["events"]:
        numbers["wheel_acceleration"] = _summarise_acceleration(problem, statistics)
    if "slip_radius" in statistics:
        numbers["widest_slip_interval"] = (2 * statistics["slip_radius"]).tolist()
    return numbers | (_summarise_plans(design, law, statistics) if statistics["plans"] else {})


def _summarise_acceleration(problem: Problem, statistics: Statistics) -> dict:
    """Return the largest change of a command from one period to the next, m/s^2, and its limit."""
    return {
        "largest_mps2": float(statistics["command_step"].max() / problem.model.dt),
        "limit_mps2": problem.scenario.robot.wheel_acceleration_max_mps2,
    }


def _summarise_events(law: SamplingLaw, statistics: Statistics, settled: int) -> dict[str, dict]:
    """Return the events that a run of this kind can have."""
    steps = statistics["events"].shape[1] - 1
    missing = _missing(law, statistics)
    numbers = {}
    for event, row in zip(EVENTS, statistics["events"], strict=True):
        if event.needs not in missing:
            eligible = steps + 1 - settled if event.needs == "bound" else steps
            numbers[event.name] = _summarise_event(row, eligible)
    return numbers


def _missing(law: SamplingLaw, statistics: Statistics) -> set[str]:
    """Return what a run lacks of what events need."""
    missing = set()
    if not law.solves_qp:
        missing.add("QP")
    if law.plant == "linear":
        missing.add("wheels")
    if not np.all(np.isfinite(statistics["ultimate_bound"])):
        missing.add("bound")
    if "command_step" not in statistics or "wheels" in missing:
        missing.add("acceleration")
    if "slip_radius" not in statistics:
        missing.add("learning")
    return missing


def _summarise_event(row: Int[np.ndarray, " counts"], steps: int) -> dict:
    row = row[: steps + 1]
    laps = int(row[1:].sum())
    total = int(row.sum())
    mean, low, high = mean_interval(row, steps, CONFIDENCE)
    return {
        "laps": laps,
        "share_of_laps": laps / total,
        "share_of_laps_interval": share_interval(laps, total, CONFIDENCE),
        "steps": int(row @ np.arange(steps + 1)),
        "share_of_steps": mean,
        "share_of_steps_interval": (low, high),
    }


def _summarise_plans(design: Design, law: SamplingLaw, statistics: Statistics) -> dict:
    """Return what became of the plans that were followed: the tube in use by stage, all tubes, and
    the cost."""
    checked = [name for name in design.tubes if f"tube_outside/{name}" in statistics]
    conditions = design.certificate.conditions
    needed = [
        conditions[name]
        for name in ("plan_stays_feasible", "terminal_cost_decrease")
        if name in conditions
    ]
    promised = law.controller == "tube_mpc" and all(condition.holds for condition in needed)
    asked = statistics["plans_by_lap"]
    return {
        "states_where_a_plan_was_asked_for": int(asked.sum()) * (len(asked) - 1),
        "tube": {
            "used": design.problem.scenario.controller.tube,
            "stages": [_summarise_stage(stage, asked) for stage in statistics["stage_events"]],
            "largest_excess_by_stage": {
                name: statistics[f"tube_excess/{name}"] for name in checked
            },
            "plans_outside_by_stage": {
                name: statistics[f"tube_outside/{name}"] for name in checked
            },
        },
        "cost": {
            "fell_by_less_than_the_stage": int(statistics["cost_excesses"]),
            "no_plan_one_step_later": int(statistics["next_plan_missing"]),
            "largest_excess": float(statistics["cost_excess"]),
            "promised_by_the_certificate": promised,
        },
    }


def _summarise_stage(
    stage: Int[np.ndarray, "events counts"], asked: Int[np.ndarray, " counts"]
) -> dict[str, dict]:
    rows = zip(STAGE_EVENTS, stage, strict=True)
    return {name: _share_of_plans(row, asked) for name, row in rows}


def _share_of_plans(row: Int[np.ndarray, " counts"], asked: Int[np.ndarray, " counts"]) -> dict:
    """Return the share of plans in which an event occurred: a ratio of two means, each bounded at
    half the risk."""
    half = 1 - (1 - CONFIDENCE) / 2
    most_plans = len(row) - 1
    mean, low, high = mean_interval(row, most_plans, half)
    plans, fewest, most = mean_interval(asked, most_plans, half)
    largest = min(high / fewest, 1.0) if fewest else 1.0
    return {"share": mean / plans, "interval": (low / most, largest)}


def _quantiles(counts: Int[np.ndarray, "3 buckets"]) -> dict[str, dict[str, float]]:
    return {
        name: _by_coordinate((histogram.quantile(counts, share) * TO_DISPLAY).tolist())
        for name, share in QUANTILES.items()
    }


def _by_coordinate(values) -> dict[str, float]:
    return dict(zip(KEYS, values, strict=True))


def _worst_laps(name: str, statistics: Statistics) -> list[dict]:
    laps = statistics[f"worst_lap/{name}"]
    usages = statistics[f"worst_usage/{name}"]
    return [
        {"lap": int(lap), "usage": float(usage)} for lap, usage in zip(laps, usages, strict=True)
    ]
