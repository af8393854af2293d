"""The attempts of `fit`: the border of the quantity, a few easier ones that show how the ratio
grows towards it, and the border at other values of a second quantity. Each attempt is saved at
once; a search is a function of the answers to its earlier questions, so that a resumed run goes on
where it was killed.

Source: new.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass

from jaxtube.experiments.run.value_log import ValueLog
from jaxtube.progress import ProgressBar, progress
from jaxtube.scenario.refusal import ScenarioError
from jaxtube.scenario.tree import Scenario
from jaxtube.synthesis.border import (
    MOST_ATTEMPTS,
    Attempt,
    Border,
    attempt_design,
    attempt_search,
    find_border,
    find_certified,
)
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
        self._scenario = scenario
        self._lever = lever
        self._log = log
        self._answers = {_key(record): _read(record["attempt"]) for record in log.records}

    def at(
        self, method: str, second: Lever | None = None, second_factor: float = 1.0
    ) -> Callable[[float, Sequence[float] | None], Attempt]:
        """Return what makes attempts by a method, at a factor of the second quantity."""
        scenario = self._scenario
        if second is not None:
            scenario = second.scale(scenario, second_factor)

        def ask(factor: float, near: Sequence[float] | None) -> Attempt:
            question = {"method": method, "second_factor": second_factor, "factor": factor}
            if _key(question) not in self._answers:
                made = METHODS[method](scenario, self._lever, factor, near)
                self._log.append(question | {"attempt": asdict(made)})
                self._answers[_key(question)] = made
            return self._answers[_key(question)]

        return ask


def fit(scenario: Scenario, lever: Lever, log: ValueLog) -> Fit:
    """Find the border of a quantity, and how it moves with the second one."""
    attempts = Attempts(scenario, lever, log)
    border = _find_own_border(attempts, lever)
    second = SECOND[lever.name]
    if border.best is None or not second.values(scenario, 1.0):
        return Fit(lever, border, None, ())
    frontier = _find_frontier(attempts, scenario, lever, second, border.best)
    return Fit(lever, border, second, frontier)


def _find_own_border(attempts: Attempts, lever: Lever) -> Border:
    """Return the border of the scenario, and easier attempts with it."""
    ask = attempts.at("design")
    with progress(MOST_ATTEMPTS, "searching the border", "designs", starting="starting") as bar:
        border = find_border(_shown(ask, bar), lever.easier, PRECISION)
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


def _shown(
    ask: Callable[[float, Sequence[float] | None], Attempt], bar: ProgressBar
) -> Callable[[float, Sequence[float] | None], Attempt]:
    """Return the same, with what was found shown on a bar."""

    def ask_and_show(factor: float, near: Sequence[float] | None) -> Attempt:
        made = ask(factor, near)
        held = "certified" if made.is_certified else "not certified"
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
            neighbour = found[min(between, key=lambda other: abs(other - factor))]
            found[factor] = _find_point(attempts, lever, second, factor, neighbour)
            bar.update()
    return tuple(
        FrontierPoint(factor, second.measure(second.scale(scenario, factor)), found[factor])
        for factor in sorted(found)
        if _is_allowed(scenario, second, factor)
    )


def _find_point(
    attempts: Attempts, lever: Lever, second: Lever, factor: float, neighbour: Attempt | None
) -> Attempt | None:
    """Return the border at one factor of the second quantity, None where none was found."""
    if neighbour is None:
        return None
    try:
        search = attempts.at("search", second, factor)
        certify = attempts.at("design", second, factor)
    except ScenarioError:
        return None
    return find_certified(search, certify, lever.easier, neighbour.factor, neighbour.caps_and_gains)


def _is_allowed(scenario: Scenario, lever: Lever, factor: float) -> bool:
    """Return whether a scenario may have the quantity times a factor."""
    try:
        lever.scale(scenario, factor)
    except ScenarioError:
        return False
    return True


def _key(question: Mapping) -> tuple[str, float, float]:
    return question["method"], question["second_factor"], question["factor"]


def _read(values: Mapping) -> Attempt:
    """Return an attempt from its record, whose tuples are lists."""
    caps = values["caps_and_gains"]
    return Attempt(**{**values, "caps_and_gains": None if caps is None else tuple(caps)})
