"""Where the MPC has a plan: the feasible set of initial errors, probed by linear programs.

F = {e : some g meets  lower <= row_errors e + rows g <= upper}  is convex; rays from the origin
reach its boundary, and the hull of the points reached lies inside it.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float
from scipy.optimize import linprog

from jaxtube.control.planning import CondensedQp
from jaxtube.scenario.refusal import ScenarioError
from jaxtube.synthesis.control_problem import ControlProblem
from jaxtube.synthesis.problem import Problem
from sets.polytope import Polytope
from sets.projection import SHARE, Projection, project

RAYS = 400
"""Rays by which starts are spread over the feasible set: boundary points of their hull."""
EXACTLY = {"primal_feasibility_tolerance": 1e-9}
EDGE = 1e-6
"""Share by which starts keep off the edge of the feasible set, which linear programs find to about
1e-9."""
JUST_INSIDE = 0.999
"""Share of the hull of boundary points that starts close to its edge take."""


def noise_corners(problem: ControlProblem) -> Float[np.ndarray, "corners 3"]:
    """Return the extreme errors of the measured pose, the one zero where there is no noise."""
    noise = problem.noise
    if not noise.any():
        return np.zeros((1, len(noise)))
    return noise * np.array(np.meshgrid(*[[-1, 1]] * len(noise))).reshape(len(noise), -1).T


def reach_of_ray(
    qps: CondensedQp,
    index: int,
    direction: Float[np.ndarray, "3"],
    origin: Float[np.ndarray, "3"] | None = None,
) -> float:
    """Return the largest t with origin + t * direction in F, t >= 0; 0 where there is none.

    The origin is that of the errors where none is given.
    """
    errors, rows, bounds = _constraints(qps, index)
    if origin is not None:
        bounds = bounds - errors @ origin
    answer = linprog(
        np.append(np.zeros(rows.shape[1]), -1.0),
        A_ub=np.column_stack([rows, errors @ direction]),
        b_ub=bounds,
        bounds=[(None, None)] * rows.shape[1] + [(0, None)],
        options=EXACTLY,
    )
    if answer.status == 3:  # unbounded: a direction that no row limits
        return np.inf
    return float(answer.x[-1]) if answer.status == 0 else 0.0


def shortfall(qps: CondensedQp, index: int, error: Float[np.ndarray, "3"]) -> float:
    """Return by how much rows must give way before `error` has a plan; <= 0 where it has one."""
    errors, rows, bounds = _constraints(qps, index)
    answer = linprog(
        np.append(np.zeros(rows.shape[1]), 1.0),
        A_ub=np.column_stack([rows, -np.ones(len(rows))]),
        b_ub=bounds - errors @ error,
        bounds=[(None, None)] * rows.shape[1] + [(-1.0, None)],
        options=EXACTLY,
    )
    return float(answer.x[-1]) if answer.status == 0 else np.inf


def boundary(
    qps: CondensedQp, index: int, error_set: Polytope, count: int, seed: int = 0
) -> Float[np.ndarray, "count 3"]:
    """Return points on the boundary of F along `count` random directions, E being scaled to a cube
    for the draw.

    Their convex hull lies in F.
    """
    states = error_set.dimension
    widths = error_set.support(np.eye(states))
    directions = np.random.default_rng(seed).normal(size=(count, states)) * widths
    in_error_set = 1 / np.max(directions @ error_set.normals.T / error_set.offsets, axis=1)
    in_feasible_set = [reach_of_ray(qps, index, direction) for direction in directions]
    return np.minimum(in_feasible_set, in_error_set)[:, None] * directions


def project_feasible_set(
    qps: CondensedQp, index: int, error_set: Polytope, share: float = SHARE
) -> Projection:
    """Return F within E of one window, between two polytopes.

    Args:
        qps: the condensed MPC.
        index: the window.
        error_set: E.
        share: of a facet's offset, by which F may reach beyond the inner polytope.

    Raises:
        ValueError: where the origin has no plan.
    """
    errors, rows, bounds = _constraints(qps, index)
    of_errors = np.concatenate([errors, error_set.normals])
    of_plans = np.pad(rows, ((0, len(error_set.normals)), (0, 0)))
    return project(of_errors, of_plans, np.append(bounds, error_set.offsets), share)


def true_starts(
    qps: CondensedQp, index: int, problem: ControlProblem, seed: int = 0
) -> Float[np.ndarray, "k 3"]:
    """Return corners of a polytope of true errors from which there is a plan, whatever the noise of
    the pose.

    The hull of `boundary`, which measured errors may fill, less the noise; of wheels that lag and
    have a limit of acceleration as much of it as lets the first command keep that, too.

    Raises:
        ScenarioError: where no error has a plan.
    """
    states = problem.operating_set.dimension
    if reach_of_ray(qps, index, np.eye(states)[-1]) <= 0:
        raise ScenarioError(
            "scenario: no start has a plan: not even the origin; see the failing conditions of "
            "`design`"
        )
    points = (1 - EDGE) * boundary(qps, index, problem.operating_set, RAYS, seed)
    if isinstance(problem, Problem) and not problem.scenario.robot.obeys_at_once:
        first = problem.first_command
        points = points if first is None else first.shrink(points)
    noise = problem.noise
    if not noise.any():
        return points
    measured = Polytope.from_vertices(points)
    return measured.pontryagin_difference(Polytope.box(-noise, noise)).vertices()


def spread_starts(
    points: Float[np.ndarray, "k 3"], count: int, seed: int, edge_share: float = 0.5
) -> Float[np.ndarray, "count 3"]:
    """Draw starts in the hull of boundary points that contains the origin: a share close to the
    edge, the rest inside.

    Each is a random mixture of three neighbouring boundary points, scaled towards the origin; start
    i is a function of (seed, i) alone.
    """
    starts = np.empty((count, 3))
    for i in range(count):
        generator = np.random.default_rng([seed, i])
        first = generator.integers(len(points))
        nearest = np.argsort(np.linalg.norm(points - points[first], axis=1))[:3]
        mixture = generator.dirichlet(np.ones(3)) @ points[nearest]
        is_at_edge = generator.random() < edge_share
        starts[i] = mixture * (JUST_INSIDE if is_at_edge else generator.random() ** (1 / 3))
    return starts


def _constraints(
    qps: CondensedQp, index: int
) -> tuple[Float[np.ndarray, "rows 3"], Float[np.ndarray, "rows n"], Float[np.ndarray, " rows"]]:
    """Return (errors, rows, bounds) of the one-sided rows  errors e + rows g <= bounds  of one
    window."""
    errors = np.concatenate([qps.row_errors[index], qps.check_errors[index]])
    reached = qps.factors.rows[index] * qps.factors.row_norms[index][:, None]
    unreached = np.zeros((len(errors) - len(reached), reached.shape[1]))
    rows = np.concatenate([reached, unreached])
    lower = np.concatenate([qps.lower[index], qps.check_lower[index]])
    upper = np.concatenate([qps.upper[index], qps.check_upper[index]])
    above = np.isfinite(upper)
    below = np.isfinite(lower)
    return (
        np.concatenate([errors[above], -errors[below]]),
        np.concatenate([rows[above], -rows[below]]),
        np.concatenate([upper[above], -lower[below]]),
    )
