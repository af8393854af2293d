"""`tune`: weights and gains by gradients through laps and through the tube; what comes out is
certified.

scenario.toml    where tuning starts         tuned.toml    the best certified iterate so far, a whole scenario
log/             every evaluation: a run that was killed goes on by the same command, to the same result
"""

from __future__ import annotations

import sys
from pathlib import Path

from jaxtube.experiments.options import Tune
from jaxtube.experiments.run import folder as run_folder
from jaxtube.experiments.run.atomic import write_atomically
from jaxtube.experiments.tune import compare as tune_compare
from jaxtube.experiments.tune import report as tune_report
from jaxtube.experiments.tune.log import Log
from jaxtube.experiments.tune.run import Descent, Judgement, descend
from jaxtube.plant.reference import settled_step
from jaxtube.scenario import Scenario, ScenarioError, load, to_toml
from jaxtube.simulation import closed_loop
from jaxtube.synthesis.design import design
from jaxtube.synthesis.disturbance import complete_problem
from jaxtube.synthesis.problem import Problem
from jaxtube.tuning.descent import Stop
from jaxtube.tuning.objective import aim
from jaxtube.tuning.parameters import Tuned, parameters
from jaxtube.tuning.tuner import Tuner, failing_conditions

NOT_CERTIFIED, BROKEN_OFF = 3, 2
SETTINGS = ("variables", "method", "evaluations", "laps", "held_out", "learning_rate", "patience")


def run(scenario: Scenario, options: Tune) -> int:
    """Run the command; returns 3 where no iterate is certified, 2 where the descent broke off."""
    tuner = make_tuner(scenario, options, options.variables)
    refuse_start_without_loop(tuner)
    with Log(options.folder / "log", run_folder.identity(scenario, options, SETTINGS)) as log:
        for line in log.damaged:
            print(line, file=sys.stderr)
        folder = run_folder.create(scenario, options)
        tuned_file(options).unlink(
            missing_ok=True
        )  # an earlier run's; a replay writes its own again
        descent = tune(tuner, log, options)
        best = chosen(descent, options.accept_uncertified)
        if best is None:
            return _report(
                f"no iterate is certified: {tune_report.why_not(descent)}; {descent.outcome.sentence}",
                NOT_CERTIFIED,
            )
        save(tuner, options, best)
        failing, verdict = certified_again(tuned_file(options))
        if failing and not options.accept_uncertified:
            tuned_file(options).unlink()
            return _report(
                f"the best iterate does not certify when read back: {', '.join(failing)}",
                NOT_CERTIFIED,
            )
        summary = tune_report.summary(tuner, descent, best, verdict)
        print(summary.text)
        folder.save_arrays("iterates", **tune_report.arrays(tuner, descent))
        tune_report.draw(folder, tuner, descent, best)
        numbers = summary.numbers
        if options.compare:
            numbers |= tune_compare.run(folder, tuner, log, options, descent, best)
        folder.save_metrics(numbers)
    print(f"\nwritten to {folder.path}/; the tuned scenario is {folder.path}/tuned.toml")
    if descent.outcome.stop in (Stop.NOT_A_NUMBER, Stop.CLIFF):
        return _report(
            f"{descent.outcome.sentence}; the best certified iterate is kept", BROKEN_OFF
        )
    return 0


def make_tuner(scenario: Scenario, options: Tune, variables: Tuned) -> Tuner:
    """Return the tuner of a scenario.

    Raises: ScenarioError where the scenario gives no gains.
    """
    problem = complete_problem(scenario)
    try:
        chosen = parameters(problem, variables)
    except ValueError as error:
        raise ScenarioError(f"scenario: {error}") from None
    settled = settled_step(problem.reference)
    goal = aim(scenario, settled)
    return Tuner(
        problem,
        closed_loop.robot_of(problem),
        chosen,
        goal,
        options.laps,
        options.held_out,
        options.seed,
    )


def refuse_start_without_loop(tuner: Tuner) -> None:
    """Raise ScenarioError where the start has no tube, so that there is nothing to descend on."""
    designed = tuner.designed(tuner.parameters.vector)
    if designed.frozen is None:
        gains = tuner.problem.scenario.controller
        raise ScenarioError(
            f"scenario: controller gains = {list(gains.tracking_gains or gains.vertex_gains)}: tuning cannot start "
            f"({designed.reason}); start from firmer gains, such as those of `certified`, or lower slip.relative_error"
        )


def tune(tuner: Tuner, log: Log, options: Tune) -> Descent:
    """Descend; the best certified iterate is on disk at any time."""
    return descend(
        tuner,
        log,
        options.method,
        options.method,
        options.evaluations,
        options.patience,
        options.learning_rate,
        lambda found: save(tuner, options, found),
    )


def chosen(descent: Descent, accept_uncertified: bool) -> Judgement | None:
    """Return the iterate to be returned, None where none qualifies."""
    iterates = [
        descent.outcome.best_certified,
        descent.outcome.best_uncertified if accept_uncertified else None,
    ]
    known = [iterate for iterate in iterates if iterate is not None]
    best = min(known, key=lambda iterate: iterate.held_out, default=None)
    return None if best is None else descent.judged[best.iteration]


def save(tuner: Tuner, options: Tune, found: Judgement) -> None:
    """Write an iterate as a scenario."""
    text = to_toml(tuner.parameters.scenario(tuner.problem.scenario, found.point))
    label = (
        f"certified{assumption(tuner.problem)}"
        if found.certified
        else f"NOT CERTIFIED: {', '.join(found.failing)}"
    )
    header = f"# Tuned from {options.scenario}; {label}.\n\n"
    write_atomically(tuned_file(options), lambda file: file.write((header + text).encode()))


def tuned_file(options: Tune) -> Path:
    """Return the file of the result."""
    return options.folder / "tuned.toml"


def certified_again(path: Path) -> tuple[tuple[str, ...], str]:
    """Design the scenario that is returned as anybody would, and say what its certificate lacks, in
    a word and a line.

    Gains that decouple are checked a second time, in rational arithmetic.
    """
    found = design(load(path))
    failing = failing_conditions(found)
    if failing:
        return failing, f"NOT CERTIFIED: {', '.join(failing)}"
    second = found.certificate.conditions.get("checked_in_rationals")
    twice = (
        "; checked once more in rational arithmetic" if second is not None and second.holds else ""
    )
    return (), f"CERTIFIED{assumption(found.problem)}: every required condition holds{twice}"


def assumption(problem: Problem) -> str:
    """Return what a certificate takes for granted where W is assumed, nothing where it is computed."""
    if problem.disturbance_bound is not None:
        return ""
    return ' for the linear model with w in W, which is assumed (disturbance.bound = "computed" bounds the robot\'s w)'


def _report(line: str, code: int) -> int:
    print(f"tune: {' '.join(line.split())}", file=sys.stderr)
    return code
