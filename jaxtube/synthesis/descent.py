"""The nonlinear program of the optimiser, solved from one start.

    minimise  log ratio + PENALTY log excess,    excess >= 1
    subject to  h_R(row) / offset <= ratio     over the rows of E_op, U and the coupling,
                use of a limit <= excess       by caps, start and wheels

over logarithms of caps, gains, ratio and excess; shares and uses by `synthesis.estimate`. With the
excess every point with a bounded tube is feasible, so that a search ends with what denies a design
where there is none.

Source: new; sequential quadratic programming by Kraft 1988 (SLSQP of scipy), multipliers by the
non-negative least squares of Lawson and Hanson 1974.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float
from scipy.optimize import minimize, nnls

from jaxtube.synthesis.banded_estimate import BandedEstimate
from jaxtube.synthesis.estimate import CAP_ROWS, LIMIT_ROWS, Estimate

ROWS = (*CAP_ROWS, *LIMIT_ROWS)
"""Names of all rows of a problem without bands, in the order of the program's."""
REACH = 3.0
"""How far the search may go from its start, in logarithms."""
PENALTY = 20.0
"""What the logarithm of the excess costs, beside that of the ratio."""
STEPS = 40
"""Iterations of a search at most."""
SETTLED = 1e-4
"""Change of the objective at which a search ends."""
ROUNDS = 4
"""Searches after each other at most."""
GAINED = 0.01
"""What a search gains in its objective where another one is worth it."""
DIFFERENCE = 1e-6
"""Step of the forward differences, in logarithms."""
MISSED = -10.0
"""Slack of every row where the loops have no bounded tube."""
BINDING = 0.03
"""Slack, in logarithms, below which a row takes part in the optimum."""
LEAST_SHARE = 1e-9
"""What counts for a share of nothing."""
COST = np.array([1.0, PENALTY])
"""Slopes of the objective in logarithms of ratio and excess."""

AnyEstimate = Estimate | BandedEstimate


class Descent(NamedTuple):
    """Where a search from one start ended, by whose estimate, and the objective there."""

    estimate: AnyEstimate
    point: Float[np.ndarray, " k"]
    objective: float


def descend(estimate: AnyEstimate, start: Float[np.ndarray, " k"]) -> Descent | None:
    """Solve the program from logarithms of caps and gains; None where the tube of the start is not
    bounded.

    A search that ends early, at a kink or far from its start, begins anew where it ended.
    """
    ranges = estimate.ranges(len(start))
    start = np.clip(start, *ranges)
    best = _judge(estimate.shaped_like(start), start)
    for _ in range(ROUNDS):
        if best is None:
            break
        near = best.point + np.array([[-REACH], [REACH]])
        bounds = np.where(np.isfinite(ranges), ranges, near)
        found = _judge(best.estimate, _solve(best, bounds))
        if found is None or found.objective >= best.objective:
            break
        gained = best.objective - found.objective
        best = found._replace(estimate=estimate.shaped_like(found.point))
        if gained < GAINED:
            break
    return best


def _solve(begun: Descent, bounds: Float[np.ndarray, "2 k"]) -> Float[np.ndarray, " k"]:
    """Return the point where sequential quadratic programs from another one end."""
    rows = _Rows(begun.estimate)
    ends = find_ends(begun.estimate, begun.point)
    assert ends is not None
    start = np.array([*begun.point, *ends])
    cost = _spread_cost(len(start))
    answer = minimize(
        lambda point: float(cost @ point),
        start,
        jac=lambda point: cost,
        bounds=[*bounds.T, (ends[0] - REACH, ends[0] + REACH), (0.0, ends[1] + REACH)],
        constraints={"type": "ineq", "fun": rows.slack, "jac": rows.slopes},
        method="SLSQP",
        options={"maxiter": STEPS, "ftol": SETTLED},
    )
    return answer.x[:-2]


def _judge(estimate: AnyEstimate, point: Float[np.ndarray, " k"]) -> Descent | None:
    ends = find_ends(estimate, point)
    return None if ends is None else Descent(estimate, point, float(COST @ ends))


def _spread_cost(size: int) -> Float[np.ndarray, " k+2"]:
    """Return the slopes of the objective in all variables."""
    return np.append(np.zeros(size - len(COST)), COST)


def find_ends(
    estimate: AnyEstimate, point: Float[np.ndarray, " k"]
) -> Float[np.ndarray, "2"] | None:
    """Return the logarithms of least ratio and excess at a point, None where its tube is not
    bounded."""
    shares = estimate.shares(point)
    if shares is None:
        return None
    return np.log([shares.caps.max(), max(shares.limits.max(), 1.0)])


def find_pressures(descent: Descent) -> Float[np.ndarray, " rows"]:
    """Return by how many per cent the objective falls where a row gains one per cent of room.

    They are the multipliers that make the end of the search stationary best: those of the ratio's
    rows add up to 1, as far as it is stationary.
    """
    estimate, point, _ = descent
    ends = find_ends(estimate, point)
    assert ends is not None
    whole = np.array([*point, *ends])
    rows = _Rows(estimate)
    binds = np.flatnonzero(rows.slack(whole) < BINDING)
    slopes_of_all = rows.slopes(whole)
    slopes = slopes_of_all[binds]
    highest = estimate.ranges(len(point))[1]
    touched = -np.eye(len(whole))[:-2][point > highest - BINDING]
    if ends[1] < BINDING:
        touched = np.vstack([touched, np.eye(len(whole))[-1]])
    multipliers, _ = nnls(np.vstack([slopes, touched]).T, _spread_cost(len(whole)))
    pressures = np.zeros(len(slopes_of_all))
    pressures[binds] = multipliers[: len(binds)]
    return pressures


class _Rows:
    """The constraints as slacks in logarithms.

    All corners are looked through where slopes are asked for; between them W is taken from those
    that were extreme so far.
    """

    def __init__(self, estimate: AnyEstimate):
        self.estimate = estimate
        self._count = len(estimate.cap_rows) + len(estimate.limit_rows)
        self._corners: Any = None  # as the estimate has them

    def slack(self, point: Float[np.ndarray, " k+2"]) -> Float[np.ndarray, " rows"]:
        """Return the slack of every row, `MISSED` where the loops have no bounded tube."""
        if self._corners is None:
            self._corners = self.estimate.find_corners(point[:-2])
        active = self.estimate.find_active(point[:-2], self._corners)
        if active is None:
            return np.full(self._count, MISSED)
        return self._slack_nearby(point[None], active)[0]

    def slopes(self, point: Float[np.ndarray, " k+2"]) -> Float[np.ndarray, "rows k+2"]:
        """Return the Jacobian of the slacks, by forward differences of what is active."""
        self._corners = self.estimate.find_corners(point[:-2], self._corners)
        active = self.estimate.find_active(point[:-2], self._corners)
        if active is None:
            return np.zeros((self._count, len(point)))
        points = point + DIFFERENCE * np.vstack([np.zeros(len(point)), np.eye(len(point))])
        slacks = self._slack_nearby(points, active)
        return ((slacks[1:] - slacks[0]) / DIFFERENCE).T

    def _slack_nearby(
        self, points: Float[np.ndarray, "n k+2"], active: Any
    ) -> Float[np.ndarray, "n rows"]:
        shares = self.estimate.shares_nearby(points[:, :-2], active)
        filled = points[:, -2:-1] - np.log(shares.caps)
        used = points[:, -1:] - np.log(np.maximum(shares.limits, LEAST_SHARE))
        return np.concatenate([filled, used], axis=1)
