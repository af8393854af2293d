"""Condensed QPs along the reference: states eliminated, one set of matrices a window, shared by
every realisation.

    e_j = Psi_j e + Theta_j g,    g = (g_0, .., g_{N-1})
    1/2 g^T H g + (F e)^T g,      H = 2 (sum_j Theta_j^T Q_j Theta_j + R),   F = 2 sum_j Theta_j^T Q_j Psi_j,  Q_N = P
    lower <= row_errors e + rows g <= upper

Rows of E_j for j = 1..N-1, of U_j for j = 0..N-1, and the terminal ones. Constraints are backed off
by what a solver may miss them by. Rows that no input reaches in any window (the lateral error one
step ahead, Euler) are kept apart.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int

from jaxtube import qp
from jaxtube.control.mpc import AnyArray, Window
from jaxtube.synthesis.problem import Problem
from jaxtube.synthesis.terminal import Terminal
from jaxtube.synthesis.tightening import BACK_OFF, Tightening, Windows

UNREACHED = 1e-12
"""A row whose input coefficients are all below this is a test of the present error, not a
constraint on the plan."""


@dataclass(frozen=True, eq=False)
class Bounds:
    """Offsets of the sets the controller really uses, window by window (rows of E, U and the
    terminal constraint)."""

    errors: Float[AnyArray, "windows horizon 6"]  # E_j, j = 0..N-1
    inputs: Float[AnyArray, "windows horizon k"]  # U_j and the coupling's rows, j = 0..N-1
    terminal_normals: Float[AnyArray, "facets 3"]
    terminal: Float[AnyArray, "windows facets"]


def tube_bounds(problem: Problem, tightening: Tightening, terminal: Terminal) -> Bounds:
    """Return the tightened sets, backed off for the solver's residual."""
    N = problem.horizon
    back_off = BACK_OFF * np.arange(1, N + 1)[:, None]
    return Bounds(
        problem.operating_set.offsets - tightening.error_reach[:, :N] - back_off,
        problem.input_rows.offsets - tightening.input_reach - back_off,
        terminal.constraint_normals,
        terminal.constraint_offsets
        - (N + 1) * BACK_OFF * np.linalg.norm(terminal.constraint_normals, axis=1),
    )


def plain_bounds(problem: Problem, windows: Windows, terminal: Terminal) -> Bounds:
    """Return E and U untightened and no terminal set: what MPC without a tube uses.

    The terminal rows stay, unbounded, so that both controllers share their shapes and one
    compilation.
    """
    count, N = len(windows.schedules), problem.horizon
    return Bounds(
        np.broadcast_to(problem.operating_set.offsets, (count, N, 6)),
        np.broadcast_to(problem.input_rows.offsets, (count, N, len(problem.input_rows.offsets))),
        terminal.constraint_normals,
        np.full(terminal.constraint_offsets.shape, np.inf),
    )


class Prediction(NamedTuple):
    """Errors ahead and the rows on them, window by window: all of a QP that neither its cost nor
    its bounds decide."""

    free: Float[AnyArray, "windows horizon+1 3 3"]  # Psi_j
    forced: Float[AnyArray, "windows horizon+1 3 n"]  # Theta_j
    row_errors: Float[AnyArray, "windows m 3"]
    rows: Float[AnyArray, "windows m n"]
    check_errors: Float[AnyArray, "windows c 3"]
    reached: Int[AnyArray, " m"]  # which rows those of the plan are, and which no input reaches
    unreached: Int[AnyArray, " c"]
    transition: Float[AnyArray, "windows 3 3"]  # A(th_k)
    input_matrix: Float[AnyArray, "windows 3 2"]  # B(th_k)


class RowBounds(NamedTuple):
    """Lower and upper bounds of the rows, and of those that no input reaches."""

    lower: Float[AnyArray, "windows m"]
    upper: Float[AnyArray, "windows m"]
    check_lower: Float[AnyArray, "windows c"]
    check_upper: Float[AnyArray, "windows c"]


class Cost(NamedTuple):
    """Weights of errors and inputs, and the terminal cost."""

    error_weight: Float[AnyArray, "3 3"]
    input_weight: Float[AnyArray, "2 2"]
    terminal: Float[AnyArray, "3 3"]


class Gains(NamedTuple):
    """Gains of the tube and of the terminal controller at the first step of each window."""

    tube: Float[AnyArray, "windows 2 3"]
    terminal: Float[AnyArray, "windows 2 3"]


def condense(
    problem: Problem,
    windows: Windows,
    terminal: Terminal,
    cost: Float[np.ndarray, "3 3"],
    bounds: Bounds,
):
    """Return the stacked `Window` of the MPC, numpy float64 (cast it for the device)."""
    ahead = predict(problem, windows, bounds.terminal_normals)
    weights_now = problem.model.weights(windows.schedules[:, 0])
    gains = Gains(windows.gains[:, 0], terminal.gains.at(weights_now))
    with jax.enable_x64(True):
        found = _weigh(
            ahead,
            row_bounds(bounds, ahead),
            gains,
            Cost(problem.error_weight, problem.input_weight, cost),
            widths(problem),
        )
        return jax.tree.map(np.asarray, found)


def widths(problem: Problem) -> Float[np.ndarray, "3"]:
    """Return the half widths of the errors that plans start from, (m, m, rad)."""
    return problem.operating_set.support(np.eye(3))


def predict(
    problem: Problem, windows: Windows, terminal_normals: Float[np.ndarray, "facets 3"]
) -> Prediction:
    """Return the prediction along the reference."""
    transitions, inputs = problem.model.matrices(windows.schedules)
    free, forced = _predictions(transitions, inputs)
    row_errors, rows = _rows(problem, free, forced, terminal_normals)
    is_reached = np.abs(rows).max(axis=(0, 2)) > UNREACHED
    reached, unreached = np.flatnonzero(is_reached), np.flatnonzero(~is_reached)
    kept, checks = (row_errors[:, reached], rows[:, reached]), row_errors[:, unreached]
    return Prediction(
        free, forced, *kept, checks, reached, unreached, transitions[:, 0], inputs[:, 0]
    )


def with_terminal_rows(ahead: Prediction, normals: Float[AnyArray, "facets 3"]) -> Prediction:
    """Return the prediction with other terminal normals, as many, all of them reached;
    differentiable in them."""
    rest = slice(ahead.rows.shape[1] - len(normals))
    row_errors = jnp.concatenate([ahead.row_errors[:, rest], normals @ ahead.free[:, -1]], axis=1)
    rows = jnp.concatenate([ahead.rows[:, rest], normals @ ahead.forced[:, -1]], axis=1)
    return ahead._replace(row_errors=row_errors, rows=rows)


def row_bounds(bounds: Bounds, ahead: Prediction) -> RowBounds:
    """Return the bounds in the order of the rows: opposite rows of E and U are one row with two
    bounds."""
    count, k = len(bounds.inputs), bounds.inputs.shape[2] // 2
    lower = [
        -bounds.errors[:, 1:, 3:],
        -bounds.inputs[:, :, k:],
        jnp.full_like(bounds.terminal, -jnp.inf),
    ]
    upper = [bounds.errors[:, 1:, :3], bounds.inputs[:, :, :k], bounds.terminal]
    lower, upper = (
        jnp.concatenate([part.reshape(count, -1) for part in parts], axis=1)
        for parts in (lower, upper)
    )
    rows, checks = ahead.reached, ahead.unreached
    return RowBounds(lower[:, rows], upper[:, rows], lower[:, checks], upper[:, checks])


def weigh(
    ahead: Prediction,
    bounds: RowBounds,
    gains: Gains,
    cost: Cost,
    largest_errors: Float[AnyArray, "3"],
) -> Window:
    """Return the stacked `Window` of a cost and of bounds; differentiable in both and in the gains.

    Only the ratio of the weights matters to the plan. Their size is chosen so that the gradient at
    g = 0 is 1 at most for errors up to `largest_errors`: to that the solver's tolerance is
    relative.
    """
    N = ahead.free.shape[1] - 1
    stage, last = jnp.broadcast_to(cost.error_weight, (N, 3, 3)), cost.terminal[None]
    weighted = jnp.einsum("wjxa,jxy->wjay", ahead.forced, jnp.concatenate([stage, last]))
    hessian = 2 * (
        jnp.einsum("wjay,wjyb->wab", weighted, ahead.forced)
        + jnp.kron(jnp.eye(N), cost.input_weight)
    )
    linear = 2 * jnp.einsum("wjay,wjye->wae", weighted, ahead.free)
    size = jax.lax.stop_gradient(jnp.maximum(1.0, jnp.max(jnp.abs(linear) @ largest_errors)))
    hessian, linear = hessian / size, linear / size
    free_inputs = -jnp.linalg.solve(hessian, linear)
    return Window(
        factors=jax.vmap(qp.factorise)(hessian, jnp.asarray(ahead.rows)),
        linear=linear,
        cost_unit=jnp.full(len(linear), size),
        row_errors=ahead.row_errors,
        lower=bounds.lower,
        upper=bounds.upper,
        check_errors=ahead.check_errors,
        check_lower=bounds.check_lower,
        check_upper=bounds.check_upper,
        free_inputs=free_inputs,
        free_rows=ahead.row_errors + ahead.rows @ free_inputs,
        free_scale=jnp.max(
            jnp.sum(jnp.abs(hessian) @ jnp.abs(free_inputs) + jnp.abs(linear), axis=2), axis=1
        ),
        tube_gain=gains.tube,
        terminal_gain=gains.terminal,
        transition=ahead.transition,
        input_matrix=ahead.input_matrix,
    )


_weigh = jax.jit(weigh)


def residual_bound(problem: Problem, window: Window) -> float:
    """Return by how much an accepted answer may miss a constraint, from any error in E, in the
    units of E and U.

    The solver accepts a residual of its tolerance times max(1, |q|), on rows of unit norm.
    """
    largest = float(np.max(np.abs(window.linear) @ widths(problem)))
    return qp.TOLERANCE[8] * max(1.0, largest) * float(np.max(window.factors.row_norms))


def _predictions(transitions, inputs):
    """Return Psi (windows, N+1, 3, 3) and Theta (windows, N+1, 3, 2N) with e_j = Psi_j e + Theta_j
    g."""
    count, N = transitions.shape[:2]
    free = np.zeros((count, N + 1, 3, 3))
    forced = np.zeros((count, N + 1, 3, 2 * N))
    free[:, 0] = np.eye(3)
    for j in range(N):
        free[:, j + 1] = transitions[:, j] @ free[:, j]
        forced[:, j + 1] = transitions[:, j] @ forced[:, j]
        forced[:, j + 1, :, 2 * j : 2 * j + 2] = inputs[:, j]
    return free, forced


def _rows(problem: Problem, free, forced, terminal_normals):
    """Return (row_errors, rows): those of E_j, those of the inputs, the terminal ones."""
    count, N = len(free), problem.horizon
    k, n = len(problem.input_rows.offsets) // 2, 2 * N
    C_E, D, C = (
        problem.operating_set.normals[:3],
        problem.input_rows.inputs[:k],
        problem.input_rows.errors[:k],
    )
    selection = np.eye(n).reshape(N, 2, n)
    row_errors = [
        (C_E @ free[:, 1:N]).reshape(count, -1, 3),
        (C @ free[:, :N]).reshape(count, -1, 3),
        terminal_normals @ free[:, N],
    ]
    rows = [
        (C_E @ forced[:, 1:N]).reshape(count, -1, n),
        (D @ selection + C @ forced[:, :N]).reshape(count, -1, n),
        terminal_normals @ forced[:, N],
    ]
    return tuple(np.concatenate(parts, axis=1) for parts in (row_errors, rows))
