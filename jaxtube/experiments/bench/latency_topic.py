"""`bench latency`: its table, its figure and its metrics.

Source: new.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from jaxtube.experiments.bench import latencies
from jaxtube.experiments.bench.cases import Case, Usual, choose_cases
from jaxtube.experiments.bench.latencies import DAQP, FULL, OURS, QUICK, LatencyResult
from jaxtube.experiments.bench.peers.catalogue import EXACT
from jaxtube.experiments.bench.pinned import run_pinned
from jaxtube.experiments.bench.rounds import write_number
from jaxtube.experiments.bench.topic import Headline, Told, Topic, say_verdict
from jaxtube.experiments.options import BenchOptions
from jaxtube.experiments.run.folder import RunFolder
from jaxtube.experiments.run.table import Column, format_table, left, wrap
from jaxtube.figures.style import bottom_legend, page_figure, styled
from jaxtube.scenario.tree import Scenario

USUAL = (Usual("paper", "scenario"), Usual("tuned", "scenario"))
COLUMNS = [
    left("one robot"),
    left("controller"),
    Column("median", "us"),
    Column("99 %", "us"),
    Column("99.9 %", "us"),
    Column("longest", "us"),
    Column("99.9 % of\nits own time", "us"),
]
COLOURS = {OURS: "#0072B2", DAQP: "#D55E00"}


class Latency(NamedTuple):
    """Steps of one robot, microseconds: the median, what 99 % and 99.9 % are below, the longest."""

    median: float
    percent_99: float
    percent_99_9: float
    longest: float


def find_latency(microseconds: Float[np.ndarray, " steps"]) -> Latency:
    """Return the latency of steps."""
    return Latency(*np.percentile(microseconds, [50, 99, 99.9, 100]).tolist())


def run(scenario: Scenario, options: BenchOptions, folder: RunFolder) -> Told:
    """Measure, print the table, draw the figure."""
    cases = choose_cases(scenario, options, USUAL)
    extent = QUICK if options.quick else FULL
    results = run_pinned(1, latencies.measure, cases, options.seed, extent)
    told = headlines(cases, results)
    folder.report(f"{say_verdict(told)}\n")
    folder.report(f"{write_table(cases, results)}\n\n{write_notes(cases, results)}")
    folder.save_figure(draw(cases, results), "latency")
    names = [f"{case.name}_{case.starts}" for case in cases]
    found = dict(zip(names, map(metrics, results), strict=True))
    return Told(found, told)


TOPIC = Topic(
    "compiles the controller of one robot for two scenarios and asks it 20,000 times, step by "
    "step: about a minute",
    run,
)


def write_table(cases: Sequence[Case], results: Sequence[LatencyResult]) -> str:
    """Return the latencies as a table."""
    rows = [
        [
            case.words,
            controller,
            *(f"{each:,.1f}" for each in find_latency(times)),
            f"{find_latency(result.own[controller]).percent_99_9:,.1f}",
        ]
        for case, result in zip(cases, results, strict=True)
        for controller, times in result.microseconds.items()
    ]
    return format_table(COLUMNS, rows)


def write_notes(cases: Sequence[Case], results: Sequence[LatencyResult]) -> str:
    """Say what the numbers are, what was compiled and what grew."""
    steps = len(results[0].microseconds[OURS])
    told = [
        f"{case.words}: {100 * result.active:.3g} % of the steps with an active row; "
        f"{result.compilations} times traced or compiled, {result.grown_kib:+,.0f} KiB of memory "
        "in those steps"
        for case, result in zip(cases, results, strict=True)
    ]
    text = (
        f"Wall clock of {steps:,} steps, after others that warm up, on one core: from the errors "
        "of recorded laps to a command that Python has; DAQP: from the errors to a plan, one model "
        f"a window. Own time: of the processor, without what other processes took; "
        f"{results[0].load:.1f} wanted its cores when this began. {'; '.join(told)}."
    )
    cure = "" if EXACT[0].is_installed else f" DAQP: {EXACT[0].cure}."
    return "\n".join(wrap(text + cure))


def metrics(result: LatencyResult) -> dict:
    """Return what was measured of a closed loop."""
    return {
        "share_active": result.active,
        "compilations": result.compilations,
        "grown_kib": result.grown_kib,
        "largest_residual": result.largest_residual,
        "us": {
            controller: find_latency(times)._asdict()
            for controller, times in result.microseconds.items()
        },
        "own_us": {
            controller: find_latency(times)._asdict() for controller, times in result.own.items()
        },
        "load_of_the_machine": result.load,
    }


def headlines(cases: Sequence[Case], results: Sequence[LatencyResult]) -> list[Headline]:
    """Return what the table of all topics shows."""
    lines = []
    for case, result in zip(cases, results, strict=True):
        ours = find_latency(result.microseconds[OURS])
        peer = find_latency(result.microseconds[DAQP]) if DAQP in result.microseconds else None
        for name in ("median", "percent_99_9"):
            words = {"median": "median", "percent_99_9": "99.9 %"}[name]
            line = Headline(
                what=f"latency, {case.words}: {words}",
                ours=f"{getattr(ours, name):.1f} us",
                peer=f"{DAQP}: {getattr(peer, name):.1f} us" if peer else "",
                ratio=write_number(getattr(peer, name) / getattr(ours, name)) if peer else "",
                residual=f"{result.largest_residual:.0e}",
            )
            lines.append(line)
    return lines


@styled
def draw(cases: Sequence[Case], results: Sequence[LatencyResult]) -> Figure:
    """Draw histograms of the steps, a panel for each closed loop."""
    figure = page_figure(2.4)
    panels = figure.subplots(1, len(results), sharex=True, sharey=True, squeeze=False)[0]
    for axes, case, result in zip(panels, cases, results, strict=True):
        _draw_histograms(axes, result)
        axes.set_title(case.words, pad=3)
        axes.set_xlabel("time of a step [µs]")
    panels[0].set_ylabel("steps")
    bottom_legend(figure, panels[0].get_legend_handles_labels()[0], columns=4)
    return figure


def _draw_histograms(axes: Axes, result: LatencyResult) -> None:
    """Draw how many steps took how long; lines at the median and where 99.9 % end."""
    every = np.concatenate(list(result.microseconds.values()))
    bins = np.geomspace(every.min(), every.max(), 80)
    for controller, times in result.microseconds.items():
        colour = COLOURS[controller]
        axes.hist(times, bins.tolist(), histtype="step", color=colour, label=controller)
        latency = find_latency(times)
        axes.axvline(latency.median, color=colour, linewidth=0.8, linestyle="--")
        axes.axvline(latency.percent_99_9, color=colour, linewidth=0.8, linestyle=":")
    axes.axvline(np.nan, color="0.4", linewidth=0.8, linestyle="--", label="median")
    axes.axvline(np.nan, color="0.4", linewidth=0.8, linestyle=":", label="99.9 %")
    axes.set(xscale="log", yscale="log", ylim=(0.7, None))
