"""The attempts of `fit`: the border of the quantity, a few easier ones that show how the ratio
grows towards it, and the border at other values of a second quantity. Each attempt is saved at
once; a search is a function of the answers to its earlier questions, so that a resumed run goes on
where it was killed.

Source: new.
"""

from __future__ import annotations

import copy
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial

from jaxtube.experiments.run.value_log import ValueLog
from jaxtube.progress import ProgressBar, progress
from jaxtube.scenario.refusal import ScenarioError
from jaxtube.scenario.tree import Scenario
from jaxtube.synthesis.attempt import Attempt, attempt_design, attempt_search, read_attempt
from jaxtube.synthesis.border import MOST_ATTEMPTS, Ask, Border, find_border, find_certified
from jaxtube.synthesis.levers import SLIP, SPEED, Lever

PRECISION = math.log(1.01)
"""Width of the bracket of the border: 1 %."""
CURVE = (0.1, 0.3, 0.6)
"""Steps from the border to the easier attempts that are shown, in logarithms."""
APART = 0.05
"""An attempt closer to one of these than that takes its place."""
SECOND = {"speed": SLIP, "limits": SPEED, "slip": SPEED}
"""The second quantity, by the name of the fitted one."""
FACTORS = (0.5, 0.75, 1.25, 1.5)
"""Of the second quantity."""

Method = Callable[[Scenario, Lever, float, Sequence[float] | None], Attempt]
METHODS: dict[str, Method] = {"design": attempt_design, "search": attempt_search}


@dataclass(frozen=True)
class FrontierPoint:
    """The border at another value of the second quantity; without an attempt none was found."""

    factor: float
    value: float
    attempt: Attempt | None


@dataclass(frozen=True)
class Fit:
    """What was found.

    Attributes:
        lever: the fitted quantity.
        border: of the scenario, with the attempts that show the way to it.
        second: the second quantity, None where the scenario has none of it.
        frontier: the border by the second quantity, which increases; its own value is among them.
    """

    lever: Lever
    border: Border
    second: Lever | None
    frontier: tuple[FrontierPoint, ...]


class Attempts:
    """Attempts by what they were asked for, each answered once, from the log where it is there."""

    def __init__(self, scenario: Scenario, lever: Lever, log: ValueLog):
        self.lever = lever
        self._scenario = scenario
        self._second_factor = 1.0
        self._log = log
        self._answers = {_key(record): read_attempt(record["attempt"]) for record in log.records}

    def of(self, second: Lever, factor: float) -> Attempts | None:
        """Return attempts at a factor of the second quantity, None where no scenario may have
        that."""
        other = copy.copy(self)
        other._second_factor = factor
        try:
            other._scenario = second.scale(self._scenario, factor)
        except ScenarioError:
            return None
        return other

    def by(self, method: str) -> Ask:
        """Return what makes attempts by a method."""
        return partial(self._answer, method)

    def _answer(self, method: str, factor: float, near: Sequence[float] | None) -> Attempt:
        question = {"method": method, "second_factor": self._second_factor, "factor": factor}
        key = _key(question)
        if key not in self._answers:
            made = METHODS[method](self._scenario, self.lever, factor, near)
            self._log.append(question | {"attempt": made.to_record()})
            self._answers[key] = made
        return self._answers[key]


def fit(
    scenario: Scenario, lever: Lever, log: ValueLog, own: tuple[float, ...] | None = None
) -> Fit:
    """Find the border of a quantity, and how it moves with the second one.

    Args:
        scenario: without caps and gains.
        lever: the quantity.
        log: of an earlier run of the same, or empty.
        own: caps and gains to begin with.
    """
    attempts = Attempts(scenario, lever, log)
    border = _find_own_border(attempts, lever, own)
    second = SECOND[lever.name]
    if border.best is None or not second.values(scenario, 1.0):
        return Fit(lever, border, None, ())
    frontier = _find_frontier(attempts, scenario, lever, second, border.best)
    return Fit(lever, border, second, frontier)


def _find_own_border(attempts: Attempts, lever: Lever, own: tuple[float, ...] | None) -> Border:
    """Return the border of the scenario, and easier attempts with it."""
    ask = attempts.by("design")
    with progress(MOST_ATTEMPTS, "searching the border", "designs", starting="starting") as bar:
        border = find_border(_shown(ask, bar), lever.easier, PRECISION, near=own)
        bar.total = bar.n
    if border.best is None:
        return border
    by_place = {-lever.easier * math.log(each.factor): each for each in border.attempts}
    best = -lever.easier * math.log(border.best.factor)
    with progress(len(CURVE), "designing what is easier", "designs", starting="starting") as bar:
        for step in CURVE:
            place = best - step
            if min(abs(place - other) for other in by_place) > APART:
                nearest = min(by_place, key=lambda other: abs(other - place))
                near = by_place[nearest].caps_and_gains
                by_place[place] = ask(math.exp(-lever.easier * place), near)
            bar.update()
    ordered = tuple(by_place[place] for place in sorted(by_place))
    return Border(ordered, border.best, border.beyond)


def _shown(ask: Ask, bar: ProgressBar) -> Ask:
    """Return the same, with what was found shown on a bar."""

    def ask_and_show(factor: float, near: Sequence[float] | None) -> Attempt:
        made = ask(factor, near)
        held = "certified" if made.holds else "not certified"
        if made.value is not None:
            bar.set_postfix_str(f"{made.value:.4g} {held}", refresh=False)
        bar.update()
        return made

    return ask_and_show


def _find_frontier(
    attempts: Attempts, scenario: Scenario, lever: Lever, second: Lever, own: Attempt
) -> tuple[FrontierPoint, ...]:
    """Return the border at other factors of the second quantity, each search from the result of its
    neighbour on the side of the scenario's own."""
    found: dict[float, Attempt | None] = {1.0: own}
    with progress(len(FACTORS), "searching the frontier", "borders", starting="starting") as bar:
        for factor in sorted(FACTORS, key=lambda factor: abs(math.log(factor))):
            between = [other for other in found if (other - 1) * (factor - 1) >= 0]
            nearest = min(between, key=lambda other: abs(other - factor))
            is_easier = (factor - nearest) * second.easier > 0
            found[factor] = _find_point(attempts.of(second, factor), found[nearest], is_easier)
            bar.update()
    return tuple(
        FrontierPoint(factor, second.measure(second.scale(scenario, factor)), found[factor])
        for factor in sorted(found)
        if _is_allowed(scenario, second, factor)
    )


def _find_point(
    attempts: Attempts | None, neighbour: Attempt | None, is_easier: bool
) -> Attempt | None:
    """Return the border at one factor of the second quantity, from that at a neighbouring one, and
    no worse where it is easier to hold; None where none was found."""
    if neighbour is None or attempts is None:
        return None
    easier = attempts.lever.easier
    first = neighbour.factor
    near = neighbour.caps_and_gains
    search = attempts.by("search")
    certify = attempts.by("design")
    quick = find_certified(search, certify, easier, 2 * PRECISION, first, near)
    if quick is not None and not (is_easier and (quick.factor - first) * easier > 0):
        return quick
    # What the estimate does not know of decides, such as a start without a plan.
    return find_border(certify, easier, 2 * PRECISION, first, near).best


def _is_allowed(scenario: Scenario, lever: Lever, factor: float) -> bool:
    """Return whether a scenario may have the quantity times a factor."""
    try:
        lever.scale(scenario, factor)
    except ScenarioError:
        return False
    return True


def _key(question: Mapping) -> tuple[str, float, float]:
    return question["method"], question["second_factor"], question["factor"]
