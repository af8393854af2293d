"""A descent of a tuner with every iterate judged; a log that is handed in answers what it already
knows, so that a killed run goes on where it was.

Streams of the log: NAME for evaluations, NAME-held-out for judgements.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Literal, NamedTuple, Protocol

import numpy as np
from jaxtyping import Bool, Float

from jaxtube.tuning.descent import adam, lbfgs
from jaxtube.tuning.judgement import HeldOutJudgement, read_judgement
from jaxtube.tuning.parameters import Point
from jaxtube.tuning.tuner import NO_DESIGN, Tuner
from jaxtube.tuning.watch import Evaluate, Inspect, Outcome

LARGEST_GRADIENT = 10.0
"""Norm to which Adam's gradients are clipped: else the first steps of an uncertified start, where
soft margins are steep, decide all later ones."""

Method = Literal["lbfgs", "adam"]


class Settings(NamedTuple):
    """How a descent runs.

    Attributes:
        method: L-BFGS-B on the same laps in every evaluation, or Adam with fresh ones in each.
        evaluations: gradients at most.
        patience: iterates without a better held-out objective after which to stop.
        learning_rate: of Adam, in the logarithms of weights and gains.
    """

    method: Method = "lbfgs"
    evaluations: int = 120
    patience: int = 40
    learning_rate: float = 0.1


class Log(Protocol):
    """Memory of what was asked and answered, by stream and in order."""

    def remember(
        self, stream: str, question: Mapping[str, Any], compute: Callable[[], Mapping[str, Any]], /
    ) -> Mapping[str, Any]:
        """Return the answer to the next question of a stream, known or computed."""
        ...


class NoLog:
    """A log that remembers nothing: every answer is computed."""

    def remember(
        self, stream: str, question: Mapping[str, Any], compute: Callable[[], Mapping[str, Any]], /
    ) -> Mapping[str, Any]:
        """Return the answer, computed."""
        return compute()


class Progress(Protocol):
    """What a caller is told while a descent runs."""

    def on_evaluation(self) -> None:
        """Count an evaluation."""

    def on_iterate(self, judgement: HeldOutJudgement, is_best: bool) -> None:
        """Take note of an iterate; `is_best` where it is the best certified one so far."""


class NoProgress:
    """Progress that nobody watches."""

    def on_evaluation(self) -> None:
        """Do nothing."""

    def on_iterate(self, judgement: HeldOutJudgement, is_best: bool) -> None:
        """Do nothing."""


@dataclass(frozen=True, eq=False)
class Descent:
    """A finished descent: its outcome, every iterate as judged, and the objective of its own draws,
    NaN where it was not evaluated."""

    method: Method
    outcome: Outcome
    judged: list[HeldOutJudgement]
    objective: Float[np.ndarray, " iterates"]

    @property
    def certified(self) -> Bool[np.ndarray, " iterates"]:
        """Which iterates are certified."""
        return np.array([judgement.certified for judgement in self.judged])

    def measure(
        self, number: Callable[[HeldOutJudgement], float]
    ) -> Float[np.ndarray, " iterates"]:
        """Return a number of every iterate, NaN of those without laps."""
        values = [number(each) if each.has_laps else np.nan for each in self.judged]
        return np.array(values, float)

    def best(self, accept_uncertified: bool = False) -> HeldOutJudgement | None:
        """Return the iterate of the least held-out objective among the certified ones, or among
        all; None where none qualifies."""
        iterates = [self.outcome.best_certified]
        if accept_uncertified:
            iterates.append(self.outcome.best_uncertified)
        known = [iterate for iterate in iterates if iterate is not None]
        if not known:
            return None
        best = min(known, key=lambda iterate: iterate.held_out)
        return self.judged[best.iteration]


def descend(
    tuner: Tuner,
    settings: Settings,
    log: Log | None = None,
    progress: Progress | None = None,
    name: str = "",
) -> Descent:
    """Run one descent from the tuner's start.

    Args:
        tuner: what is asked.
        settings: how it descends.
        log: of answers, for resuming.
        progress: told of every evaluation and iterate.
        name: of the log's streams, the method unless given.
    """
    journal = _Journal(tuner, log or NoLog(), progress or NoProgress(), name or settings.method)
    start = tuner.parameters.vector
    names = tuner.parameters.free_names
    outcome = _run_method(settings, journal.evaluate, journal.inspect, start, names)
    return Descent(settings.method, outcome, journal.judged, journal.objective())


def _run_method(
    settings: Settings, evaluate: Evaluate, inspect: Inspect, start: Point, names: tuple[str, ...]
) -> Outcome:
    match settings.method:
        case "adam":
            return adam(
                evaluate,
                inspect,
                start,
                names,
                budget=settings.evaluations,
                patience=settings.patience,
                learning_rate=settings.learning_rate,
                largest_gradient=LARGEST_GRADIENT,
            )
        case "lbfgs":
            return lbfgs(
                evaluate,
                inspect,
                start,
                names,
                budget=settings.evaluations,
                patience=settings.patience,
            )


class _Journal:
    """Answers of a tuner as a descent asks for them, logged and kept."""

    def __init__(self, tuner: Tuner, log: Log, progress: Progress, name: str) -> None:
        self.judged: list[HeldOutJudgement] = []
        self._tuner = tuner
        self._log = log
        self._progress = progress
        self._name = name
        self._values: dict[bytes, float] = {}
        self._best = np.inf

    def evaluate(self, point: Point, draws: int) -> tuple[float, Point]:
        """Return objective and gradient."""

        def compute() -> dict[str, Any]:
            value, gradient = self._tuner.evaluate(point, draws)
            return {"value": value, "gradient": gradient}

        answer = self._log.remember(self._name, {"point": point, "draws": draws}, compute)
        value = float(answer["value"])
        self._values[point.tobytes()] = value
        self._progress.on_evaluation()
        return value, answer["gradient"]

    def inspect(self, iteration: int, point: Point) -> HeldOutJudgement:
        """Return the held-out judgement of an iterate."""
        judgement = judge_iterate(self._tuner, self._log, f"{self._name}-held-out", point)
        self.judged.append(judgement)
        is_best = judgement.certified and judgement.held_out < self._best
        if is_best:
            self._best = judgement.held_out
        self._progress.on_iterate(judgement, is_best)
        return judgement

    def objective(self) -> Float[np.ndarray, " iterates"]:
        """Return the objective of every iterate on its own draws.

        An iterate is evaluated when it is left, if not before: the last one may have no value.
        """
        values = [self._values.get(each.point.tobytes(), np.nan) for each in self.judged]
        objective = np.array(values)
        objective[objective >= NO_DESIGN] = np.nan
        return objective


def judge_iterate(tuner: Tuner, log: Log, stream: str, point: Point) -> HeldOutJudgement:
    """Return the held-out judgement of a point, from the log where it is there."""
    answer = log.remember(stream, {"point": point}, lambda: tuner.inspect(point).arrays())
    return read_judgement(point, answer)
