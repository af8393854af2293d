"""The report of a Monte Carlo run: shares with exact bounds, quantiles, extremes; the verdict on W
comes first.

Shares of laps have Clopper-Pearson intervals; shares of steps or plans, which depend on each other
within a lap, have intervals over laps (`jaxtube.statistics.intervals`). All hold for the one
sampling law of the run.
"""

from __future__ import annotations

import msgspec
import numpy as np
from jaxtyping import Int

from jaxtube.experiments.montecarlo import tube_reach
from jaxtube.experiments.options import MontecarloOptions
from jaxtube.experiments.run.metrics import COORDINATES, TO_DISPLAY
from jaxtube.experiments.run.table import Column, format_table, left
from jaxtube.plant.reference import settled_step
from jaxtube.scenario import Scenario
from jaxtube.statistics import histogram
from jaxtube.statistics.intervals import mean_interval, share_interval
from jaxtube.statistics.run import RANKED, Statistics
from jaxtube.statistics.tally import EVENTS, STAGE_EVENTS
from jaxtube.synthesis.design import Design
from jaxtube.synthesis.feasible import RAYS

CONFIDENCE = 0.95
QUANTILES = {"median": 0.5, "p95": 0.95, "p999": 0.999}
EVENT_WORDS = {
    "w_outside_W": "w outside W",
    "w_outside_longitudinal": "  longitudinal",
    "w_outside_lateral": "  lateral",
    "w_outside_heading": "  heading",
    "e_outside_E": "e outside E",
    "e_outside_longitudinal": "  longitudinal",
    "e_outside_lateral": "  lateral",
    "e_outside_heading": "  heading",
    "u_outside_U": "u outside U",
    "wheels_saturated": "wheels at their limits",
    "qp_infeasible": "QP infeasible",
    "qp_unsolved": "QP unsolved",
    "row_active": "some row active",
    "backup": "backup in use",
    "outside_ultimate_bound": "outside the ultimate bound",
    "not_finite": "not finite",
}


def summary(design: Design, options: MontecarloOptions, statistics: Statistics) -> dict:
    """Return the numbers of a run, plain, with units in the keys: functions of design, options and
    statistics alone."""
    problem, steps = design.problem, statistics["events"].shape[1] - 1
    settled = settled_step(problem.reference)
    eligible = {"outside_ultimate_bound": steps + 1 - settled}
    events = {
        name: _event(row, eligible.get(name, steps))
        for name, row in zip(EVENTS, statistics["events"], strict=True)
        if name not in left_out(options, statistics)
    }
    return {
        "certificate": design.certificate.verdict,
        "law": law(problem.scenario, options),
        "confidence": CONFIDENCE,
        "laps": int(statistics["laps"]),
        "steps_a_lap": steps,
        "settled_s": settled * problem.reference.dt,
        "events": events,
        # Beyond each facet, in m, rad, m/s; negative inside.
        "largest_excess": {
            name: statistics[f"excess/{name}"] for name in ("disturbance", "error", "input")
        },
        "ultimate_bound": dict(
            zip(COORDINATES, statistics["ultimate_bound"] * TO_DISPLAY, strict=True)
        ),
        "plans": int(statistics["plans"]),
        **(_plans(design, options, statistics) if statistics["plans"] else {}),
        "peak_error": _quantiles(statistics["peak"]),
        "rms_error_settled": _quantiles(statistics["rms"]),
        "disturbance": _quantiles(statistics["disturbance"]),
        "worst": {
            name: [
                {"lap": int(lap), "usage": float(usage)}
                for lap, usage in zip(
                    statistics[f"worst_lap/{name}"], statistics[f"worst_usage/{name}"], strict=True
                )
            ]
            for name in RANKED
        },
        **(
            {"reach": tube_reach.metrics(design, options.seed)} if options.plant == "linear" else {}
        ),
    }


def left_out(options: MontecarloOptions, statistics: Statistics) -> set[str]:
    """Return the events that a run of this kind cannot have, so that nothing is said of them."""
    missing = (
        set()
        if options.controller.endswith("mpc")
        else {"qp_infeasible", "qp_unsolved", "row_active", "backup"}
    )
    missing |= {"wheels_saturated"} if options.plant == "linear" else set()
    return missing | (
        set() if np.all(np.isfinite(statistics["ultimate_bound"])) else {"outside_ultimate_bound"}
    )


def _plans(design: Design, options: MontecarloOptions, statistics: Statistics) -> dict:
    """Return what became of the plans that were followed: the tube in use by stage, all tubes, and
    the cost."""
    checked = [name for name in design.tubes if f"tube_outside/{name}" in statistics]
    conditions = design.certificate.conditions
    promised = options.controller == "tube_mpc" and all(
        conditions[name].holds
        for name in ("plan_stays_feasible", "terminal_cost_decrease")
        if name in conditions
    )
    planned = statistics["plans_by_lap"]
    return {
        "states_where_a_plan_was_asked_for": int(planned.sum()) * (len(planned) - 1),
        "tube": {
            "used": design.problem.scenario.controller.tube,
            "stages": [
                {
                    name: _share_of_plans(row, planned)
                    for name, row in zip(STAGE_EVENTS, stage, strict=True)
                }
                for stage in statistics["stage_events"]
            ],
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


def law(scenario: Scenario, options: MontecarloOptions) -> str:
    """Return the sampling law in words; every bound holds for it alone."""
    where = {
        "scenario": "the scenario's start",
        "feasible": f"starts uniform in the hull of {RAYS} boundary points of the feasible set",
        "edge": f"starts on the hull of {RAYS} boundary points of the feasible set",
    }[options.starts]
    if options.plant == "linear":
        return f"{options.controller} on the linear model, w in W (half of the draws at its vertices), {where}"
    slip, noise = scenario.slip, msgspec.structs.astuple(scenario.noise)
    varies = {"true": "true slip", "measured": "measured slip", "both": "true and measured slip"}[
        slip.random
    ]
    measured = "pose measured exactly"
    if any(noise):
        measured = (
            f"pose noise uniform within {noise[0]:.3g} m, {noise[1]:.3g} m, {noise[2]:.3g} deg"
        )
    spread = "at" if slip.process in ("vertex", "adversarial") else "uniform within"
    return (
        f"{options.controller} on the slipping robot, {varies} ({slip.process}) {spread} +-"
        f"{slip.relative_error:.3g} of its nominal value, {measured}, {where}"
    )


def _event(row: Int[np.ndarray, " counts"], steps: int) -> dict:
    row = row[: steps + 1]
    laps, total = int(row[1:].sum()), int(row.sum())
    mean, low, high = mean_interval(row, steps, CONFIDENCE)
    return {
        "laps": laps,
        "share_of_laps": laps / total,
        "share_of_laps_interval": share_interval(laps, total, CONFIDENCE),
        "steps": int(row @ np.arange(steps + 1)),
        "share_of_steps": mean,
        "share_of_steps_interval": (low, high),
    }


def _share_of_plans(row: Int[np.ndarray, " counts"], planned: Int[np.ndarray, " counts"]) -> dict:
    """Return the share of plans in which an event occurred: a ratio of two means, each bounded at
    half the risk."""
    half = 1 - (1 - CONFIDENCE) / 2
    (mean, low, high), (plans, least, most) = (
        mean_interval(counts, len(row) - 1, half) for counts in (row, planned)
    )
    return {
        "share": mean / plans,
        "interval": (low / most, min(high / least, 1.0) if least else 1.0),
    }


def _quantiles(counts: Int[np.ndarray, "3 buckets"]) -> dict:
    found = {
        name: histogram.quantile(counts, share) * TO_DISPLAY for name, share in QUANTILES.items()
    }
    return {
        name: dict(zip(COORDINATES, values.tolist(), strict=True)) for name, values in found.items()
    }


def text(options: MontecarloOptions, found: dict, performance: dict) -> str:
    """Return the report; the verdict on the tube's premise is its first line."""
    parts = [
        verdict(found),
        f"certificate: {found['certificate']}",
        f"law: {found['law']}; seed {options.seed}; {found['laps']:,} laps",
        _event_table(found),
    ]
    if found["plans"]:
        parts.append(_tube_table(found))
    if "reach" in found:
        parts.append(tube_reach.table(found["reach"]))
    parts += [_quantile_table(found), _worst(found)]
    if performance:
        parts.append(_performance(performance))
    return "\n\n".join(parts)


def verdict(found: dict) -> str:
    """Return one line: does the disturbance set hold, do plans keep to the tube, and was E kept."""
    w, e, percent = (
        found["events"]["w_outside_W"],
        found["events"]["e_outside_E"],
        f"{found['confidence']:.0%}",
    )
    if w["laps"]:
        low, high = w["share_of_steps_interval"]
        premise = f"w leaves W in {w['share_of_steps']:.2%} of the steps ({percent}: {low:.2%} to {high:.2%})"
        parts = [
            f"{name} {found['events'][f'w_outside_{name}']['share_of_steps']:.2%}"
            for name in ("longitudinal", "lateral", "heading")
        ]
        premise += f" [{', '.join(parts)}]: the tube's premise does not hold here"
    else:
        premise = f"w stayed in W in every step ({percent}: in at most {_bound(w)} of the laps it would not)"
    kept = f"{e['laps']:,} of {found['laps']:,} laps left E ({_interval(e['share_of_laps_interval'], e['laps'])})"
    if not found["plans"]:
        return f"{premise}; {kept}"
    stages = [stage["outside"]["share"] for stage in found["tube"]["stages"]]
    followed = ", ".join(f"{share:.2%}" for share in stages)
    return f"{premise}; plans leave R_1 .. R_{len(stages)} in {followed}; {kept}"


def _bound(event: dict) -> str:
    return f"{event['share_of_laps_interval'][1]:.3g}"


def _interval(interval: tuple[float, float], events: int) -> str:
    low, high = interval
    return f"at most {high:.3g}" if not events else f"{low:.4g} to {high:.4g}"


def _event_table(found: dict) -> str:
    columns = [
        left(f"each at {found['confidence']:.0%} on its own"),
        Column("laps"),
        Column("share of laps, interval"),
        Column("share of steps"),
        Column("interval"),
    ]
    table = format_table(columns, [_event_row(*item) for item in found["events"].items()])
    if "outside_ultimate_bound" not in found["events"]:
        return table
    bound = ", ".join(f"{value:.3g}" for value in found["ultimate_bound"].values())
    return (
        f"{table}\nultimate bound ({bound}; m, m, deg): holds the measured error from "
        f"{found['settled_s']:.3g} s on while w is in W and no row is active"
    )


def _event_row(name: str, event: dict) -> list[str]:
    return [
        EVENT_WORDS[name],
        f"{event['laps']:,}",
        _interval(event["share_of_laps_interval"], event["laps"]),
        f"{event['share_of_steps']:.4%}" if event["steps"] else "0",
        _interval(event["share_of_steps_interval"], event["steps"]),
    ]


def _tube_table(found: dict) -> str:
    tube = found["tube"]
    cost = found["cost"]
    asked = found["states_where_a_plan_was_asked_for"]
    columns = [
        left(""),
        Column("any facet"),
        Column("interval"),
        Column("longitudinal"),
        Column("lateral"),
        Column("heading"),
    ]
    rows = [_stage_row(j, stage) for j, stage in enumerate(tube["stages"], 1)]
    worst = ", ".join(
        f"{name} {float(np.max(values)):.3g}"
        for name, values in tube["largest_excess_by_stage"].items()
    )
    promise = (
        "promises more"
        if cost["promised_by_the_certificate"]
        else "makes no promise for this design"
    )
    lines = [
        f"{found['plans']:,} plans from the measured error, followed to their end; share of them "
        f"outside R_j of the tube `{tube['used']}`",
        format_table(columns, rows),
        "largest excess over a facet, all stages (m or rad; negative: inside):",
        f"  {worst}",
        f"there was no plan at {asked - found['plans']:,} of {asked:,} states",
        f"one undisturbed step later: no plan in {cost['no_plan_one_step_later']:,} cases, a cost "
        "that fell by less than that of the step in "
        f"{cost['fell_by_less_than_the_stage']:,} (the certificate {promise})",
    ]
    return "\n".join(lines)


def _stage_row(j: int, stage: dict) -> list[str]:
    low, high = stage["outside"]["interval"]
    outside, *by_coordinate = (stage[name]["share"] for name in STAGE_EVENTS)
    return [
        f"R_{j}",
        f"{outside:.4%}",
        f"{low:.4%} to {high:.4%}",
        *(f"{share:.4%}" for share in by_coordinate),
    ]


def _quantile_table(found: dict) -> str:
    quantiles = {"median": "median", "p999": "99.9 %"}
    headings = [f"{name} {unit}" for unit in quantiles.values() for name in AXES]
    rows = {
        "largest error of a lap": "peak_error",
        f"RMS error from {found['settled_s']:.3g} s on": "rms_error_settled",
        "w, steps": "disturbance",
    }
    body = []
    for label, key in rows.items():
        values = [found[key][quantile][name] for quantile in quantiles for name in COORDINATES]
        body.append([label, *(f"{value:.3g}" for value in values)])
    table = format_table([left(""), *map(Column, headings)], body)
    return f"{table}\nquantiles are read off buckets and up to 12 % too large or too small"


AXES = ("e_x [m]", "e_y [m]", "e_th [deg]")


def _worst(found: dict) -> str:
    names = {"error": "E", "disturbance": "W", "tube": "the tube"}
    lines = ["worst laps, 1 being a facet (--replay LAP draws one: errors, w and wheels):"]
    for key, label in names.items():
        laps = ", ".join(
            f"{entry['lap']} ({entry['usage']:.4g})" for entry in found["worst"][key][:4]
        )
        lines.append(f"  {label:<9} {laps}")
    return "\n".join(lines)


def _performance(performance: dict) -> str:
    parts = [f"{performance['laps']:,} laps in {performance['seconds']:.1f} s"]
    parts.append(
        f"first results, with compilation, after {performance['first_results_seconds']:.1f} s"
    )
    if performance["laps_per_second"]:
        parts.append(f"then {performance['laps_per_second']:,.0f} laps a second")
    if "validation_share" in performance:
        parts.append(
            f"{performance['validation_share']:.0%} of the computing time spent in validation"
        )
    parts.append(f"peak memory {performance['peak_memory_bytes'] / 2**20:,.0f} MiB")
    return "; ".join(parts)
