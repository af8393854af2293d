"""A quadratic cost for gains that are given: one Lyapunov inequality a loop, one semidefinite program for all.

    P - Phi_i^T P Phi_i >= Q + K_i^T R K_i,    least trace P

Notation: Phi_i = A_i + B_i K_i the loops, Q error weight, R input weight, P cost; u = +K e throughout.
"""

from __future__ import annotations

from typing import Any

import clarabel
import numpy as np
import scipy.linalg
from jaxtyping import Float
from scipy.sparse import csc_matrix

# Surplus that covers the rounding of a float64 check; it costs the same share of the objective.
ROUNDING_SURPLUS = 1e-7


def cost_of_gains(
    loops: Float[np.ndarray, "v n n"],
    gains: Float[np.ndarray, "v m n"],
    error_weight: Float[np.ndarray, "n n"],
    input_weight: Float[np.ndarray, "m m"],
) -> Float[np.ndarray, "n n"]:
    """Compute the terminal cost of least trace for gains that are given: P - Phi_i^T P Phi_i >= Q + K_i^T R K_i.

    Args: loops, gains: Phi_i = A_i + B_i K_i and K_i, u = +K e. error_weight: Q >= 0. input_weight: R > 0.
    Returns: P, with the decrease exact in float64 for every pair, hence for every joint mixture of them.
    Raises: RuntimeError where the solver finds none: the loops share no quadratic cost.
    """
    n = loops.shape[-1]
    rows, columns = np.triu_indices(n)
    order = np.lexsort((rows, columns))  # the solver stacks the upper triangle column by column
    rows, columns = rows[order], columns[order]
    scale = np.where(rows == columns, 1.0, np.sqrt(2.0))
    basis = np.zeros((len(rows), n, n))
    basis[np.arange(len(rows)), rows, columns] = basis[np.arange(len(rows)), columns, rows] = 1.0
    stage = stage_cost(gains, error_weight, input_weight)
    decrease = basis[None] - np.einsum("vki,bkl,vlj->vbij", loops, basis, loops)
    A = -(decrease[:, :, rows, columns] * scale).swapaxes(1, 2).reshape(-1, len(rows))
    solve: Any = clarabel  # its stubs name none of these
    settings = solve.DefaultSettings()
    settings.verbose = False
    solver = solve.DefaultSolver(
        csc_matrix((len(rows), len(rows))),
        np.trace(basis, axis1=1, axis2=2),
        csc_matrix(A),
        -(stage[:, rows, columns] * scale).ravel(),
        [solve.PSDTriangleConeT(n)] * len(loops),
        settings,
    )
    answer = solver.solve()
    if str(answer.status) != "Solved":
        raise RuntimeError(f"cost_of_gains: Clarabel reports {answer.status}; the loops share no quadratic cost")
    return scaled_to_decrease(np.tensordot(answer.x, basis, axes=1), loops, stage)


def scaled_to_decrease(P: np.ndarray, loops, stage) -> np.ndarray:
    """Scale P by the smallest factor that makes the decrease exact in float64; RuntimeError where none does."""
    try:
        pairs = zip(stage, P - np.swapaxes(loops, -1, -2) @ P @ loops, strict=True)
        factor = max(scipy.linalg.eigh(least, decrease, eigvals_only=True)[-1] for least, decrease in pairs)
    except np.linalg.LinAlgError:
        raise RuntimeError("terminal cost: the solver's answer does not decrease; rescale the weights") from None
    return P * factor * (1 + ROUNDING_SURPLUS)


def stage_cost(gains, Q, R) -> np.ndarray:
    """Return Q + K_i^T R K_i."""
    return Q + np.swapaxes(gains, -1, -2) @ R @ gains
