"""`fit`: the largest speed, the smallest limits or the widest slip for which a certificate is
found.

    fitted.toml       the certified scenario at the border, which `design` certifies again
    frontier.png      the ratio towards the border, and the border by a second quantity; not where
                      no attempt has a ratio

A border is that of one search: beyond it no design was found, which does not prove that there is
none.
"""

from __future__ import annotations

from typing import Any

from jaxtube.atomic import write_atomically
from jaxtube.experiments.design.nearest import say_nearest
from jaxtube.experiments.fit import figures
from jaxtube.experiments.fit.attempts import Fit, FrontierPoint, fit
from jaxtube.experiments.fit.report import describe_border, make_page, report
from jaxtube.experiments.options import PROGRAM, FitOptions
from jaxtube.experiments.run import folder as run_folder
from jaxtube.experiments.run.exit_codes import ExitCode
from jaxtube.experiments.run.folder import RunFolder
from jaxtube.experiments.run.table import wrap
from jaxtube.experiments.run.value_log import open_log
from jaxtube.scenario.reading import find
from jaxtube.scenario.refusal import ScenarioError
from jaxtube.scenario.tree import Scenario, to_toml
from jaxtube.synthesis.attempt import Attempt
from jaxtube.synthesis.levers import FITTED, Lever
from jaxtube.synthesis.optimise import refuse_other_kinds
from jaxtube.synthesis.starts import caps_and_gains, with_caps_and_gains, without_caps
from jaxtube.witness.shares import find_promise

FILE = "fitted.toml"


def run(scenario: Scenario, options: FitOptions) -> int:
    """Run the command; an interrupted run goes on from the attempts in its folder.

    Raises:
        ScenarioError: where caps and gains of the scenario cannot be searched, or it has none of
            the quantity.
    """
    lever = FITTED[options.quantity]
    _refuse_unfit(scenario, lever)
    folder = run_folder.create(scenario, options)
    bare = without_caps(scenario)
    with open_log(folder, "attempts", {"quantity": lever.name}, scenario) as log:
        found = fit(bare, lever, log, caps_and_gains(scenario))
    folder.report(report(bare, found))
    if found.border.best is None:
        told = [line for each in say_nearest(scenario, options) for line in wrap(each, "  ")]
        folder.report("\n" + "\n".join(told))
    if any(attempt.ratio is not None for attempt in found.border.attempts):
        folder.save_figure(figures.frontier(bare, found), "frontier")
    else:
        folder.report("\n  No figure: of no attempt is there a tube to draw.")
    folder.save_metrics(_metrics(found))
    folder.save_page(make_page(bare, found))
    best = found.border.best
    if best is not None:
        _save_fitted(folder, bare, found, best, options)
        print(f"\nnext: {PROGRAM} design --scenario {folder.path / FILE}")
    print(f"\nwritten to {folder.path}/")
    return ExitCode.NO_GUARANTEE if options.require_certificate and best is None else 0


def _refuse_unfit(scenario: Scenario, lever: Lever) -> None:
    """Refuse a scenario whose quantity has no border that can be searched."""
    if scenario.operating.bands:
        raise ScenarioError(
            "scenario: operating.bands: fit finds one set of caps, not bands; leave them out"
        )
    try:
        refuse_other_kinds(scenario)
    except ValueError as error:
        raise ScenarioError(f"scenario: fit: {str(error).removeprefix('optimise: ')}") from None
    if lever.values(scenario, 1.0):
        return
    if lever.name == "speed":
        raise ScenarioError(
            'scenario: reference.shape = "file": the speed is that of the file; make another with '
            "`path --speed`, or fit limits or slip"
        )
    raise ScenarioError(f"scenario: fit {lever.name}: the scenario has none of it; give some")


def _metrics(found: Fit) -> dict[str, Any]:
    border = found.border
    return {
        "quantity": found.lever.name,
        "best": None if border.best is None else border.best.to_record(),
        "beyond": None if border.beyond is None else border.beyond.to_record(),
        "attempts": [attempt.to_record() for attempt in border.attempts],
        "second_quantity": None if found.second is None else found.second.name,
        "frontier": [_describe_point(point) for point in found.frontier],
    }


def _describe_point(point: FrontierPoint) -> dict[str, Any]:
    attempt = None if point.attempt is None else point.attempt.to_record()
    return {"factor": point.factor, "value": point.value, "attempt": attempt}


def _save_fitted(
    folder: RunFolder, scenario: Scenario, found: Fit, best: Attempt, options: FitOptions
) -> None:
    """Write the certified scenario at the border."""
    fitted = make_fitted(scenario, found.lever, best)
    told = " ".join([f"Fitted from {options.label}.", *describe_border(scenario, found)])
    paragraphs = [told, _carry_promise(found.lever, options)]
    comment = "\n".join(f"# {line}" for told in paragraphs for line in wrap(told))
    text = f"{comment}\n\n{to_toml(fitted)}"
    write_atomically(folder.path / FILE, lambda file: file.write(text.encode()))


def _carry_promise(lever: Lever, options: FitOptions) -> str:
    """Return what the scenario's file promises of its slips, where they stay; else nothing."""
    if lever.name == "slip":
        return ""
    promise = find_promise(find(options.scenario).read_text(encoding="utf-8-sig"))
    return promise.sentence if promise else ""


def make_fitted(scenario: Scenario, lever: Lever, attempt: Attempt) -> Scenario:
    """Return the scenario of an attempt, with its caps and gains."""
    assert attempt.caps_and_gains is not None
    return with_caps_and_gains(lever.scale(scenario, attempt.factor), attempt.caps_and_gains)
