"""`tune`: weights and gains by gradients through laps and through the tube; what comes out is
certified.

scenario.toml    where tuning starts
tuned.toml       the best certified iterate so far, a whole scenario
log/             every evaluation: a run that was killed goes on by the same command, to the same
                 result
"""

from __future__ import annotations

import sys
from pathlib import Path

from jaxtube.atomic import write_atomically
from jaxtube.experiments.options import TuneOptions
from jaxtube.experiments.run import folder as run_folder
from jaxtube.experiments.run.exit_codes import ExitCode
from jaxtube.experiments.run.folder import RunFolder
from jaxtube.experiments.tune import compare as tune_compare
from jaxtube.experiments.tune import report as tune_report
from jaxtube.experiments.tune.log import TuningLog
from jaxtube.progress import announce, progress
from jaxtube.scenario.reading import load
from jaxtube.scenario.tree import Scenario, to_toml
from jaxtube.tuning.bar import DescentBar
from jaxtube.tuning.judgement import HeldOutJudgement
from jaxtube.tuning.run import Settings
from jaxtube.tuning.tune import Tuned, assumption, run_tuner
from jaxtube.tuning.tuner import Tuner, make_tuner, refuse_untunable
from jaxtube.tuning.watch import Stop

SETTINGS = ("variables", "method", "evaluations", "laps", "held_out", "learning_rate", "patience")


def run(scenario: Scenario, options: TuneOptions) -> int:
    """Run the command; returns 3 where no iterate is certified, 2 where the descent broke off."""
    refuse_untunable(scenario)
    announce("designing where tuning starts")
    tuner = make_tuner(
        scenario,
        variables=options.variables,
        laps=options.laps,
        held_out=options.held_out,
        seed=options.seed,
    )
    settings = make_settings(options)
    with TuningLog(options.folder / "log", run_folder.identity(scenario, options, SETTINGS)) as log:
        for line in log.damaged:
            print(line, file=sys.stderr)
        folder = run_folder.create(scenario, options)
        file = TunedFile(folder.path / "tuned.toml", tuner, options.scenario)
        file.path.unlink(missing_ok=True)  # an earlier run's; a replay writes its own again
        counter = progress(settings.evaluations, f"tuning {settings.method}", "gradients")
        with DescentBar(counter, file.save) as bar:
            tuned = run_tuner(
                tuner,
                settings,
                accept_uncertified=options.accept_uncertified,
                log=log,
                progress=bar,
            )
        refusal = save_result(tuned, file, options.accept_uncertified)
        if refusal:
            return _say(refusal, ExitCode.NO_GUARANTEE)
        summary = report(folder, tuned)
        numbers = summary.numbers
        if options.compare:
            numbers |= tune_compare.run(folder, tuned, log, settings)
        folder.save_metrics(numbers)
        folder.save_page(tune_report.make_page(tuned, summary))
    print(f"\nwritten to {folder.path}/; the tuned scenario is {file.path}")
    if tuned.stop in (Stop.NOT_A_NUMBER, Stop.CLIFF):
        return _say(f"{tuned.sentence}; the best certified iterate is kept", ExitCode.BROKEN_OFF)
    return 0


def make_settings(options: TuneOptions) -> Settings:
    """Return how the descent runs."""
    return Settings(options.method, options.evaluations, options.patience, options.learning_rate)


class TunedFile:
    """The file of the result."""

    def __init__(self, path: Path, tuner: Tuner, start: str) -> None:
        """Name the file.

        Args:
            path: of the file.
            tuner: whose points are written.
            start: name of the scenario where tuning started.
        """
        self.path = path
        self._tuner = tuner
        self._start = start

    def save(self, judgement: HeldOutJudgement) -> None:
        """Write an iterate as a scenario."""
        problem = self._tuner.problem
        if judgement.certified:
            label = f"certified{assumption(problem)}"
        else:
            label = f"NOT CERTIFIED: {', '.join(judgement.failing)}"
        scenario = self._tuner.parameters.scenario(problem.scenario, judgement.point)
        text = f"# Tuned from {self._start}; {label}.\n\n{to_toml(scenario)}"
        write_atomically(self.path, lambda file: file.write(text.encode()))


def save_result(tuned: Tuned, file: TunedFile, accept_uncertified: bool) -> str:
    """Write the tuned scenario and read it back.

    Returns:
        Why there is none, empty where there is one.
    """
    failing = ", ".join(tuned.failing)
    if tuned.best is None:
        return f"no iterate is certified: the best one fails {failing}; {tuned.sentence}"
    file.save(tuned.best)
    if load(str(file.path)) != tuned.scenario:
        failing = "same_scenario"
    elif tuned.is_certified or accept_uncertified:
        return ""
    file.path.unlink()
    return f"the best iterate does not certify when read back: {failing}"


def report(folder: RunFolder, tuned: Tuned) -> tune_report.Summary:
    """Print, draw and save what came out, and return it."""
    announce("comparing start and result on new laps, compiled first")
    summary = tune_report.summarise_tuning(tuned)
    folder.report(summary.text)
    folder.save_arrays("iterates", **tune_report.iterate_arrays(tuned))
    announce("drawing")
    tune_report.draw(folder, tuned)
    return summary


def _say(line: str, code: ExitCode) -> int:
    print(f"tune: {' '.join(line.split())}", file=sys.stderr)
    return code
