"""`identify`: from a log to a scenario whose slips, track, lag and noise are those of the robot.

    identified.toml       the scenario, every value with its source
    report.txt            the promise first, then what was found, and what is not covered
    windows.npz           the windows: wheels, velocities, slips, and what each was used for

A log that tells too little is refused in one line; what was found of its sensors is printed before.
"""

from __future__ import annotations

import tomllib

import numpy as np

from jaxtube.atomic import write_atomically
from jaxtube.experiments.identify import box_figure, figures, prediction_figure
from jaxtube.experiments.identify.log_report import say_log
from jaxtube.experiments.identify.metrics import measure
from jaxtube.experiments.identify.report import make_page, report
from jaxtube.experiments.options import PROGRAM, IdentifyOptions
from jaxtube.experiments.run import folder as run_folder
from jaxtube.experiments.run.folder import RunFolder
from jaxtube.experiments.run.hints import make_hints
from jaxtube.identification.findings import Findings, inspect_log
from jaxtube.identification.identify import Choices, Identified, identify_log, identify_windows
from jaxtube.identification.scenario_text import find_track_width, write_scenario
from jaxtube.progress import announce
from jaxtube.recordings.bag import is_bag
from jaxtube.recordings.hints import parse_pairs
from jaxtube.recordings.log import Log
from jaxtube.recordings.reading import read_log
from jaxtube.recordings.window_table import is_window_table, read_windows
from jaxtube.recordings.windows import Windows
from jaxtube.scenario.refusal import ScenarioError, refusal
from jaxtube.scenario.tree import Scenario
from jaxtube.scenario.validation import validate

FILE = "identified.toml"


def run(scenario: None, options: IdentifyOptions) -> int:
    """Run the command; returns 0 once the robot is identified.

    Raises:
        ScenarioError: one line, for a file that cannot be read or tells too little.
    """
    if options.overrides:
        cure = f"change {FILE}, or its keys when it is used"
        raise refusal("command line", "override", options.overrides[0], "is of no use here", cure)
    choices = Choices(options.least_wheel_mps, options.box, options.margin)
    recorded = read(options)
    announce(f"identifying the robot of {options.log}")
    if isinstance(recorded, Log):
        findings = inspect_log(recorded, options.window_s)
        identified = _identify_log(findings, choices)
    else:
        findings = None
        identified = identify_windows(recorded, choices)
    text = write_scenario(identified, findings, options.track_m)
    folder = run_folder.create(read_text(text), options)
    folder.report(report(identified, findings, options.track_m))
    write_atomically(folder.path / FILE, lambda file: file.write(text.encode()))
    announce("drawing")
    save(folder, identified, findings, options)
    folder.save_metrics(measure(identified, findings, options.track_m))
    folder.save_page(make_page(identified, findings, options.track_m))
    print(f"\n{FILE}, figures, windows.npz, metrics.json and manifest.json are in {folder.path}/")
    scenario_file = folder.path / FILE
    print(f"next: {PROGRAM} fit speed --scenario {scenario_file}")
    print(f"and, with a log recorded besides: {PROGRAM} replay LOG --scenario {scenario_file}")
    return 0


def read(options: IdentifyOptions) -> Log | Windows:
    """Read the file of a log, or of windows.

    Raises:
        ScenarioError: one line.
    """
    try:
        hints = make_hints(options)
        if is_bag(options.log) or not is_window_table(options.log, hints):
            return read_log(options.log, hints)
        return read_windows(options.log, parse_pairs("--select", options.select), hints)
    except ScenarioError:
        raise
    except ValueError as error:
        raise ScenarioError(str(error)) from None


def _identify_log(findings: Findings, choices: Choices) -> Identified:
    """Identify a robot from its log; before a refusal, print what was found all the same."""
    try:
        return identify_log(findings, choices)
    except ScenarioError:
        print(say_log(findings))
        raise


def read_text(text: str) -> Scenario:
    """Return the scenario of the text of a scenario file."""
    return validate(tomllib.loads(text), lambda key: FILE)


def save(
    folder: RunFolder,
    identified: Identified,
    findings: Findings | None,
    options: IdentifyOptions,
) -> None:
    """Save windows and figures."""
    windows = identified.windows
    count = len(windows.command)
    start = findings.windows.start if findings else np.full(count, np.nan)
    folder.save_arrays(
        "windows",
        start_s=start,
        command=windows.command,
        wheels=windows.wheels,
        velocity=windows.velocity,
        steady=windows.steady,
        lost=windows.lost,
        slips=identified.slips,
        sideslips=identified.sideslips,
        fits=identified.fits,
        counts=identified.counts,
    )
    folder.save_figure(figures.over_time(identified, findings), "slip_over_time")
    folder.save_figure(figures.by_speed(identified), "slip_by_speed")
    folder.save_figure(figures.ground_by_wheel(identified), "ground_by_wheel")
    folder.save_figure(box_figure.where_from(identified), "box")
    width, _ = find_track_width(identified, findings, options.track_m)
    figure = prediction_figure.predictions(identified, options.window_s, width)
    folder.save_figure(figure, "prediction")
