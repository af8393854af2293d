# ruff: noqa: E741 -- l and u are the letters of the problem
"""Solve a batch of strictly convex quadratic programs that share their matrices, each with a status
and a residual.

    minimise over x   1/2 x' P x + q' x   subject to   l <= A x <= u

P > 0 (n, n) and A (m, n) are shared; q (batch, n) and l, u (batch, m), infinite where a bound is
absent, are not.

(1) The unconstrained optimum -P^-1 q: the exact answer where it meets the bounds. If all do,
    nothing else is done.
(2) The dual active-set method, exact where it ends: nearly everywhere.
(3) A fixed number of ADMM iterations, started at (1), and a few active-set Newton steps; each
    instance keeps its iterate of smallest residual.
(4) An interior point method for the few that remain, then Newton steps again.
(5) Infeasibility is said only where proved: the multipliers of (2) to (4), then those of an elastic
    problem, are offered as certificates to an explicit check.

(2) to (5) gather the unsolved instances into blocks: their cost grows with the number of these.
Whether they run is decided by the data of the whole batch, so do not vmap `solve`: give it a longer
batch. It runs under jit and in scan. Its derivative, first order and reverse mode, is that on the
active rows, whatever found them (`sensitivity`): one small product, and more for the instances with
an active row alone.

Notation: the letters of OSQP. Multipliers are positive at u and negative at l: P x + q + A' y = 0.
Source: Stellato, Banjac, Goulart, Bemporad, Boyd, OSQP, Mathematical Programming Computation 2020,
for the problem and (3); the modules `exchange` (2), `fixed_point` (3), `interior_point` (4),
`farkas` (5) and `sensitivity` name theirs.
"""

from functools import partial

import jax
import jax.numpy as jnp
from jax import Array
from jaxtyping import Float, Int

from jaxtube.qp import fixed_point, sensitivity
from jaxtube.qp.batched_ldl import matmul
from jaxtube.qp.blocks import block_sizes, update_in_blocks
from jaxtube.qp.factors import Factors
from jaxtube.qp.fixed_point import TOLERANCE
from jaxtube.qp.source import Solution, Source
from jaxtube.qp.stages import solve_constrained
from jaxtube.qp.status import SOLVED, UNSOLVED


def solve(
    factors: Factors,
    q: Float[Array, "batch n"],
    l: Float[Array, "*batch m"],
    u: Float[Array, "*batch m"],
) -> Solution:
    """Solve the batch; never raises on data, never returns a NaN.

    Args:
        factors: of P and A, by `factorise`.
        q: linear costs.
        l: lower bounds, of every instance or common to all.
        u: upper bounds, likewise.

    Returns:
        The best iterates. With the residual and the scales of `fixed_point`: SOLVED where the
        residual is at most 1e-9 in float64, 5e-7 in float32, so that no row, scaled to unit norm,
        misses its bounds by more than this (or the rounding of A x where that is larger),
        whatever the size of the cost. INFEASIBLE where proved (see `farkas`), or where l > u in
        some row. UNSOLVED: neither. x is zero and the residual infinite where the data are not
        numbers or l > u.

        Reverse mode gives the derivative of x and of the multipliers with respect to q, l, u and,
        through `factorise`, to P and A; it is zero where the instance is not SOLVED, and everywhere
        for the residual.
    """
    shape = (len(q), len(factors.rows))
    return solve_batch(factors, q, jnp.broadcast_to(l, shape), jnp.broadcast_to(u, shape))


@jax.custom_vjp
def solve_batch(
    factors: Factors,
    q: Float[Array, "batch n"],
    l: Float[Array, "batch m"],
    u: Float[Array, "batch m"],
) -> Solution:
    """Solve as `solve`, every instance with bounds of its own."""
    x = matmul(q, factors.optimum)  # (1)
    row_values = matmul(q, factors.optimum_rows)
    scale = fixed_point.dual_scale(factors, q.T, x.T)
    residual = jnp.max(jnp.abs(matmul(x, factors.hessian) + q), axis=1) / scale
    is_inside = jnp.all((l <= row_values) & (row_values <= u), axis=1)
    is_solved = is_inside & (residual <= TOLERANCE[q.dtype.itemsize])
    status = jnp.where(is_solved, SOLVED, UNSOLVED).astype(jnp.int32)
    free = Solution(x, jnp.zeros_like(l), status, residual)
    source = make_source(factors, q, l, u)
    general = partial(solve_the_rest, factors, source)
    return jax.lax.cond(jnp.all(is_solved), lambda free: free, general, free)


def make_source(
    factors: Factors,
    q: Float[Array, "batch n"],
    l: Float[Array, "batch m"],
    u: Float[Array, "batch m"],
) -> Source:
    """Return the numbers of the instances, with rows of unit norm."""
    return Source((q, l, u), lambda data: fixed_point.unit_rows(factors, *data))


def solve_the_rest(factors: Factors, source: Source, free: Solution) -> Solution:
    """Solve the instances that `free`, the unconstrained optimum, does not solve."""
    return finish(solve_constrained(factors, source, None, free))


def finish(solution: Solution) -> Solution:
    """Return solutions whose x are numbers."""
    sound = jnp.isfinite(solution.residual)
    return solution._replace(
        x=jnp.where(sound[:, None], solution.x, 0.0),
        multipliers=jnp.where(sound[:, None], solution.multipliers, 0.0),
        residual=jnp.where(sound, solution.residual, jnp.inf),
    )


def solve_and_remember(factors: Factors, q, l, u) -> tuple[Solution, tuple]:
    """Solve; return the answers and what their derivative needs."""
    solution = solve_batch(factors, q, l, u)
    source = make_source(factors, q, l, u)
    return solution, (factors, solution, find_rows_of_solved(factors, source, solution))


def find_rows_of_solved(
    factors: Factors, source: Source, solution: Solution
) -> Int[Array, "batch n"]:
    """Return the active rows of every instance, as `sensitivity.find_active_rows`; none where it is
    not solved."""
    m, _ = factors.rows.shape
    norms = factors.row_norms

    def find(data, _):
        of_instances, x, y = data
        block = source.form(of_instances)
        return sensitivity.find_active_rows(factors, x.T, (y * norms).T, block.l, block.u).T

    is_constrained = jnp.any(solution.multipliers != 0, axis=1) & (solution.status == SOLVED)
    size, _ = block_sizes(len(solution.x))
    data = (source.data, solution.x, solution.multipliers)
    nothing = jnp.full(solution.x.shape, 2 * m, sensitivity.find_row_type(m))
    return update_in_blocks(find, size, is_constrained, data, nothing)


def pull_back(saved: tuple, cotangent: Solution) -> tuple[Factors, Array, Array, Array]:
    """Return the cotangents of factors, q, l and u; only the instances with an active row cost more
    than a product."""
    factors, solution, active = saved
    m, _ = factors.rows.shape
    zero = jnp.zeros_like(solution.multipliers)
    solved = solution.status == SOLVED
    x_bar = jnp.where(solved[:, None], cotangent.x, 0.0)
    y_bar = jnp.where(solved[:, None], cotangent.multipliers, 0.0)

    free = jnp.where(solved[:, None], -matmul(x_bar, factors.optimum), 0.0)
    size, _ = block_sizes(len(x_bar))
    adjoint = partial(solve_adjoint, factors)
    constrained = jnp.any(active < 2 * m, axis=1)
    data = (active, x_bar, y_bar)
    d, l_bar, u_bar = update_in_blocks(adjoint, size, constrained, data, (free, zero, zero))
    shared = sensitivity.shared_cotangents(
        factors, solution.x, solution.multipliers, d, l_bar + u_bar
    )
    return shared, -d, l_bar, u_bar


def solve_adjoint(
    factors: Factors, data: tuple[Array, ...], _
) -> tuple[Float[Array, "batch n"], Float[Array, "batch m"], Float[Array, "batch m"]]:
    """Return d and the cotangents of l and u for a block of instances, `data` being (active rows,
    x_bar, y_bar)."""
    active, x_bar, y_bar = data
    norms = factors.row_norms
    twice = jnp.concatenate([y_bar / norms, y_bar / norms], axis=1)
    of_rows = jnp.take_along_axis(twice, active, axis=1, mode="fill", fill_value=0.0)
    d, nu = sensitivity.minimise_on_rows(factors, active.T, -x_bar.T, of_rows.T)
    u_bar, l_bar = sensitivity.spread(factors, active.T, nu)
    return d.T, l_bar.T / norms, u_bar.T / norms


solve_batch.defvjp(solve_and_remember, pull_back)
