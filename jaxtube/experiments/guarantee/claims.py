"""What each claim of a robust tube-MPC rests on in a certificate, and what laps that attack it have
shown.

A lap violates the guarantee where any of VIOLATIONS occurs in any of its periods. Laps are counted
event by event, so of several events the violating laps lie between the largest count and the sum.
Bounds are one-sided (Clopper-Pearson), one law at a time: they hold for laps drawn by that law, and
for no other.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection
from typing import NamedTuple

from jaxtube.scenario import Scenario
from jaxtube.statistics.intervals import largest_share
from sets.certificate import Certificate

CONFIDENCE = 0.95
VIOLATIONS = {
    "w_outside_W": "w out W",
    "e_outside_E": "e out E",
    "u_outside_U": "u out U",
    "wheels_saturated": "wheels",
    "qp_infeasible": "no plan",
    "qp_unsolved": "unsolv.",
    "not_finite": "not a number",
}


class Tested(NamedTuple):
    """A design that was attacked: `laws` holds the summary of its laps under each law, by name."""

    name: str
    scenario: Scenario
    certificate: Certificate
    laws: dict[str, dict]
    note: str = ""


class Count(NamedTuple):
    """How often something was seen: laps, or plans that were followed, of so many; by law where it
    was seen most."""

    seen: int
    of: int
    unit: str
    worst: str  # law, "" where nothing was seen
    seen_there: int
    of_there: int


class Claim(NamedTuple):
    """A part of the guarantee: conditions of the certificate that it needs, the first its own, and
    what refutes it.

    A claim on the robot needs a W that holds as well; one that is not is on the model. `refuted`
    reads, from the summary of one law, (times seen, of how many, unit); None where laps cannot
    tell.
    """

    title: str
    conditions: tuple[str, ...]
    on_robot: bool = True
    refuted: Callable[[dict], tuple[int, int, str]] | None = None
    scope: Callable[[Scenario], str] = lambda scenario: ""


class Verdict(NamedTuple):
    """What became of one claim of one design: made, how far it goes, proved and how, and what laps
    have shown."""

    claimed: bool
    scope: str
    certified: bool
    proof: str
    seen: Count | None


def _laps_with(*events: str) -> Callable[[dict], tuple[int, int, str]]:
    return lambda law: (max(law["events"][name]["laps"] for name in events), law["laps"], "laps")


def _plans_outside(law: dict) -> tuple[int, int, str]:
    """Count, of the plans that were followed, those outside the tube at the stage where most of
    them are."""
    if not law["plans"]:
        return 0, 0, "plans"
    tube = law["tube"]
    return max(map(int, tube["plans_outside_by_stage"][tube["used"]])), law["plans"], "plans"


def _cost_excesses(law: dict) -> tuple[int, int, str]:
    return (
        (law["cost"]["fell_by_less_than_the_stage"] if law["plans"] else 0),
        law["plans"],
        "plans",
    )


def _wheel_speeds(scenario: Scenario) -> str:
    reference = scenario.reference
    span = f"{reference.wheel_speed_min_mps:g} to {reference.wheel_speed_max_mps:g} m/s"
    return (
        f"{span}, any order" if reference.certified_for == "box" else f"those of the path in {span}"
    )


def _slip_error(scenario: Scenario) -> str:
    slip = scenario.slip
    return f"{slip.relative_error:.0%} of {slip.nominal_right:g} right, {slip.nominal_left:g} left"


def _disturbance_set(scenario: Scenario) -> str:
    section = scenario.disturbance
    if section.bound == "computed":
        return "W is computed"
    return f"W assumed: {section.longitudinal_m:g} m, {section.lateral_m:g} m, {section.heading_deg:g} deg"


PREMISE = ("disturbance_bound_proved",)
RECURSION = ("plan_stays_feasible", "shifted_plan_inclusion", "tightening_covers_reach")
TERMINAL = ("terminal_set_invariant", "terminal_set_admissible", "vertices_cover_schedule")
RATIONALS = "checked_in_rationals"
CLAIMS = (
    Claim(
        "W holds every disturbance of the robot",
        PREMISE,
        False,
        _laps_with("w_outside_W"),
        _disturbance_set,
    ),
    Claim("an invariant terminal set exists over the certified wheel speeds", TERMINAL, False),
    Claim(
        "a plan is followed by a plan",
        RECURSION,
        refuted=_laps_with("qp_infeasible", "qp_unsolved"),
    ),
    Claim(
        "the tube holds the error around a plan",
        ("tightening_covers_reach",),
        refuted=_plans_outside,
    ),
    Claim(
        "the error stays in E", ("true_error_in_e", *RECURSION), refuted=_laps_with("e_outside_E")
    ),
    Claim(
        "inputs stay in U", ("input_sets_not_empty", *RECURSION), refuted=_laps_with("u_outside_U")
    ),
    Claim(
        "wheels stay within their limits",
        ("wheel_limits", *RECURSION),
        refuted=_laps_with("wheels_saturated"),
    ),
    Claim(
        "the cost of the model decreases",
        ("terminal_cost_decrease", "plan_stays_feasible"),
        False,
        _cost_excesses,
    ),
    Claim(
        "wheel speeds covered",
        ("vertices_cover_schedule", "terminal_set_invariant"),
        scope=_wheel_speeds,
    ),
    Claim("slip error covered", ("disturbance_bound_proved",), False, scope=_slip_error),
    Claim("checked in exact arithmetic", (RATIONALS,), False),
)
WORDS = {
    "disturbance_bound_proved": "W is not proved to hold w",
    "plan_stays_feasible": "the next plan may not fit",
    RATIONALS: "in floating point only",
    "terminal_set_invariant": "no invariant set",
}


def judge(claim: Claim, design: Tested) -> Verdict:
    """Return whether a design makes a claim, whether its certificate proves it, and how often it
    was seen to fail."""
    known = design.certificate.conditions
    # Without caps of its own a design takes U from the wheel limits: what keeps U then keeps the
    # wheels.
    names = [name for name in claim.conditions if name in known or name != "wheel_limits"]
    failing = [name for name in names if not _holds(design, name)]
    reasons = [_reason(design, name) for name in failing]
    if claim.on_robot and not all(_holds(design, name) for name in PREMISE):
        reasons.append("W does not hold")
    proof = f"no: {', '.join(reasons)}" if reasons else f"yes, margin {known[names[0]].margin:.3g}"
    other = known.get("invariant_set_for_tube_gain")
    if claim.conditions == TERMINAL and other and not other.holds:
        proof += f"; but not for the gain of the tube ({other.margin:.3g})"
    claimed = claim.conditions != (RATIONALS,) or RATIONALS in known
    seen = count(claim.refuted, design.laws) if claim.refuted else None
    return Verdict(claimed, claim.scope(design.scenario), not reasons, proof, seen)


def _holds(design: Tested, name: str) -> bool:
    condition = design.certificate.conditions.get(name)
    return condition is not None and condition.holds


def _reason(design: Tested, name: str) -> str:
    """Say why a condition fails, with its margin where it has one."""
    words, condition = (
        WORDS.get(name, name.replace("_", " ")),
        design.certificate.conditions.get(name),
    )
    return (
        words
        if condition is None or math.isinf(condition.margin)
        else f"{words} ({condition.margin:.3g})"
    )


def count(refuted: Callable[[dict], tuple[int, int, str]], laws: dict[str, dict]) -> Count:
    """Add up over the laws how often a claim was refuted, and name the law under which it was most
    of all."""
    found = {name: refuted(law) for name, law in laws.items()}
    worst = max(found, key=lambda name: found[name][0] / max(found[name][1], 1))
    seen, of, unit = found[worst]
    total, of_all = sum(each[0] for each in found.values()), sum(each[1] for each in found.values())
    return Count(total, of_all, unit, worst if seen else "", seen, of)


def violating(law: dict, events: Collection[str] = tuple(VIOLATIONS)) -> tuple[int, int]:
    """Return the least and the most laps that can have had one of some events."""
    laps = [law["events"][name]["laps"] for name in events]
    return max(laps), min(sum(laps), law["laps"])


def bound(law: dict) -> float:
    """Return the share of laps by this law that violate the guarantee, at most, at CONFIDENCE."""
    return largest_share(violating(law)[1], law["laps"], 1 - CONFIDENCE)


def steps(law: dict) -> int:
    """Return the periods that were checked."""
    return law["laps"] * law["steps_a_lap"]


def metrics(tested: list[Tested]) -> dict:
    """Return what `metrics.json` holds, by design."""
    return {
        "confidence": CONFIDENCE,
        "violations": list(VIOLATIONS),
        "designs": {design.name: _metrics(design) for design in tested},
    }


def _metrics(design: Tested) -> dict:
    verdicts = {claim.title: judge(claim, design) for claim in CLAIMS}
    return {
        "certified": design.certificate.holds_for_robot,
        "certified_for_model": design.certificate.holds_for_model,
        "certificate": {
            name: {"holds": each.holds, "margin": each.margin, "scope": each.scope}
            for name, each in design.certificate.conditions.items()
        },
        "claims": {
            name: each._asdict() | {"seen": each.seen._asdict() if each.seen else None}
            for name, each in verdicts.items()
        },
        "laws": {
            name: law
            | {
                "violating_laps_least": violating(law)[0],
                "violating_laps_most": violating(law)[1],
                "share_of_violating_laps_at_most": bound(law),
            }
            for name, law in design.laws.items()
        },
        "note": design.note,
    }
