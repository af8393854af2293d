# ruff: noqa: E741 -- l and u are the letters of the problem
"""Solve a batch of strictly convex quadratic programs that share their matrices, each with a status
and a residual.

    minimise over x   1/2 x' P x + q' x   subject to   l <= A x <= u

P > 0 (n, n) and A (m, n) are shared; q (batch, n) and l, u (batch, m), infinite where a bound is
absent, are not.

(1) The unconstrained optimum -P^-1 q: the exact answer where it meets the bounds. If all do,
  nothing else is done.
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
from jaxtyping import Bool, Float, Int, PyTree

from jaxtube.qp import farkas, fixed_point, interior_point, sensitivity
from jaxtube.qp.batched_ldl import matmul
from jaxtube.qp.fixed_point import Factors, Instances, Iterate

__all__ = [
    "INFEASIBLE",
    "SOLVED",
    "STATUS_TEXT",
    "UNSOLVED",
    "Factors",
    "Solution",
    "factorise",
    "kkt_residual",
    "solve",
]

SOLVED, INFEASIBLE, UNSOLVED = 0, 1, 2
STATUS_TEXT = {
    SOLVED: "solved: the residual is within the tolerance",
    INFEASIBLE: "infeasible, proved: no x meets the bounds; widen l, u or begin closer to the reference",
    UNSOLVED: "unsolved: if the residual is infinite look for NaN in the data, else use float64, more iterations or a "
    "better scaled P",
}
TOLERANCE = {8: 1e-9, 4: 5e-7}  # by bytes of a float
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


def factorise(P: Float[Array, "n n"], A: Float[Array, "m n"]) -> Factors:
    """Prepare what the batch shares, as `fixed_point.factorise`; differentiable in what the answer
    depends on.

    The rest makes the solver fast: its cotangents are zero, and reverse mode need not add them up.
    """
    factors = fixed_point.factorise(P, A)
    fast = jax.tree.map(jax.lax.stop_gradient, factors)
    return fast._replace(hessian=factors.hessian, rows=factors.rows, row_norms=factors.row_norms)


Method = Callable[[Instances, Iterate], tuple[Iterate, Bool[Array, " batch"]]]


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
    """Solve the batch; never raises on data, never returns a NaN.

    l, u may be (m,), common to all. `tolerance` is 1e-9 in float64 and 5e-7 in float32 unless
    given. SOLVED: `kkt_residual` <= tolerance max(1, |q|_inf), or <= the rounding error of P x if
    that is larger. INFEASIBLE: proved (see `farkas`), or l > u in some row. UNSOLVED: neither. x is
    the best iterate; it is zero and the residual infinite where the data are not numbers or l > u.
    Reverse mode gives the derivative of x and of the multipliers with respect to q, l, u and,
    through `factorise`, to P and A; it is zero where the instance is not SOLVED, and everywhere for
    the residual.
    """
    tolerance = TOLERANCE[q.dtype.itemsize] if tolerance is None else tolerance
    l, u = (jnp.broadcast_to(bound, (len(q), len(factors.rows))) for bound in (l, u))
    return solve_batch(iterations, polish_steps, tolerance, factors, q, l, u)


@partial(jax.custom_vjp, nondiff_argnums=(0, 1, 2))
def solve_batch(
    iterations: int,
    polish_steps: int,
    tolerance: float,
    factors: Factors,
    q: Float[Array, "batch n"],
    l: Float[Array, "batch m"],
    u: Float[Array, "batch m"],
) -> Solution:
    """Do what `solve` says."""
    x, row_values = matmul(q, factors.optimum), matmul(q, factors.optimum_rows)  # (1)
    residual = jnp.max(jnp.abs(matmul(x, factors.hessian) + q), axis=1)
    rounding = (
        2 * jnp.finfo(q.dtype).eps * jnp.max(jnp.abs(factors.hessian)) * jnp.max(jnp.abs(x), axis=1)
    )
    limit = jnp.maximum(tolerance * jnp.maximum(1.0, jnp.max(jnp.abs(q), axis=1)), rounding)
    inside = jnp.all((l <= row_values) & (row_values <= u), axis=1) & (residual <= limit)
    free = Solution(
        x, jnp.zeros_like(l), jnp.where(inside, SOLVED, UNSOLVED).astype(jnp.int32), residual
    )
    general = partial(
        solve_constrained, factors, Instances(q, l, u, limit), iterations, polish_steps, tolerance
    )
    return jax.lax.cond(jnp.all(inside), lambda free: free, general, free)


def solve_and_remember(
    iterations: int, polish_steps: int, tolerance: float, factors: Factors, q, l, u
):
    """Solve, and keep what the derivative needs."""
    solution = solve_batch(iterations, polish_steps, tolerance, factors, q, l, u)
    return solution, (factors, l, u, solution)


def pull_back(
    iterations: int, polish_steps: int, tolerance: float, saved: tuple, cotangent: Solution
) -> tuple[Factors, Array, Array, Array]:
    """Return the cotangents of factors, q, l and u; only the instances with an active row cost more
    than a product."""
    factors, l, u, solution = saved
    norms, zero, solved = factors.row_norms, jnp.zeros_like(l), solution.status == SOLVED
    x_bar, y_bar = (jnp.where(solved[:, None], part, 0.0) for part in cotangent[:2])
    constrained = solved & jnp.any(solution.multipliers != 0, axis=1)

    def block(given, _):
        x, y, l, u, x_bar, y_bar = given
        y, l, u, y_bar = y * norms, l / norms, u / norms, y_bar / norms
        at_lower, at_upper = sensitivity.active_rows(factors, x.T, y.T, l.T, u.T)
        d, nu = sensitivity.adjoint(factors, at_lower | at_upper, x_bar.T, y_bar.T)
        return d.T, jnp.where(at_lower, nu, 0.0).T / norms, jnp.where(at_upper, nu, 0.0).T / norms

    free = jnp.where(solved[:, None], -matmul(x_bar, factors.optimum), 0.0)
    given = solution.x, solution.multipliers, l, u, x_bar, y_bar
    d, l_bar, u_bar = in_blocks(block, block_sizes()[0], constrained, given, (free, zero, zero))
    shared = sensitivity.shared_cotangents(
        factors, solution.x, solution.multipliers, d, l_bar + u_bar
    )
    return shared, -d, l_bar, u_bar


solve_batch.defvjp(solve_and_remember, pull_back)


def kkt_residual(
    factors: Factors,
    q: Float[Array, "batch n"],
    l: Float[Array, "*batch m"],
    u: Float[Array, "*batch m"],
    x: Float[Array, "batch n"],
    multipliers: Float[Array, "batch m"],
) -> Float[Array, " batch"]:
    """Return max(|P x + q + A'y|_inf, |A x - clip(A x + y, l, u)|_inf), rows scaled to unit 2-norm.

    Infinite where a number is NaN or where bounds cross.
    """
    l, u = (jnp.broadcast_to(bound, multipliers.shape) for bound in (l, u))
    given = unit_rows(factors, Instances(q, l, u, q[:, 0]))
    return fixed_point.residual(factors, given, x.T, (multipliers * factors.row_norms).T)


def unit_rows(factors: Factors, given: Instances) -> Instances:
    """Turn instances as the caller gives them, batch first, into those of unit rows, batch last."""
    norms = factors.row_norms
    return Instances(given.q.T, (given.l / norms).T, (given.u / norms).T, given.limit)


def solve_constrained(
    factors: Factors,
    given: Instances,
    iterations: int,
    polish_steps: int,
    tolerance: float,
    free: Solution,
) -> Solution:
    """Run steps (2) to (5) on the instances that `free`, the unconstrained optimum, does not solve."""
    A = factors.rows
    quadratic = interior_point.program(factors.hessian, jnp.concatenate([A, -A]))
    elastic = farkas.elastic_program(factors.hessian, A)

    def proved(block, upper, lower):
        return farkas.excludes(A, block.l, block.u, upper, lower, tolerance)

    def split(block, best):
        best = fixed_point.better(
            factors, block, best._replace(residual=jnp.full_like(best.residual, jnp.inf)), *best[:2]
        )
        x, y = fixed_point.admm(factors, block, best.x, iterations)  # (2)
        best = fixed_point.polish(factors, block, best, x, y, polish_steps)  # (3)
        return best, fixed_point.crossing(block) | proved(
            block, jnp.maximum(y, 0.0), jnp.maximum(-y, 0.0)
        )

    def rescue(caution, block, best):
        h = jnp.concatenate([block.u, -block.l])
        x, y = interior_point.solve(
            quadratic, block.q, h, best.x, INTERIOR_ITERATIONS, caution
        )  # (4)
        upper, lower = jnp.split(y, 2)
        best = fixed_point.polish(factors, block, best, x, upper - lower, RESCUE_STEPS)
        return best, proved(block, upper, lower)

    def refute(block, best):
        return best, proved(
            block,
            *farkas.elastic_multipliers(elastic, block.l, block.u, best.x, INTERIOR_ITERATIONS),
        )

    size, rare_size = block_sizes()
    solution = improve(split, size, factors, given, free)
    # One program for both: the cautious method for what the bold one leaves.
    cautions = jax.tree.map(
        lambda *each: jnp.array(each, A.dtype), interior_point.BOLD, interior_point.CAUTIOUS
    )
    solution = jax.lax.scan(
        lambda now, caution: (
            improve(partial(rescue, caution), rare_size, factors, given, now),
            None,
        ),
        solution,
        cautions,
    )[0]
    solution = improve(refute, rare_size, factors, given, solution)  # (5)
    sound = jnp.isfinite(solution.residual)
    return solution._replace(
        x=jnp.where(sound[:, None], solution.x, 0.0),
        residual=jnp.where(sound, solution.residual, jnp.inf),
    )


def block_sizes() -> tuple[int, int]:
    """Return how many instances make a block, and how many where few are expected."""
    # A processor's caches hold 64 instances and it pays for every one; an accelerator pays for
    # every block.
    return (64, 32) if jax.default_backend() == "cpu" else (8192, 1024)


def improve(
    method: Method, size: int, factors: Factors, given: Instances, solution: Solution
) -> Solution:
    """Apply a method once to every unsolved instance whose data are numbers, `size` of them at a
    time."""
    norms = factors.row_norms

    def block(given, now):
        given = unit_rows(factors, given)
        best, infeasible = method(
            given, Iterate(now.x.T, (now.multipliers * norms).T, now.residual)
        )
        status = jnp.where(
            best.residual <= given.limit, SOLVED, jnp.where(infeasible, INFEASIBLE, UNSOLVED)
        )
        return Solution(best.x.T, best.y.T / norms, status.astype(jnp.int32), best.residual)

    pending = (solution.status == UNSOLVED) & jnp.isfinite(solution.residual)
    return in_blocks(block, size, pending, given, solution)


def in_blocks(
    method: Callable[[PyTree, PyTree], PyTree],
    size: int,
    pending: Bool[Array, " batch"],
    given: PyTree,
    found: PyTree,
) -> PyTree:
    """Replace what is found for the pending instances by method(given, found), `size` of them at a
    time."""
    batch = len(pending)
    size = min(size, batch)

    def block(carry):
        pending, found = carry
        index = jnp.nonzero(pending, size=size, fill_value=batch)[0]
        new = method(
            *jax.tree.map(lambda a: jnp.take(a, index, axis=0, mode="clip"), (given, found))
        )
        found = jax.tree.map(lambda old, new: old.at[index].set(new, mode="drop"), found, new)
        return pending.at[index].set(False, mode="drop"), found

    return jax.lax.while_loop(lambda carry: jnp.any(carry[0]), block, (pending, found))[1]
