"""The optimiser of a certified design: caps and tracking gains under which the tube fills least of
what it may use.

    minimise  max  h_R(row) / offset  over the rows of E_op, U and the coupling,    R the minimal RPI set of the gains

over the caps of the measured error, of the inputs, of |e_x| / a + |u2| / b <= 1, and (k1, k2, k3).
Wider caps admit a wider disturbance set W, narrower ones leave less room for it: the optimum is
where all constraints that matter bind alike. On the way W is estimated at corners of the operating
set and R in two parts, e_x alone (decoupled) and (e_y, e_th) driven by it; what comes out is
designed and certified as any other scenario, by rigorous bounds.

Source: new; sequential quadratic programming by Kraft 1988 (SLSQP of scipy) on logarithms of all
quantities.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import msgspec
import numpy as np
from jaxtyping import Float
from scipy.optimize import minimize

from jaxtube.plant.model import VERTEX_SIDES
from jaxtube.scenario import Scenario
from jaxtube.synthesis.disturbance import (
    complete_problem,
    ground_speed_limits,
    kinematics,
    operation,
)
from jaxtube.synthesis.problem import Problem, error_vector
from sets.robot.plant import Period, split_residual

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
k3."""
DIRECTIONS = 120
"""Facets of the polygon around the minimal RPI set in (e_y, e_th)."""
START_STEPS, START_TURN = 2, 1 / 3
"""Caps exceed the start by this many steps of W, and leave it this share of the yaw rate deficit to
turn with."""
STEP = 1e-4
CORRECTIONS = 3
"""Repetitions at most, where the rigorous bound of the ground speeds passes what corners showed."""


@dataclass(frozen=True)
class Shares:
    """What share of each cap the tube fills, and how far the limits beside them are used."""

    caps: Float[np.ndarray, " caps"]
    limits: Float[np.ndarray, " limits"]


class _Search:
    """One problem's shares as a function of the logarithms of caps and gains."""

    def __init__(self, problem: Problem):
        scenario, T = problem.scenario, problem.model.dt
        self.problem, self.kinematics = problem, kinematics(problem)
        self.noise = error_vector(scenario.noise)
        self.error_limits = error_vector(scenario.constraints) - self.noise
        self.wheel_error = operation(problem).wheel_error
        self.corners = np.unique(problem.corners, axis=0)
        self.period = Period(T, problem.model.track_width, T * float(self.corners.mean()) / 2)
        slowest, fastest = ground_speed_limits(problem)
        self.speed_limits = float(slowest.max()), float(fastest.min())
        stretched = [problem.model.stretched_box(*region) for region in problem.regions]
        ends = np.array([np.stack(pair)[VERTEX_SIDES, [0, 1]] for pair in stretched]).reshape(-1, 2)
        self.h, self.c = problem.model.turn_and_reach(ends).T
        self.yaw_rate = (
            float(np.max(np.abs(self.corners @ [1.0, -1.0]))) / problem.model.track_width
        )
        angles = 2 * np.pi * np.arange(DIRECTIONS) / DIRECTIONS
        self.directions = np.stack([np.cos(angles), np.sin(angles)], axis=1)

    def shares(self, logarithms: Float[np.ndarray, " 11"]) -> Shares | None:
        """Return the shares of caps and limits, None where the loops have no bounded tube."""
        caps, (k1, k2, k3) = _caps(logarithms), np.exp(logarithms[8:])
        x, y, heading, slower, faster, turning, a, b = caps
        yaw, (w_x, w_y, w_th), speeds = self.disturbance(caps)
        reach = self.lateral(k1, k2, k3, yaw, w_x, w_y, w_th)
        if reach is None:
            return None
        r_x, points = w_x / (1 - abs(1 - self.period.dt * k1)), reach
        r_y, r_th = points.max(axis=0)
        r_1, r_2 = k1 * r_x + self.yaw_rate * r_y, float(np.max(points @ [k2, k3]))
        filled = [
            r_x / x,
            r_y / y,
            r_th / heading,
            r_1 / min(slower, faster),
            r_2 / turning,
            r_x / a + r_2 / b,
        ]
        start = np.abs(self.problem.initial_error)
        widths = np.array([w_x, w_y + self.period.lateral_per_yaw * yaw, w_th + yaw])
        limits = [
            *(np.array([x, y, heading]) / self.error_limits),
            *((start + START_STEPS * widths) / np.array([x, y, heading]) if start.any() else ()),
            START_TURN * turning / max(b * (1 - start[0] / a), STEP) if start.any() else 0.0,
            speeds[1] / self.speed_limits[1],
            1 + (self.speed_limits[0] - speeds[0]) / self.speed_limits[1],
        ]
        return Shares(np.array(filled), np.array(limits))

    def disturbance(self, caps):
        """Return (yaw kick, box of the rest, (least, greatest) ground speed) at corners of the
        operating set."""
        x, y, heading, slower, faster, turning, a, b = caps
        coupled = _coupled_corners(x, turning, a, b)
        axes = [
            np.arange(len(coupled)),
            [-y, y],
            np.linspace(-heading, heading, 5),
            [-slower, faster],
        ]
        axes += [
            np.arange(len(self.corners)),
            *([-error, error] for error in self.wheel_error),
            [-1.0, 1.0],
        ]
        at, e_y, e_th, u1, corner, d_r, d_l, side = (
            grid.ravel() for grid in np.meshgrid(*axes, indexing="ij")
        )
        (e_x, u2), (V_r, V_l) = coupled[at.astype(int)].T, self.corners[corner.astype(int)].T
        n_x, n_y, n_th = (side * width for width in self.noise)
        variables = e_x, e_y, e_th, u1, u2, V_r, V_l, d_r, d_l, n_x, n_y, n_th
        parts = split_residual(self.kinematics, self.period, variables)
        w_x, w_y = (np.max(np.abs(coordinate)) for coordinate in parts.rest)
        box = np.array([w_x + self.noise[0], w_y + self.noise[1], 2 * self.noise[2]])
        speeds = min(parts.right.min(), parts.left.min()), max(parts.right.max(), parts.left.max())
        return float(np.max(np.abs(parts.yaw))), box, speeds

    def lateral(self, k1, k2, k3, yaw, w_x, w_y, w_th) -> Float[np.ndarray, "points 2"] | None:
        """Return corners of a polygon around the minimal RPI set in (e_y, e_th), None where it does
        not settle."""
        T, directions = self.period.dt, self.directions
        if not abs(1 - T * k1) < 1:
            return None
        drift = np.max(np.abs(self.h)) * abs(2 - T * k1) * w_x / (1 - abs(1 - T * k1))
        kick = np.abs(directions @ [self.period.lateral_per_yaw, 1.0])
        steps = yaw * kick + np.abs(directions) @ [w_y + drift, w_th]
        loops = np.array(
            [
                [[1 - c * T * k2 / 2, c * (1 - T * k3 / 2)], [-T * k2, 1 - T * k3]]
                for c in self.extreme_c
            ]
        )
        images = directions @ loops
        offsets = steps.copy()
        for _ in range(500):
            points = _corners(directions, offsets)
            reach = steps + np.max(images @ points.T, axis=(0, 2))
            if not np.all(reach < 1e3 * steps.max()):
                return None
            if np.all(reach <= offsets * (1 + STEP / 10)):
                return points
            offsets = np.maximum(offsets, reach)
        return None

    @property
    def extreme_c(self) -> tuple[float, float]:
        """Least and greatest lateral error a period per rad of heading, m."""
        return float(self.c.min()), float(self.c.max())


def _caps(logarithms) -> Float[np.ndarray, " 8"]:
    """Return caps in SI units, the least speed deficit by its size."""
    caps = np.exp(logarithms[:8])
    caps[2] = np.deg2rad(caps[2])
    return caps


def _coupled_corners(x: float, turning: float, a: float, b: float) -> Float[np.ndarray, "points 2"]:
    """Return corners of {|e_x| <= x, |u2| <= turning, |e_x| / a + |u2| / b <= 1}, and points along
    its cut edges."""
    last_x, last_turn = (
        max(min(x, a * (1 - turning / b)), 0.0),
        max(min(turning, b * (1 - x / a)), 0.0),
    )
    along = np.linspace(0.0, 1.0, 5)[:, None]
    edge = (1 - along) * [last_x, min(turning, b)] + along * [min(x, a), last_turn]
    return np.concatenate([edge * signs for signs in itertools.product((-1, 1), repeat=2)])


def _corners(
    directions: Float[np.ndarray, "k 2"], offsets: Float[np.ndarray, " k"]
) -> Float[np.ndarray, "k 2"]:
    """Return the points where neighbouring sides of a polygon meet."""
    following, next_offsets = np.roll(directions, -1, axis=0), np.roll(offsets, -1)
    determinant = directions[:, 0] * following[:, 1] - directions[:, 1] * following[:, 0]
    first = offsets * following[:, 1] - next_offsets * directions[:, 1]
    second = directions[:, 0] * next_offsets - following[:, 0] * offsets
    return np.stack([first, second], axis=1) / determinant[:, None]


@dataclass(frozen=True)
class Optimum:
    """What the optimiser found: the scenario with its caps and gains, and the estimated ratio."""

    scenario: Scenario
    ratio: float


def optimise(
    problem: Problem,
    progress: Callable[[float], None] = lambda ratio: None,
    starts: Sequence[tuple[float, ...]] = STARTS,
) -> Optimum:
    """Find caps and tracking gains of least ratio within the limits of the scenario.

    Args:
        problem: its operating section and tracking gains are replaced; all else is kept.
        progress: is told the best ratio after each start.
        starts: of the search, as `STARTS`; the optimum of a problem much like this one saves time.

    Returns:
        The best of all starts, an estimate: design the scenario to know its ratio and its
        certificate.

    Raises:
        ValueError: where no start leads to a bounded tube, or the scenario is of another kind.
    """
    settings, bound = problem.scenario.controller, problem.scenario.disturbance.bound
    kind = settings.model, settings.input_map, settings.tube, settings.terminal, bound
    if kind != ("exact_jacobian", "x_exact", "sequence", "T-A", "computed"):
        raise ValueError(
            f"optimise: model, input_map, tube, terminal and disturbance.bound are {', '.join(kind)}; "
            "set them to exact_jacobian, x_exact, sequence, T-A and computed, as the scenario `certified` does"
        )
    search, best, least = _Search(problem), None, np.inf
    for start in starts:
        found, ratio = _descend(search, np.log(start))
        if ratio < least:
            best, least = found, ratio
        progress(least)
    if best is None:
        raise ValueError(
            "optimise: no start leads to a bounded tube; lower slip.relative_error or the speed range"
        )
    for _ in range(CORRECTIONS):
        scenario = _with(problem.scenario, best)
        excess = wheel_excess(complete_problem(scenario))
        if excess <= 1:
            break
        # Corners miss the greatest ground speed by little: ask for that much less.
        search.speed_limits = search.speed_limits[0], search.speed_limits[1] / excess / (1 + STEP)
        best, least = _descend(search, best)
    return Optimum(_with(problem.scenario, best), float(least))


def wheel_excess(problem: Problem) -> float:
    """Return by what factor the greatest ground speed that may be commanded passes what the wheels
    can make of it."""
    assert problem.residual is not None
    return float(np.max(problem.residual.ground_speeds[1] / ground_speed_limits(problem)[1]))


def _descend(search: _Search, start) -> tuple[np.ndarray, float]:
    """Run the nonlinear program from one start; return (logarithms, ratio), ratio infinite where
    limits are missed."""
    top = np.log(0.999 / search.period.dt)
    start = np.append(np.minimum(start, [np.inf] * 8 + [top] * 3), 0.0)
    first = search.shares(start[:-1])
    if first is None:
        return start[:-1], np.inf
    unbounded, rows = np.full(len(first.caps) + len(first.limits), -10.0), len(first.caps)
    start[-1] = np.log(first.caps.max())

    def slack(point):
        found = search.shares(point[:-1])
        if found is None:
            return unbounded
        logs = np.log(np.maximum(np.concatenate([found.caps, found.limits]), 1e-9))
        logs[:rows] -= point[-1]
        return -logs

    def slope(point):
        at, rows = slack(point), []
        for i in range(len(point)):
            moved = point.copy()
            moved[i] += STEP
            rows.append((slack(moved) - at) / STEP)
        return np.stack(rows, axis=1)

    bounds = [(value - 1.5, value + 1.5) for value in start[:-1]] + [(-5.0, 5.0)]
    bounds[8] = (np.log(0.5), top)
    answer = minimize(
        lambda point: point[-1],
        start,
        jac=lambda point: np.eye(len(point))[-1],
        bounds=bounds,
        constraints={"type": "ineq", "fun": slack, "jac": slope},
        method="SLSQP",
        options={"maxiter": 40, "ftol": 1e-4},
    )
    shares = search.shares(answer.x[:-1])
    if shares is None or shares.limits.max() > 1 + 10 * STEP:
        return answer.x[:-1], np.inf
    return answer.x[:-1], float(shares.caps.max())


def _with(scenario: Scenario, logarithms) -> Scenario:
    """Return the scenario with these caps and gains, rounded to what one would write."""
    values = np.exp(logarithms)
    limits = error_vector(scenario.constraints) - error_vector(scenario.noise)
    limits[2] = np.rad2deg(limits[2])
    values[:3] = np.minimum(values[:3], limits)
    values[3] *= -1
    caps = {name: _rounded(value) for name, value in zip(NAMES, values[:8], strict=True)}
    gains = tuple(_rounded(value) for value in values[8:])
    return msgspec.structs.replace(
        scenario,
        operating=msgspec.structs.replace(scenario.operating, **caps),
        controller=msgspec.structs.replace(scenario.controller, tracking_gains=gains),
    )


def _rounded(value: float) -> float:
    """Return a number of four significant digits, never larger in size."""
    unit = 10.0 ** (np.floor(np.log10(abs(value))) - 3)
    return float(
        np.format_float_positional(np.trunc(value / unit) * unit, 4, unique=False, fractional=False)
    )
