# ruff: noqa: E741 -- l and u are the letters of the problem
"""Derivative of the answers of a batch of quadratic programs with respect to their data, in reverse
mode.

    P x + q + A' y = 0,
    a_i x = b_i on the active rows (b = u where y > 0, l where y < 0),    y_i = 0 on the others

determine x and y, and their derivative as long as the active rows stay the same. Cotangents x_bar,
y_bar become
(1) d and nu, the answer and the multipliers of one more program:
    minimise over d   1/2 d' P d - x_bar' d   subject to   a_i d = y_bar_i on the active rows;
(2) q_bar = -d,   b_bar = nu,
    P_bar = -(d x' + x d') / 2,   A_bar = -(y d' + nu x'), summed over the batch.

Where a row is about to become active or to leave, x has one derivative on either side: a row that
is active with a multiplier of zero counts as inactive. Where active rows depend on each other the
multipliers, and the derivative of x with respect to the bounds, are not unique: nu of least norm is
taken.

Notation: that of `fixed_point`. P is symmetric, and so is P_bar. Source: Fiacco, Sensitivity
analysis for nonlinear programming using penalty methods, Mathematical Programming 1976, theorem
2.1; Amos and Kolter, OptNet, ICML 2017, equations (6) to (8).
"""

import jax
import jax.numpy as jnp
from jax import Array
from jaxtyping import Bool, Float

from jaxtube.qp import batched_ldl
from jaxtube.qp.batched_ldl import matmul
from jaxtube.qp.factors import Factors

ADJOINT_PENALTY = {8: 1e6, 4: 1e3}
"""Penalty over rho, by bytes of a float.

Each pass divides the error by about ADJOINT_PENALTY times the least eigenvalue of A P^-1 A' on the
active rows, over rho; there is no good guess to begin with, so that penalty and passes exceed those
of polish.
"""
ADJOINT_PASSES = 6


def active_rows(
    factors: Factors,
    x: Float[Array, "n batch"],
    y: Float[Array, "m batch"],
    l: Float[Array, "m batch"],
    u: Float[Array, "m batch"],
) -> tuple[Bool[Array, "m batch"], Bool[Array, "m batch"]]:
    """Return which rows are active at l and which at u, for answers x with multipliers y.

    The smaller of distance to the bound and multiplier counts as zero: y alone may be a rounding
    error anywhere.
    """
    v = matmul(factors.rows, x) + y / factors.rho
    return v < l, v > u


def adjoint(
    factors: Factors,
    active: Bool[Array, "m batch"],
    x_bar: Float[Array, "n batch"],
    y_bar: Float[Array, "m batch"],
) -> tuple[Float[Array, "n batch"], Float[Array, "m batch"]]:
    """Solve (1) by augmented Lagrangian passes, so that their penalty leaves no error; return d and
    nu."""
    A = factors.rows
    P = factors.hessian
    weights = jnp.where(active, factors.rho * ADJOINT_PENALTY[x_bar.dtype.itemsize], 0.0)
    penalised = factors.packed_hessian[:, None] + matmul(factors.pair_products, weights)
    ldl = batched_ldl.factorise(penalised)

    def correct(_, guess):
        d, nu = guess
        multipliers = nu + weights * (matmul(A, d) - y_bar)
        gradient = matmul(P, d) - x_bar + matmul(A.T, multipliers)
        d = d - batched_ldl.solve(ldl, gradient)
        return d, nu + weights * (matmul(A, d) - y_bar)

    start = (jnp.zeros_like(x_bar), jnp.zeros_like(y_bar))
    return jax.lax.fori_loop(0, ADJOINT_PASSES, correct, start)


def shared_cotangents(
    factors: Factors,
    x: Float[Array, "batch n"],
    multipliers: Float[Array, "batch m"],
    d: Float[Array, "batch n"],
    nu: Float[Array, "batch m"],
) -> Factors:
    """Return P_bar and A_bar of (2), as cotangents of `factors`; the batch is first, the rows are
    the caller's.

    The other fields of `factors` make the solver fast and leave the answer as it is: their
    cotangents are zero.
    """
    half = matmul(d.T, x) / -2

    def active_rows_bar():
        return -(matmul(multipliers.T, d) + matmul(nu.T, x))

    def no_rows_bar():
        return jnp.zeros_like(factors.rows)

    rows_bar = jax.lax.cond(jnp.any(multipliers != 0), active_rows_bar, no_rows_bar)
    return jax.tree.map(jnp.zeros_like, factors)._replace(
        hessian=half + half.T,
        rows=rows_bar * factors.row_norms[:, None],
        row_norms=jnp.sum(rows_bar * factors.rows, axis=1),
    )
