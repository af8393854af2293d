# ruff: noqa: E741 -- l and u are the letters of the problem
"""ADMM and an active-set Newton method for batches of quadratic programs, both on one fixed-point
equation.

    minimise over x   1/2 x' P x + q' x   subject to   l <= A x <= u     has the answer x with multipliers y where
    P x + q + A' y = 0   and   A x = clip(A x + y / rho, l, u)   for any rho > 0.

ADMM, over-relaxed, on the one vector v = A x + y / rho:
    z = clip(v, l, u),   x = K (rho A' (2 z - v) - q),   v <- v + alpha (A x - z),   y = rho (v - z).
Newton (semismooth): the rows with v outside [l, u] become equations, the others lose their
multiplier; the equations are solved by augmented Lagrangian passes, so that their penalty leaves no
error. It converges in a few steps or not at all: the iterate of smallest residual is kept.

Notation: rows of A have unit 2-norm, K = (P + rho A' A)^-1, the batch is the last axis. Source:
Stellato, Banjac, Goulart, Bemporad, Boyd, OSQP, Mathematical Programming Computation 2020; rho of
the fastest guaranteed rate: Giselsson and Boyd, IEEE Transactions on Automatic Control 2017;
Newton: Hintermueller, Ito, Kunisch, SIAM J. Optimization 2002.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import Array
from jaxtyping import Bool, Float

from jaxtube.qp import batched_ldl
from jaxtube.qp.batched_ldl import matmul

RELAXATION = 1.7  # alpha
PENALTY = {
    8: 5e4,
    4: 1e1,
}  # over rho, by bytes of a float: fast convergence against rounding of the multipliers
PASSES = 3


class Factors(NamedTuple):
    """Everything that a batch shares."""

    hessian: Float[Array, "n n"]
    rows: Float[Array, "m n"]  # unit 2-norm, or zero
    row_norms: Float[Array, " m"]
    optimum: Float[Array, "n n"]  # without constraints x = q @ optimum
    optimum_rows: Float[Array, "n m"]  # and A x = q @ optimum_rows, in the caller's row scaling
    admm_gain: Float[Array, "n n"]  # K
    rho: Float[Array, ""]
    packed_hessian: Float[Array, " pairs"]
    pair_products: Float[Array, "pairs m"]


class Instances(NamedTuple):
    """What differs over the batch; the bounds belong to unit rows, `limit` is the residual that is
    accepted."""

    q: Float[Array, "n batch"]
    l: Float[Array, "m batch"]
    u: Float[Array, "m batch"]
    limit: Float[Array, " batch"]


class Iterate(NamedTuple):
    """A guess of the answer and how far it is from the optimality conditions."""

    x: Float[Array, "n batch"]
    y: Float[Array, "m batch"]
    residual: Float[Array, " batch"]


def factorise(P: Float[Array, "n n"], A: Float[Array, "m n"]) -> Factors:
    """Prepare what the batch shares, once; vmap it for a stack of programs and slice the stack.

    P must be symmetric positive definite (if it is not, every answer is UNSOLVED). A row shorter
    than 64 eps of the longest counts as zero: it only tests whether 0 is in [l, u]. Raises
    ValueError where shapes do not fit.
    """
    if P.ndim != 2 or A.ndim != 2 or P.shape != (A.shape[1],) * 2 or not len(A):
        raise ValueError(
            f"P, A: shapes {P.shape} and {A.shape}; give (n, n) and (m, n), m >= 1 (one zero row will do)"
        )
    eps, (m, n) = jnp.finfo(A.dtype).eps, A.shape
    norms = jnp.linalg.norm(jax.lax.stop_gradient(A), axis=1)
    is_zero = norms <= 64 * eps * jnp.max(norms)
    # The norm of a zero row has no derivative: the row is replaced before, not only after.
    norms = jnp.where(is_zero, 1.0, jnp.linalg.norm(jnp.where(is_zero[:, None], 1.0, A), axis=1))
    unit = jnp.where(is_zero[:, None], 0.0, A / norms[:, None])
    root = jax.scipy.linalg.solve_triangular(
        jnp.linalg.cholesky(P), jnp.eye(n, dtype=P.dtype), lower=True
    )
    gram = matmul(unit.T, unit)
    spectrum = jnp.linalg.eigvalsh(
        matmul(root, matmul(gram, root.T))
    )  # nonzero part: that of A P^-1 A'
    smallest = jnp.min(jnp.where(spectrum > m * eps * spectrum[-1], spectrum, jnp.inf))
    rho = jnp.where(spectrum[-1] > 0, 2 / jnp.sqrt(smallest * spectrum[-1]), 1.0)
    optimum = -matmul(root.T, root)
    return Factors(
        hessian=P,
        rows=unit,
        row_norms=norms,
        optimum=optimum,
        optimum_rows=matmul(optimum, unit.T) * norms,
        admm_gain=jnp.linalg.inv(P + rho * gram),
        rho=rho,
        packed_hessian=batched_ldl.pack(P),
        pair_products=batched_ldl.pair_products(unit),
    )


def residual(
    factors: Factors, given: Instances, x: Float[Array, "n batch"], y: Float[Array, "m batch"]
) -> Float[Array, " batch"]:
    """Return max(|P x + q + A'y|_inf, |A x - clip(A x + y, l, u)|_inf); infinite where NaN or
    bounds that cross."""
    row_values = matmul(factors.rows, x)
    stationarity = matmul(factors.hessian, x) + given.q + matmul(factors.rows.T, y)
    distance = row_values - jnp.clip(row_values + y, given.l, given.u)
    largest = jnp.maximum(
        jnp.max(jnp.abs(stationarity), axis=0), jnp.max(jnp.abs(distance), axis=0)
    )
    return jnp.where(jnp.isnan(largest) | crossing(given), jnp.inf, largest)


def crossing(given: Instances) -> Bool[Array, " batch"]:
    """Return whether the bounds of some row leave no number between them; clip would silently take
    the upper one."""
    return jnp.any((given.l > given.u) | (given.l == jnp.inf) | (given.u == -jnp.inf), axis=0)


def better(
    factors: Factors,
    given: Instances,
    best: Iterate,
    x: Float[Array, "n batch"],
    y: Float[Array, "m batch"],
) -> Iterate:
    """Return, instance by instance, the guess x, y or the `best` so far, whichever has the smaller
    residual."""
    guess = Iterate(x, y, residual(factors, given, x, y))
    wins = guess.residual < best.residual
    return jax.tree.map(lambda new, old: jnp.where(wins, new, old), guess, best)


def admm(
    factors: Factors, given: Instances, start: Float[Array, "n batch"], iterations: int
) -> tuple[Float[Array, "n batch"], Float[Array, "m batch"]]:
    """Iterate from v = A start; return x and y."""
    A, K, rho = factors.rows, factors.admm_gain, factors.rho

    def primal(v, z):
        return matmul(K, rho * matmul(A.T, 2 * z - v) - given.q)

    def iterate(_, v):
        z = jnp.clip(v, given.l, given.u)
        return v + RELAXATION * (matmul(A, primal(v, z)) - z)

    v = jax.lax.fori_loop(0, iterations, iterate, matmul(A, start))
    z = jnp.clip(v, given.l, given.u)
    return primal(v, z), rho * (v - z)


def polish(
    factors: Factors,
    given: Instances,
    best: Iterate,
    x: Float[Array, "n batch"],
    y: Float[Array, "m batch"],
    steps: int,
) -> Iterate:
    """Take Newton steps from x, y; return the best of `best`, of x, y and of the steps, never worse
    than `best`."""
    A, P, rho = factors.rows, factors.hessian, factors.rho
    penalty = rho * PENALTY[x.dtype.itemsize]

    def step(_, carry):
        x, y, best = carry
        v = matmul(A, x) + y / rho
        active = (v < given.l) | (v > given.u)
        bound = jnp.clip(v, given.l, given.u)
        weights = jnp.where(active, penalty, 0.0)
        ldl = batched_ldl.factorise(
            factors.packed_hessian[:, None] + matmul(factors.pair_products, weights)
        )

        def correct(_, guess):
            x, y = guess
            gradient = matmul(P, x) + given.q + matmul(A.T, y + weights * (matmul(A, x) - bound))
            x = x - batched_ldl.solve(ldl, gradient)
            return x, y + weights * (matmul(A, x) - bound)

        x, y = jax.lax.fori_loop(0, PASSES, correct, (x, jnp.where(active, y, 0.0)))
        return x, y, better(factors, given, best, x, y)

    return jax.lax.fori_loop(0, steps, step, (x, y, better(factors, given, best, x, y)))[2]
