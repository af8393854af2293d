"""`montecarlo`: laps by the million, every period checked, block by block into records that survive
the process.

Open the records, compute the blocks that are missing, join all of them, report. The statistics are
the same bytes whatever was interrupted and wherever the blocks were computed; `performance.json`
alone differs between two runs.
"""

from __future__ import annotations

import contextlib
import itertools
import resource
import sys
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from typing import TYPE_CHECKING

import jax
import numpy as np

from jaxtube.experiments.montecarlo import netcdf, replay, tube_reach
from jaxtube.experiments.montecarlo import report as montecarlo_report
from jaxtube.experiments.montecarlo.page import make_page
from jaxtube.experiments.options import MontecarloOptions
from jaxtube.experiments.run import blocks
from jaxtube.experiments.run import folder as run_folder
from jaxtube.experiments.run.designing import identify_restored, make_design
from jaxtube.experiments.run.folder import RunFolder
from jaxtube.experiments.run.limits import describe_pose
from jaxtube.experiments.run.records import Records
from jaxtube.progress import announce, progress
from jaxtube.reporting.laps import StoredLaps, collect
from jaxtube.reporting.player import make_player
from jaxtube.scenario.tree import Scenario
from jaxtube.simulation.promise import limit_true_errors
from jaxtube.statistics import run as montecarlo
from jaxtube.statistics.events import find_row
from jaxtube.statistics.lap import choose_numbers, run_numbered
from jaxtube.statistics.montecarlo import MonteCarlo, make_closed_loop_task, name_law
from jaxtube.statistics.run import BLOCK, Run, Statistics, Task
from jaxtube.synthesis.design import refuse_infeasible_start
from jaxtube.synthesis.parts import Design

if TYPE_CHECKING:
    from jaxtube.experiments.run.cluster import Cluster

KEPT = 40
"""Laps that are kept, to be played and drawn."""


def run(scenario: Scenario, options: MontecarloOptions) -> int:
    """Run the command."""
    blocks.use_devices(options.devices)
    if options.netcdf:
        netcdf.require_libraries()
    announce("designing: sets, gains and certificate")
    design = limit_true_errors(make_design(scenario, options), options.plant)
    if options.starts == "scenario":
        refuse_infeasible_start(design)
    known = blocks.identity(scenario, options) | identify_restored(design)
    if options.replay is not None:
        return replay.run(design, options, known)
    with Records(options.folder / "records", known, montecarlo.merge, BLOCK) as records:
        for line in records.damaged:
            print(line, file=sys.stderr)
        missing = records.missing(int(options.realisations))
        folder = run_folder.create(scenario, options)
        folder.save_json("identity", known)
        task = make_task(design, options)
        performance = compute(task, options, records, missing)
        statistics = records.merge()
    save(design, task, options, folder, statistics, performance)
    return 0


def compute(
    task: Task, options: MontecarloOptions, records: Records, missing: Iterator[int]
) -> dict:
    """Compute and record the missing blocks; return what it took, {} where none was missing."""
    first = next(missing, None)
    if first is None:
        return {}
    devices = tuple(jax.local_devices()[: options.devices or None])
    local = Run(task, int(options.realisations), options.chunk, devices)
    before = records.laps
    outside = count_laps_outside(records.merge())
    seconds = []
    with contextlib.ExitStack() as stack:
        source = stack.enter_context(connect(options.cluster, local)) if options.cluster else local
        bar = stack.enter_context(progress(local.realisations, "simulating", "laps", before))
        at_once = source.at_once
        start = time.perf_counter()
        for block, statistics in source.compute(itertools.chain([first], missing)):
            recorded = records.laps
            records.add(block, int(statistics["laps"]), statistics)
            outside += count_laps_outside(statistics)
            bar.set_postfix_str(f"{outside} left E", refresh=False)
            bar.update(records.laps - recorded)
            seconds.append(time.perf_counter() - start)
    performance = {"laps": records.laps - before, **measure_rate(seconds, at_once)}
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024
    return performance | {"peak_memory_bytes": peak}


def make_task(design: Design, options: MontecarloOptions) -> Task:
    """Return what every block of the run needs."""
    return make_closed_loop_task(
        design, options.controller, options.plant, options.starts, None, options.seed
    )


def connect(cluster: str, local: Run) -> Cluster:
    """Return the cluster that an option names, a context; its library is needed only here."""
    from jaxtube.experiments.run.cluster import Cluster

    return Cluster(cluster, local)


def measure_rate(seconds: list[float], at_once: int) -> dict:
    """Return the time to the first results, which holds the compilation, and laps a second from
    there on.

    `seconds` are those at which blocks were recorded; the last block, which may be partial, is not
    counted.
    """
    first = seconds[min(at_once, len(seconds)) - 1]
    rest = len(seconds) - at_once - 1
    speed = rest * BLOCK / (seconds[-2] - first) if rest > 0 else None
    return {"seconds": seconds[-1], "first_results_seconds": first, "laps_per_second": speed}


def count_laps_outside(statistics: Statistics) -> int:
    """Return how many laps left E."""
    return int(statistics["events"][find_row("e_outside_E"), 1:].sum()) if statistics else 0


def save(
    design: Design,
    task: Task,
    options: MontecarloOptions,
    folder: RunFolder,
    statistics: Statistics,
    performance: dict,
) -> None:
    """Write statistics and metrics, print the report, and draw the figures."""
    from jaxtube.experiments.montecarlo import figures as montecarlo_figures

    announce("joining the records")
    law = name_law(design, options.controller, options.plant, options.starts)
    result = MonteCarlo(design, law, options.seed, statistics)
    summary = dict(result.summary)
    if options.plant == "linear":
        summary["reach"] = tube_reach.metrics(design, options.seed)
    folder.save_arrays("statistics", **statistics)
    folder.save_metrics(summary)
    if performance:
        folder.save_json("performance", performance)
    if options.netcdf:
        netcdf.save(folder.path / "statistics.nc", result)
    # First what was found: figures take as long as a small run.
    folder.report(montecarlo_report.text(design.problem, options.seed, summary, performance))
    with ThreadPoolExecutor(1) as pool:
        # Most of it is compilation, which runs beside Python.
        keeping = pool.submit(keep_laps, design, task, options, summary)
        montecarlo_figures.draw(design, task, options.seed, statistics, summary, folder)
        kept = keeping.result()
    folder.save_arrays("laps", **kept.arrays())
    player = make_player(kept, describe_pose(design.problem))
    folder.save_page(make_page(design, summary, player))
    print(
        "\nreport.html, figures, metrics.json, statistics.npz, laps.npz and the records are in "
        f"{folder.path}/"
    )


def keep_laps(design: Design, task: Task, options: MontecarloOptions, summary: dict) -> StoredLaps:
    """Return some laps of the run, simulated again: those that used most of E and W, and the
    first."""
    numbers = choose_numbers(summary, KEPT)
    laps = run_numbered(task, options.seed, numbers)
    by_controller = {options.controller: np.array(numbers, np.uint64)}
    return collect(design, {options.controller: laps}, by_controller, summary["laps"])
