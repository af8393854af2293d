"""Whether the true errors stay in the error constraints between the ends of periods, too: a bound
on them can prove it, motions followed through a period can refute the bound.

Source: new.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from jaxtyping import Float

from jaxtube.coordinates import COORDINATES, describe_excursion
from jaxtube.scenario.error_box import error_vector
from jaxtube.synthesis.certificate.period import errors_within_period, extreme_cases
from jaxtube.synthesis.disturbance import bound_committed_errors, bound_error_between_periods
from jaxtube.synthesis.problem import Problem
from sets.certificate import ROUNDING, Condition, judge

NAME = "true_error_between_periods"
SHARES = (0.25, 0.5, 0.75)
"""Shares of a period after which motions are looked at."""


def check_between_periods(problem: Problem) -> Iterator[Condition]:
    """Check that true errors which lie in their limits at the ends of a period lie in the error
    constraints within it; nothing where there is no bound on them, as the assumptions then say.

    It is for information: what the verdicts promise holds at the ends of periods. A motion that
    leaves the bound decides the verdict for the robot all the same, for then the mathematics is
    wrong.
    """
    try:
        excursion = bound_error_between_periods(problem)
    except ValueError:
        return
    limits = bound_committed_errors(problem)
    found = find_chord_distance(problem, limits)
    if np.any(found > excursion + ROUNDING):
        sentence = f"The bound within a period is refuted: found {found}, where {excursion} is."
        yield Condition(NAME, float(np.min(excursion - found)), sentence, "robot")
        return
    rooms = error_vector(problem.scenario.constraints) - limits - excursion
    worst = int(np.argmin(rooms))
    by = describe_excursion(excursion)
    yield judge(
        NAME,
        float(rooms[worst]) + ROUNDING,
        f"Between the ends of periods the true error leaves the limits that it has there {by}, and "
        "with that stays in the error constraints at all times; motions found leave the chord "
        f"between their ends by {np.max(found[:2] / excursion[:2]):.1%} of that.",
        f"Between the ends of periods the true error may leave the limits that it has there {by}: "
        f"the {COORDINATES[worst].name} one then passes its constraint.",
        "information",
    )


def find_chord_distance(problem: Problem, limits: Float[np.ndarray, "3"]) -> Float[np.ndarray, "3"]:
    """Return how far motions that begin and end within |e| <= limits are, on the way, from the
    chord between their ends, (m, m, rad), among the extremes of what is certified."""
    cases = extreme_cases(problem)
    start = errors_within_period(problem, cases, 0.0)
    end = errors_within_period(problem, cases, 1.0)
    stays = np.all(np.maximum(np.abs(start), np.abs(end)) <= limits + ROUNDING, axis=1)
    distances = []
    for share in SHARES:
        chord = (1 - share) * start + share * end
        distances.append(np.abs(errors_within_period(problem, cases, share) - chord)[stays])
    return np.max(np.concatenate(distances), axis=0, initial=0.0)
