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
import numpy as np
from jax import Array
from jaxtyping import Float, Int

from jaxtube.qp import batched_ldl
from jaxtube.qp.batched_ldl import add_up, matmul
from jaxtube.qp.factors import Factors

SLACK = {8: 1e-10, 4: 1e-5}
"""What passes add to the diagonal of A P^-1 A', over 1 / rho, by bytes of a float.

Each pass divides the error by 1 + the least eigenvalue of A P^-1 A' on the active rows over this:
rows that are nearly parallel leave none after a few, and the multipliers of rows that are parallel
stay as far above rounding.
"""
PASSES = 4


def find_active_rows(
    factors: Factors,
    x: Float[Array, "n batch"],
    y: Float[Array, "m batch"],
    l: Float[Array, "m batch"],
    u: Float[Array, "m batch"],
) -> Int[Array, "n batch"]:
    """Return which rows are active, for answers x with multipliers y: i for row i at u, m + i at l,
    2 m where there is none.

    The smaller of distance to the bound and multiplier counts as zero: y alone may be a rounding
    error anywhere, and so may the distance of a row that depends on active ones. Of more than n
    rows, which then depend on each other, the first n count.
    """
    m, n = factors.rows.shape
    v = matmul(factors.rows, x) + y / factors.rho
    is_lower = (v < l) & (y < 0)
    is_active = is_lower | ((v > u) & (y > 0))
    rank = jnp.cumsum(is_active, axis=0, dtype=jnp.int32)
    place = jnp.where(is_active, rank - 1, n)
    kind = find_row_type(m)
    row = jnp.arange(m, dtype=kind)[:, None] + jnp.where(is_lower, m, 0).astype(kind)
    nothing = jnp.full(x.shape, 2 * m, kind)
    return nothing.at[place, jnp.arange(x.shape[1])].set(row, mode="drop")


def find_row_type(m: int) -> type[np.integer]:
    """Return the smallest integer that numbers 2 m rows, and none of them."""
    return np.int16 if 2 * m <= np.iinfo(np.int16).max else np.int32


def spread(
    factors: Factors, active: Int[Array, "n batch"], values: Float[Array, "n batch"]
) -> tuple[Float[Array, "m batch"], Float[Array, "m batch"]]:
    """Return what belongs to active rows as that of all rows at u, and of all rows at l."""
    m, _ = factors.rows.shape
    lanes = values.shape[1]
    both = jnp.zeros((2 * m, lanes), values.dtype)
    both = both.at[active, jnp.arange(lanes)].set(values, mode="drop")
    return both[:m], both[m:]


def minimise_on_rows(
    factors: Factors,
    active: Int[Array, "n batch"],
    q: Float[Array, "n batch"],
    b: Float[Array, "n batch"],
) -> tuple[Float[Array, "n batch"], Float[Array, "n batch"]]:
    """Minimise 1/2 x' P x + q' x subject to a_i x = b_i on the active rows; return x and the
    multipliers, those of least norm.

    Augmented Lagrangian passes, so that their penalty leaves no error; b is zero where there is no
    row.
    """
    m, n = factors.rows.shape
    row = jnp.where(active < 2 * m, active % m, m)
    # Columns first: what is added up below then runs over the batch.
    columns = jnp.take(factors.rows.T, row, axis=1, mode="fill", fill_value=0.0)
    whitened = jnp.take(factors.whitened.T, row, axis=1, mode="fill", fill_value=0.0)
    gram = add_up([column[:, None] * column for column in whitened])
    slack = SLACK[q.dtype.itemsize] / factors.rho
    diagonal = slack * jnp.eye(n, dtype=gram.dtype)[:, :, None]
    ldl = batched_ldl.factorise((gram + diagonal)[np.triu_indices(n)])
    free = matmul(factors.optimum, q)
    missed = add_up([columns[i] * free[i] for i in range(n)]) - b

    def correct(_, y):
        return y + batched_ldl.solve(ldl, missed - add_up([gram[i] * y[i] for i in range(n)]))

    y = jax.lax.fori_loop(0, PASSES, correct, jnp.zeros_like(b))
    push = add_up([columns[:, i] * y[i] for i in range(n)])
    return free + matmul(factors.optimum, push), y


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
