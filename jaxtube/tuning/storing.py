"""A finished descent as plain facts and arrays, and back."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from jaxtube.storage import Arrays
from jaxtube.tuning.judgement import HeldOutJudgement, read_judgement
from jaxtube.tuning.run import Descent
from jaxtube.tuning.watch import Outcome, Stop, WatchedIterate

BESTS = ("best_certified", "best_uncertified")


def list_descent_facts(descent: Descent) -> dict[str, Any]:
    """Return the plain numbers and names of a descent."""
    outcome = descent.outcome
    bests = {name: getattr(outcome, name) for name in BESTS}
    return {
        "method": descent.method,
        "iterations": outcome.iterations,
        "evaluations": outcome.evaluations,
        "stop": str(outcome.stop),
        "sentence": outcome.sentence,
        **{name: best and best.iteration for name, best in bests.items()},
    }


def list_descent_arrays(descent: Descent) -> Arrays:
    """Return the arrays of a descent, nested by name; iterates by their number."""
    judged = {
        str(iteration): {"point": judgement.point, **judgement.arrays()}
        for iteration, judgement in enumerate(descent.judged)
    }
    return {"objective": descent.objective, "judged": judged}


def read_descent(facts: Mapping[str, Any], arrays: Mapping[str, Any]) -> Descent:
    """Return the descent of its facts and arrays."""
    entries = [arrays["judged"][str(number)] for number in range(len(arrays["judged"]))]
    judged = [read_judgement(entry["point"], entry) for entry in entries]
    bests = {name: _read_iterate(facts[name], judged) for name in BESTS}
    outcome = Outcome(
        point=judged[-1].point,
        iterations=facts["iterations"],
        evaluations=facts["evaluations"],
        stop=Stop(facts["stop"]),
        sentence=facts["sentence"],
        **bests,
    )
    return Descent(facts["method"], outcome, judged, arrays["objective"])


def _read_iterate(iteration: int | None, judged: list[HeldOutJudgement]) -> WatchedIterate | None:
    if iteration is None:
        return None
    judgement = judged[iteration]
    return WatchedIterate(iteration, judgement.point, judgement.held_out)
