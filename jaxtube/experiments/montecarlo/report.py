"""The report of a Monte Carlo run: a verdict of one line, then what it rests on: shares with exact
bounds, quantiles, extremes."""

from __future__ import annotations

import textwrap

import numpy as np

from jaxtube import qp
from jaxtube.coordinates import COORDINATES, KEYS, NAMES
from jaxtube.experiments.montecarlo import tube_reach
from jaxtube.experiments.run.limits import describe_error_set
from jaxtube.experiments.run.table import WIDTH, Column, format_table, left, wrap
from jaxtube.statistics.events import EVENTS, Event
from jaxtube.statistics.tally import STAGE_EVENTS
from jaxtube.synthesis.problem import Problem


def text(problem: Problem, seed: int, summary: dict, performance: dict) -> str:
    """Return the report; the verdict is its first line."""
    parts = [
        say_verdict(summary),
        findings(summary),
        f"certificate: {summary['certificate']}",
        _describe_law(seed, summary),
        describe_error_set(problem),
        _event_table(summary),
    ]
    if summary["plans"]:
        parts.append(_tube_table(summary))
    if "reach" in summary:
        parts.append(tube_reach.table(summary["reach"]))
    parts += [_quantile_table(summary), _list_worst(summary)]
    if performance:
        parts.append(_describe_performance(performance))
    return "\n\n".join(parts)


def say_verdict(summary: dict) -> str:
    """Return one short line: whether w stayed in W, the tube's premise, and how many laps left
    E."""
    outside = summary["events"]["e_outside_E"]["laps"]
    kept = f"{outside:,} of {summary['laps']:,} laps left E"
    if summary["events"]["w_outside_W"]["laps"]:
        return f"w left W, so the tube's premise does not hold here; {kept}"
    return f"w stayed in W in every step; {kept}"


def findings(summary: dict) -> str:
    """Return the shares behind the verdict, with their bounds."""
    left_e = summary["events"]["e_outside_E"]
    interval = _interval(left_e["share_of_laps_interval"], left_e["laps"])
    lines = [
        f"at {summary['confidence']:.0%} confidence:",
        *_describe_disturbance(summary),
        f"share of the laps that leave E: {interval}",
    ]
    if "wheel_acceleration" in summary:
        lines.append(_describe_acceleration(summary))
    if summary["plans"]:
        lines.append(_describe_plans(summary["tube"]["stages"]))
    return "\n  ".join([*lines, *_describe_unsolved(summary["events"])])


def _describe_unsolved(events: dict[str, dict]) -> list[str]:
    """Return a line for each kind of QP without a solution that occurred."""
    statuses = {"qp_infeasible": qp.INFEASIBLE, "qp_unsolved": qp.UNSOLVED}
    counts = {status: events[name]["steps"] for name, status in statuses.items() if name in events}
    return qp.describe_unsolved(counts)


def _describe_disturbance(summary: dict) -> list[str]:
    events = summary["events"]
    outside = events["w_outside_W"]
    if not outside["laps"]:
        high = outside["share_of_laps_interval"][1]
        return [f"share of the laps in which w leaves W: at most {high:.3g}"]
    low, high = outside["share_of_steps_interval"]
    shares = {name: events[f"w_outside_{name}"]["share_of_steps"] for name in NAMES}
    return [
        f"w outside W in {outside['share_of_steps']:.2%} of the steps ({low:.2%} to {high:.2%})",
        f"  by coordinate: {', '.join(f'{name} {share:.2%}' for name, share in shares.items())}",
    ]


def _describe_acceleration(summary: dict) -> str:
    laps = summary["events"]["acceleration_exceeded"]["laps"]
    largest = summary["wheel_acceleration"]["largest_mps2"]
    limit = summary["wheel_acceleration"]["limit_mps2"]
    return (
        f"commands change by {largest:.3g} m/s^2 at most from one period to the next, the wheels' "
        f"limit is {limit:g}: beyond it in {laps:,} laps"
    )


def _describe_plans(stages: list[dict]) -> str:
    shares = [stage["outside"]["share"] for stage in stages]
    largest = max(shares)
    if not largest:
        return "no plan that was followed left the tube"
    stage = 1 + shares.index(largest)
    return f"largest share of the plans outside the tube: {largest:.2%}, at R_{stage}"


def _describe_law(seed: int, summary: dict) -> str:
    law = textwrap.fill(summary["law"], WIDTH, initial_indent="  ", subsequent_indent="  ")
    return (
        f"law, what laps are drawn from; all bounds hold for it alone:\n{law}\n"
        f"  {summary['laps']:,} laps, seed {seed}"
    )


def _interval(interval: tuple[float, float], events: int) -> str:
    low, high = interval
    return f"{low:.4g} to {high:.4g}" if events else f"at most {high:.3g}"


def _event_table(summary: dict) -> str:
    columns = [
        left(f"each at {summary['confidence']:.0%} on its own"),
        Column("laps"),
        Column("share of laps, interval"),
        Column("share of steps"),
        Column("interval"),
    ]
    counted = [event for event in EVENTS if event.name in summary["events"]]
    rows = [_event_row(event, summary["events"][event.name]) for event in counted]
    meanings = [f"  {event.words}: {event.meaning}" for event in counted if not event.part]
    lines = [format_table(columns, rows), *meanings]
    if "outside_ultimate_bound" in summary["events"]:
        lines.append(_describe_ultimate_bound(summary))
    return "\n".join(lines)


def _event_row(event: Event, numbers: dict) -> list[str]:
    return [
        f"  {event.words}" if event.part else event.words,
        f"{numbers['laps']:,}",
        _interval(numbers["share_of_laps_interval"], numbers["laps"]),
        f"{numbers['share_of_steps']:.4%}" if numbers["steps"] else "0",
        _interval(numbers["share_of_steps_interval"], numbers["steps"]),
    ]


def _describe_ultimate_bound(summary: dict) -> str:
    bound = ", ".join(f"{value:.3g}" for value in summary["ultimate_bound"].values())
    units = ", ".join(coordinate.unit for coordinate in COORDINATES)
    return (
        f"  ultimate bound ({bound}; {units}): holds the error that the controller sees\n"
        f"  from {summary['settled_s']:.3g} s on while w is in W and no constraint of the plan is "
        "active"
    )


def _tube_table(summary: dict) -> str:
    tube = summary["tube"]
    cost = summary["cost"]
    asked = summary["states_where_a_plan_was_asked_for"]
    columns = [left(""), Column("any facet"), Column("interval"), *map(Column, NAMES)]
    rows = [_stage_row(j, stage) for j, stage in enumerate(tube["stages"], 1)]
    largest = ", ".join(
        f"{name} {float(np.max(values)):.3g}"
        for name, values in tube["largest_excess_by_stage"].items()
    )
    is_promised = cost["promised_by_the_certificate"]
    promise = "promises more" if is_promised else "makes no promise for this design"
    lines = [
        *wrap(
            f"{summary['plans']:,} plans from the error that the controller sees, followed to "
            f"their end; share of them outside R_j of the tube `{tube['used']}`"
        ),
        format_table(columns, rows),
        "largest excess over a facet, all stages (m or rad; negative: inside):",
        f"  {largest}",
        f"there was no plan at {asked - summary['plans']:,} of {asked:,} states",
        f"one undisturbed step later: no plan in {cost['no_plan_one_step_later']:,} cases; a cost "
        "that fell by less than that of the",
        f"  step in {cost['fell_by_less_than_the_stage']:,} (the certificate {promise})",
    ]
    return "\n".join(lines)


def _stage_row(j: int, stage: dict) -> list[str]:
    low, high = stage["outside"]["interval"]
    shares = [f"{stage[name]['share']:.4%}" for name in STAGE_EVENTS]
    return [f"R_{j}", shares[0], f"{low:.4%} to {high:.4%}", *shares[1:]]


def _quantile_table(summary: dict) -> str:
    quantiles = {"median": "median", "p999": "99.9 %"}
    columns = [left("")]
    for words in quantiles.values():
        columns += [Column(f"{words}\n{axis.symbol}", axis.unit) for axis in COORDINATES]
    kinds = {
        "largest error of a lap": "peak_error",
        f"RMS error from {summary['settled_s']:.3g} s on": "rms_error_settled",
        "w, steps": "disturbance",
    }
    rows = []
    for label, kind in kinds.items():
        values = [summary[kind][quantile][key] for quantile in quantiles for key in KEYS]
        rows.append([label, *(f"{value:.3g}" for value in values)])
    table = format_table(columns, rows)
    return f"{table}\nquantiles are read off buckets and up to 12 % too large or too small"


def _list_worst(summary: dict) -> str:
    names = {"error": "E", "disturbance": "W", "tube": "the tube"}
    lines = [
        "worst laps, and how far each went as a share of the set, 1 being its boundary",
        "(--replay LAP draws one: errors, w and wheels):",
    ]
    for kind, label in names.items():
        worst = summary["worst"][kind][:4]
        laps = ", ".join(f"{entry['lap']} ({entry['usage']:.4g})" for entry in worst)
        lines.append(f"  {label:<9} {laps}")
    return "\n".join(lines)


def _describe_performance(performance: dict) -> str:
    parts = [
        f"{performance['laps']:,} laps in {performance['seconds']:.1f} s",
        f"first results, with compilation, after {performance['first_results_seconds']:.1f} s",
    ]
    if performance["laps_per_second"]:
        parts.append(f"then {performance['laps_per_second']:,.0f} laps a second")
    parts.append(f"peak memory {performance['peak_memory_bytes'] / 2**20:,.0f} MiB")
    return "; ".join(parts)
