"""How far a terminal cost is from the best one for its objective, by weak duality.

Notation as in `sets.lmi`.

Source: Vandenberghe, Boyd 1996, section 3 (weak duality of semidefinite programs).
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from sets.lmi import SHARES, TerminalCost, compute_root, raise_weights
from sets.lyapunov import stage_cost
from sets.riccati import check_system, compute_decrease, compute_gain, transpose

VALUE_ITERATIONS = 100
"""Any number gives a valid lower bound on the cost; more sharpen it."""


def optimality_gap(
    A: Float[np.ndarray, "vertices n n"],
    B: Float[np.ndarray, "vertices n m"],
    error_weight: Float[np.ndarray, "n n"],
    input_weight: Float[np.ndarray, "m m"],
    terminal: TerminalCost,
) -> float:
    """Bound how far a terminal cost is from the best one for its objective, by weak duality.

    The objectives are concave in S, so none gains more over S_0 = P^-1 than its tangent <M, S -
    S_0>, M = I, P^2 or P. For every Z_i >= 0, projected here, and every feasible (S, Y_i),

        <M, S> <= <M, S> + sum_i <Z_i, L_i(S, Y_i)> = constant + <r, S> + sum_i <r_i, Y_i>,

    and with any P_0 = G G^T below every feasible P, L_i >= 0 gives 0 <= G^T S G <= I and |R^(1/2)
    Y_i G| <= 1: the residual terms are below a sum of positive eigenvalues and nuclear norms.

    Args:
        A, B, error_weight, input_weight: as given to `terminal_cost`.
        terminal: its answer, or any other.

    Returns:
        An upper bound on the suboptimality, up to rounding of float64 and whatever the multipliers:
        relative to trace S or trace P, absolute for log det S. Q and R are raised as in
        `terminal_cost`.

    Raises:
        ValueError: shapes or weights that are refused.

    Source: Vandenberghe, Boyd 1996, section 3 (weak duality of semidefinite programs).
    """
    check_system(A.shape[:1], A, B, error_weight, input_weight)
    n = A.shape[1]
    P = terminal.cost
    S = np.linalg.inv(P)
    Q, R = raise_weights(error_weight, input_weight, SHARES[0])
    Q_root = compute_root(Q)
    R_root = compute_root(R)
    M, unit = {
        "trace_s": (np.eye(n), np.trace(S)),
        "trace_p": (P @ P, np.trace(P)),
        "logdet": (P, 1.0),
    }[terminal.objective]
    Z = _project(terminal.multipliers)
    Z_now = Z[:, :n, :n]
    Z_next = Z[:, n : 2 * n, :n]
    Z_error = Z[:, 2 * n : 3 * n, :n]
    Z_input = Z[:, 3 * n :, :n]
    own = Z_now + Z[:, n : 2 * n, n : 2 * n]
    r = M + np.sum(own + 2 * transpose(A) @ Z_next + 2 * Q_root @ Z_error, axis=0)
    r_inputs = 2 * (transpose(B) @ Z_next + R_root @ Z_input)
    G_inverse = np.linalg.inv(np.linalg.cholesky(_bound_cost_below(A, B, Q, R)))
    constant = np.trace(Z[:, 2 * n :, 2 * n :], axis1=1, axis2=2).sum()
    along_cost = np.linalg.eigvalsh(G_inverse @ (r + r.T) @ G_inverse.T / 2)
    along_gains = np.linalg.solve(R_root, r_inputs @ G_inverse.T)
    from_cost = np.maximum(along_cost, 0).sum()
    from_gains = np.linalg.svd(along_gains, compute_uv=False).sum()
    return float((constant + from_cost + from_gains - np.trace(M @ S)) / unit)


def _project(multipliers: np.ndarray) -> np.ndarray:
    """Return the nearest positive semidefinite matrices."""
    w, v = np.linalg.eigh((multipliers + transpose(multipliers)) / 2)
    return (v * np.maximum(w, 0)[:, None, :]) @ transpose(v)


def _bound_cost_below(A, B, Q, R) -> np.ndarray:
    """Bound every feasible P from below: value iteration from Q rises at each vertex and never
    passes it."""
    P = np.broadcast_to(Q, A.shape)
    for _ in range(VALUE_ITERATIONS):
        gains = compute_gain(A, B, P, R)
        P = P - compute_decrease(A, B, gains, P) + stage_cost(gains, Q, R)
    return P.mean(axis=0)
