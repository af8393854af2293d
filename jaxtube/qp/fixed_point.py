# ruff: noqa: E741 -- l and u are the letters of the problem
"""ADMM and an active-set Newton method for batches of quadratic programs, both on one fixed-point
equation.

    minimise over x   1/2 x' P x + q' x   subject to   l <= A x <= u
has the answer x with multipliers y where
    P x + q + A' y = 0   and   A x = clip(A x + y / rho, l, u)   for any rho > 0.

ADMM, over-relaxed, on the one vector v = A x + y / rho:
    z = clip(v, l, u),   x = K (rho A' (2 z - v) - q),
    v <- v + alpha (A x - z),   y = rho (v - z).
Newton (semismooth): the rows with v outside [l, u] become equations, the others lose their
multiplier; the equations are solved by augmented Lagrangian passes, so that their penalty leaves no
error. It converges in a few steps or not at all: the iterate of smallest residual is kept.

Residual, the largest of the errors of both equations, each relative to its own scale:
    |P x + q + A' y|_inf / sigma   and   |A x - clip(A x + y / sigma, l, u)|_inf / pi,
where sigma = max(1, |q|_inf, rounding of P x) and pi = max(1, rounding of A x). A residual of r
means that no row misses its bounds by more than r pi, whatever the size of the cost.

Notation: rows of A have unit 2-norm, K = (P + rho A' A)^-1, the batch is the last axis. Source:
Stellato, Banjac, Goulart, Bemporad, Boyd, OSQP, Mathematical Programming Computation 2020; Newton:
Hintermueller, Ito, Kunisch, SIAM J. Optimization 2002.
"""

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Bool, Float, Int

from jaxtube.qp import batched_ldl
from jaxtube.qp.batched_ldl import matmul, product
from jaxtube.qp.factors import Factors, Iterated
from jaxtube.qp.tags import largest

TOLERANCE = {8: 1e-9, 4: 5e-7}
"""Residual that is accepted, by bytes of a float."""
RELAXATION = 1.7
"""alpha"""
NEWTON_PENALTY = {8: 5e4, 4: 1e1}
"""Newton's penalty over rho, by bytes of a float: fast convergence against rounding of the
multipliers."""
NEWTON_PASSES = 3
DUAL_ROUNDING = 2
"""Errors of P x below this multiple of eps |P| |x| count as rounding."""
PRIMAL_ROUNDING = 4
"""Errors of A x below this multiple of eps |x| count as rounding."""


class Instances(NamedTuple):
    """What differs over the batch; the bounds are those of unit rows."""

    q: Float[Array, "n batch"]
    l: Float[Array, "m batch"]
    u: Float[Array, "m batch"]
    optimum: Float[Array, "n batch"]  # of no constraints
    dual_scale: Float[Array, " batch"]  # sigma


class Iterate(NamedTuple):
    """A guess of the answer and how far it is from the optimality conditions."""

    x: Float[Array, "n batch"]
    y: Float[Array, "m batch"]
    residual: Float[Array, " batch"]


def unit_rows(
    factors: Factors,
    q: Float[Array, "batch n"],
    l: Float[Array, "batch m"],
    u: Float[Array, "batch m"],
) -> Instances:
    """Return instances whose bounds are those of the caller's rows."""
    norms = factors.row_norms[:, None]
    return make_instances(factors, q.T, l.T / norms, u.T / norms)


def make_instances(
    factors: Factors,
    q: Float[Array, "n batch"],
    l: Float[Array, "m batch"],
    u: Float[Array, "m batch"],
) -> Instances:
    """Return instances whose bounds are those of unit rows."""
    optimum = product(factors.optimum, q)
    return Instances(q, l, u, optimum, dual_scale(factors, q, optimum))


def dual_scale(
    factors: Factors, q: Float[Array, "n batch"], optimum: Float[Array, "n batch"]
) -> Float[Array, " batch"]:
    """Return sigma, `optimum` being the x without constraints."""
    eps = jnp.finfo(q.dtype).eps
    unit = DUAL_ROUNDING * eps / TOLERANCE[q.dtype.itemsize]
    rounding = unit * jnp.max(jnp.abs(factors.hessian)) * jnp.max(jnp.abs(optimum), axis=0)
    return jnp.maximum(jnp.maximum(1.0, jnp.max(jnp.abs(q), axis=0)), rounding)


def primal_scale(x: Float[Array, "n batch"]) -> Float[Array, " batch"]:
    """Return pi."""
    unit = PRIMAL_ROUNDING * jnp.finfo(x.dtype).eps / TOLERANCE[x.dtype.itemsize]
    return jnp.maximum(1.0, unit * jnp.max(jnp.abs(x), axis=0))


def bound_tolerance(largest: float) -> float:
    """Return by how much an answer that is SOLVED in float64, its entries up to `largest`, may miss
    a bound, on rows of unit norm."""
    return max(TOLERANCE[8], PRIMAL_ROUNDING * float(np.finfo(np.float64).eps) * largest)


def residual(
    factors: Factors, instances: Instances, x: Float[Array, "n batch"], y: Float[Array, "m batch"]
) -> Float[Array, " batch"]:
    """Return the residual of a guess; infinite where a number is NaN or where bounds cross."""
    row_values = matmul(factors.rows, x)
    stationarity = product(factors.hessian, x) + instances.q + matmul(factors.rows.T, y)
    share = 1 / instances.dual_scale
    projected = jnp.clip(row_values + y * share, instances.l, instances.u)
    dual = largest(stationarity) * share
    missed = jnp.where(is_crossing(instances), jnp.inf, row_values - projected)
    either = jnp.maximum(dual, largest(missed) / primal_scale(x))
    return jnp.where(jnp.isnan(either), jnp.inf, either)


def has_crossing_bounds(instances: Instances) -> Bool[Array, " batch"]:
    """Return whether the bounds of some row leave no number between them."""
    return jnp.any(is_crossing(instances), axis=0)


def is_crossing(instances: Instances) -> Bool[Array, "m batch"]:
    """Return the rows whose bounds leave no number between them; clip would silently take the upper
    one."""
    l = instances.l
    u = instances.u
    return (l > u) | (l == jnp.inf) | (u == -jnp.inf)


def keep_better(
    factors: Factors,
    instances: Instances,
    best: Iterate,
    x: Float[Array, "n batch"],
    y: Float[Array, "m batch"],
) -> Iterate:
    """Return, instance by instance, the guess x, y or the `best` so far, whichever has the smaller
    residual."""
    guess = Iterate(x, y, residual(factors, instances, x, y))
    wins = guess.residual < best.residual
    return jax.tree.map(lambda new, old: jnp.where(wins, new, old), guess, best)


def admm(
    factors: Factors,
    iterated: Iterated,
    instances: Instances,
    start: Float[Array, "n batch"],
    iterations: int,
) -> tuple[Float[Array, "n batch"], Float[Array, "m batch"]]:
    """Iterate from v = A start; return x and y."""
    A = factors.rows
    K = iterated.admm_gain
    rho = factors.rho

    def primal(v, z):
        return matmul(K, rho * matmul(A.T, 2 * z - v) - instances.q)

    def iterate(_, v):
        z = jnp.clip(v, instances.l, instances.u)
        return v + RELAXATION * (matmul(A, primal(v, z)) - z)

    v = jax.lax.fori_loop(0, iterations, iterate, matmul(A, start))
    z = jnp.clip(v, instances.l, instances.u)
    return primal(v, z), rho * (v - z)


def polish(
    factors: Factors,
    iterated: Iterated,
    instances: Instances,
    best: Iterate,
    guess: tuple[Float[Array, "n batch"], Float[Array, "m batch"]],
    steps: Int[Array, ""] | int,
) -> Iterate:
    """Take Newton steps from a guess x, y; return the best of these, the guess and `best`."""
    step = partial(take_newton_step, factors, iterated, instances)
    start = (*guess, keep_better(factors, instances, best, *guess))
    return jax.lax.fori_loop(0, steps, step, start)[2]


def take_newton_step(
    factors: Factors,
    iterated: Iterated,
    instances: Instances,
    _,
    carry: tuple[Float[Array, "n batch"], Float[Array, "m batch"], Iterate],
) -> tuple[Float[Array, "n batch"], Float[Array, "m batch"], Iterate]:
    """Solve with the rows that x, y suggest are active, in a few passes; return x, y and the best
    iterate so far."""
    x, y, best = carry
    A = factors.rows
    P = factors.hessian
    rho = factors.rho
    penalty = rho * NEWTON_PENALTY[x.dtype.itemsize]
    v = matmul(A, x) + y / rho
    active = (v < instances.l) | (v > instances.u)
    bound = jnp.clip(v, instances.l, instances.u)
    weights = jnp.where(active, penalty, 0.0)
    products = matmul(iterated.pair_products, weights)
    penalised = iterated.packed_hessian[:, None] + products
    ldl = batched_ldl.factorise(penalised)

    def correct(_, guess):
        x, y = guess
        multipliers = y + weights * (matmul(A, x) - bound)
        gradient = matmul(P, x) + instances.q + matmul(A.T, multipliers)
        x = x - batched_ldl.solve(ldl, gradient)
        return x, y + weights * (matmul(A, x) - bound)

    start = (x, jnp.where(active, y, 0.0))
    x, y = jax.lax.fori_loop(0, NEWTON_PASSES, correct, start)
    return x, y, keep_better(factors, instances, best, x, y)
