"""Whether the wheels keep their acceleration: a search for periods in which they do not, and a
proof from the rows that the plans keep, whatever these were made of.

Over errors e, inputs u, disturbances w and the next inputs u', all within their rows, and
e' = A e + B u + w, the commands of both periods follow from the input map. The search ascends their
difference by linear programs, each about the point before it (Griffith and Stewart 1961). The proof
bounds m (u' - u), m = (1, l) and (1, -l), by weak duality, with a vector v for all that A and B
vary by, and adds what the input map may (`sets.robot.command_steps`).

Source: new.
"""

from __future__ import annotations

import itertools
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from scipy.optimize import linprog

from jaxtube.synthesis.acceleration import (
    StepBounds,
    bound_steps,
    find_command_steps,
    find_reference_steps,
)
from jaxtube.synthesis.certificate.period import map_inputs
from jaxtube.synthesis.certificate.period_cases import PeriodCases
from jaxtube.synthesis.disturbance import kinematics, operation
from jaxtube.synthesis.problem import Problem
from sets.certificate import ROUNDING, Condition, judge

NAME = "wheel_acceleration"
ASCENTS = 4
"""Linear programs in a row, from each start of the search."""
STEP = 1e-5
"""Of the differences that stand for derivatives, m, rad, m/s, rad/s."""


class TwoPeriods(NamedTuple):
    """Rows and offsets on (e, u, w, v, u'), and the half widths of a box around them."""

    rows: Float[np.ndarray, "k 13"]
    offsets: Float[np.ndarray, " k"]
    widths: Float[np.ndarray, "13"]


def check_acceleration(problem: Problem) -> Condition:
    """Check that no command differs from the one before by more than the wheels' acceleration
    allows, from the second one on."""
    try:
        bounds = bound_steps(problem, operation(problem), kinematics(problem))
    except ValueError as error:
        return Condition(NAME, -np.inf, f"No bound on changes of commands: {error}.", "robot")
    dt = problem.model.dt
    limit = problem.scenario.robot.wheel_acceleration_max_mps2
    assert limit is not None
    share = find_largest_change(problem)
    if share > 1 + ROUNDING:
        return Condition(
            NAME,
            (1 - share) * limit,
            f"A command may change by {share * limit:.4g} m/s^2 from one period to the next; the "
            f"wheels have {limit:g}.",
            "robot",
        )
    room = bounds.change - bound_change(problem, bounds)
    return judge(
        NAME,
        room / dt + ROUNDING,
        f"From one period to the next no command changes by more than {limit:g} m/s^2, whatever "
        f"the disturbances and the reference's steps; changes found reach {share:.1%} of that.",
        f"The plans do not keep the wheels' acceleration of {limit:g} m/s^2: over ground commands "
        f"may change by {-room / dt:.3g} m/s^2 more.",
        "robot",
    )


def bound_change(problem: Problem, bounds: StepBounds) -> float:
    """Return a proved bound of |m (u' - u)|, m/s, over both m."""
    largest = np.abs(operation(problem).box[:, :5]).max(axis=0)
    strays = bounds.model.radius @ largest
    periods = _two_periods(problem, bounds.model.middle, strays)
    proved = []
    for sign, row in itertools.product((-1.0, 1.0), bounds.rows):
        goal = np.concatenate([np.zeros(3), -row, np.zeros(6), row]) * sign
        proved.append(_bound_by_duality(periods, goal))
    return max(proved)


def _two_periods(
    problem: Problem, model: Float[np.ndarray, "3 5"], strays: Float[np.ndarray, "3"]
) -> TwoPeriods:
    """Return what errors, inputs, disturbances, strays and the next inputs keep together."""
    rows = problem.input_rows
    E = problem.operating_set
    W = problem.disturbance_set
    now = np.hstack([rows.errors, rows.inputs, np.zeros((len(rows.offsets), 8))])
    following = np.hstack([model, np.eye(3), np.eye(3), np.zeros((3, 2))])
    inputs_after = np.hstack([np.zeros((len(rows.offsets), 11)), rows.inputs])
    caps = np.hstack([E.normals, np.zeros((len(E.offsets), 10))])
    disturbances = np.hstack(
        [np.zeros((len(W.offsets), 5)), W.normals, np.zeros((len(W.offsets), 5))]
    )
    box = np.zeros((3, 13))
    box[:, 8:11] = np.eye(3)
    inputs = np.abs(operation(problem).inputs).max(axis=0)
    widths = [E.support(np.eye(3)), inputs, W.support(np.eye(3)), strays, inputs]
    return TwoPeriods(
        np.vstack(
            [
                now,
                caps,
                disturbances,
                box,
                -box,
                rows.errors @ following + inputs_after,
                E.normals @ following,
            ]
        ),
        np.concatenate(
            [rows.offsets, E.offsets, W.offsets, strays, strays, rows.offsets, E.offsets]
        ),
        np.concatenate(widths),
    )


def _bound_by_duality(periods: TwoPeriods, goal: Float[np.ndarray, "13"]) -> float:
    """Return an upper bound of a goal, by multipliers that need not be exact."""
    answer = linprog(-goal, periods.rows, periods.offsets, bounds=(None, None), method="highs")
    if answer.status != 0:
        return np.inf
    multipliers = np.maximum(-answer.ineqlin.marginals, 0.0)
    missed = np.abs(goal - multipliers @ periods.rows)
    return float(multipliers @ periods.offsets + missed @ periods.widths)


def find_largest_change(problem: Problem) -> float:
    """Return the largest change of a command that is found, as a share of the limit."""
    largest = 0.0
    for now, after in _reference_pairs(problem):
        model = np.hstack(problem.model.matrices(now))
        periods = _two_periods(problem, model, np.zeros(3))
        for wheel, sign in itertools.product((0, 1), (-1.0, 1.0)):
            search = _Search(problem, periods, model, now, after, wheel, sign)
            largest = max(largest, search.ascend())
    return largest


def _reference_pairs(problem: Problem) -> list[tuple[np.ndarray, np.ndarray]]:
    """Return wheel speeds of the reference in one period and the next, extreme ones."""
    steps = find_reference_steps(problem)
    corners = np.unique(problem.corners, axis=0)
    pairs = []
    for now, target in itertools.product(corners, corners):
        after = np.clip(target, now - steps, now + steps)
        is_certified = [np.all((after >= low) & (after <= high)) for low, high in problem.regions]
        pairs.append((now, after if any(is_certified) else now))
    return [tuple(np.array(each)) for each in np.unique(np.array(pairs), axis=0)]


class _Search:
    """An ascent of the change of one wheel's command, one way."""

    def __init__(self, problem: Problem, periods: TwoPeriods, model, now, after, wheel, sign):
        self.problem = problem
        self.periods = periods
        self.following = np.hstack([model, np.eye(3)])
        self.wheels = (now, after)
        self.wheel = wheel
        self.sign = sign
        steps = find_command_steps(problem)
        assert steps is not None
        self.limit = steps[wheel]

    def ascend(self) -> float:
        """Return the largest change found, as a share of the limit."""
        point = np.zeros(13)
        best = -np.inf
        for _ in range(ASCENTS):
            answer = linprog(
                -self._differentiate(point),
                self.periods.rows,
                self.periods.offsets,
                bounds=(None, None),
                method="highs",
            )
            if answer.status != 0:
                break
            point = answer.x
            best = max(best, self._change(point))
        return float(best / self.limit)

    def _split(self, point: Float[np.ndarray, "13"]) -> tuple[np.ndarray, np.ndarray]:
        """Return (error, input) of both periods."""
        after = np.concatenate([self.following @ point[:8], point[11:]])
        return point[:5], after

    def _change(self, point: Float[np.ndarray, "13"]) -> float:
        now, after = self._split(point)
        before = self._command(self.wheels[0], now[None])[0]
        return float(self.sign * (self._command(self.wheels[1], after[None])[0] - before))

    def _differentiate(self, point: Float[np.ndarray, "13"]) -> Float[np.ndarray, "13"]:
        """Return the slopes of the change."""
        shifts = STEP * np.concatenate([np.eye(5), -np.eye(5)])
        slopes = []
        for wheels, state in zip(self.wheels, self._split(point), strict=True):
            told = self._command(wheels, state + shifts)
            slopes.append((told[:5] - told[5:]) / (2 * STEP))
        now, after = slopes
        ahead = np.concatenate([after[:3] @ self.following, np.zeros(3), after[3:]])
        return self.sign * (ahead - np.concatenate([now, np.zeros(8)]))

    def _command(
        self, wheels: Float[np.ndarray, "2"], states: Float[np.ndarray, "n 5"]
    ) -> Float[np.ndarray, " n"]:
        """Return what the wheel is told, m/s over ground, at errors and inputs."""
        none = np.zeros((len(states), 3))
        cases = PeriodCases(
            errors=states[:, :3],
            inputs=states[:, 3:],
            wheels=np.tile(wheels, (len(states), 1)),
            slip=none[:, :2],
            measured_slip=none[:, :2],
            sideslip=none[:, 0],
            noise=none,
        )
        speed, turn = map_inputs(self.problem, cases)
        side = (1 - 2 * self.wheel) * self.problem.model.track_width / 2
        return speed + side * turn
