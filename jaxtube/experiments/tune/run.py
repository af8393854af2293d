"""A descent as a run: every evaluation and every inspected iterate logged, so that a killed run
goes on where it was.

Streams of the log: NAME for evaluations, NAME-held-out for inspections.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from jaxtube.experiments.run.progress import progress
from jaxtube.experiments.tune.log import Log
from jaxtube.tuning.descent import Outcome, adam, lbfgs
from jaxtube.tuning.objective import lap_costs
from jaxtube.tuning.tuner import NO_DESIGN, Inspected, Tuner

Point = Float[np.ndarray, " free"]
METHODS = {"adam": "Adam", "lbfgs": "L-BFGS-B"}


def pooled(values: Float[np.ndarray, " laps"]) -> float:
    """Return the RMS over all laps of RMS values of each."""
    return float(np.sqrt(np.mean(values**2)))


class Judgement(NamedTuple):
    """What laps and a design say of a point; the arrays of its laps are empty where nothing could
    be played."""

    point: Point
    held_out: float
    certified: bool
    failing: tuple[str, ...]
    costs: Float[np.ndarray, " laps"]
    errors: Float[np.ndarray, "laps 3"]  # RMS once settled, m, m, rad
    effort: Float[np.ndarray, " laps"]  # RMS, m/s
    settled_effort: Float[np.ndarray, " laps"]
    backups: Float[np.ndarray, " laps"]
    shares: Float[np.ndarray, " caps"]

    @property
    def lateral(self) -> float:
        """RMS lateral error over all laps once settled, m."""
        return pooled(self.errors[:, 1])

    @property
    def overall_effort(self) -> float:
        """RMS effort over all laps, m/s."""
        return pooled(self.effort)


@dataclass(frozen=True, eq=False)
class Descent:
    """A finished descent: its outcome and every iterate as judged, with the objective of its own
    draws."""

    method: str
    outcome: Outcome
    judged: list[Judgement]
    objective: Float[np.ndarray, " iterates"]

    @property
    def certified(self) -> Bool[np.ndarray, " iterates"]:
        """Which iterates are certified."""
        return np.array([each.certified for each in self.judged])


def descend(
    tuner: Tuner,
    log: Log,
    name: str,
    method: str,
    budget: int,
    patience: int,
    rate: float,
    better: Callable,
) -> Descent:
    """Run one descent from the tuner's start; `better(judgement)` is told of every certified
    iterate that is the best.

    Adam's gradients are clipped: else the first steps of an uncertified start, where soft margins
    are steep, decide all later ones.
    """
    judged: list[Judgement] = []
    values: dict[bytes, float] = {}
    best = np.inf

    def evaluate(point: Point, draws: int) -> tuple[float, Point]:
        def compute():
            value, gradient = tuner.evaluate(point, draws)
            return {"value": value, "gradient": gradient}

        answer = log.remember(name, {"point": point, "draws": draws}, compute)
        value = values[point.tobytes()] = float(answer["value"])
        bar.update()
        return value, answer["gradient"]

    def inspect(iteration: int, point: Point) -> Judgement:
        nonlocal best
        found = judge(tuner, log, f"{name}-held-out", point)
        judged.append(found)
        if found.certified and found.held_out < best:
            best = found.held_out
            better(found)
        bar.set_postfix_str(_postfix(found, best), refresh=False)
        return found

    start, names = tuner.parameters.vector, tuner.parameters.free_names
    with progress(budget, f"tuning {name}", "gradients") as bar:
        if method == "adam":
            outcome = adam(
                evaluate,
                inspect,
                start,
                names,
                budget=budget,
                patience=patience,
                learning_rate=rate,
                largest_gradient=10.0,
            )
        else:
            outcome = lbfgs(evaluate, inspect, start, names, budget=budget, patience=patience)
        bar.total = bar.n
    # An iterate is evaluated when it is left, if not before: the last one may have no value.
    objective = np.array([values.get(each.point.tobytes(), np.nan) for each in judged])
    objective[objective >= NO_DESIGN] = np.nan
    return Descent(METHODS[method], outcome, judged, objective)


def judge(tuner: Tuner, log: Log, stream: str, point: Point) -> Judgement:
    """Return the held-out judgement of a point, from the log where it is there."""
    answer = log.remember(stream, {"point": point}, lambda: _arrays(tuner, tuner.inspect(point)))
    return read_judgement(point, answer)


def _arrays(tuner: Tuner, found: Inspected) -> dict[str, np.ndarray]:
    arrays = {
        "held_out": np.array(found.held_out),
        "certified": np.array(found.certified),
        "failing": np.frombuffer("; ".join(found.failing).encode(), np.uint8),
    }
    if found.laps is None or found.shares is None:
        empty = np.empty(0)
        return (
            arrays
            | dict.fromkeys(("costs", "effort", "settled_effort", "backups", "shares"), empty)
            | {"errors": np.empty((0, 3))}
        )
    return arrays | {
        "costs": np.asarray(lap_costs(found.laps, tuner.aim)),
        "errors": found.laps.errors,
        "effort": found.laps.effort,
        "settled_effort": found.laps.settled_effort,
        "backups": found.laps.backups,
        "shares": found.shares,
    }


def read_judgement(point: Point, answer: dict[str, np.ndarray]) -> Judgement:
    """Return the judgement that `_arrays` wrote."""
    failing = tuple(filter(None, bytes(answer["failing"]).decode().split("; ")))
    arrays = {
        name: answer[name]
        for name in ("costs", "errors", "effort", "settled_effort", "backups", "shares")
    }
    return Judgement(point, float(answer["held_out"]), bool(answer["certified"]), failing, **arrays)


def _postfix(found: Judgement, best: float) -> str:
    if not len(found.errors):
        return f"no closed loop ({found.failing[0]})"
    state = "certified" if found.certified else f"not certified ({', '.join(found.failing)})"
    least = f", best certified {best:.4g}" if np.isfinite(best) else ""
    return (
        f"held out {found.held_out:.4g}{least}; lateral {1e3 * found.lateral:.2f} mm, "
        f"effort {found.overall_effort:.4f} m/s; {state}"
    )
