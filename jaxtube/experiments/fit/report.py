"""The report of `fit`: the border first, then the attempts around it, and the border by the second
quantity."""

from __future__ import annotations

from jaxtube.experiments.fit.attempts import Fit, FrontierPoint
from jaxtube.experiments.run.table import WIDTH, Column, format_table, left, wrap
from jaxtube.scenario.tree import Scenario
from jaxtube.synthesis.border import Attempt
from jaxtube.synthesis.levers import Lever

SUPERLATIVES = {"speed": "largest speed", "limits": "smallest limits", "slip": "widest slip"}
CAVEAT = (
    "the border is that of this search: beyond it no design was found, which does not prove that "
    "there is none"
)


def report(scenario: Scenario, found: Fit) -> str:
    """Return the report as text."""
    lines = []
    for line in describe_border(scenario, found):
        lines += wrap(line, "  ")
    lines += ["", _attempt_table(found), *wrap(f"  {CAVEAT}", "  ")]
    if found.second is not None:
        lines += ["", _frontier_table(found, found.second)]
    return "\n".join(lines)


def describe_border(scenario: Scenario, found: Fit) -> list[str]:
    """Return what was found of the border, a sentence a line."""
    lever = found.lever
    best = found.border.best
    beyond = found.border.beyond
    name = SUPERLATIVES[lever.name]
    if best is None:
        return [_say_none(lever, found.border.attempts)]
    values = lever.say(lever.scale(scenario, best.factor))
    assert best.ratio is not None
    lines = [
        f"{name} with a certificate: {values} ({best.factor:.4g} times the scenario's); the tube "
        f"fills {best.ratio:.1%} of its caps"
    ]
    if beyond is None:
        return [*lines, "no border was met as far as was searched"]
    where = "there" if beyond.value is None else f"at {_say_value(lever, beyond)}"
    return [*lines, f"no design was found {where}: {beyond.reason}"]


def _say_none(lever: Lever, attempts: tuple[Attempt, ...]) -> str:
    """Return that no attempt holds, and which came closest."""
    with_ratio = [attempt for attempt in attempts if attempt.ratio is not None]
    if not with_ratio:
        return f"no {lever.name} tried has a design: {attempts[0].reason}"
    closest = min(with_ratio, key=lambda attempt: attempt.ratio or 0.0)
    return (
        f"no {lever.name} tried has a certified design; closest at {_say_value(lever, closest)}: "
        f"{closest.reason}"
    )


def _attempt_table(found: Fit) -> str:
    columns = [
        Column(found.lever.label),
        Column("factor"),
        Column("tube fills", "% of caps"),
        left("certified"),
        left("binds, or denies it"),
    ]
    return format_table(columns, map(_attempt_row, found.border.attempts), WIDTH)


def _attempt_row(attempt: Attempt) -> list[str]:
    is_told = attempt.is_certified or (attempt.ratio is not None and attempt.ratio > 1)
    return [
        "-" if attempt.value is None else f"{attempt.value:.4g}",
        f"{attempt.factor:.4g}",
        "-" if attempt.ratio is None else f"{100 * attempt.ratio:.1f}",
        "yes" if attempt.is_certified else "no",
        attempt.binding if is_told else attempt.reason,
    ]


def _frontier_table(found: Fit, second: Lever) -> str:
    columns = [
        Column(second.label),
        Column(f"certified {found.lever.label}"),
        Column("tube fills", "% of caps"),
        left("binds"),
    ]
    return format_table(columns, map(_frontier_row, found.frontier), WIDTH)


def _frontier_row(point: FrontierPoint) -> list[str]:
    value = f"{point.value:.4g}"
    attempt = point.attempt
    ratio = None if attempt is None else attempt.ratio
    if attempt is None or ratio is None:
        return [value, "none found", "-", "-"]
    return [value, f"{attempt.value:.4g}", f"{100 * ratio:.1f}", attempt.binding]


def _say_value(lever: Lever, attempt: Attempt) -> str:
    return f"{lever.label} = {attempt.value:.4g}"
