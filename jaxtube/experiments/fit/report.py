"""The report of `fit`: the border first, then the attempts around it, and the border by the second
quantity."""

from __future__ import annotations

from jaxtube.experiments.fit.attempts import Fit, FrontierPoint
from jaxtube.experiments.run.page_table import make_table
from jaxtube.experiments.run.table import Column, format_table, left, wrap
from jaxtube.reporting.page import Page, Section
from jaxtube.scenario.tree import Scenario
from jaxtube.synthesis.attempt import Attempt
from jaxtube.synthesis.levers import Lever

SUPERLATIVES = {"speed": "largest speed", "limits": "smallest limits", "slip": "widest slip"}
CAVEAT = (
    "The border is that of this search: beyond it no design was found, which does not prove that "
    "there is none."
)


def report(scenario: Scenario, found: Fit) -> str:
    """Return the report as text."""
    lines = [say_verdict(found)]
    lines += [line for each in describe_border(scenario, found) for line in wrap(each, "  ")]
    lines += ["", _attempt_table(found), *wrap(CAVEAT, "  ")]
    if found.second is not None:
        lines += ["", _frontier_table(found, found.second)]
    return "\n".join(lines)


def say_verdict(found: Fit) -> str:
    """Return one line: how far a certificate was found."""
    best = found.border.best
    if best is None:
        return f"NOT CERTIFIED at any {found.lever.name} tried"
    assert best.ratio is not None
    return (
        f"CERTIFIED; the {SUPERLATIVES[found.lever.name]} found is {best.factor:.4g} times the "
        f"scenario's; the tube fills {best.ratio:.1%} of its caps"
    )


def make_page(scenario: Scenario, found: Fit) -> Page:
    """Return the page of a fit."""
    table = make_table(
        _attempt_columns(found), map(_attempt_row, found.border.attempts), note=CAVEAT
    )
    tone = "bad" if found.border.best is None else "good"
    lead = describe_border(scenario, found)
    return Page(say_verdict(found), tone, lead, [Section("Attempts", [table])])


def describe_border(scenario: Scenario, found: Fit) -> list[str]:
    """Return what was found of the border, a sentence each."""
    lever = found.lever
    best = found.border.best
    beyond = found.border.beyond
    if best is None:
        return [_say_none(scenario, lever, found.border.attempts)]
    values = lever.say(lever.scale(scenario, best.factor))
    assert best.ratio is not None
    sentences = [
        f"The {SUPERLATIVES[lever.name]} with a certificate: {values}; {best.factor:.4g} times the "
        f"scenario's, and the tube fills {best.ratio:.1%} of its caps."
    ]
    if beyond is None:
        return [*sentences, "No border was met as far as was searched."]
    where = _say_place(scenario, lever, beyond)
    return [*sentences, f"No design was found at {where}: {beyond.reason}."]


def _say_none(scenario: Scenario, lever: Lever, attempts: tuple[Attempt, ...]) -> str:
    """Return which attempt came closest where none holds."""
    with_ratio = [attempt for attempt in attempts if attempt.ratio is not None]
    closest = min(with_ratio or attempts, key=lambda attempt: attempt.ratio or 0.0)
    return f"Closest at {_say_place(scenario, lever, closest)}: {closest.reason}."


def _say_place(scenario: Scenario, lever: Lever, attempt: Attempt) -> str:
    """Return where an attempt was made, by the key that stands for the quantity."""
    if attempt.value is None:
        return f"{attempt.factor:.4g} times the scenario's {lever.name}"
    return lever.say_measured(lever.scale(scenario, attempt.factor))


def _attempt_columns(found: Fit) -> list[Column]:
    return [
        Column(found.lever.label),
        Column("factor"),
        Column("tube fills", "% of caps"),
        left("certified"),
        left("binds, or denies it"),
    ]


def _attempt_table(found: Fit) -> str:
    return format_table(_attempt_columns(found), map(_attempt_row, found.border.attempts))


def _attempt_row(attempt: Attempt) -> list[str]:
    is_told = attempt.holds or attempt.ratio is None or attempt.ratio > 1
    return [
        "-" if attempt.value is None else f"{attempt.value:.4g}",
        f"{attempt.factor:.4g}",
        "-" if attempt.ratio is None else f"{100 * attempt.ratio:.1f}",
        "yes" if attempt.holds else "no",
        attempt.binding if is_told and attempt.binding else _shorten(attempt.reason),
    ]


def _shorten(reason: str) -> str:
    """Return what is wrong, without where it came from and without cures."""
    return reason.removeprefix("scenario: ").split("; ")[0]


def _frontier_table(found: Fit, second: Lever) -> str:
    columns = [
        Column(second.label),
        Column(f"certified {found.lever.label}"),
        Column("tube fills", "% of caps"),
        left("binds"),
    ]
    return format_table(columns, map(_frontier_row, found.frontier))


def _frontier_row(point: FrontierPoint) -> list[str]:
    value = f"{point.value:.4g}"
    attempt = point.attempt
    ratio = None if attempt is None else attempt.ratio
    if attempt is None or ratio is None:
        return [value, "none found", "-", "-"]
    return [value, f"{attempt.value:.4g}", f"{100 * ratio:.1f}", attempt.binding]
