"""Condensed QPs along the reference: states eliminated, one set of matrices a window, shared by every realisation.

    e_j = Psi_j e + Theta_j g,    g = (g_0, .., g_{N-1})
    1/2 g^T H g + (F e)^T g,      H = 2 (sum_j Theta_j^T Q_j Theta_j + R),   F = 2 sum_j Theta_j^T Q_j Psi_j,  Q_N = P
    lower <= row_errors e + rows g <= upper

Rows of E_j for j = 1..N-1, of U_j for j = 0..N-1, and the terminal ones. Constraints are backed off by what a solver
may miss them by. Rows that no input reaches in any window (the lateral error one step ahead, Euler) are kept apart.
"""

from __future__ import annotations

from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from jaxtube import qp
from jaxtube.design.problem import Problem
from jaxtube.design.terminal import Terminal
from jaxtube.design.tightening import BACK_OFF, Tightening, Windows
from jaxtube.mpc import Window

UNREACHED = 1e-12
"""A row whose input coefficients are all below this is a test of the present error, not a constraint on the plan."""


_factorise = jax.jit(jax.vmap(qp.factorise))


@dataclass(frozen=True, eq=False)
class Bounds:
    """Offsets of the sets the controller really uses, window by window (rows of E, U and the terminal constraint)."""

    errors: Float[np.ndarray, "windows horizon 6"]  # E_j, j = 0..N-1
    inputs: Float[np.ndarray, "windows horizon k"]  # U_j and the coupling's rows, j = 0..N-1
    terminal_normals: Float[np.ndarray, "facets 3"]
    terminal: Float[np.ndarray, "windows facets"]


def tube_bounds(problem: Problem, tightening: Tightening, terminal: Terminal) -> Bounds:
    """Return the tightened sets, backed off for the solver's residual."""
    N = problem.horizon
    back_off = BACK_OFF * np.arange(1, N + 1)[:, None]
    return Bounds(
        problem.operating_set.offsets - tightening.error_reach[:, :N] - back_off,
        problem.input_rows.offsets - tightening.input_reach - back_off,
        terminal.constraint_normals,
        terminal.constraint_offsets - (N + 1) * BACK_OFF * np.linalg.norm(terminal.constraint_normals, axis=1),
    )


def plain_bounds(problem: Problem, windows: Windows, terminal: Terminal) -> Bounds:
    """Return E and U untightened and no terminal set: what MPC without a tube uses.

    The terminal rows stay, unbounded, so that both controllers share their shapes and one compilation.
    """
    count, N = len(windows.schedules), problem.horizon
    return Bounds(
        np.broadcast_to(problem.operating_set.offsets, (count, N, 6)),
        np.broadcast_to(problem.input_rows.offsets, (count, N, len(problem.input_rows.offsets))),
        terminal.constraint_normals,
        np.full(terminal.constraint_offsets.shape, np.inf),
    )


def condense(problem: Problem, windows: Windows, terminal: Terminal, cost: Float[np.ndarray, "3 3"], bounds: Bounds):
    """Return the stacked `Window` of the MPC, numpy float64 (cast it for the device)."""
    transitions, inputs = problem.model.matrices(windows.schedules)
    free, forced = _predictions(transitions, inputs)
    N = problem.horizon
    weights = np.stack([problem.error_weight] * N + [cost])
    input_weight = np.kron(np.eye(N), problem.input_weight)
    hessian = 2 * (np.einsum("wjxa,jxy,wjyb->wab", forced, weights, forced) + input_weight)
    linear = 2 * np.einsum("wjxa,jxy,wjye->wae", forced, weights, free)
    row_errors, rows, lower, upper = _rows(problem, free, forced, bounds)
    reached = np.abs(rows).max(axis=(0, 2)) > UNREACHED
    weights_now = problem.model.weights(windows.schedules[:, 0])
    row_errors_reached, rows_reached = row_errors[:, reached], rows[:, reached]
    free_inputs = -np.linalg.solve(hessian, linear)
    with jax.enable_x64(True):
        factors = _factorise(jnp.asarray(hessian), jnp.asarray(rows_reached))
        factors = jax.tree.map(np.asarray, factors)
    return Window(
        factors=factors,
        linear=linear,
        row_errors=row_errors_reached,
        lower=lower[:, reached],
        upper=upper[:, reached],
        check_errors=row_errors[:, ~reached],
        check_lower=lower[:, ~reached],
        check_upper=upper[:, ~reached],
        free_inputs=free_inputs,
        free_rows=row_errors_reached + rows_reached @ free_inputs,
        free_scale=_row_sum(np.abs(hessian) @ np.abs(free_inputs) + np.abs(linear)),
        tube_gain=windows.gains[:, 0],
        terminal_gain=terminal.gains.at(weights_now),
        transition=transitions[:, 0],
        input_matrix=inputs[:, 0],
    )


def residual_bound(problem: Problem, window: Window) -> float:
    """Return by how much an accepted answer may miss a constraint, from any error in E, in the units of E and U.

    The solver accepts a residual of its tolerance times max(1, |q|), on rows of unit norm.
    """
    widths = problem.operating_set.support(np.eye(3))
    largest = float(np.max(np.abs(window.linear) @ widths))
    return qp.TOLERANCE[8] * max(1.0, largest) * float(np.max(window.factors.row_norms))


def _row_sum(matrices: Float[np.ndarray, "windows n 3"]) -> Float[np.ndarray, " windows"]:
    return matrices.sum(axis=2).max(axis=1)


def _predictions(transitions, inputs):
    """Return Psi (windows, N+1, 3, 3) and Theta (windows, N+1, 3, 2N) with e_j = Psi_j e + Theta_j g."""
    count, N = transitions.shape[:2]
    free = np.zeros((count, N + 1, 3, 3))
    forced = np.zeros((count, N + 1, 3, 2 * N))
    free[:, 0] = np.eye(3)
    for j in range(N):
        free[:, j + 1] = transitions[:, j] @ free[:, j]
        forced[:, j + 1] = transitions[:, j] @ forced[:, j]
        forced[:, j + 1, :, 2 * j : 2 * j + 2] = inputs[:, j]
    return free, forced


def _rows(problem: Problem, free, forced, bounds: Bounds):
    """Return (row_errors, rows, lower, upper): opposite rows of E and U become one row with two bounds."""
    count, N = len(free), problem.horizon
    k, n = len(problem.input_rows.offsets) // 2, 2 * N
    C_E, D, C = problem.operating_set.normals[:3], problem.input_rows.inputs[:k], problem.input_rows.errors[:k]
    selection = np.eye(n).reshape(N, 2, n)
    last = bounds.terminal_normals
    row_errors = [
        (C_E @ free[:, 1:N]).reshape(count, -1, 3),
        (C @ free[:, :N]).reshape(count, -1, 3),
        last @ free[:, N],
    ]
    rows = [
        (C_E @ forced[:, 1:N]).reshape(count, -1, n),
        (D @ selection + C @ forced[:, :N]).reshape(count, -1, n),
        last @ forced[:, N],
    ]
    lower = [
        -bounds.errors[:, 1:, 3:].reshape(count, -1),
        -bounds.inputs[:, :, k:].reshape(count, -1),
        np.full(bounds.terminal.shape, -np.inf),
    ]
    upper = [
        bounds.errors[:, 1:, :3].reshape(count, -1),
        bounds.inputs[:, :, :k].reshape(count, -1),
        bounds.terminal,
    ]
    return tuple(np.concatenate(parts, axis=1) for parts in (row_errors, rows, lower, upper))
