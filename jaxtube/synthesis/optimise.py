"""The optimiser of a certified design: caps and tracking gains under which the tube fills least of
what it may use.

    minimise  max  h_R(row) / offset  over the rows of E_op, U and the coupling,
              R the minimal RPI set of the gains

over the caps of the measured error, of the inputs, of |e_x| / a + |u2| / b <= 1, and (k1, k2, k3).
Of several bands of speed those of every band are chosen at once, and R is the one set of all of
them (`synthesis.banded_estimate`).
Where pose noise takes much of the ratio, the gain of an observer is chosen with them. Wider caps
admit a wider disturbance set W, narrower ones leave less room for it: the optimum is where all
constraints that matter bind alike. On the way W and R are estimated (`synthesis.estimate`,
`synthesis.descent`); what comes out is designed and certified as any other scenario, by rigorous
bounds.

Source: new.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from operator import attrgetter

import numpy as np
from jaxtyping import Float

from jaxtube.scenario.tree import Scenario
from jaxtube.synthesis.banded_estimate import BandedEstimate
from jaxtube.synthesis.continuation import PATHS, follow
from jaxtube.synthesis.corners import CAPS_AND_GAINS
from jaxtube.synthesis.descent import AnyEstimate, Descent, descend
from jaxtube.synthesis.design import find_share_of_start, prepare
from jaxtube.synthesis.disturbance import complete_problem, ground_speed_limits
from jaxtube.synthesis.estimate import ACCURACY, Estimate
from jaxtube.synthesis.optimum import Optimum, describe
from jaxtube.synthesis.problem import Problem
from jaxtube.synthesis.starts import caps_and_gains, make_starts

TRIED = 2
"""Starts made for the robot that are followed, beside the scenario's own."""
SEARCHES = 2 + TRIED + len(PATHS)
"""Searches at most, beside the one from nearby."""
QUIET = 0.9
"""Share of the ratio that is left without pose noise, below which an observer is tried."""
WORTH = 0.97
"""Share of the ratio of the measured error that an observer has to reach, to be worth it."""
OBSERVER_RATES = (1.0, 0.3, 2.5)
"""Rates, by period, at which the search for an observer's gain starts, (longitudinal, lateral,
heading)."""
CORRECTIONS = 6
"""Searches at most for wheels that keep their limits."""
FIRMER = 4.0
"""Times that each of them asks for more beyond what is missed than the one before: a search does
not move for less than it settles by."""
FARTHER = (1.03, 1.12)
"""Factors by which a start without a plan is taken for farther away than it has to be, one try
after the other where rigorous bounds deny what the estimate showed."""
RESERVES = (0.05, 0.15, 0.4)
"""Shares by which proved errors may pass those at corners, one after the other where they pass them
by more than the estimate counts on."""
get_objective = attrgetter("objective")
KIND = ("exact_jacobian", "x_exact", "sequence", "T-A", "computed")
"""Model, input map, tube, terminal set and bound that the search knows."""


class UnboundedTubeError(ValueError):
    """No tracking gains that were tried bound a tube: wheel speeds of the reference turn the robot
    too far in a period, or differ too much."""


def optimise(
    problem: Problem,
    on_progress: Callable[[float], None] = lambda ratio: None,
    near: Sequence[float] | None = None,
) -> Optimum:
    """Find caps and tracking gains of least ratio within the limits of the scenario.

    Args:
        problem: its operating section and tracking gains are replaced; all else is kept.
        on_progress: is told the best ratio so far after each search; there are `SEARCHES` at most.
        near: caps and gains, in the order of `corners.NAMES` and k1, k2, k3: the optimum of a
            problem much like this one. Where the search from there ends with a design it is the
            only one.

    Where none of them ends with a design, an easier scenario's optimum is followed to this one
    (`synthesis.continuation`), unless it has bands.

    Returns:
        The best of all searches, an estimate: design the scenario to know its ratio and its
        certificate.

    Raises:
        UnboundedTubeError: where no gains that were tried bound a tube, or none can.
        ValueError: the scenario is of another kind.
    """
    refuse_other_kinds(problem.scenario)
    _refuse_half_turns(problem)
    estimate = make_estimate(problem)
    best = None if near is None else descend(estimate, estimate.to_point(near))
    if best is not None and describe(best).holds:
        return _correct(best)
    own = caps_and_gains(problem.scenario)
    starts = [] if own is None else [estimate.to_point(own)]
    for start in [*starts, *make_starts(estimate)[:TRIED]]:
        descent = descend(estimate, start)
        if descent is not None:
            best = descent if best is None else min(best, descent, key=get_objective)
        on_progress(np.inf if best is None else describe(best).ratio)
    is_missing = best is None or not describe(best).holds
    if near is None and is_missing and isinstance(estimate, Estimate):
        for descent in follow(estimate):
            best = descent if best is None else min(best, descent, key=get_objective)
            on_progress(describe(best).ratio)
    if best is None:
        section = problem.scenario.reference
        raise UnboundedTubeError(
            "optimise: no tracking gains tried bound a tube over reference wheel speeds from "
            f"{section.wheel_speed_min_mps:g} to {section.wheel_speed_max_mps:g} m/s in any order; "
            "narrow reference.wheel_speed_min_mps and wheel_speed_max_mps"
        )
    if _is_noisy(best):
        observed = descend(estimate, np.append(best.point, _observer_start()))
        if observed is not None and observed.objective < best.objective + math.log(WORTH):
            best = observed
        on_progress(describe(best).ratio)
    return _correct(best)


def _refuse_half_turns(problem: Problem) -> None:
    """Refuse a reference that may turn by half a turn in a period: what steers then is lost."""
    dt = problem.model.dt
    turn = dt * float(np.abs(problem.corners @ [1.0, -1.0]).max()) / problem.model.track_width
    if turn >= math.pi:
        section = problem.scenario.reference
        raise UnboundedTubeError(
            f"optimise: reference wheel speeds from {section.wheel_speed_min_mps:g} to "
            f"{section.wheel_speed_max_mps:g} m/s in any order turn the robot by up to "
            f"{turn:.3g} rad in a period of {dt:g} s, and no gains steer beyond half a turn; "
            "shorten controller.dt_s, or narrow reference.wheel_speed_min_mps and "
            "wheel_speed_max_mps"
        )


def _is_noisy(descent: Descent) -> bool:
    """Whether pose noise takes so much of the tube that an observer may be worth it, which neither
    the scenario gives nor the search has."""
    estimate = descent.estimate
    has_observer = estimate.problem.scenario.controller.has_observer
    if (
        has_observer
        or isinstance(estimate, BandedEstimate)
        or len(descent.point) > CAPS_AND_GAINS
        or not estimate.corners.noise.any()
    ):
        return False
    shares = estimate.shares(descent.point)
    quiet = estimate.without_noise().shares(descent.point)
    if shares is None or quiet is None:
        return True
    return bool(quiet.caps.max() < QUIET * shares.caps.max())


def _observer_start() -> Float[np.ndarray, "3"]:
    """Return where the search for an observer's gain starts, in logarithms."""
    return np.log(-np.expm1(-np.array(OBSERVER_RATES)))


def optimise_nearby(problem: Problem, near: Sequence[float]) -> Optimum | None:
    """Return the end of the one search from caps and gains nearby, quick and uncorrected; None
    where their tube is not bounded.

    Raises:
        ValueError: as `optimise`.
    """
    refuse_other_kinds(problem.scenario)
    _refuse_half_turns(problem)
    estimate = make_estimate(problem)
    descent = descend(estimate, estimate.to_point(near))
    return None if descent is None else describe(descent)


def wheel_excess(problem: Problem) -> float:
    """Return by what factor the greatest ground speed that may be commanded passes what the wheels
    can make of it."""
    assert problem.ground_speeds is not None
    greatest = problem.ground_speeds[1]
    return float(np.max(greatest / ground_speed_limits(problem)[1]))


def wheel_shortfall(problem: Problem) -> float:
    """Return by how much the least ground speed that may be commanded is below what the wheels can
    make, as a share of the greatest that they can; negative where it is above."""
    assert problem.ground_speeds is not None
    least = problem.ground_speeds[0]
    slowest, fastest = ground_speed_limits(problem)
    return float(np.max(slowest - least) / np.min(fastest))


def can_optimise(scenario: Scenario) -> bool:
    """Return whether caps and gains of a scenario of this kind can be searched quickly: those of
    bands take minutes."""
    return _find_kind(scenario) == KIND and not scenario.operating.bands


def refuse_other_kinds(scenario: Scenario) -> None:
    """Raise ValueError for a scenario of another kind."""
    kind = _find_kind(scenario)
    if kind != KIND:
        raise ValueError(
            "optimise: model, input_map, tube, terminal and disturbance.bound are "
            f"{', '.join(kind)}; set them to exact_jacobian, x_exact, sequence, T-A and computed, "
            "as the scenario `certified` does"
        )


def _find_kind(scenario: Scenario) -> tuple[str, ...]:
    settings = scenario.controller
    return (
        settings.model,
        settings.input_map,
        settings.tube,
        settings.terminal,
        scenario.disturbance.bound,
    )


def make_estimate(problem: Problem) -> AnyEstimate:
    """Return the estimate of a problem, with bands or without."""
    return BandedEstimate(problem) if problem.scenario.operating.bands else Estimate(problem)


def _correct(descent: Descent) -> Optimum:
    """Return the optimum whose wheels keep their limits by the rigorous bound, and whose start has
    a plan, where that can be had."""
    asked = descent.estimate
    descent = _spare_wheels(_leave_room(descent, asked), asked)
    found = describe(descent, asked)
    share = _find_share(found)
    for farther in FARTHER:
        if not 0 < share < 1:
            break
        estimate = descent.estimate.with_farther_start(farther / share)
        descent = _spare_wheels(descend(estimate, descent.point) or descent, asked)
        tried = describe(descent, asked)
        reached = _find_share(tried)
        if reached <= share:
            break
        found = tried
        share = reached
    return found


def _leave_room(descent: Descent, asked: AnyEstimate) -> Descent:
    """Return a search whose caps leave what is proved of an estimate or of late poses, which may
    pass what corners show, enough of the constraints; the given one where none does."""
    given = descent
    for reserve in RESERVES:
        found = describe(descent, asked)
        if not found.holds or _is_provable(found):
            return descent
        descent = descend(descent.estimate.with_reserve(reserve), descent.point) or descent
    return descent if _is_provable(describe(descent, asked)) else given


def _is_provable(found: Optimum) -> bool:
    """Whether rigorous bounds let a problem be made of an optimum."""
    try:
        complete_problem(found.scenario)
    except ValueError:
        return False
    return True


def _spare_wheels(descent: Descent, asked: AnyEstimate) -> Descent:
    """Return a search whose wheels keep their limits by the rigorous bound, where it holds."""
    for correction in range(CORRECTIONS):
        found = describe(descent, asked)
        if not found.holds:
            break
        try:
            problem = complete_problem(found.scenario)
        except ValueError:
            break
        excess = wheel_excess(problem)
        shortfall = wheel_shortfall(problem)
        if excess <= 1 and shortfall <= 0:
            break
        # Corners miss the extreme ground speeds by little: ask for that much less, or more.
        stricter = descent.estimate
        beyond = ACCURACY * FIRMER**correction
        if excess > 1:
            stricter = stricter.with_less_speed(excess * (1 + beyond))
        if shortfall > 0:
            stricter = stricter.with_more_speed(shortfall + beyond)
        descent = descend(stricter, descent.point) or descent
    return descent


def _find_share(found: Optimum) -> float:
    """Return the share of the start that has a plan, 0 where no design comes of the optimum."""
    if not found.holds:
        return 0.0
    try:
        return find_share_of_start(prepare(complete_problem(found.scenario)))
    except ValueError:
        return 0.0
