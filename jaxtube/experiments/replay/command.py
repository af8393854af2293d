"""`replay`: a log that a scenario was not made from, as the witness of that scenario.

report.txt       what was promised and what was found, spans that nothing allowed explains, W
slips.csv        slips and sideslip of windows, for slip.process = "recorded"
spans.npz        every span that is judged: times, w, what it may be, usage
"""

from __future__ import annotations

import numpy as np

from jaxtube.atomic import write_atomically
from jaxtube.experiments.options import ReplayOptions
from jaxtube.experiments.replay import figures
from jaxtube.experiments.replay.metrics import metrics
from jaxtube.experiments.replay.report import make_page, report
from jaxtube.experiments.run import folder as run_folder
from jaxtube.experiments.run.folder import RunFolder
from jaxtube.experiments.run.hints import make_hints
from jaxtube.identification.findings import inspect_log
from jaxtube.plant.recorded_slips import FEWEST_ROWS, write_slips
from jaxtube.progress import announce
from jaxtube.recordings.bag import is_bag
from jaxtube.recordings.log import Log
from jaxtube.recordings.reading import read_log
from jaxtube.recordings.window_table import is_window_table
from jaxtube.scenario.reading import find
from jaxtube.scenario.refusal import ScenarioError, refusal
from jaxtube.scenario.tree import Scenario
from jaxtube.witness.examine import Witness, examine
from jaxtube.witness.shares import QuotedPromise, find_promise
from jaxtube.witness.span_test import SpanTest

SLIPS = "slips.csv"


def run(scenario: Scenario, options: ReplayOptions) -> int:
    """Run the command; returns 0 whatever the log says.

    Raises:
        ScenarioError: one line, for a log that cannot be read or says nothing of the scenario.
    """
    log = read(options)
    announce("putting the scenario to the test of every period")
    findings = inspect_log(log, options.window_s)
    witness = examine(findings, scenario, options.longer_s)
    promise = find_promised(options)
    folder = run_folder.create(scenario, options)
    folder.report(report(witness, promise, options.scenario))
    announce("drawing")
    save(folder, witness)
    folder.save_metrics(metrics(witness, promise))
    folder.save_page(make_page(witness, promise, options.scenario))
    print(
        f"\nreport.html, figures, spans.npz, metrics.json and manifest.json are in {folder.path}/"
    )
    if save_slips(folder, witness):
        print(
            f"{SLIPS} drives laps with the slips of this log: montecarlo --scenario "
            f"{options.scenario} slip.process=recorded slip.recording={folder.path / SLIPS}"
        )
    return 0


def read(options: ReplayOptions) -> Log:
    """Read the log.

    Raises:
        ScenarioError: one line.
    """
    try:
        hints = make_hints(options)
        if not is_bag(options.log) and is_window_table(options.log, hints):
            cure = "give the log that they were made from"
            problem = "is a table of windows, which hold no poses over time"
            raise refusal("command line", "LOG", options.log, problem, cure)
        return read_log(options.log, hints)
    except ScenarioError:
        raise
    except ValueError as error:
        raise ScenarioError(str(error)) from None


def find_promised(options: ReplayOptions) -> QuotedPromise | None:
    """Return what was promised: as an option says, or the comments of the scenario's file."""
    if options.promised is not None:
        return QuotedPromise(options.promised, "as given")
    return find_promise(find(options.scenario).read_text(encoding="utf-8-sig"))


def save(folder: RunFolder, witness: Witness) -> None:
    """Save spans and figures."""
    tests = {"period": witness.period, "longer": witness.longer}
    arrays = {}
    for name, test in tests.items():
        if test is not None:
            arrays |= {f"{name}_{key}": value for key, value in _list_arrays(test).items()}
            folder.save_figure(figures.over_time(witness, test), f"disturbance_{name}")
    folder.save_arrays("spans", **arrays)
    folder.save_figure(figures.histograms(witness), "histograms")
    folder.save_figure(figures.window_slips(witness), "slips")


def _list_arrays(test: SpanTest) -> dict[str, np.ndarray]:
    spans = test.spans
    return {
        "start_s": spans.start,
        "end_s": spans.end,
        "command": spans.command,
        "steady": spans.is_kind("steady"),
        "disturbance": test.measured,
        "centre": test.reach.centre,
        "half_widths": test.reach.half_widths,
        "remainder": test.reach.remainder,
        "usage": test.verdict.usage,
        "explained": test.verdict.explained,
        "refuted": test.verdict.refuted,
        "excess": test.verdict.excess,
    }


def save_slips(folder: RunFolder, witness: Witness) -> bool:
    """Save the slips of the log in the form that laps are driven with; say whether there are
    any."""
    time, values = witness.windows.recorded()
    if len(time) < FEWEST_ROWS:
        return False
    text = write_slips(time, values)
    write_atomically(folder.path / SLIPS, lambda file: file.write(text.encode()))
    return True
