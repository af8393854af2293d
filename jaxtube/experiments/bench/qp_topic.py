"""`bench qp`: its table, its figure and its metrics.

Source: new.
"""

from __future__ import annotations

from jaxtube.experiments.bench import qp_figure, solvers
from jaxtube.experiments.bench.cases import FAMILIES, choose_cases
from jaxtube.experiments.bench.peers.catalogue import tight_peers
from jaxtube.experiments.bench.pinned import run_pinned
from jaxtube.experiments.bench.rounds import Spread, spread, write_number
from jaxtube.experiments.bench.solvers import FULL, KNOWING, OURS, QUICK, FamilyResult, Measured
from jaxtube.experiments.bench.topic import Headline, Told, Topic, describe, say_verdict
from jaxtube.experiments.options import BenchOptions
from jaxtube.experiments.run.folder import RunFolder
from jaxtube.experiments.run.table import WIDTH, Column, format_table, left, wrap
from jaxtube.qp.fixed_point import TOLERANCE
from jaxtube.scenario.tree import Scenario

COLUMNS = [
    left("solver"),
    Column("us a\nprogram"),
    Column("its time over\njaxtube's"),
    Column("over jaxtube's\nwith regions"),
    Column("largest\nresidual"),
    Column(f"above\n{TOLERANCE[8]:.0e}"),
    Column("wrong"),
]
COMPARED = (OURS, KNOWING)


def run(scenario: Scenario, options: BenchOptions, folder: RunFolder) -> Told:
    """Measure, print the table, draw the figure."""
    cases = choose_cases(scenario, options, FAMILIES)
    results = run_pinned(1, solvers.measure, cases, options.seed, QUICK if options.quick else FULL)
    found = [result for result in results if result.programs]
    told = headlines(found)
    folder.report(f"{say_verdict(told)}\n")
    for result in results:
        folder.report(f"{write_title(result)}\n\n{write_table(result)}\n")
    folder.report(write_notes(results))
    if found:
        folder.save_figure(qp_figure.accuracy(found), "qp_accuracy")
    return Told({name_family(each): metrics(each) for each in found}, told)


TOPIC = Topic(
    "records programs with active rows from laps of three scenarios, compiles, and lets every "
    "solver solve them in turn: about four minutes",
    run,
)


def name_family(result: FamilyResult) -> str:
    """Return the name of a family in metrics."""
    return f"{result.scenario}_{result.starts}"


def write_title(result: FamilyResult) -> str:
    """Say what the programs are."""
    starts = "" if result.starts == "scenario" else f", {result.starts} starts"
    words = f"{result.scenario}{starts}: {result.programs:,} programs with active rows"
    if not result.programs:
        return f"{words}: nothing to solve"
    return f"{words}, n = {result.n}, m = {result.m}, {result.active:.1f} active in the mean"


def write_table(result: FamilyResult) -> str:
    """Return the solvers of a family as a table; peers that are not installed are named."""
    rows = [_write_row(result, each) for each in result.solvers]
    missing = [f"{peer.name}: {peer.cure}" for peer in tight_peers() if not peer.is_installed]
    # Intervals read badly in two lines.
    return "\n".join([format_table(COLUMNS, rows, WIDTH), *missing])


def _write_row(result: FamilyResult, solver: Measured) -> list[str]:
    over = [ratio(result, solver, name) for name in COMPARED]
    wrong = solver.accuracy.wrong
    return [
        solver.name,
        write_number(spread(solver.microseconds).median),
        *("-" if each is None else str(each) for each in over),
        f"{solver.accuracy.largest:.0e}",
        f"{solver.accuracy.above:,}",
        "-" if wrong is None else f"{wrong:,}",
    ]


def ratio(result: FamilyResult, solver: Measured, name: str) -> Spread | None:
    """Return a solver's time over that of one of ours, round by round; None without the latter."""
    ours = next((each for each in result.solvers if each.name == name), None)
    if ours is None or ours is solver:
        return None
    return spread(solver.microseconds / ours.microseconds)


def write_notes(results: list[FamilyResult]) -> str:
    """Say what the numbers are, and how the solvers were set."""
    settings = {
        each.name: f"{each.settings} ({each.programs:,})"
        for result in results
        for each in result.solvers
    }
    told = "; ".join(f"{name}: {words}" for name, words in settings.items())
    text = (
        "One thread; medians, in brackets quartiles, of rounds in which every solver had its turn. "
        "Residual: of the optimality conditions, as the batched solver defines it; wrong: more "
        "than 1e-6 away from DAQP's answer. Every program is solved cold, called from Python; "
        f"settings, and how many programs: {told}"
    )
    return "\n".join(wrap(text))


def metrics(result: FamilyResult) -> dict:
    """Return what was measured of a family."""
    return {
        "n": result.n,
        "m": result.m,
        "programs": result.programs,
        "mean_active_rows": result.active,
        "solvers": [_describe(result, each) for each in result.solvers],
        "by_tolerance": [_describe(result, each) for each in result.sweep],
    }


def _describe(result: FamilyResult, solver: Measured) -> dict:
    comparisons = {}
    if solver in result.solvers:
        over = {name: ratio(result, solver, name) for name in COMPARED}
        comparisons = {f"over {name}": describe(each) for name, each in over.items() if each}
    return {
        "solver": solver.name,
        "settings": solver.settings,
        "tolerance": solver.tolerance,
        "programs": solver.programs,
        "us_a_program": describe(spread(solver.microseconds)),
        "median_residual": solver.accuracy.median,
        "largest_residual": solver.accuracy.largest,
        "residuals_above_1e-9": solver.accuracy.above,
        "wrong": solver.accuracy.wrong,
        **comparisons,
    }


def headlines(results: list[FamilyResult]) -> list[Headline]:
    """Return what the table of all topics shows."""
    lines = []
    for result in results:
        for ours in result.solvers:
            if ours.name in COMPARED:
                lines += [make_headline(result, ours, each) for each in find_peers(result)]
    return lines


def find_peers(result: FamilyResult) -> list[Measured]:
    """Return the solvers that are not ours."""
    return [solver for solver in result.solvers if solver.name not in COMPARED]


def make_headline(result: FamilyResult, ours: Measured, peer: Measured) -> Headline:
    """Return the line of one of ours beside one peer."""
    knowing = " with regions" if ours.name == KNOWING else ""
    return Headline(
        what=f"qp, {name_family(result)}, m = {result.m}{knowing}",
        ours=f"{write_number(spread(ours.microseconds).median)} us",
        peer=f"{peer.name}: {write_number(spread(peer.microseconds).median)} us",
        ratio=str(ratio(result, peer, ours.name)),
        residual=f"{ours.accuracy.largest:.0e}",
    )
