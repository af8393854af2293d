"""The report of `guarantee`: what each design claims, what of it is certified, and what laps that attack it have shown.

A lap violates the guarantee where any of VIOLATIONS occurs in any of its periods. Laps are counted event by event, so
of several events the violating laps lie between the largest count and the sum. Bounds are one-sided (Clopper-Pearson),
one law at a time: they hold for laps drawn by that law, and for no other.
"""

from __future__ import annotations

import textwrap
from collections.abc import Callable
from typing import NamedTuple

from jaxtube.intervals import largest_share
from jaxtube.scenario import Scenario
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
SHOWN = tuple(VIOLATIONS)[:-1]
CLAIM, LABEL, CELL = 29, 10, 34


class Tested(NamedTuple):
    """A design that was attacked: `laws` holds the summary of its laps under each law, by name."""

    name: str
    scenario: Scenario
    certificate: Certificate
    laws: dict[str, dict]
    note: str = ""


class Count(NamedTuple):
    """How often something was seen: laps, or plans that were followed, of so many; by law where it was seen most."""

    seen: int
    of: int
    unit: str
    worst: str  # law, "" where nothing was seen
    seen_there: int
    of_there: int


class Claim(NamedTuple):
    """A part of the guarantee: the conditions of the certificate it rests on, the first its own, and what refutes it.

    `refuted` reads, from the summary of one law, (times seen, of how many, unit); None where laps cannot tell.
    """

    title: str
    conditions: tuple[str, ...]
    refuted: Callable[[dict], tuple[int, int, str]] | None = None
    scope: Callable[[Scenario], str] = lambda scenario: ""


class Verdict(NamedTuple):
    """What became of one claim of one design."""

    claimed: bool
    certified: bool
    claim: str
    proof: str
    seen: Count | None


def _laps_with(*events: str) -> Callable[[dict], tuple[int, int, str]]:
    return lambda law: (max(law["events"][name]["laps"] for name in events), law["laps"], "laps")


def _plans_outside(law: dict) -> tuple[int, int, str]:
    if not law["plans"]:
        return 0, 0, "plans"
    tube = law["tube"]
    return max(map(int, tube["plans_outside_by_stage"][tube["used"]])), law["plans"], "plans"


def _cost_excesses(law: dict) -> tuple[int, int, str]:
    return (law["cost"]["fell_by_less_than_the_stage"] if law["plans"] else 0), law["plans"], "plans"


def _wheel_speeds(scenario: Scenario) -> str:
    reference = scenario.reference
    span = f"{reference.wheel_speed_min_mps:g} to {reference.wheel_speed_max_mps:g} m/s"
    return f"{span}, any order" if reference.certified_for == "box" else f"those of the path in {span}"


def _slip_error(scenario: Scenario) -> str:
    slip = scenario.slip
    return f"{slip.relative_error:.0%} of {slip.nominal_right:g} right, {slip.nominal_left:g} left"


def _disturbance_set(scenario: Scenario) -> str:
    section = scenario.disturbance
    if section.bound == "computed":
        return "W is computed"
    return f"W assumed: {section.longitudinal_m:g} m, {section.lateral_m:g} m, {section.heading_deg:g} deg"


PREMISE = ("disturbance_bound_proved", "disturbance_in_w")
RECURSION = ("plan_stays_feasible", "shifted_plan_inclusion", "tightening_covers_reach")
CLAIMS = (
    Claim("W holds every disturbance of the robot", PREMISE, _laps_with("w_outside_W"), _disturbance_set),
    Claim(
        "an invariant terminal set exists over the certified wheel speeds",
        ("terminal_set_invariant", "terminal_set_admissible", "vertices_cover_schedule"),
    ),
    Claim("a plan is followed by a plan", (*RECURSION, *PREMISE), _laps_with("qp_infeasible", "qp_unsolved")),
    Claim("the tube holds the error around a plan", ("tightening_covers_reach", *PREMISE), _plans_outside),
    Claim("the error stays in E", ("true_error_in_e", *RECURSION, *PREMISE), _laps_with("e_outside_E")),
    Claim("inputs stay in U", ("input_sets_not_empty", *RECURSION, *PREMISE), _laps_with("u_outside_U")),
    Claim("wheels stay within their limits", ("wheel_limits", *RECURSION, *PREMISE), _laps_with("wheels_saturated")),
    Claim("the cost decreases", ("terminal_cost_decrease", "plan_stays_feasible"), _cost_excesses),
    Claim("wheel speeds covered", ("vertices_cover_schedule", "terminal_set_invariant"), scope=_wheel_speeds),
    Claim("slip error covered", ("disturbance_bound_proved",), scope=_slip_error),
    Claim("checked in exact arithmetic", ("checked_in_rationals",)),
)
WORDS = {
    "disturbance_bound_proved": "W holds no proved bound",
    "disturbance_in_w": "w leaves W",
    "plan_stays_feasible": "the next plan may not fit",
    "checked_in_rationals": "in floating point only",
    "terminal_set_invariant": "no invariant set",
}


def judge(claim: Claim, design: Tested) -> Verdict:
    """Return whether a design makes a claim, whether its certificate proves it, and how often it was seen to fail."""
    known = design.certificate.conditions
    # A design without caps of its own takes U from the wheel limits, so that the conditions on U are those on wheels.
    names = [name for name in claim.conditions if name in known or name != "wheel_limits"]
    failing = [name for name in names if name not in known or not known[name].holds]
    claimed = claim.conditions != ("checked_in_rationals",) or "checked_in_rationals" in known
    if failing:
        reasons = ", ".join(_reason(design.certificate, name) for name in failing)
        proof = f"no: {reasons}"
    else:
        proof = f"yes, margin {known[names[0]].margin:.3g}"
    seen = count(claim.refuted, design.laws) if claim.refuted else None
    return Verdict(claimed, not failing, claim.scope(design.scenario), proof, seen)


def _reason(certificate: Certificate, name: str) -> str:
    words = WORDS.get(name, name.replace("_", " "))
    condition = certificate.conditions.get(name)
    finite = condition is not None and abs(condition.margin) != float("inf")
    return f"{words} ({condition.margin:.3g})" if condition and finite else words


def count(refuted: Callable[[dict], tuple[int, int, str]], laws: dict[str, dict]) -> Count:
    """Add up over the laws how often a claim was refuted, and name the law under which it was most of all."""
    found = {name: refuted(law) for name, law in laws.items()}
    worst = max(found, key=lambda name: found[name][0] / max(found[name][1], 1))
    seen, of, unit = found[worst]
    totals = [sum(each[i] for each in found.values()) for i in range(2)]
    return Count(totals[0], totals[1], unit, worst if seen else "", seen, of)


def violating(law: dict) -> tuple[int, int]:
    """Return the least and the most laps that can have violated the guarantee."""
    laps = [law["events"][name]["laps"] for name in VIOLATIONS]
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
        "certified": design.certificate.holds,
        "certificate": {
            name: {"holds": each.holds, "margin": each.margin, "required": each.required}
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


# --------------------------------------------------------------------------------------------------------------- tables


def cells(claim: Claim, design: Tested) -> tuple[str, str, str]:
    """Return in words what a design claims, what is certified of it, and what was seen."""
    verdict = judge(claim, design)
    claimed = "no" if not verdict.claimed else f"yes: {verdict.claim}" if verdict.claim else "yes"
    return claimed, verdict.proof, _seen(verdict.seen) if verdict.seen else ""


def _seen(count: Count) -> str:
    text = f"{count.seen:,} of {count.of:,} {count.unit}"
    return f"{text}; worst: {count.worst}, {count.seen_there / count.of_there:.3g}" if count.seen else text


def totals(design: Tested) -> tuple[str, str, str]:
    """Return in words how much was tried, how many laps violated the guarantee, and the worst bound."""
    laws = design.laws
    least, most = (sum(violating(law)[i] for law in laws.values()) for i in range(2))
    violations = f"{least:,}" if least == most else f"{least:,} to {most:,}"
    worst = max(laws, key=lambda name: bound(laws[name]))
    tried = f"{sum(law['laps'] for law in laws.values()):,} in {sum(map(steps, laws.values())):,} steps"
    return tried, f"{violations} laps", f"{bound(laws[worst]):.3g} of the laps ({worst})"


TOTALS = ("laps tried", "that violate any of these", f"share, one law, at most ({CONFIDENCE:.0%})")
HEADINGS = ("claimed", "certified", "seen")


def text(tested: list[Tested]) -> str:
    """Return the report as text of at most 110 columns."""
    parts = [verdict(design) for design in tested]
    parts.append(claim_table(tested))
    parts += [law_table(design) for design in tested]
    parts += [legend(), *(design.note for design in tested if design.note)]
    return "\n\n".join("\n".join(_wrapped(part)) for part in parts)


def _wrapped(part: str) -> list[str]:
    return [line for row in part.split("\n") for line in (textwrap.wrap(row, 110) if len(row) > 110 else [row])]


def verdict(design: Tested) -> str:
    """Return one line: certified or not, and what the attack came to."""
    failing = ", ".join(design.certificate.failing)
    tried, violations, share = totals(design)
    proved = f"NOT CERTIFIED ({failing})" if failing else "CERTIFIED"
    return f"{design.name}: {proved}; {violations} of {tried} violate what is claimed"


def claim_table(tested: list[Tested]) -> str:
    """Return the claims side by side, three lines each: claimed, certified, seen."""
    lines = [
        _row("claim", "", [design.name for design in tested]),
        "-" * (CLAIM + LABEL + 2 + (CELL + 1) * len(tested)),
    ]
    for claim in CLAIMS:
        found = [cells(claim, design) for design in tested]
        lines.append(_rows(claim.title, zip(HEADINGS, zip(*found, strict=True), strict=True)))
    found = zip(*map(totals, tested), strict=True)
    lines += [_rows(title, [("", row)]) for title, row in zip(TOTALS, found, strict=True)]
    return "\n".join(lines)


def _rows(title: str, rows) -> str:
    """Lay out one claim: its title to the left of its labelled rows, cells wrapped; rows without words are left out."""
    lines = []
    for label, words in rows:
        if any(words):
            columns = [textwrap.wrap(cell or "-", CELL) for cell in words]
            for i in range(max(map(len, columns))):
                lines.append((label if i == 0 else "", [column[i] if i < len(column) else "" for column in columns]))
    titles = textwrap.wrap(title, CLAIM)
    lines += [("", [""])] * (len(titles) - len(lines))
    titles += [""] * (len(lines) - len(titles))
    return "\n".join(_row(title, *line) for title, line in zip(titles, lines, strict=True))


def _row(title: str, label: str, columns: list[str]) -> str:
    return f"{title:<{CLAIM}} {label:<{LABEL}}{''.join(f' {column:<{CELL}}' for column in columns)}".rstrip()


def law_table(design: Tested) -> str:
    """Return one line a law: laps in which each event occurred, rows active, greatest usage of W and E, the bound."""
    head = f"{design.name:<17}{'laps':>9}{'steps':>12}"
    head += "".join(f"{VIOLATIONS[name]:>8}" for name in SHOWN) + f"{'active':>8}{'W':>6}{'E':>6}{'at most':>9}"
    lines = [head, "-" * len(head)]
    for name, law in design.laws.items():
        counts = "".join(f"{law['events'][event]['laps']:>8}" for event in SHOWN)
        active = f"{law['events']['row_active']['share_of_steps']:.2%}"
        used = "".join(f"{law['worst'][kind][0]['usage']:>6.2f}" for kind in ("disturbance", "error"))
        lines.append(f"{name:<17}{law['laps']:>9,}{steps(law):>12,}{counts}{active:>8}{used}{bound(law):>9.2g}")
    return "\n".join(lines)


def legend() -> str:
    """Return what the columns mean."""
    return (
        "Laps by law: w outside W, e outside E, u outside U, wheels asked beyond their limits, QP infeasible, QP "
        'unsolved; a lap with any of these violates the guarantee ("at most": their share among laps of the law, at '
        f"{CONFIDENCE:.0%}, one-sided). active: share of steps with active rows. W, E: the most of each set that was "
        "used, 1 being its edge. edge: the first second, from the edge of the feasible set; else whole laps, from all "
        "over it."
    )


def markdown(tested: list[Tested]) -> str:
    """Return the same tables in Markdown."""
    head = ["claim", *(f"{design.name}: {heading}" for design in tested for heading in HEADINGS)]
    rows = [[claim.title, *(cell for each in tested for cell in cells(claim, each))] for claim in CLAIMS]
    laps = ["laps: tried, violating, share of one law at most", *(cell for design in tested for cell in totals(design))]
    parts = [*map(verdict, tested), _markdown_table(head, [*rows, laps])]
    parts += [_markdown_table(*_law_rows(design)) for design in tested]
    return "\n\n".join([*parts, legend(), *(design.note for design in tested if design.note)]) + "\n"


def _law_rows(design: Tested) -> tuple[list[str], list[list[str]]]:
    head = [design.name, "laps", "steps", *VIOLATIONS.values(), "active", "W", "E", "at most"]
    rows = []
    for name, law in design.laws.items():
        counts = [f"{law['events'][event]['laps']:,}" for event in VIOLATIONS]
        used = [f"{law['worst'][kind][0]['usage']:.4g}" for kind in ("disturbance", "error")]
        active = f"{law['events']['row_active']['share_of_steps']:.2%}"
        rows.append([name, f"{law['laps']:,}", f"{steps(law):,}", *counts, active, *used, f"{bound(law):.3g}"])
    return head, rows


def _markdown_table(head: list[str], rows: list[list[str]]) -> str:
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join(f"| {' | '.join(cell or '-' for cell in line)} |" for line in lines)
