"""The optimiser of a certified design: caps and tracking gains under which the tube fills least of
what it may use.

    minimise  max  h_R(row) / offset  over the rows of E_op, U and the coupling,
              R the minimal RPI set of the gains

over the caps of the measured error, of the inputs, of |e_x| / a + |u2| / b <= 1, and (k1, k2, k3).
Where pose noise takes much of the ratio, the gain of an observer is chosen with them.
Wider caps admit a wider disturbance set W, narrower ones leave less room for it: the optimum is
where all constraints that matter bind alike. On the way W and R are estimated
(`synthesis.estimate`); what comes out is designed and certified as any other scenario, by rigorous
bounds.

Source: new; sequential quadratic programming by Kraft 1988 (SLSQP of scipy) on logarithms of all
quantities.
"""

from __future__ import annotations

import copy
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

import msgspec
import numpy as np
from jaxtyping import Float
from scipy.optimize import minimize

from jaxtube.scenario.error_box import error_vector, noise_bounds
from jaxtube.scenario.tree import Scenario
from jaxtube.synthesis.advice import say_what_widens
from jaxtube.synthesis.disturbance import complete_problem, ground_speed_limits
from jaxtube.synthesis.estimate import ACCURACY, CAPS_AND_GAINS, USUAL_TRACK_WIDTH_M, Estimate
from jaxtube.synthesis.problem import Problem, make_problem

NAMES = (
    "longitudinal_m",
    "lateral_m",
    "heading_deg",
    "speed_deficit_min_mps",
    "speed_deficit_max_mps",
    "yaw_rate_deficit_radps",
    "turning_longitudinal_m",
    "turning_yaw_rate_radps",
)
STARTS = (
    (0.105, 0.29, 17.0, 0.35, 0.80, 0.90, 0.14, 1.05, 9.5, 7.0, 9.0),
    (0.125, 0.145, 18.5, 0.31, 0.80, 1.30, 0.126, 1.44, 9.5, 11.0, 6.0),
)
"""Starts of the search: caps in the order of `NAMES` (the least speed deficit by its size), k1, k2,
k3; for a robot of the usual track width."""
LENGTH_POWERS = (1, 1, 0, 1, 1, 0, 1, 0, 0, -1, 0)
"""Powers of a length by which each number of a start grows with the robot."""
CORRECTIONS = 3
"""Repetitions at most, where the rigorous bound of the ground speeds passes what corners showed."""
REACH = 1.5
"""How far the search may go from its start, in logarithms."""
SLOWEST_GAIN = 0.5
"""Least k1, 1/s."""
DIFFERENCE = 1e-4
"""Step of the forward differences of the constraints, in logarithms."""
QUIET = 0.8
"""Share of the ratio that is left without pose noise, below which an observer is tried."""
WORTH = 0.97
"""Share of the ratio of the measured error that an observer has to reach, to be worth it."""
OBSERVER_RATES = (10.0, 3.0, 25.0)
"""Rates, 1/s, at which the search for an observer's gain starts, (longitudinal, lateral,
heading)."""
LEAST_SHARE = 0.01
"""Least gain of an observer that is searched."""
MISSED = -10.0
"""Slack of every constraint where the loops have no bounded tube."""


@dataclass(frozen=True)
class Optimum:
    """The scenario with the best caps and gains, and the estimated ratio."""

    scenario: Scenario
    ratio: float


def optimise(
    problem: Problem,
    on_progress: Callable[[float], None] = lambda ratio: None,
    starts: Sequence[tuple[float, ...]] | None = None,
) -> Optimum:
    """Find caps and tracking gains of least ratio within the limits of the scenario, and the gain
    of an observer where one is worth it.

    Args:
        problem: its operating section and tracking gains are replaced, and an observer's gain of 1;
            all else is kept.
        on_progress: is told the best ratio after each start.
        starts: of the search, as `STARTS`; None for `search_starts`. The optimum of a problem much
            like this one saves time.

    Returns:
        The best of all starts, an estimate: design the scenario to know its ratio and its
        certificate.

    Raises:
        ValueError: where no start leads to a bounded tube, or the scenario is of another kind.
    """
    _refuse_other_kinds(problem.scenario)
    starts = search_starts(problem) if starts is None else starts
    estimate = Estimate(problem)
    best = None
    least = np.inf
    for start in starts:
        point, ratio = _descend(estimate, np.log(start))
        if ratio < least:
            best = point
            least = ratio
        on_progress(least)
    at = best if best is not None else np.log(starts[0])
    if _is_noisy(estimate, at):
        point, ratio = _descend(estimate, np.append(at, _observer_start(estimate)))
        if ratio < least * WORTH:
            best = point
            least = ratio
            on_progress(least)
    if best is None:
        widened = _with_values(problem.scenario, np.log(starts[0]))
        raise ValueError(
            f"optimise: no start leads to a bounded tube; {say_what_widens(make_problem(widened))}"
            "; lower slip.relative_error, [noise] or the range of reference wheel speeds"
        )
    for _ in range(CORRECTIONS):
        excess = wheel_excess(complete_problem(_with_values(problem.scenario, best)))
        if excess <= 1:
            break
        # Corners miss the greatest ground speed by little: ask for that much less.
        estimate = estimate.with_less_speed(excess * (1 + ACCURACY))
        best, least = _descend(estimate, best)
    return Optimum(_with_values(problem.scenario, best), float(least))


def _is_noisy(estimate: Estimate, point: Float[np.ndarray, " n"]) -> bool:
    """Whether pose noise takes so much of the tube that an observer may be worth it, which the
    scenario does not give."""
    if estimate.problem.scenario.controller.has_observer or not estimate.noise.any():
        return False
    quiet = copy.copy(estimate)
    quiet.noise = np.zeros(3)
    shares = estimate.shares(point)
    without_noise = quiet.shares(point)
    if shares is None or without_noise is None:
        return True
    return bool(without_noise.caps.max() < QUIET * shares.caps.max())


def _observer_start(estimate: Estimate) -> Float[np.ndarray, "3"]:
    """Return where the search for an observer's gain starts, in logarithms."""
    return np.log(-np.expm1(-np.array(OBSERVER_RATES) * estimate.period.dt))


def search_starts(problem: Problem) -> list[tuple[float, ...]]:
    """Return the starts of a search: the scenario's own caps and gains, where it gives all, and
    `STARTS` in the robot's size."""
    size = problem.robot.track_width / USUAL_TRACK_WIDTH_M
    factors = size ** np.array(LENGTH_POWERS, float)
    scaled = [tuple((factors * start).tolist()) for start in np.array(STARTS)]
    own = caps_and_gains(problem.scenario)
    return scaled if own is None else [own, *scaled]


def caps_and_gains(scenario: Scenario) -> tuple[float, ...] | None:
    """Return the scenario's own caps and tracking gains as a start of the search, None where any is
    missing."""
    caps = [getattr(scenario.operating, name) for name in NAMES]
    if None in caps or not scenario.controller.tracking_gains:
        return None
    return tuple(abs(cap) for cap in caps) + scenario.controller.tracking_gains


def wheel_excess(problem: Problem) -> float:
    """Return by what factor the greatest ground speed that may be commanded passes what the wheels
    can make of it."""
    assert problem.disturbance_bound is not None
    greatest = problem.disturbance_bound.ground_speeds[1]
    return float(np.max(greatest / ground_speed_limits(problem)[1]))


def _refuse_other_kinds(scenario: Scenario) -> None:
    settings = scenario.controller
    kind = (
        settings.model,
        settings.input_map,
        settings.tube,
        settings.terminal,
        scenario.disturbance.bound,
    )
    if kind != ("exact_jacobian", "x_exact", "sequence", "T-A", "computed"):
        raise ValueError(
            "optimise: model, input_map, tube, terminal and disturbance.bound are "
            f"{', '.join(kind)}; set them to exact_jacobian, x_exact, sequence, T-A and computed, "
            "as the scenario `certified` does"
        )


def _descend(
    estimate: Estimate, start: Float[np.ndarray, " n"]
) -> tuple[Float[np.ndarray, " n"], float]:
    """Run the nonlinear program from one start; return (logarithms, ratio), ratio infinite where
    limits are missed."""
    fastest_gain = np.log(0.999 / estimate.period.dt)
    observed = len(start) - CAPS_AND_GAINS
    start = np.minimum(start, [np.inf] * 8 + [fastest_gain] * 3 + [0.0] * observed)
    first = estimate.shares(start)
    if first is None:
        return start, np.inf
    caps = len(first.caps)
    slack = partial(_compute_slack, estimate, caps, caps + len(first.limits))
    bounds = [(value - REACH, value + REACH) for value in start] + [(-5.0, 5.0)]
    bounds[CAPS_AND_GAINS:-1] = [(np.log(LEAST_SHARE), 0.0)] * observed
    bounds[8] = (np.log(SLOWEST_GAIN), fastest_gain)
    answer = minimize(
        lambda point: point[-1],
        np.append(start, np.log(first.caps.max())),
        jac=lambda point: np.eye(len(point))[-1],
        bounds=bounds,
        constraints={"type": "ineq", "fun": slack, "jac": partial(_differentiate, slack)},
        method="SLSQP",
        options={"maxiter": 40, "ftol": 1e-4},
    )
    point = answer.x[:-1]
    shares = estimate.shares(point)
    if shares is None or shares.limits.max() > 1 + 10 * ACCURACY:
        return point, np.inf
    return point, float(shares.caps.max())


def _compute_slack(
    estimate: Estimate, caps: int, rows: int, point: Float[np.ndarray, " n+1"]
) -> Float[np.ndarray, " rows"]:
    """Return the slack of `caps` caps under the ratio, whose logarithm is the last entry of the
    point, and of the limits, in logarithms."""
    shares = estimate.shares(point[:-1])
    if shares is None:
        return np.full(rows, MISSED)
    used = np.concatenate([shares.caps, shares.limits])
    logarithms = np.log(np.maximum(used, 1e-9))
    logarithms[:caps] -= point[-1]
    return -logarithms


def _differentiate(
    function: Callable[[Float[np.ndarray, " n"]], Float[np.ndarray, " rows"]],
    point: Float[np.ndarray, " n"],
) -> Float[np.ndarray, "rows n"]:
    """Return the Jacobian of a function by forward differences."""
    here = function(point)
    columns = [
        (function(point + DIFFERENCE * direction) - here) / DIFFERENCE
        for direction in np.eye(len(point))
    ]
    return np.stack(columns, axis=1)


def _with_values(scenario: Scenario, logarithms: Float[np.ndarray, " n"]) -> Scenario:
    """Return the scenario with these caps and gains, rounded to what one would write."""
    values = np.exp(logarithms)
    limits = error_vector(scenario.constraints) - noise_bounds(scenario)
    limits[2] = np.rad2deg(limits[2])
    observer_gain = scenario.controller.observer_gain
    if len(logarithms) > CAPS_AND_GAINS:
        observer_gain = tuple(_round_down(min(value, 1.0)) for value in values[CAPS_AND_GAINS:])
    values[:3] = np.minimum(values[:3], limits)
    values[3] *= -1
    rounded = [_round_down(value) for value in values]
    caps = dict(zip(NAMES, rounded[:8], strict=True))
    return msgspec.structs.replace(
        scenario,
        operating=msgspec.structs.replace(scenario.operating, **caps),
        controller=msgspec.structs.replace(
            scenario.controller, tracking_gains=tuple(rounded[8:11]), observer_gain=observer_gain
        ),
    )


def _round_down(value: float) -> float:
    """Return a number of four significant digits, never larger in size."""
    unit = 10.0 ** (np.floor(np.log10(abs(value))) - 3)
    shortened = np.trunc(value / unit) * unit
    text = np.format_float_positional(shortened, 4, unique=False, fractional=False)
    return float(text)
