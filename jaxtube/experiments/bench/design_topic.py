"""`bench design`: its tables and its metrics.

Source: new.
"""

from __future__ import annotations

from jaxtube.experiments.bench import designs
from jaxtube.experiments.bench.cases import name_scenarios
from jaxtube.experiments.bench.designs import FULL, QUICK, DesignResult, SetResult
from jaxtube.experiments.bench.peers import invariant_sets
from jaxtube.experiments.bench.pinned import run_pinned
from jaxtube.experiments.bench.rounds import spread, write_number
from jaxtube.experiments.bench.topic import Headline, Told, Topic, describe, say_verdict
from jaxtube.experiments.options import BenchOptions
from jaxtube.experiments.run.folder import RunFolder
from jaxtube.experiments.run.table import Column, format_table, left, wrap
from jaxtube.scenario.tree import Scenario

USUAL = ("paper", "certified", "husky")


def run(scenario: Scenario, options: BenchOptions, folder: RunFolder) -> Told:
    """Measure and print the tables."""
    extent = QUICK if options.quick else FULL
    # A process each: what is called first there is a first call.
    results = {
        name: run_pinned(1, designs.measure, each, extent)
        for name, each in name_scenarios(scenario, options, USUAL)
    }
    told = headlines(results)
    folder.report(f"{say_verdict(told)}\n")
    folder.report(f"{write_stages(results)}\n")
    folder.report(write_sets(results))
    found = {name: metrics(result) for name, result in results.items()}
    return Told(found, told)


TOPIC = Topic(
    "designs three scenarios, each in a new process and then again; finds their maximal invariant "
    "sets twice: about a minute",
    run,
)


def write_stages(results: dict[str, DesignResult]) -> str:
    """Return seconds by stage as a table."""
    stages = list(next(iter(results.values())).first)
    columns = [left("scenario"), *(Column(stage.replace("_", "\n"), "s") for stage in stages)]
    columns += [Column("first\ncall", "s"), Column("call\nafter it", "s")]
    rows = [
        [
            name,
            *(write_number(result.first[stage], 2) for stage in stages),
            write_number(result.first_s),
            str(spread(result.repeated)),
        ]
        for name, result in results.items()
    ]
    text = (
        "Seconds of the processor, one thread, after the imports; the stages are those of the "
        "first call in a new process. Rationals are part of the certificate, asked again alone."
    )
    return "\n".join([format_table(columns, rows), "", *wrap(text)])


def write_sets(results: dict[str, DesignResult]) -> str:
    """Return seconds of maximal invariant sets as a table."""
    columns = [
        left("maximal\ninvariant set"),
        Column("facets"),
        Column("sets", "ms"),
        Column("polytope", "ms"),
        Column("its steps"),
        Column("its time\nover ours"),
        Column("largest\ndifference"),
    ]
    rows = [_write_set(name, result.invariant) for name, result in results.items()]
    text = (
        "Both find the same set by the same recursion, to the same tolerance; `polytope` reduces "
        "by linear programs, scipy's unless it finds cvxopt. Where it was stopped, its steps are "
        "those it did, and its time is more. Difference: by which share the smaller set has to "
        "grow to contain the other one."
    )
    return "\n".join([format_table(columns, rows), "", *wrap(text)])


def _write_set(name: str, found: SetResult | None) -> list[str]:
    if found is None:
        return [name, "there is none", "", "", "", "", ""]
    ours = f"{1e3 * spread(found.seconds).median:.2f}"
    if found.peer is None:
        return [name, f"{found.facets}", ours, invariant_sets.CURE, "", "", ""]
    ended = found.peer.polytope is not None
    more = "" if ended else "> "
    return [
        name,
        f"{found.facets}",
        ours,
        f"{more}{1e3 * found.peer.seconds:,.0f}",
        f"{found.peer.steps}" if ended else f"stopped after {found.peer.steps}",
        f"{more}{ratio(found):,.0f}",
        f"{found.difference:.0e}" if ended else "-",
    ]


def ratio(found: SetResult) -> float:
    """Return the peer's time over ours; that until it was stopped where it did not end."""
    assert found.peer
    return found.peer.seconds / spread(found.seconds).median


def metrics(result: DesignResult) -> dict:
    """Return what was measured of a scenario."""
    numbers: dict = {
        "verdict": result.certified,
        "first_call_s": result.first_s,
        "first_call_by_stage_s": result.first,
        "repeated_call_s": describe(spread(result.repeated)),
    }
    found = result.invariant
    if found:
        numbers["invariant_set"] = {
            "facets": found.facets,
            "s": describe(spread(found.seconds)),
        }
    if found and found.peer:
        numbers["invariant_set"] |= {
            "polytope_s": found.peer.seconds,
            "polytope_steps": found.peer.steps,
            "polytope_ended": found.peer.polytope is not None,
            "polytope_over_ours": ratio(found),
            "difference": found.difference,
        }
    return numbers


def headlines(results: dict[str, DesignResult]) -> list[Headline]:
    """Return what the table of all topics shows."""
    lines = []
    for name, result in results.items():
        again = spread(result.repeated).median
        ours = f"{write_number(result.first_s)} s, then {write_number(again)} s"
        lines.append(Headline(f"design, {name}", ours, "", ""))
        found = result.invariant
        if found and found.peer:
            more = "" if found.peer.polytope is not None else "> "
            lines.append(
                Headline(
                    f"design, {name}: maximal invariant set",
                    f"{1e3 * spread(found.seconds).median:.2f} ms",
                    f"polytope: {more}{1e3 * found.peer.seconds:,.0f} ms",
                    f"{more}{ratio(found):,.0f}",
                )
            )
    return lines
