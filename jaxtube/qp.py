"""Solve a batch of strictly convex quadratic programs that share their matrices, each with a status and a residual.

    minimise over x   1/2 x' P x + q' x   subject to   l <= A x <= u

P > 0 (n, n) and A (m, n) are shared; q (batch, n) and l, u (batch, m), infinite where a bound is absent, are not.

(1) Start at v = -A P^-1 q. Where l <= v <= u this is the exact answer; where it holds for the whole batch, stop.
(2) A fixed number of ADMM iterations on one m-vector v, over-relaxed:
        z = clip(v, l, u),  x = K (rho A' (2 z - v) - q),  v <- v + alpha (A x - z),  multipliers y = rho (v - z).
(3) Active-set polish, a semismooth Newton method on A x = clip(A x + y / rho, l, u): rows outside the bounds become
    equations, solved by augmented Lagrangian passes, so that their penalty leaves no error.
(4) An interior point method, polished again, for the few that remain.
(5) A proof of infeasibility for the few that still remain.

Steps (2) to (5) run on blocks gathered from the unsolved instances: their cost grows with the number of these. Every
step keeps, instance by instance, the iterate of smallest Karush-Kuhn-Tucker residual. `solve` decides by the data of
the whole batch whether to go on: do not vmap it, give it a longer batch.

Notation: that of OSQP; inside, rows of A have unit 2-norm and the batch is the last axis; K = (P + rho A' A)^-1.
Source: Stellato, Banjac, Goulart, Bemporad, Boyd, OSQP, Mathematical Programming Computation 2020 (ADMM, polish);
rho for the fastest guaranteed rate: Giselsson and Boyd, IEEE Transactions on Automatic Control 2017; the polish as a
Newton method: Hintermueller, Ito, Kunisch, SIAM J. Optimization 2002.
"""

from collections.abc import Callable
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import Array
from jaxtyping import Bool, Float, Int

from jaxtube import batched_ldl, farkas, interior_point
from jaxtube.batched_ldl import matmul

SOLVED, INFEASIBLE, UNSOLVED = 0, 1, 2
STATUS_TEXT = {
    SOLVED: "solved: the residual is within the tolerance",
    INFEASIBLE: "infeasible, proved: no x meets the bounds; widen l, u or start from a smaller initial error",
    UNSOLVED: "unsolved: look at the residual (infinite: NaN in q, l or u); raise iterations, scale P or use float64",
}
RELAXATION = 1.7  # alpha
REFINEMENTS = 3
RESCUE_ITERATIONS = 25
ADMM_BLOCK, RESCUE_BLOCK = 256, 32
TOLERANCE = {8: 1e-8, 4: 2e-5}  # by bytes of a float


class Factors(NamedTuple):
    """Everything that the batch shares; stack along leading axes with vmap(factorise) and slice one for `solve`."""

    hessian: Float[Array, "n n"]
    rows: Float[Array, "m n"]  # unit 2-norm
    row_norms: Float[Array, " m"]
    optimum: Float[Array, "n n"]  # (-P^-1)' : x = q @ optimum without constraints
    optimum_rows: Float[Array, "n m"]  # and A x = q @ optimum_rows, in the caller's row scaling
    admm_gain: Float[Array, "n n"]  # K
    rho: Float[Array, ""]
    packed_hessian: Float[Array, " pairs"]
    pair_products: Float[Array, "pairs m"]


class Solution(NamedTuple):
    """Answer of every instance; x is finite always, and trustworthy where status == SOLVED."""

    x: Float[Array, "batch n"]
    multipliers: Float[Array, "batch m"]  # positive at u, negative at l: P x + q + A' multipliers = 0
    status: Int[Array, " batch"]
    residual: Float[Array, " batch"]


class Instances(NamedTuple):
    """What differs over the batch, bounds scaled like the rows; `limit` is the residual that is accepted."""

    q: Float[Array, "n batch"]
    l: Float[Array, "m batch"]
    u: Float[Array, "m batch"]
    limit: Float[Array, " batch"]


def factorise(P: Float[Array, "n n"], A: Float[Array, "m n"]) -> Factors:
    """Prepare the shared data, once; P must be symmetric positive definite (else every answer is UNSOLVED).

    A row shorter than 1e-14 (float64) of the longest counts as zero: a test 0 in [l, u]. Raises ValueError on shapes.
    """
    if A.shape != (len(A), len(P)) or P.shape != (len(P), len(P)) or not len(A):
        raise ValueError(f"P, A: shapes {P.shape}, {A.shape}; give (n, n) and (m, n), m >= 1 (a row of zeros will do)")
    eps, (m, n) = jnp.finfo(A.dtype).eps, A.shape
    norms = jnp.linalg.norm(A, axis=1)
    zero = norms <= 64 * eps * jnp.max(norms)
    norms = jnp.where(zero, 1.0, norms)
    unit = jnp.where(zero[:, None], 0.0, A) / norms[:, None]
    inverse_root = jax.scipy.linalg.solve_triangular(jnp.linalg.cholesky(P), jnp.eye(n, dtype=P.dtype), lower=True)
    spectrum = jnp.linalg.eigvalsh(matmul(matmul(inverse_root, matmul(unit.T, unit)), inverse_root.T))
    smallest = jnp.min(jnp.where(spectrum > m * eps * spectrum[-1], spectrum, jnp.inf))
    rho = jnp.where(spectrum[-1] > 0, 2 / jnp.sqrt(smallest * spectrum[-1]), 1.0)
    optimum = -matmul(inverse_root.T, inverse_root)
    gain = jnp.linalg.inv(P + rho * matmul(unit.T, unit))
    rows = unit * norms[:, None]
    products = batched_ldl.pair_products(unit)
    return Factors(P, unit, norms, optimum, matmul(optimum, rows.T), gain, rho, batched_ldl.pack(P), products)


def solve(
    factors: Factors,
    q: Float[Array, "batch n"],
    l: Float[Array, "*batch m"],
    u: Float[Array, "*batch m"],
    *,
    iterations: int = 30,
    polish_steps: int = 4,
    tolerance: float | None = None,
) -> Solution:
    """Solve the batch: SOLVED iff residual <= tolerance max(1, |q|_inf), INFEASIBLE iff proved, UNSOLVED otherwise.

    l and u may be (m,) for all. Default tolerance 1e-8 in float64, 2e-5 in float32. Never raises on data.
    """
    tolerance = TOLERANCE[q.dtype.itemsize] if tolerance is None else tolerance
    l, u = (jnp.broadcast_to(bound, (len(q), factors.rows.shape[0])) for bound in (l, u))
    x, row_values = matmul(q, factors.optimum), matmul(q, factors.optimum_rows)  # (1)
    residual = jnp.max(jnp.abs(matmul(x, factors.hessian) + q), axis=1)
    limit = tolerance * jnp.maximum(1.0, jnp.max(jnp.abs(q), axis=1))
    inside = jnp.all((l <= row_values) & (row_values <= u), axis=1) & (residual <= limit)
    free = Solution(x, jnp.zeros_like(l), jnp.where(inside, SOLVED, UNSOLVED).astype(jnp.int32), residual)
    instances = Instances(q, l, u, limit)
    general = partial(solve_constrained, factors, instances, iterations, polish_steps, tolerance)
    return jax.lax.cond(jnp.all(inside), lambda free: free, general, free)


def kkt_residual(
    factors: Factors,
    q: Float[Array, "batch n"],
    l: Float[Array, "*batch m"],
    u: Float[Array, "*batch m"],
    x: Float[Array, "batch n"],
    multipliers: Float[Array, "batch m"],
) -> Float[Array, " batch"]:
    """Return max(|P x + q + A'y|_inf, |A x - clip(A x + y, l, u)|_inf) with unit rows; infinite for NaN."""
    norms, y = factors.row_norms, multipliers
    return residual_of(factors, q.T, (l / norms).T, (u / norms).T, x.T, (y * norms).T)


def residual_of(
    factors: Factors,
    q: Float[Array, "n batch"],
    l: Float[Array, "m #batch"],
    u: Float[Array, "m #batch"],
    x: Float[Array, "n batch"],
    y: Float[Array, "m batch"],
) -> Float[Array, " batch"]:
    """Return the residual of `kkt_residual` in scaled rows, the batch last."""
    row_values = matmul(factors.rows, x)
    stationarity = matmul(factors.hessian, x) + q + matmul(factors.rows.T, y)
    fixed_point = row_values - jnp.clip(row_values + y, l, u)
    residual = jnp.maximum(jnp.max(jnp.abs(stationarity), axis=0), jnp.max(jnp.abs(fixed_point), axis=0))
    return jnp.where(jnp.isnan(residual), jnp.inf, residual)


def solve_constrained(
    factors: Factors, instances: Instances, iterations: int, polish_steps: int, tolerance: float, free: Solution
) -> Solution:
    """Run steps (2) to (5) on the instances that the unconstrained optimum does not solve; `instances` batch first."""
    norms, (q, l, u, limit) = factors.row_norms, instances
    instances = Instances(q, l / norms, u / norms, limit)
    crossing = jnp.any((l > u) | (l == jnp.inf) | (u == -jnp.inf), axis=1)
    residual = kkt_residual(factors, q, l, u, free.x, free.multipliers)
    status = jnp.where(crossing, INFEASIBLE, free.status).astype(jnp.int32)
    solution = free._replace(status=status, residual=residual)
    quadratic = interior_point.program(factors.hessian, jnp.concatenate([factors.rows, -factors.rows]))
    elastic = farkas.elastic_program(factors.hessian, factors.rows)

    def first(block, best):
        x, y = admm(factors, block, best.x, iterations)
        return prove(factors, block, polish(factors, block, best, x, y, polish_steps), *two_sided(y), tolerance)

    def rescue(block, best):
        x, y = interior(quadratic, block, best.x)
        return prove(factors, block, polish(factors, block, best, x, y, polish_steps), *two_sided(y), tolerance)

    def last(block, best):
        multipliers = farkas.elastic_multipliers(elastic, block.l, block.u, best.x, RESCUE_ITERATIONS)
        return prove(factors, block, best, *multipliers, tolerance)

    for method, size in ((first, ADMM_BLOCK), (rescue, RESCUE_BLOCK), (last, RESCUE_BLOCK)):
        solution = in_blocks(method, size, instances, solution)
    x = jnp.where(jnp.isfinite(solution.residual)[:, None], solution.x, 0.0)
    return solution._replace(x=x, multipliers=solution.multipliers / norms)


def in_blocks(
    method: Callable[[Instances, Solution], Solution], size: int, instances: Instances, solution: Solution
) -> Solution:
    """Apply a method, batch last, to the unsolved instances with sound data, `size` of them at a time."""
    batch = len(solution.status)
    size = min(size, batch)

    def block(carry):
        pending, solution = carry
        index = jnp.nonzero(pending, size=size, fill_value=batch)[0]
        gathered = jax.tree.map(lambda a: jnp.take(a, index, axis=0, mode="clip").T, (instances, solution))
        found = method(*gathered)
        solution = jax.tree.map(lambda old, new: old.at[index].set(new.T, mode="drop"), solution, found)
        return pending.at[index].set(False, mode="drop"), solution

    pending = (solution.status == UNSOLVED) & jnp.isfinite(solution.residual)
    return jax.lax.while_loop(lambda carry: jnp.any(carry[0]), block, (pending, solution))[1]


def admm(
    factors: Factors, block: Instances, start: Float[Array, "n batch"], iterations: int
) -> tuple[Float[Array, "n batch"], Float[Array, "m batch"]]:
    """Run step (2) from v = A start; return x and its multipliers."""
    A, K, rho = factors.rows, factors.admm_gain, factors.rho

    def primal(v, z):
        return matmul(K, rho * matmul(A.T, 2 * z - v) - block.q)

    def iterate(_, v):
        z = jnp.clip(v, block.l, block.u)
        return v + RELAXATION * (matmul(A, primal(v, z)) - z)

    v = jax.lax.fori_loop(0, iterations, iterate, matmul(A, start))
    z = jnp.clip(v, block.l, block.u)
    return primal(v, z), rho * (v - z)


def interior(
    program: interior_point.Program, block: Instances, start: Float[Array, "n batch"]
) -> tuple[Float[Array, "n batch"], Float[Array, "m batch"]]:
    """Run step (4); return x and its multipliers."""
    h = jnp.concatenate([block.u, -block.l])
    x, y = interior_point.solve(program, block.q, h, start, RESCUE_ITERATIONS)
    upper, lower = jnp.split(y, 2)
    return x, upper - lower


def polish(
    factors: Factors,
    block: Instances,
    best: Solution,
    x: Float[Array, "n batch"],
    y: Float[Array, "m batch"],
    steps: int,
) -> Solution:
    """Run step (3) from x, y; return the best of these, of the polished iterates and of what was there before."""
    A, P, rho, (q, l, u, _) = factors.rows, factors.hessian, factors.rho, block
    penalty = rho * jnp.finfo(x.dtype).eps ** -0.4

    def newton(_, carry):
        x, y, best = carry
        v = matmul(A, x) + y / rho
        active = (v < l) | (v > u)
        bound = jnp.clip(v, l, u)
        weights = jnp.where(active, penalty, 0.0)
        ldl = batched_ldl.factorise(factors.packed_hessian[:, None] + matmul(factors.pair_products, weights))
        y = jnp.where(active, y, 0.0)

        def refine(_, iterate):
            x, y = iterate
            predicted = y + weights * (matmul(A, x) - bound)
            x = x - batched_ldl.solve(ldl, matmul(P, x) + q + matmul(A.T, predicted))
            return x, y + weights * (matmul(A, x) - bound)

        x, y = jax.lax.fori_loop(0, REFINEMENTS, refine, (x, y))
        return x, y, better(factors, block, best, x, y)

    return jax.lax.fori_loop(0, steps, newton, (x, y, better(factors, block, best, x, y)))[2]


def better(
    factors: Factors, block: Instances, best: Solution, x: Float[Array, "n batch"], y: Float[Array, "m batch"]
) -> Solution:
    """Return, instance by instance, x, y or `best`, whichever has the smaller residual; a NaN never wins."""
    residual = residual_of(factors, block.q, block.l, block.u, x, y)
    wins = residual < best.residual
    x, y, residual = (jnp.where(wins, *pair) for pair in ((x, best.x), (y, best.multipliers), (residual, best.residual)))
    return Solution(x, y, jnp.where(residual <= block.limit, SOLVED, best.status).astype(jnp.int32), residual)


def prove(
    factors: Factors,
    block: Instances,
    best: Solution,
    upper: Float[Array, "m batch"],
    lower: Float[Array, "m batch"],
    tolerance: float,
) -> Solution:
    """Mark as infeasible the unsolved instances that the multipliers of the two sides exclude."""
    excluded = farkas.excludes(factors.rows, block.l, block.u, upper, lower, tolerance) & (best.status == UNSOLVED)
    return best._replace(status=jnp.where(excluded, INFEASIBLE, best.status).astype(jnp.int32))


def two_sided(y):
    return jnp.maximum(y, 0), jnp.maximum(-y, 0)
