"""The linear-quadratic regulator, for weights of any size and ratio.

    P = Q + A^T P (I + B R^-1 B^T P)^-1 A,    K = -(R + B^T P B)^-1 B^T P A

Notation: e+ = A e + B u, Q error weight, R input weight, P cost, K gain; u = +K e throughout.

Source: Chu, Fan, Lin, Wang 2004, Int. J. Control 77, 767-788 (doubling).
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

DOUBLINGS = 60
"""Doublings of the horizon after which a Riccati recursion without limit is given up."""


def lqr_gain(
    A: Float[np.ndarray, "n n"],
    B: Float[np.ndarray, "n m"],
    error_weight: Float[np.ndarray, "n n"],
    input_weight: Float[np.ndarray, "m m"],
) -> Float[np.ndarray, "m n"]:
    """Return the gain K of the discrete linear-quadratic regulator, u = +K e.

    Args:
        A, B: e+ = A e + B u.
        error_weight: Q >= 0.
        input_weight: R > 0.

    Returns:
        K, for which A + B K is stable.

    Raises:
        ValueError: shapes or weights that are refused, or a pair without stabilising solution.

    Source: Gonzalez et al. 2009, eq. (22).
    """
    check_system((), A, B, error_weight, input_weight)
    P = solve_riccati(A, B, error_weight, input_weight)
    return compute_gain(A, B, P, input_weight)


def solve_riccati(A, B, Q, R) -> np.ndarray:
    """Return the stabilising solution of P = Q + A^T P (I + B R^-1 B^T P)^-1 A by a recursion whose
    every step doubles the horizon of the cost P.

    With G = B R^-1 B^T, Phi = A, P = Q at first:

        Phi+ = Phi M Phi,    G+ = G + Phi M G Phi^T,    P+ = P + Phi^T P M Phi,    M = (I + G P)^-1

    Unlike an ordered Schur form it depends on the ratio of the weights alone, however far apart.

    Source: Chu, Fan, Lin, Wang 2004, Int. J. Control 77, 767-788.
    """
    eye = np.eye(len(A))
    G = B @ np.linalg.solve(R, B.T)
    Phi = A
    P = Q
    with np.errstate(all="ignore"):
        for _ in range(DOUBLINGS):
            M = np.linalg.inv(eye + G @ P)
            rise = Phi.T @ P @ M @ Phi
            G = G + Phi @ M @ G @ Phi.T
            Phi = Phi @ M @ Phi
            P = P + (rise + rise.T) / 2
            if not all(np.isfinite(matrix).all() for matrix in (P, Phi, G)):
                break
            if np.abs(rise).max() <= 1e-16 * np.abs(P).max() and is_stabilising(A, B, P, R):
                return P
    raise ValueError(
        f"A = {A.tolist()} with this B has no stabilising gain: change the pair or weigh all errors"
    )


def is_stabilising(A, B, P, R) -> bool:
    loop = A + B @ compute_gain(A, B, P, R)
    return bool(np.abs(np.linalg.eigvals(loop)).max() < 1)


def compute_gain(A, B, P, R) -> np.ndarray:
    """Return the inputs that minimise u^T R u + e+^T P e+, as a gain."""
    return -np.linalg.solve(R + transpose(B) @ P @ B, transpose(B) @ P @ A)


def compute_decrease(A, B, gains, P) -> np.ndarray:
    """Return P - Phi^T P Phi."""
    Phi = A + B @ gains
    return P - transpose(Phi) @ P @ Phi


def check_system(stack: tuple[int, ...], A, B, error_weight, input_weight) -> None:
    """Refuse shapes and weights that the problem does not cover; `stack` is the leading shape of A
    and B."""
    n = A.shape[-1]
    m = B.shape[-1]
    expected = (
        ("A", A, (*stack, n, n)),
        ("B", B, (*stack, n, m)),
        ("error_weight", error_weight, (n, n)),
        ("input_weight", input_weight, (m, m)),
    )
    for name, matrix, shape in expected:
        if matrix.shape != shape:
            raise ValueError(f"{name} has shape {matrix.shape}: give it shape {shape}")
        if not np.isfinite(matrix).all():
            raise ValueError(f"{name} holds {matrix[~np.isfinite(matrix)][0]}: give finite numbers")
    for name, weight in (("error_weight", error_weight), ("input_weight", input_weight)):
        skew = np.abs(weight - weight.T).max()
        if skew > 1e-12 * np.abs(weight).max():
            raise ValueError(f"{name} differs from its transpose by {skew:.3g}: make it symmetric")
    least, most = np.linalg.eigvalsh(error_weight)[[0, -1]]
    if most <= 0 or least < -1e-12 * most:
        raise ValueError(
            f"error_weight has eigenvalues {least:.3g} to {most:.3g}: "
            "make it semidefinite and not zero"
        )
    least = np.linalg.eigvalsh(input_weight)[0]
    if least <= 0:
        raise ValueError(f"input_weight has eigenvalue {least:.3g}: make it positive definite")


def transpose(stack: np.ndarray) -> np.ndarray:
    return np.swapaxes(stack, -1, -2)
