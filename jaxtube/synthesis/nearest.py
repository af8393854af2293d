"""The nearest scenarios that hold, where a design fails: for a few keys that decide, the value up
to which a certified design was found.

    pull of a quantity = sum over rows of  pressure x change of the row's logarithm,  for one per
                         cent of the quantity

says by how many per cent the ratio falls at the optimum: which keys decide.

Source: new; the envelope theorem for the pulls.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from functools import partial

import msgspec
import numpy as np
from jaxtyping import Float

from jaxtube.scenario.tree import Initial, Scenario
from jaxtube.synthesis.attempt import Attempt, attempt_design, attempt_search
from jaxtube.synthesis.border import find_nearest_certified
from jaxtube.synthesis.descent import LEAST_SHARE, ROWS
from jaxtube.synthesis.estimate import Estimate
from jaxtube.synthesis.levers import RANGE, SPEED, Lever, list_levers
from jaxtube.synthesis.optimum import Optimum
from jaxtube.synthesis.problem import make_problem
from jaxtube.synthesis.starts import caps_and_gains, without_caps

STEP = 0.02
"""Logarithm by which a quantity is made easier to learn its pull."""
LEAST_PULL = 0.02
"""Pull from which on a quantity is worth a search."""
SEARCHED = 3
"""Quantities at most whose border is searched."""
ON_PATH = Initial(x_m=0.0, y_m=0.0, heading_deg=0.0)
PRECISION = 0.04
"""Width of the bracket of a border, in logarithms."""
WANTED = 2
"""Quantities of which a value that holds is enough."""
WHEEL_SPEEDS = (RANGE, SPEED)
"""Quantities that decide whether a tube is bounded."""


def find_nearest(
    found: Optimum, on_progress: Callable[[], object] = lambda: None
) -> dict[Lever, Scenario | None]:
    """Search the nearest scenarios that hold for starts on the path.

    Where a start away from the path has a plan is another question, which takes longer.

    Args:
        found: the best caps and gains for a scenario that no design was found for.
        on_progress: is called after the search along each quantity; there are `SEARCHED` at most.

    Returns:
        By quantity, the one that decides most first, the scenario with its nearest value for which
        a certified design was found, without caps and gains; None where none was.
    """
    near = caps_and_gains(found.scenario)
    return _search_along(choose_levers(found), found.scenario, near, on_progress)


def find_nearest_bounded(
    scenario: Scenario, on_progress: Callable[[], object] = lambda: None
) -> dict[Lever, Scenario | None]:
    """Search the nearest scenario that holds where no gains bound a tube, as `find_nearest` does
    where some do: along the reference's wheel speeds. With the period and the track they make the
    loops, which decide whether a tube is bounded; the limits do not. Nothing with bands, whose
    ends no quantity scales."""
    if scenario.operating.bands:
        return {}
    levers = [lever for lever in WHEEL_SPEEDS if lever.values(scenario, 1.0)]
    return _search_along(levers, scenario, None, on_progress)


def _search_along(
    levers: Sequence[Lever],
    scenario: Scenario,
    near: tuple[float, ...] | None,
    on_progress: Callable[[], object],
) -> dict[Lever, Scenario | None]:
    """Return by quantity the nearest scenario that holds, beginning with caps and gains nearby."""
    bare = msgspec.structs.replace(without_caps(scenario), initial=ON_PATH)
    nearest: dict[Lever, Scenario | None] = {}
    for lever in levers:
        if sum(held is not None for held in nearest.values()) < WANTED:
            certified = find_nearest_certified(
                partial(attempt_search, bare, lever),
                partial(_design_afresh, bare, lever),
                lever.easier,
                PRECISION,
                1.0,
                near,
            )
            scaled = None if certified is None else lever.scale(bare, certified.factor)
            nearest[lever] = scaled
        on_progress()
    return nearest


def _design_afresh(
    scenario: Scenario, lever: Lever, factor: float, _: Sequence[float] | None
) -> Attempt:
    """Attempt a design from the scenario alone, as one does who is told what is nearest."""
    return attempt_design(scenario, lever, factor, None)


def choose_levers(found: Optimum) -> list[Lever]:
    """Return the quantities that pull most at an optimum, the speed first, either way: wheels that
    must not be slow may want it higher."""
    pulls = {lever: find_pull(found, lever) for lever in list_levers(found.scenario)}
    if SPEED in pulls:
        pulls[SPEED] = abs(pulls[SPEED])
    worth = [lever for lever in pulls if pulls[lever] > LEAST_PULL]
    worth.sort(key=lambda lever: (lever is not SPEED, -pulls[lever]))
    return worth[:SEARCHED]


def find_pull(found: Optimum, lever: Lever) -> float:
    """Return by how many per cent the ratio falls for one per cent of a quantity; NaN where the
    quantity cannot be eased."""
    values = caps_and_gains(found.scenario)
    assert values is not None
    try:
        eased = lever.scale(found.scenario, math.exp(lever.easier * STEP))
        levels = [_find_levels(each, values) for each in (found.scenario, eased)]
    except ValueError:
        return math.nan
    pressures = np.array([found.pressures[row] for row in ROWS])
    return float(pressures @ (levels[0] - levels[1])) / STEP


def _find_levels(scenario: Scenario, values: Sequence[float]) -> Float[np.ndarray, " rows"]:
    """Return the logarithms of the shares at caps and gains, NaN where their tube is not
    bounded."""
    estimate = Estimate(make_problem(scenario))
    point = estimate.to_point(values)
    shares = estimate.shaped_like(point).shares(point)
    if shares is None:
        return np.full(len(ROWS), np.nan)
    return np.log(np.maximum(np.concatenate([shares.caps[0], shares.limits[0]]), LEAST_SHARE))
