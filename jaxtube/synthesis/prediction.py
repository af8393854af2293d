"""Predictions along the reference, states eliminated, and the rows of all constraints on them.

    e_j = Psi_j e + Theta_j g,    g = (g_0, .., g_{N-1})

Rows of E_j for j = 1..N-1, of U_j for j = 0..N-1, and the terminal ones. Those that no input
reaches in any window (the lateral error one step ahead, Euler) are kept apart.
"""

from __future__ import annotations

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int

from jaxtube.qp.regions import AnyArray
from jaxtube.synthesis.control_problem import ControlProblem
from jaxtube.synthesis.limits import InputRows
from jaxtube.synthesis.windows import Windows

UNREACHED = 1e-12
"""A row whose input coefficients are all below this is a test of the present error, not a
constraint on the plan."""


class Prediction(NamedTuple):
    """Errors ahead and the rows on them, window by window: what depends neither on the cost nor on
    the bounds."""

    free: Float[AnyArray, "windows horizon+1 3 3"]  # Psi_j
    forced: Float[AnyArray, "windows horizon+1 3 n"]  # Theta_j
    row_errors: Float[AnyArray, "windows m 3"]
    rows: Float[AnyArray, "windows m n"]
    check_errors: Float[AnyArray, "windows c 3"]
    reached: Int[AnyArray, " m"]  # indices of the rows of the plan
    unreached: Int[AnyArray, " c"]  # and of those that no input reaches
    transition: Float[AnyArray, "windows 3 3"]  # A(th_k)
    input_matrix: Float[AnyArray, "windows 3 2"]  # B(th_k)


def predict(
    problem: ControlProblem, windows: Windows, terminal_normals: Float[np.ndarray, "facets 3"]
) -> Prediction:
    """Return the prediction along the reference."""
    transitions, inputs = problem.model.matrices(windows.schedules)
    free, forced = predict_errors(transitions, inputs)
    input_rows = problem.rows_of(windows.regimes)
    row_errors, rows = stack_rows(problem, input_rows, free, forced, terminal_normals)
    is_reached = np.abs(rows).max(axis=(0, 2)) > UNREACHED
    reached = np.flatnonzero(is_reached)
    unreached = np.flatnonzero(~is_reached)
    return Prediction(
        free=free,
        forced=forced,
        row_errors=row_errors[:, reached],
        rows=rows[:, reached],
        check_errors=row_errors[:, unreached],
        reached=reached,
        unreached=unreached,
        transition=transitions[:, 0],
        input_matrix=inputs[:, 0],
    )


def predict_errors(
    transitions: Float[np.ndarray, "windows horizon 3 3"],
    inputs: Float[np.ndarray, "windows horizon 3 2"],
) -> tuple[Float[np.ndarray, "windows horizon+1 3 3"], Float[np.ndarray, "windows horizon+1 3 n"]]:
    """Return Psi and Theta with e_j = Psi_j e + Theta_j g."""
    count, N, states, size = inputs.shape
    free = np.zeros((count, N + 1, states, states))
    forced = np.zeros((count, N + 1, states, size * N))
    free[:, 0] = np.eye(states)
    for j in range(N):
        free[:, j + 1] = transitions[:, j] @ free[:, j]
        forced[:, j + 1] = transitions[:, j] @ forced[:, j]
        forced[:, j + 1, :, size * j : size * (j + 1)] = inputs[:, j]
    return free, forced


def stack_rows(
    problem: ControlProblem,
    input_rows: InputRows,
    free: Float[np.ndarray, "windows horizon+1 3 3"],
    forced: Float[np.ndarray, "windows horizon+1 3 n"],
    terminal_normals: Float[np.ndarray, "facets 3"],
) -> tuple[Float[np.ndarray, "windows m+c 3"], Float[np.ndarray, "windows m+c n"]]:
    """Return the coefficients of e and of g in the rows of E_j, those of U_j, the terminal ones.

    Of each pair of opposite rows of E and U the first stands for both. `input_rows` are those of
    every stage of every window.
    """
    N = problem.horizon
    n = forced.shape[3]
    k = problem.input_row_count // 2
    C_E = problem.operating_set.normals[: len(problem.operating_set.offsets) // 2]
    D = input_rows.inputs[:, :, :k]
    C = input_rows.errors[:, :, :k]
    selection = np.eye(n).reshape(N, n // N, n)  # g_j = selection[j] g
    error_parts = (C_E @ free[:, 1:N], C @ free[:, :N], terminal_normals @ free[:, N])
    input_parts = (
        C_E @ forced[:, 1:N],
        D @ selection + C @ forced[:, :N],
        terminal_normals @ forced[:, N],
    )
    row_errors = np.concatenate([merge_stages(part) for part in error_parts], axis=1)
    rows = np.concatenate([merge_stages(part) for part in input_parts], axis=1)
    return row_errors, rows


def merge_stages(array: Float[AnyArray, "windows *stage k"]) -> Float[AnyArray, "windows m k"]:
    """Return the rows of all stages, one below the other."""
    return array.reshape(array.shape[0], -1, array.shape[-1])


def with_terminal_rows(ahead: Prediction, normals: Float[AnyArray, "facets 3"]) -> Prediction:
    """Return the prediction with other terminal normals, as many, all of them reached;
    differentiable in them."""
    rest = slice(ahead.rows.shape[1] - len(normals))
    row_errors = jnp.concatenate([ahead.row_errors[:, rest], normals @ ahead.free[:, -1]], axis=1)
    rows = jnp.concatenate([ahead.rows[:, rest], normals @ ahead.forced[:, -1]], axis=1)
    return ahead._replace(row_errors=row_errors, rows=rows)
