"""Starts of the search by continuation: the optimum of an easier scenario, followed to the one that
is asked for.

    for factor in path:  point <- descend(scenario with the quantity times factor, point)

The quantity is the slip error, which grows from little, or the speed, which grows from slow. Caps
and gains of a scenario are close to those of one a little harder, and where tubes barely are
bounded no start made for the robot may lead there.

Source: continuation as of Allgower and Georg 2003, Introduction to Numerical Continuation Methods,
chapter 2, with the search as corrector.
"""

from __future__ import annotations

from collections.abc import Iterator

from jaxtube.scenario.refusal import ScenarioError
from jaxtube.synthesis.descent import Descent, descend
from jaxtube.synthesis.estimate import Estimate
from jaxtube.synthesis.levers import SLIP, SPEED, Lever
from jaxtube.synthesis.problem import Problem, make_problem
from jaxtube.synthesis.starts import make_starts

PATHS = {SLIP: (0.3, 0.6, 0.85), SPEED: (0.5, 0.7, 0.85)}
"""Factors of a quantity on the way to the scenario that is asked for."""


def follow(estimate: Estimate) -> Iterator[Descent]:
    """Yield where a search ends that comes from less slip error, then from less speed; nothing
    where a scenario has none of it, or the way is lost."""
    for lever, path in PATHS.items():
        found = _follow_path(estimate, lever, path)
        if found is not None:
            yield found


def _follow_path(estimate: Estimate, lever: Lever, path: tuple[float, ...]) -> Descent | None:
    """Return where a search ends that follows a quantity, None where there is none of it, or the
    tube of some optimum on the way has no bound at the next."""
    descent = None
    for factor in path:
        easier = _ease(estimate.problem, lever, factor)
        if easier is None:
            return None
        descent = _descend_from(Estimate(easier), descent)
        if descent is None:
            return None
    return None if descent is None else descend(estimate, descent.point)


def _ease(problem: Problem, lever: Lever, factor: float) -> Problem | None:
    """Return the problem with a quantity times a factor, None where it may not be."""
    if not lever.values(problem.scenario, 1.0):
        return None
    try:
        return make_problem(lever.scale(problem.scenario, factor))
    except ScenarioError:
        return None


def _descend_from(estimate: Estimate, descent: Descent | None) -> Descent | None:
    """Search from another optimum, or where there is none yet from the best start that is made."""
    if descent is not None:
        return descend(estimate, descent.point)
    for start in make_starts(estimate)[:1]:
        return descend(estimate, start)
    return None
