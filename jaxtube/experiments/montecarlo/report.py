"""The report of a Monte Carlo run: the verdict on W first, then shares with exact bounds,
quantiles, extremes."""

from __future__ import annotations

import numpy as np

from jaxtube.coordinates import KEYS, NAMES
from jaxtube.experiments.montecarlo import tube_reach
from jaxtube.experiments.run.table import Column, format_table, left
from jaxtube.statistics.events import EVENTS, Event
from jaxtube.statistics.tally import STAGE_EVENTS


def text(seed: int, found: dict, performance: dict) -> str:
    """Return the report; the verdict on the tube's premise is its first line."""
    parts = [
        verdict(found),
        f"certificate: {found['certificate']}",
        f"law: {found['law']}; seed {seed}; {found['laps']:,} laps",
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
    e = found["events"]["e_outside_E"]
    interval = _interval(e["share_of_laps_interval"], e["laps"])
    kept = f"{e['laps']:,} of {found['laps']:,} laps left E ({interval})"
    if not found["plans"]:
        return f"{_premise(found)}; {kept}"
    stages = [stage["outside"]["share"] for stage in found["tube"]["stages"]]
    followed = ", ".join(f"{share:.2%}" for share in stages)
    return f"{_premise(found)}; plans leave R_1 .. R_{len(stages)} in {followed}; {kept}"


def _premise(found: dict) -> str:
    """Return what was seen of the tube's premise, w in W."""
    w = found["events"]["w_outside_W"]
    percent = f"{found['confidence']:.0%}"
    if not w["laps"]:
        return (
            f"w stayed in W in every step ({percent}: in at most {_bound(w)} of the laps it would "
            "not)"
        )
    low, high = w["share_of_steps_interval"]
    shares = {name: found["events"][f"w_outside_{name}"]["share_of_steps"] for name in NAMES}
    parts = ", ".join(f"{name} {share:.2%}" for name, share in shares.items())
    return (
        f"w leaves W in {w['share_of_steps']:.2%} of the steps ({percent}: {low:.2%} to {high:.2%})"
        f" [{parts}]: the tube's premise does not hold here"
    )


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
    counted = [event for event in EVENTS if event.name in found["events"]]
    rows = [_event_row(event, found["events"][event.name]) for event in counted]
    table = format_table(columns, rows)
    if "outside_ultimate_bound" not in found["events"]:
        return table
    bound = ", ".join(f"{value:.3g}" for value in found["ultimate_bound"].values())
    return (
        f"{table}\nultimate bound ({bound}; m, m, deg): holds the measured error from "
        f"{found['settled_s']:.3g} s on while w is in W and no row is active"
    )


def _event_row(event: Event, numbers: dict) -> list[str]:
    return [
        f"  {event.words}" if event.part else event.words,
        f"{numbers['laps']:,}",
        _interval(numbers["share_of_laps_interval"], numbers["laps"]),
        f"{numbers['share_of_steps']:.4%}" if numbers["steps"] else "0",
        _interval(numbers["share_of_steps_interval"], numbers["steps"]),
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
        values = [found[key][quantile][name] for quantile in quantiles for name in KEYS]
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
