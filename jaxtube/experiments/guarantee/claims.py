"""What each claim of a robust tube-MPC rests on in a certificate, and what laps that attack it have
shown.

A lap violates the guarantee where any of VIOLATIONS occurs in any of its periods. Laps are counted
event by event, so the number of laps with at least one of several events lies between the largest
count and the sum. Bounds are one-sided (Clopper-Pearson), one law at a time: they hold for laps
drawn by that law, and for no other.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection
from typing import NamedTuple

from jaxtube.experiments.run.conditions import condition_metrics
from jaxtube.scenario.tree import Scenario
from jaxtube.statistics.events import VIOLATIONS
from jaxtube.statistics.intervals import CONFIDENCE, largest_share
from jaxtube.synthesis.certificate.terminal import ANY_ORDER
from sets.certificate import Certificate


class DesignUnderTest(NamedTuple):
    """A design that was attacked; `laws` holds the summary of its laps by the name of the law."""

    name: str
    scenario: Scenario
    certificate: Certificate
    laws: dict[str, dict]
    note: str = ""


class EventCount(NamedTuple):
    """Occurrences of an event under one law, out of so many trials: laps, or plans that were
    followed."""

    times: int
    trials: int
    unit: str


class Count(NamedTuple):
    """How often something was seen under all laws, and under the law where its share is largest."""

    seen: int
    trials: int
    unit: str
    worst: str  # law, "" where nothing was seen
    seen_there: int
    trials_there: int


class GuaranteeClaim(NamedTuple):
    """A part of the guarantee.

    Attributes:
        title: in words.
        conditions: of the certificate that it needs, its own first.
        on_robot: whether it is on the robot, so that W must hold as well, or on the model alone.
        refutation: how often the summary of one law refutes it; None where laps cannot tell.
        scope: how far it goes, in words.
        concerns: whether a design has what the claim is about; where none has, it is not told.
    """

    title: str
    conditions: tuple[str, ...]
    on_robot: bool = True
    refutation: Callable[[dict], EventCount] | None = None
    scope: Callable[[DesignUnderTest], str] = lambda design: ""
    concerns: Callable[[DesignUnderTest], bool] = lambda design: True


class Verdict(NamedTuple):
    """What became of one claim of one design: made, how far it goes, proved and how, and what laps
    have shown."""

    claimed: bool
    scope: str
    certified: bool
    proof: str
    seen: Count | None


def _laps_with(*events: str) -> Callable[[dict], EventCount]:
    """Return what counts the laps with the most frequent of some events."""

    def count(law: dict) -> EventCount:
        return EventCount(max(law["events"][name]["laps"] for name in events), law["laps"], "laps")

    return count


def _plans_outside(law: dict) -> EventCount:
    """Count the plans outside the tube, at the stage where most of them are."""
    if not law["plans"]:
        return EventCount(0, 0, "plans")
    tube = law["tube"]
    outside = tube["plans_outside_by_stage"][tube["used"]]
    return EventCount(max(map(int, outside)), law["plans"], "plans")


def _cost_excesses(law: dict) -> EventCount:
    """Count the plans whose cost fell by less than that of the step."""
    excesses = law["cost"]["fell_by_less_than_the_stage"] if law["plans"] else 0
    return EventCount(excesses, law["plans"], "plans")


def _wheel_speeds(design: DesignUnderTest) -> str:
    reference = design.scenario.reference
    span = f"{reference.wheel_speed_min_mps:g} to {reference.wheel_speed_max_mps:g} m/s"
    speeds = span if reference.certified_for == "box" else f"those of the path in {span}"
    order = "any order" if _has_any_order(design) else "in the order of this path alone"
    return f"{speeds}, {order}"


def _limits_acceleration(design: DesignUnderTest) -> bool:
    return design.scenario.robot.wheel_acceleration_max_mps2 is not None


def _wheel_acceleration(design: DesignUnderTest) -> str:
    most = design.scenario.robot.wheel_acceleration_max_mps2
    return "" if most is None else f"{most:g} m/s^2 from the second command on"


def _has_any_order(design: DesignUnderTest) -> bool:
    """Return whether the certificate holds for the certified wheel speeds in any order: a tube that
    follows the reference is checked along this path, and for other orders by a condition of its
    own."""
    follows_reference = design.scenario.controller.tube == "sequence"
    return not follows_reference or _holds(design, ANY_ORDER)


def _slip_error(design: DesignUnderTest) -> str:
    slip = design.scenario.slip
    if slip.has_intervals:
        measured = f", measured within {slip.say_measurement_error()}" if slip.is_measured else ""
        return f"anywhere in {slip.say_intervals()}{measured}"
    return f"{slip.relative_error:.0%} of {slip.nominal_right:g} right, {slip.nominal_left:g} left"


def _disturbance_set(design: DesignUnderTest) -> str:
    section = design.scenario.disturbance
    if section.bound == "computed":
        return "W is computed"
    return (
        f"W assumed: {section.longitudinal_m:g} m, {section.lateral_m:g} m, "
        f"{section.heading_deg:g} deg"
    )


PREMISE = ("disturbance_bound_proved",)
RECURSION = (
    "plan_stays_feasible",
    "shifted_plan_inclusion",
    "tightening_covers_reach",
    "plans_keep_these_sets",
)
TERMINAL = ("terminal_set_invariant", "terminal_set_admissible", "vertices_cover_schedule")
RATIONALS = "checked_in_rationals"
CLAIMS = (
    GuaranteeClaim(
        "W holds every disturbance of the robot",
        PREMISE,
        on_robot=False,
        refutation=_laps_with("w_outside_W"),
        scope=_disturbance_set,
    ),
    GuaranteeClaim(
        "an invariant terminal set exists over the certified wheel speeds",
        TERMINAL,
        on_robot=False,
    ),
    GuaranteeClaim(
        "a plan is followed by a plan",
        RECURSION,
        refutation=_laps_with("qp_infeasible", "qp_unsolved"),
    ),
    GuaranteeClaim(
        "the tube holds the error around a plan",
        ("tightening_covers_reach",),
        refutation=_plans_outside,
    ),
    GuaranteeClaim(
        "the error stays in E",
        ("true_error_in_e", *RECURSION),
        refutation=_laps_with("e_outside_E"),
    ),
    GuaranteeClaim(
        "inputs stay in U",
        ("input_sets_not_empty", *RECURSION),
        refutation=_laps_with("u_outside_U"),
    ),
    GuaranteeClaim(
        "wheels stay within their limits",
        ("wheel_limits", *RECURSION),
        refutation=_laps_with("wheels_saturated"),
    ),
    GuaranteeClaim(
        "commands keep the wheels' acceleration",
        ("wheel_acceleration", *RECURSION),
        refutation=_laps_with("acceleration_exceeded"),
        scope=_wheel_acceleration,
        concerns=_limits_acceleration,
    ),
    GuaranteeClaim(
        "the cost of the model decreases",
        ("terminal_cost_decrease", "plan_stays_feasible"),
        on_robot=False,
        refutation=_cost_excesses,
    ),
    GuaranteeClaim(
        "wheel speeds covered",
        ("vertices_cover_schedule", "terminal_set_invariant"),
        scope=_wheel_speeds,
    ),
    GuaranteeClaim("slip error covered", PREMISE, on_robot=False, scope=_slip_error),
    GuaranteeClaim("checked in exact arithmetic", (RATIONALS,), on_robot=False),
)
WORDS = {
    "disturbance_bound_proved": "W is not proved to hold w",
    "plan_stays_feasible": "the next plan may not fit",
    RATIONALS: "in floating point only",
    "terminal_set_invariant": "no invariant set",
}
"""What it means that a condition fails, where its name does not say so."""


def judge_claim(claim: GuaranteeClaim, design: DesignUnderTest) -> Verdict:
    """Return whether a design makes a claim, whether its certificate proves it, and how often it
    was seen to fail."""
    known = design.certificate.conditions
    concerned = claim.concerns(design)
    # Without caps of its own a design takes U from the wheel limits: what keeps U then keeps the
    # wheels.
    names = [name for name in claim.conditions if name in known or name != "wheel_limits"]
    reasons = [_say_what_fails(design, name) for name in names if not _holds(design, name)]
    if claim.on_robot and not all(_holds(design, name) for name in PREMISE):
        reasons.append("W does not hold")
    proof = f"no: {', '.join(reasons)}" if reasons else f"yes, margin {known[names[0]].margin:.3g}"
    own_gain = known.get("invariant_set_for_tube_gain")
    if claim.conditions == TERMINAL and own_gain and not own_gain.holds:
        proof += f"; but not for the gain of the tube ({own_gain.margin:.3g})"
    return Verdict(
        claimed=concerned and (claim.conditions != (RATIONALS,) or RATIONALS in known),
        scope=claim.scope(design),
        certified=not reasons,
        proof=proof,
        seen=count(claim.refutation, design.laws) if concerned and claim.refutation else None,
    )


def _holds(design: DesignUnderTest, name: str) -> bool:
    condition = design.certificate.conditions.get(name)
    return condition is not None and condition.holds


def _say_what_fails(design: DesignUnderTest, name: str) -> str:
    """Return in words that a condition fails, with its margin where it has one."""
    words = WORDS.get(name, name.replace("_", " "))
    condition = design.certificate.conditions.get(name)
    if condition is None or math.isinf(condition.margin):
        return words
    return f"{words} ({condition.margin:.3g})"


def count(refutation: Callable[[dict], EventCount], laws: dict[str, dict]) -> Count:
    """Add up over the laws how often a claim was refuted, and name the law under which its share
    was largest."""
    by_law = {name: refutation(law) for name, law in laws.items()}
    worst = max(by_law, key=lambda name: by_law[name].times / max(by_law[name].trials, 1))
    most = by_law[worst]
    times = sum(seen.times for seen in by_law.values())
    trials = sum(seen.trials for seen in by_law.values())
    return Count(times, trials, most.unit, worst if most.times else "", most.times, most.trials)


def list_claims(tested: list[DesignUnderTest]) -> list[GuaranteeClaim]:
    """Return those of CLAIMS that concern some design."""
    return [claim for claim in CLAIMS if any(map(claim.concerns, tested))]


def list_violations(tested: list[DesignUnderTest]) -> list[str]:
    """Return those of VIOLATIONS that the laps of some design can have."""
    events = [law["events"] for design in tested for law in design.laws.values()]
    return [name for name in VIOLATIONS if any(name in counted for counted in events)]


def bound_violating_laps(law: dict, events: Collection[str] = VIOLATIONS) -> tuple[int, int]:
    """Return the least and the largest number of laps that can have had one of some events."""
    laps = [law["events"][name]["laps"] for name in events if name in law["events"]]
    return max(laps), min(sum(laps), law["laps"])


def bound_violating_share(law: dict) -> float:
    """Return the largest share of laps by this law that violate the guarantee, at CONFIDENCE."""
    _, most = bound_violating_laps(law)
    return largest_share(most, law["laps"], 1 - CONFIDENCE)


def count_steps(law: dict) -> int:
    """Return the periods that were checked."""
    return law["laps"] * law["steps_a_lap"]


def metrics(tested: list[DesignUnderTest]) -> dict:
    """Return what `metrics.json` holds, by design."""
    return {
        "confidence": CONFIDENCE,
        "violations": list_violations(tested),
        "designs": {design.name: _metrics(design) for design in tested},
    }


def _metrics(design: DesignUnderTest) -> dict:
    certificate = design.certificate
    return {
        "certified": certificate.holds_for_robot,
        "certified_for_model": certificate.holds_for_model,
        "certificate": condition_metrics(certificate),
        "claims": {
            claim.title: _verdict_metrics(judge_claim(claim, design))
            for claim in list_claims([design])
        },
        "laws": {name: law | _bounds(law) for name, law in design.laws.items()},
        "note": design.note,
    }


def _verdict_metrics(verdict: Verdict) -> dict:
    seen = _count_metrics(verdict.seen) if verdict.seen else None
    return verdict._asdict() | {"seen": seen}


def _count_metrics(count: Count) -> dict:
    """Return a count by the names that `metrics.json` uses."""
    return {
        "seen": count.seen,
        "of": count.trials,
        "unit": count.unit,
        "worst": count.worst,
        "seen_there": count.seen_there,
        "of_there": count.trials_there,
    }


def _bounds(law: dict) -> dict:
    """Return the bounds on the laps of a law that violate the guarantee."""
    least, most = bound_violating_laps(law)
    return {
        "violating_laps_least": least,
        "violating_laps_most": most,
        "share_of_violating_laps_at_most": bound_violating_share(law),
    }
