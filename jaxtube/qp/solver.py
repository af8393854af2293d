# ruff: noqa: E741 -- l and u are the letters of the problem
"""Solve a batch of strictly convex quadratic programs that share their matrices, each with a status
and a residual.

    minimise over x   1/2 x' P x + q' x   subject to   l <= A x <= u

P > 0 (n, n) and A (m, n) are shared; q (batch, n) and l, u (batch, m), infinite where a bound is
absent, are not.

(1) The unconstrained optimum -P^-1 q: the exact answer where it meets the bounds. If all do,
    nothing else is done. Else answers known beforehand are tried, where there are any (`regions`).
(2) A fixed number of ADMM iterations, started at (1).
(3) A few active-set Newton steps; each instance keeps its iterate of smallest residual.
(4) An interior point method for the few that remain, then (3) again.
(5) Infeasibility is said only where proved: the multipliers of (2) and (4), then those of an
    elastic problem, are offered as certificates to an explicit check.

(2) to (5) gather the unsolved instances into blocks: their cost grows with the number of these.
Whether they run is decided by the data of the whole batch, so do not vmap `solve`: give it a longer
batch. It runs under jit and in scan. Its derivative, first order and reverse mode, is that on the
active rows, whatever found them (`sensitivity`): one small product, and more for the instances with
an active row alone.

Notation: the letters of OSQP. Multipliers are positive at u and negative at l: P x + q + A' y = 0.
Source: Stellato, Banjac, Goulart, Bemporad, Boyd, OSQP, Mathematical Programming Computation 2020,
for the problem and (2); the modules `fixed_point` (2, 3), `interior_point` (4), `farkas` (5) and
`sensitivity` name theirs.
"""

from collections.abc import Callable
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import Array
from jaxtyping import Bool, Float, Int

from jaxtube.qp import farkas, fixed_point, interior_point, regions, sensitivity
from jaxtube.qp.batched_ldl import matmul
from jaxtube.qp.blocks import block_sizes, update_in_blocks
from jaxtube.qp.factors import Factors
from jaxtube.qp.fixed_point import TOLERANCE, Instances, Iterate
from jaxtube.qp.interior_point import BOLD, CAUTIOUS, Caution
from jaxtube.qp.regions import Known
from jaxtube.qp.status import INFEASIBLE, SOLVED, UNSOLVED

ITERATIONS = 30
"""Iterations of (2)."""
POLISH_STEPS = 4
"""Newton steps of (3)."""
INTERIOR_ITERATIONS = 60
RESCUE_STEPS = 64
"""Newton steps after (4): where a row misses its bound by 1e-8 they try several active sets before
they settle."""


class Solution(NamedTuple):
    """Answer of every instance: x and multipliers are finite always, and to be trusted where status
    == SOLVED."""

    x: Float[Array, "batch n"]
    multipliers: Float[Array, "batch m"]
    status: Int[Array, " batch"]
    residual: Float[Array, " batch"]


Method = Callable[[Instances, Iterate], tuple[Iterate, Bool[Array, " batch"]]]
"""What improves iterates and says which instances it proved infeasible."""


def solve(
    factors: Factors,
    q: Float[Array, "batch n"],
    l: Float[Array, "*batch m"],
    u: Float[Array, "*batch m"],
    known: Known | None = None,
) -> Solution:
    """Solve the batch; never raises on data, never returns a NaN.

    Args:
        factors: of P and A, by `factorise`.
        q: linear costs.
        l: lower bounds, of every instance or common to all.
        u: upper bounds, likewise.
        known: critical regions of a parametric program of which these are instances, and their
            parameters. An answer found there is taken only if its residual would be accepted.

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
    return solve_batch(factors, q, jnp.broadcast_to(l, shape), jnp.broadcast_to(u, shape), known)


@jax.custom_vjp
def solve_batch(
    factors: Factors,
    q: Float[Array, "batch n"],
    l: Float[Array, "batch m"],
    u: Float[Array, "batch m"],
    known: Known | None,
) -> Solution:
    """Solve as `solve`, every instance with bounds of its own."""
    x = matmul(q, factors.optimum)  # (1)
    row_values = matmul(q, factors.optimum_rows)
    scale = fixed_point.dual_scale(factors, q, x)
    residual = jnp.max(jnp.abs(matmul(x, factors.hessian) + q), axis=1) / scale
    is_inside = jnp.all((l <= row_values) & (row_values <= u), axis=1)
    is_solved = is_inside & (residual <= TOLERANCE[q.dtype.itemsize])
    status = jnp.where(is_solved, SOLVED, UNSOLVED).astype(jnp.int32)
    free = Solution(x, jnp.zeros_like(l), status, residual)
    general = partial(solve_constrained, factors, Instances(q, l, u, scale), known)
    return jax.lax.cond(jnp.all(is_solved), lambda free: free, general, free)


def solve_and_remember(factors: Factors, q, l, u, known) -> tuple[Solution, tuple]:
    """Solve; return the answers and what their derivative needs."""
    solution = solve_batch(factors, q, l, u, known)
    return solution, (factors, l, u, solution)


def pull_back(saved: tuple, cotangent: Solution) -> tuple[Factors, Array, Array, Array, None]:
    """Return the cotangents of factors, q, l and u; only the instances with an active row cost more
    than a product."""
    factors, l, u, solution = saved
    zero = jnp.zeros_like(l)
    solved = solution.status == SOLVED
    x_bar = jnp.where(solved[:, None], cotangent.x, 0.0)
    y_bar = jnp.where(solved[:, None], cotangent.multipliers, 0.0)
    constrained = solved & jnp.any(solution.multipliers != 0, axis=1)

    free = jnp.where(solved[:, None], -matmul(x_bar, factors.optimum), 0.0)
    data = (solution.x, solution.multipliers, l, u, x_bar, y_bar)
    size, _ = block_sizes()
    adjoint = partial(solve_adjoint, factors)
    d, l_bar, u_bar = update_in_blocks(adjoint, size, constrained, data, (free, zero, zero))
    shared = sensitivity.shared_cotangents(
        factors, solution.x, solution.multipliers, d, l_bar + u_bar
    )
    return shared, -d, l_bar, u_bar, None


def solve_adjoint(
    factors: Factors, data: tuple[Array, ...], _
) -> tuple[Float[Array, "batch n"], Float[Array, "batch m"], Float[Array, "batch m"]]:
    """Return d and the cotangents of l and u for a block of instances, `data` being (x, y, l, u,
    x_bar, y_bar)."""
    x, y, l, u, x_bar, y_bar = data
    norms = factors.row_norms
    at_lower, at_upper = sensitivity.active_rows(
        factors, x.T, (y * norms).T, (l / norms).T, (u / norms).T
    )
    d, nu = sensitivity.adjoint(factors, at_lower | at_upper, x_bar.T, (y_bar / norms).T)
    l_bar = jnp.where(at_lower, nu, 0.0).T / norms
    u_bar = jnp.where(at_upper, nu, 0.0).T / norms
    return d.T, l_bar, u_bar


solve_batch.defvjp(solve_and_remember, pull_back)


def solve_constrained(
    factors: Factors, instances: Instances, known: Known | None, free: Solution
) -> Solution:
    """Run steps (2) to (5) on the instances that `free`, the unconstrained optimum, does not
    solve."""
    A = factors.rows
    quadratic = interior_point.program(factors.hessian, jnp.concatenate([A, -A]))
    elastic = farkas.elastic_program(factors.hessian, A)
    size, rare_size = block_sizes()

    def rescue_all(solution, caution):
        method = partial(rescue, factors, quadratic, caution)
        return improve(method, rare_size, factors, instances, solution), None

    if known is not None:
        free = accept_known(factors, known, instances, size, free)
    solution = improve(partial(split, factors), size, factors, instances, free)
    # A scan compiles one program for both: the cautious method for what the bold one leaves.
    cautions = Caution(*jnp.array([BOLD, CAUTIOUS], A.dtype).T)
    solution, _ = jax.lax.scan(rescue_all, solution, cautions)
    solution = improve(partial(refute, factors, elastic), rare_size, factors, instances, solution)
    sound = jnp.isfinite(solution.residual)
    return solution._replace(
        x=jnp.where(sound[:, None], solution.x, 0.0),
        residual=jnp.where(sound, solution.residual, jnp.inf),
    )


def accept_known(
    factors: Factors, known: Known, instances: Instances, size: int, solution: Solution
) -> Solution:
    """Take the answers of known regions where they are answers."""
    pending = (solution.status == UNSOLVED) & jnp.isfinite(solution.residual)
    tolerance = TOLERANCE[instances.q.dtype.itemsize]

    def take(data, before: Solution) -> Solution:
        block, parameters = data
        x, y = regions.look_up(Known(known.regions, parameters), len(factors.rows))
        unit = unit_rows(factors, block)
        residual = fixed_point.residual(factors, unit, x.T, (y * factors.row_norms).T)
        is_answer = residual <= tolerance
        status = jnp.where(is_answer, SOLVED, before.status).astype(jnp.int32)
        answer = Solution(x, y, status, residual)
        return jax.tree.map(
            lambda new, old: jnp.where(jnp.expand_dims(is_answer, range(1, new.ndim)), new, old),
            answer,
            before,
        )

    return update_in_blocks(take, size, pending, (instances, known.parameters), solution)


def split(
    factors: Factors, block: Instances, best: Iterate
) -> tuple[Iterate, Bool[Array, " batch"]]:
    """Improve a block by ADMM and Newton steps, (2) and (3)."""
    nothing = best._replace(residual=jnp.full_like(best.residual, jnp.inf))
    best = fixed_point.keep_better(factors, block, nothing, best.x, best.y)
    x, y = fixed_point.admm(factors, block, best.x, ITERATIONS)
    best = fixed_point.polish(factors, block, best, x, y, POLISH_STEPS)
    excluded = is_excluded(factors, block, jnp.maximum(y, 0.0), jnp.maximum(-y, 0.0))
    return best, fixed_point.has_crossing_bounds(block) | excluded


def rescue(
    factors: Factors,
    quadratic: interior_point.Program,
    caution: Caution,
    block: Instances,
    best: Iterate,
) -> tuple[Iterate, Bool[Array, " batch"]]:
    """Improve a block by the interior point method and Newton steps, (4)."""
    h = jnp.concatenate([block.u, -block.l])
    x, y = interior_point.solve(quadratic, block.q, h, best.x, INTERIOR_ITERATIONS, caution)
    upper, lower = jnp.split(y, 2)
    best = fixed_point.polish(factors, block, best, x, upper - lower, RESCUE_STEPS)
    return best, is_excluded(factors, block, upper, lower)


def refute(
    factors: Factors, elastic: interior_point.Program, block: Instances, best: Iterate
) -> tuple[Iterate, Bool[Array, " batch"]]:
    """Leave the iterates of a block; say which instances the elastic problem excludes, (5)."""
    upper, lower = farkas.elastic_multipliers(
        elastic, block.l, block.u, best.x, INTERIOR_ITERATIONS
    )
    return best, is_excluded(factors, block, upper, lower)


def is_excluded(
    factors: Factors,
    block: Instances,
    upper: Float[Array, "m batch"],
    lower: Float[Array, "m batch"],
) -> Bool[Array, " batch"]:
    """Return which instances the multipliers y_u, y_l prove infeasible."""
    tolerance = TOLERANCE[block.q.dtype.itemsize]
    return farkas.excludes(factors.rows, block.l, block.u, upper, lower, tolerance)


def improve(
    method: Method, size: int, factors: Factors, instances: Instances, solution: Solution
) -> Solution:
    """Apply a method once to every unsolved instance whose data are numbers, `size` of them at a
    time."""
    pending = (solution.status == UNSOLVED) & jnp.isfinite(solution.residual)
    method_of_block = partial(improve_block, method, factors)
    return update_in_blocks(method_of_block, size, pending, instances, solution)


def improve_block(
    method: Method, factors: Factors, instances: Instances, solution: Solution
) -> Solution:
    """Apply a method once to a block of instances."""
    norms = factors.row_norms
    tolerance = TOLERANCE[instances.q.dtype.itemsize]
    instances = unit_rows(factors, instances)
    start = Iterate(solution.x.T, (solution.multipliers * norms).T, solution.residual)
    best, infeasible = method(instances, start)
    otherwise = jnp.where(infeasible, INFEASIBLE, UNSOLVED)
    status = jnp.where(best.residual <= tolerance, SOLVED, otherwise)
    return Solution(best.x.T, best.y.T / norms, status.astype(jnp.int32), best.residual)


def unit_rows(factors: Factors, instances: Instances) -> Instances:
    """Return instances with the batch first and the caller's rows as those of unit rows, batch
    last."""
    norms = factors.row_norms
    l = (instances.l / norms).T
    u = (instances.u / norms).T
    return Instances(instances.q.T, l, u, instances.dual_scale)
