"""`bench loop`: its tables and its metrics.

Source: new.
"""

from __future__ import annotations

from jaxtube.experiments.bench import loops
from jaxtube.experiments.bench.cases import LOOPS, Case, choose_cases
from jaxtube.experiments.bench.loops import CLOCK, DAQP, FULL, QUICK, LoopResult
from jaxtube.experiments.bench.peers.catalogue import EXACT
from jaxtube.experiments.bench.pinned import run_pinned
from jaxtube.experiments.bench.rounds import Spread, spread, write_number
from jaxtube.experiments.bench.topic import Headline, Told, Topic, describe, say_verdict
from jaxtube.experiments.options import BenchOptions
from jaxtube.experiments.run.folder import RunFolder
from jaxtube.experiments.run.table import Column, format_table, left, wrap
from jaxtube.scenario.tree import Scenario

TIMED = ("bare", "checked", DAQP, CLOCK)
SPEEDS = [
    left("laps"),
    Column("active", "%"),
    *(Column(name.replace(" ", "\n", 1), "M/s") for name in TIMED),
    Column("largest\nresidual"),
    Column("unsolved"),
    Column("wrong"),
]
COMPARED = {
    "bare over\nDAQP from Python": ("bare", DAQP),
    "checked over\nDAQP from Python": ("checked", DAQP),
    "bare over\nDAQP's own clock": ("bare", CLOCK),
    "checked over\nDAQP's own clock": ("checked", CLOCK),
}


def run(scenario: Scenario, options: BenchOptions, folder: RunFolder) -> Told:
    """Measure and print the tables."""
    cases = choose_cases(scenario, options, LOOPS)
    results = run_pinned(1, loops.measure, cases, options.seed, QUICK if options.quick else FULL)
    told = headlines(cases, results)
    folder.report(f"{say_verdict(told)}\n")
    folder.report(f"{write_speeds(cases, results)}\n")
    if EXACT[0].is_installed:
        folder.report(f"{write_ratios(cases, results)}\n")
    folder.report(write_notes(results))
    names = [f"{case.name}_{case.starts}" for case in cases]
    found = dict(zip(names, map(metrics, results), strict=True))
    return Told(found, told)


TOPIC = Topic(
    "compiles closed loops of four scenarios, records the programs of their laps, and runs all of "
    "them in turn: about three minutes",
    run,
)


def write_speeds(cases: list[Case], results: list[LoopResult]) -> str:
    """Return periods a second of the loops as a table."""
    rows = []
    for case, result in zip(cases, results, strict=True):
        speeds = [write_speed(result, name) if name in result.seconds else "-" for name in TIMED]
        rows.append(
            [
                case.words,
                f"{100 * result.active:.3g}",
                *speeds,
                f"{result.largest_residual:.0e}",
                f"{result.unsolved:,}",
                "-" if result.wrong is None else f"{result.wrong:,}",
            ]
        )
    return format_table(SPEEDS, rows)


def write_ratios(cases: list[Case], results: list[LoopResult]) -> str:
    """Return how many times as many periods the loops do as DAQP does programs."""
    rows = [
        [case.words, *(str(each) for each in ratios(result).values())]
        for case, result in zip(cases, results, strict=True)
    ]
    return format_table([left("laps"), *map(Column, COMPARED)], rows)


def ratios(result: LoopResult) -> dict[str, Spread]:
    """Return the speeds of loops over those of DAQP, round by round."""
    return {
        title: spread(result.seconds[other] / result.seconds[name])
        for title, (name, other) in COMPARED.items()
        if other in result.seconds
    }


def write_notes(results: list[LoopResult]) -> str:
    """Say what the numbers are."""
    laps, recorded = results[0].periods
    text = (
        "Million periods a second on one thread, medians of rounds in which all columns of a row "
        f"had their turn; in brackets quartiles. The loops run {laps:,} periods: robot, draws, "
        "tube-MPC; checked: with all that `montecarlo` checks. DAQP solves the programs of "
        f"{recorded:,} of them alone, recorded, one model a window, started at the rows that were "
        "active last: updated and solved from Python, and by its own clock, which leaves out the "
        "update. Active, unsolved, wrong (more than 1e-6 from DAQP's plan): of those."
    )
    cure = "" if EXACT[0].is_installed else f" DAQP: {EXACT[0].cure}."
    return "\n".join(wrap(text + cure))


def metrics(result: LoopResult) -> dict:
    """Return what was measured of a loop."""
    comparisons = {
        title.replace("\n", " "): describe(each) for title, each in ratios(result).items()
    }
    return {
        "periods": result.periods[0],
        "recorded_periods": result.periods[1],
        "share_active": result.active,
        "unsolved": result.unsolved,
        "largest_residual": result.largest_residual,
        "wrong": result.wrong,
        "s_a_period": {name: describe(spread(each)) for name, each in result.seconds.items()},
        **comparisons,
    }


def headlines(cases: list[Case], results: list[LoopResult]) -> list[Headline]:
    """Return what the table of all topics shows."""
    lines = []
    for case, result in zip(cases, results, strict=True):
        for title, found in ratios(result).items():
            name, peer = COMPARED[title]
            lines.append(
                Headline(
                    what=f"loop, {case.words}, {name}",
                    ours=f"{write_speed(result, name)} M/s",
                    peer=f"{peer}: {write_speed(result, peer)} M/s",
                    ratio=str(found),
                    residual=f"{result.largest_residual:.0e}",
                )
            )
    return lines


def write_speed(result: LoopResult, name: str) -> str:
    """Return million periods a second, the median of rounds."""
    return write_number(1e-6 / spread(result.seconds[name]).median)
