"""Watch over a descent: it counts evaluations and iterates, keeps the best, and ends the descent
when a rule says so, with a sentence that says what happened and what to change."""

from __future__ import annotations

import enum
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
from jaxtyping import Float

CLIFF = 10.0
"""An objective this many times its least value so far has fallen off a cliff: loops that no longer
track."""
CLIFF_STEPS = 5
"""Values beyond a cliff in a row that end a descent."""

Point = Float[np.ndarray, " parameters"]


class Inspection(Protocol):
    """What the caller finds out about an iterate; a held-out value that is not finite is never the
    best."""

    @property
    def held_out(self) -> float: ...
    @property
    def certified(self) -> bool: ...


Evaluate = Callable[[Point, int], tuple[float, Point]]
"""Objective, positive, and its gradient at a point, over the draws of an index."""
Inspect = Callable[[int, Point], Inspection]
"""Inspection of iteration k and its point."""


class Stop(enum.StrEnum):
    """Why a descent ended."""

    BUDGET = "budget"
    CONVERGED = "converged"
    PATIENCE = "patience"
    NOT_A_NUMBER = "not_a_number"
    CLIFF = "cliff"
    LINE_SEARCH = "line_search"


@dataclass(frozen=True, eq=False)
class WatchedIterate:
    """An inspected iterate; iteration 0 is the start."""

    iteration: int
    point: Point
    held_out: float

    @property
    def rank(self) -> tuple[float, int]:
        """The least is the best: of equal held-out values the first."""
        return self.held_out, self.iteration


@dataclass(frozen=True, eq=False)
class Outcome:
    """The end of a descent.

    Attributes:
        point: the last iterate, not the best.
        iterations: steps from the start to the last iterate.
        evaluations: of objective and gradient.
        stop: why it ended.
        sentence: one line that says what happened and what to change.
        best_certified: of the least held-out value; None where no certified iterate was inspected.
        best_uncertified: the same of those without certificate.
    """

    point: Point
    iterations: int
    evaluations: int
    stop: Stop
    sentence: str
    best_certified: WatchedIterate | None
    best_uncertified: WatchedIterate | None


class EndOfDescent(Exception):
    """The end of a descent; thrown because scipy's loop can be left in no other way."""

    def __init__(self, stop: Stop, sentence: str) -> None:
        super().__init__(stop, sentence)
        self.stop = stop
        self.sentence = sentence


@dataclass(eq=False)
class Watch:
    """Count of evaluations and iterates, and the best so far.

    `gentler`: advice appended when a step overshot.
    """

    objective: Evaluate
    inspector: Inspect
    start: Point
    names: Sequence[str]
    budget: int
    patience: int
    gentler: str = ""
    iteration: int = -1
    evaluations: int = 0
    lowest: float = math.inf
    beyond_cliff: int = 0
    best_certified: WatchedIterate | None = None
    best_uncertified: WatchedIterate | None = None
    point: Point = field(init=False)

    def __post_init__(self) -> None:
        self.point = self.start

    def evaluate(self, point: Point, draws: int = 0) -> tuple[float, Point]:
        """Return finite objective and gradient, or end the descent."""
        if self.evaluations == self.budget:
            raise EndOfDescent(
                Stop.BUDGET,
                f"the budget of {self.budget} evaluations is used up at iteration "
                f"{self.iteration}; raise the budget to go on",
            )
        value, gradient = self.objective(np.array(point), draws)
        value = float(value)
        gradient = np.array(gradient, self.start.dtype)
        self.evaluations += 1
        if not math.isfinite(value):
            raise self._not_a_number("objective", self.farthest(point))
        finite = np.isfinite(gradient)
        if not finite.all():
            first = int(np.argmin(finite))
            raise self._not_a_number("gradient", self._parameter(first, point))
        return value, gradient

    def refuse_cliff(self, value: float) -> None:
        """End the descent at the last of CLIFF_STEPS values in a row that are beyond a cliff."""
        self.lowest = min(self.lowest, value)
        is_beyond = value > CLIFF * self.lowest > 0
        self.beyond_cliff = self.beyond_cliff + 1 if is_beyond else 0
        if self.beyond_cliff == CLIFF_STEPS:
            raise EndOfDescent(
                Stop.CLIFF,
                f"objective is over {CLIFF:g} times its least value so far, {self.lowest:.4g}, at "
                f"{CLIFF_STEPS} iterations in a row up to {self.iteration} "
                f"({self.farthest(self.point)}); lower the learning rate or clip gradients to a "
                "smaller norm",
            )

    def inspect(self, point: Point) -> None:
        """Take the next iterate, and end the descent when patience is over."""
        self.point = np.array(point)
        self.iteration += 1
        inspection = self.inspector(self.iteration, np.array(point))
        iterate = WatchedIterate(self.iteration, self.point, float(inspection.held_out))
        if inspection.certified:
            self.best_certified = _better(iterate, self.best_certified)
        else:
            self.best_uncertified = _better(iterate, self.best_uncertified)
        best = self.best_certified or self.best_uncertified  # what would be returned
        last_progress = best.iteration if best else 0
        if self.iteration - last_progress >= self.patience:
            raise self._out_of_patience(best)

    def outcome(self, ended: EndOfDescent) -> Outcome:
        """Return the outcome of a descent that ended."""
        return Outcome(
            self.point,
            self.iteration,
            self.evaluations,
            ended.stop,
            ended.sentence,
            self.best_certified,
            self.best_uncertified,
        )

    def farthest(self, point: Point) -> str:
        """Name the parameter that went farthest from the start, the likeliest cause of trouble."""
        return self._parameter(int(np.argmax(np.abs(point - self.start))), point)

    def _parameter(self, index: int, point: Point) -> str:
        return f"parameter {self.names[index]} = {point[index]:.4g}"

    def _out_of_patience(self, best: WatchedIterate | None) -> EndOfDescent:
        least = "any finite number"
        if best:
            least = f"{best.held_out:.4g} of iteration {best.iteration}"
        return EndOfDescent(
            Stop.PATIENCE,
            f"held-out value is not below {least} after {self.patience} more; use the best "
            "iterate, or raise the patience to look further",
        )

    def _not_a_number(self, what: str, parameter: str) -> EndOfDescent:
        gentler = self.gentler if self.iteration else ""
        return EndOfDescent(
            Stop.NOT_A_NUMBER,
            f"{what} is not a number at iteration {self.iteration} ({parameter}); "
            f"{gentler}start closer to a stable design",
        )


def _better(iterate: WatchedIterate, best: WatchedIterate | None) -> WatchedIterate | None:
    """Return the better of two iterates; one without a finite held-out value is never better."""
    if not math.isfinite(iterate.held_out):
        return best
    if best is None or iterate.rank < best.rank:
        return iterate
    return best
