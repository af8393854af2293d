"""A quadratic cost for gains that are given: one Lyapunov inequality a loop, one semidefinite
program for all.

    D_i(P) = P - Phi_i^T P Phi_i - (Q + K_i^T R K_i) >= 0,    small trace P

Of the answers the centred one is taken, which keeps off all the inequalities and depends smoothly
on the data:

    minimise  trace P / trace of the mean stage cost  -  CENTRING  sum_i log det D_i(P)

Its trace exceeds the least one by CENTRING v n mean stage costs at most (v loops, n states).
Notation: Phi_i = A_i + B_i K_i the loops, Q error weight, R input weight, P cost; u = +K e
throughout. Source: Boyd, Vandenberghe, Convex Optimization 2004, sections 9.6 and 11.2 (Newton's
method, barrier).
"""

from __future__ import annotations

from typing import Any

import numpy as np
import scipy.linalg
from jaxtyping import Float

from sets.semidefinite import (
    ALMOST_SOLVED,
    SOLVED,
    evaluate,
    lift,
    make_unknowns,
    minimise,
    symmetric_basis,
    trace,
)

ROUNDING_SURPLUS = 1e-7
"""Surplus that covers the rounding of a float64 check; it costs the same share of the objective."""

CENTRING = 1e-3
"""Weight of the barrier."""

LIFT = 0.05
"""Newton's method starts this share above the solver's answer, which lies on the boundary."""

NEWTON_STEPS = 200
"""Steps of Newton's method at most."""

NEWTON_DECREMENT = 1e-16
"""Squared decrement, as a share of CENTRING, at which Newton's method has reached the centre."""


def cost_of_gains(
    loops: Float[np.ndarray, "v n n"],
    gains: Float[np.ndarray, "v m n"],
    error_weight: Float[np.ndarray, "n n"],
    input_weight: Float[np.ndarray, "m m"],
) -> Float[np.ndarray, "n n"]:
    """Return the terminal cost of gains that are given: P - Phi_i^T P Phi_i > Q + K_i^T R K_i,
    centred.

    Args:
        loops, gains: Phi_i = A_i + B_i K_i and K_i, u = +K e.
        error_weight: Q > 0.
        input_weight: R > 0.

    Returns:
        P, which decreases by more than the stage cost for every pair, hence for every joint mixture
        of them.

    Raises:
        RuntimeError: the solver finds none: the loops share no quadratic cost.
    """
    weighted = stage_cost(gains, error_weight, input_weight)
    # A power of two, so that no digit of the weights is lost.
    unit = 2.0 ** np.round(np.log2(np.trace(weighted.mean(axis=0))))
    stage = weighted / unit
    basis = symmetric_basis(loops.shape[-1])
    P = (1 + LIFT) * scale_to_decrease(_minimise_trace(loops, stage), loops, stage)
    for _ in range(NEWTON_STEPS):
        slope, curvature = centring(P, loops, stage)
        step = -np.linalg.solve(curvature, slope)
        decrement = float(-slope @ step)
        # Damped while far from the centre, where the full step could leave the inequalities.
        damping = 1 + np.sqrt(max(decrement, 0.0) / CENTRING)
        P = P + np.tensordot(step, basis, axes=1) / damping
        if decrement <= NEWTON_DECREMENT * CENTRING:
            return P * unit
    raise RuntimeError(
        "cost_of_gains: Newton's method does not reach the centre; rescale the weights"
    )


def centring(
    P: Float[Any, "n n"], loops: Float[Any, "v n n"], stage: Float[Any, "v n n"], xp: Any = np
) -> tuple[Float[Any, " k"], Float[Any, "k k"]]:
    """Return slope and curvature of what the centred cost minimises, in the coordinates of
    `symmetric_basis`.

    `xp` is numpy or a module with the same functions, to which the arrays belong.
    """
    basis = symmetric_basis(len(P))
    transposed = xp.swapaxes(loops, 1, 2)
    moves = basis - transposed[:, None] @ basis @ loops[:, None]
    surplus = P - transposed @ P @ loops - stage
    relative = xp.linalg.solve(surplus[:, None], moves)
    slope = np.trace(basis, axis1=1, axis2=2) / xp.trace(stage.mean(axis=0))
    slope = slope - CENTRING * xp.trace(relative, axis1=2, axis2=3).sum(axis=0)
    return slope, CENTRING * xp.einsum("vaij,vbji->ab", relative, relative)


def _minimise_trace(loops, stage) -> Float[np.ndarray, "n n"]:
    """Solve  minimise trace P  subject to D_i(P) >= 0  to the solver's tolerance."""
    (P,) = make_unknowns(symmetric_basis(loops.shape[-1]))
    decrease = [
        P - loop.T @ P @ loop - lift(wanted, len(P) - 1)
        for loop, wanted in zip(loops, stage, strict=True)
    ]
    answer = minimise(trace(P), decrease)
    # An inaccurate answer is scaled, centred and checked afterwards.
    if answer.status not in (SOLVED, ALMOST_SOLVED):
        raise RuntimeError(
            f"cost_of_gains: Clarabel reports {answer.status}; the loops share no quadratic cost"
        )
    return evaluate(P, answer.x)


def scale_to_decrease(
    P: Float[np.ndarray, "n n"],
    loops: Float[np.ndarray, "v n n"],
    stage: Float[np.ndarray, "v n n"],
) -> Float[np.ndarray, "n n"]:
    """Scale P by the smallest factor that makes the decrease exact in float64.

    Raises:
        RuntimeError: no factor does.
    """
    decreases = P - np.swapaxes(loops, -1, -2) @ P @ loops
    try:
        factors = [
            scipy.linalg.eigh(wanted, decrease, eigvals_only=True)[-1]
            for wanted, decrease in zip(stage, decreases, strict=True)
        ]
    except np.linalg.LinAlgError:
        raise RuntimeError(
            "terminal cost: the solver's answer does not decrease; rescale the weights"
        ) from None
    return P * max(factors) * (1 + ROUNDING_SURPLUS)


def stage_cost(
    gains: Float[np.ndarray, "v m n"], Q: Float[np.ndarray, "n n"], R: Float[np.ndarray, "m m"]
) -> Float[np.ndarray, "v n n"]:
    """Return Q + K_i^T R K_i."""
    return Q + np.swapaxes(gains, -1, -2) @ R @ gains
