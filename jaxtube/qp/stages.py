# ruff: noqa: E741 -- l and u are the letters of the problem
"""The stages through which the instances of a batch go that their unconstrained optimum does not
solve: known regions, the dual active-set method, ADMM and Newton, interior point, infeasibility.

Each takes what the ones before it left, in blocks, and forms the numbers of a block when it works
on it: a few instances of a large batch cost little. An answer is taken where its residual says so,
and infeasibility where it is proved. Notation and source: `solver`.
"""

from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import Array
from jaxtyping import Bool, Float, Int, PyTree

from jaxtube.qp import dual_active_set, farkas, fixed_point, interior_point, regions
from jaxtube.qp.batched_ldl import matmul
from jaxtube.qp.blocks import block_sizes, gather, update_in_blocks
from jaxtube.qp.dual_active_set import Found, Start
from jaxtube.qp.exchange import make_program
from jaxtube.qp.factors import Factors
from jaxtube.qp.fixed_point import TOLERANCE, Instances, Iterate
from jaxtube.qp.interior_point import BOLD, CAUTIOUS, Caution
from jaxtube.qp.regions import Regions
from jaxtube.qp.status import INFEASIBLE, SOLVED, UNSOLVED

ITERATIONS = 30
"""Of ADMM."""
POLISH_STEPS = 4
"""Of Newton's method after it."""
INTERIOR_ITERATIONS = 60
RESCUE_STEPS = 64
"""Of Newton's method after the interior point: where a row misses its bound by 1e-8 they try
several active sets before they settle."""
MISSED = 1e-2
"""By how much the dual active-set method may miss a row, by the tolerance of the residual."""
MISSED_ROUNDING = 4
"""The same, by the rounding of a row's value."""


class Solution(NamedTuple):
    """Answer of every instance: x and multipliers are finite always, and to be trusted where status
    == SOLVED."""

    x: Float[Array, "batch n"]
    multipliers: Float[Array, "batch m"]
    status: Int[Array, " batch"]
    residual: Float[Array, " batch"]


class Source(NamedTuple):
    """The numbers of the instances: arrays with the batch as leading axis, and what makes q, l and
    u of some rows of them."""

    data: PyTree
    form: Callable[[Any], tuple[Array, Array, Array]]


Method = Callable[[Instances, Iterate], tuple[Iterate, Bool[Array, " batch"]]]
"""What improves iterates and says which instances it proved infeasible."""


def solve_constrained(
    factors: Factors, source: Source, known: Regions | None, solution: Solution
) -> Solution:
    """Solve the instances that are UNSOLVED.

    Args:
        factors: what they share.
        source: the others' numbers.
        known: critical regions of the parameters that `source.data` then are.
        solution: of those that are solved; the residual of the others is finite unless their data
            are not numbers.
    """
    size, _ = block_sizes()
    if known is not None:
        method = partial(look_up_block, factors, source.form, known)
        solution = update_in_blocks(method, size, find_pending(solution), source.data, solution)
    search = partial(search_active_sets, factors, source)
    solution = _where_any(find_pending(solution), search, solution)
    iterate = partial(iterate_to_the_end, factors, source)
    return _where_any(find_pending(solution), iterate, solution)


def find_pending(solution: Solution) -> Bool[Array, " batch"]:
    """Return which instances are to be solved: neither solved nor refuted, and their data are
    numbers."""
    return (solution.status == UNSOLVED) & jnp.isfinite(solution.residual)


def _where_any(
    pending: Bool[Array, " batch"], method: Callable[[Solution], Solution], solution: Solution
) -> Solution:
    return jax.lax.cond(jnp.any(pending), method, lambda solution: solution, solution)


def form_block(factors: Factors, form, data: PyTree) -> tuple[Instances, Float[Array, "n block"]]:
    """Return the instances of a block, and their unconstrained optima."""
    q, l, u = form(data)
    optimum = matmul(q, factors.optimum)
    scale = fixed_point.dual_scale(factors, q, optimum)
    return fixed_point.unit_rows(factors, Instances(q, l, u, scale)), optimum.T


def as_solution(
    factors: Factors, best: Iterate, infeasible: Bool[Array, " block"] | bool = False
) -> Solution:
    """Return iterates with the status that their residuals, or a proof, give them."""
    tolerance = TOLERANCE[best.x.dtype.itemsize]
    otherwise = jnp.where(infeasible, INFEASIBLE, UNSOLVED)
    status = jnp.where(best.residual <= tolerance, SOLVED, otherwise)
    return Solution(best.x.T, best.y.T / factors.row_norms, status.astype(jnp.int32), best.residual)


# ----------------------------------------------------------------------------------- known regions


def look_up_block(
    factors: Factors, form, known: Regions, data: Float[Array, "block 3"], _: Solution
) -> Solution:
    """Return the answers of known regions, where they are answers."""
    block, _ = form_block(factors, form, data)
    x, y = regions.look_up(known, data, len(factors.rows))
    x = x.T
    y = (y * factors.row_norms).T
    return as_solution(factors, Iterate(x, y, fixed_point.residual(factors, block, x, y)))


# ----------------------------------------------------------------------- dual active-set method


def search_active_sets(factors: Factors, source: Source, solution: Solution) -> Solution:
    """Solve by the dual active-set method; refute what it says has no answer."""
    size, rare_size = block_sizes()
    program = make_program(factors.whitened)
    load = partial(load_lanes, factors, source)
    pending = find_pending(solution)
    found = dual_active_set.find_active_sets(program, load, pending, rare_size)
    data = (source.data, found)
    judge = partial(judge_block, factors, source.form)
    solution = update_in_blocks(judge, size, pending, data, solution)
    doubtful = found.is_ray & find_pending(solution)
    check = partial(check_rays, factors, source.form)
    return update_in_blocks(check, rare_size, doubtful, data, solution)


def load_lanes(factors: Factors, source: Source, places: Int[Array, " lanes"]) -> Start:
    """Return the instances at places in the batch as the dual active-set method wants them."""
    q, l, u = source.form(gather(places, source.data))
    z = matmul(factors.root, -q.T)
    bounds = jnp.concatenate([u / factors.row_norms, -l / factors.row_norms], axis=1).T
    eps = jnp.finfo(q.dtype).eps
    longest = jnp.sqrt(jnp.max(jnp.sum(factors.whitened**2, axis=1)))
    rounding = MISSED_ROUNDING * eps * longest * jnp.sqrt(jnp.sum(z * z, axis=0))
    tolerance = jnp.maximum(MISSED * TOLERANCE[q.dtype.itemsize], rounding)
    # Of data that are not numbers nothing is proved.
    return Start(z, bounds, jnp.where(jnp.isnan(bounds).any(axis=0), jnp.inf, tolerance))


def judge_block(factors: Factors, form, data: tuple[PyTree, Found], _: Solution) -> Solution:
    """Return what active sets say of a block of instances."""
    block, optimum = form_block(factors, form, data[0])
    upper, lower = push_of(data[1], len(factors.rows))
    y = upper - lower
    x = matmul(factors.optimum, block.q + matmul(factors.rows.T, y))
    is_guess = jnp.all(jnp.isfinite(x), axis=0) & ~data[1].is_ray
    x = jnp.where(is_guess, x, optimum)
    y = jnp.where(is_guess, y, 0.0)
    best = Iterate(x, y, fixed_point.residual(factors, block, x, y))
    return as_solution(factors, best, fixed_point.has_crossing_bounds(block))


def check_rays(factors: Factors, form, data: tuple[PyTree, Found], solution: Solution) -> Solution:
    """Return a block of solutions, INFEASIBLE where the rays found are proofs of it."""
    block, _ = form_block(factors, form, data[0])
    upper, lower = push_of(data[1], len(factors.rows))
    excluded = is_excluded(factors, block, upper, lower)
    return solution._replace(status=jnp.where(excluded, INFEASIBLE, solution.status))


def push_of(found: Found, m: int) -> tuple[Float[Array, "m block"], Float[Array, "m block"]]:
    """Return the multipliers y_u, y_l >= 0 of all rows."""
    block = jnp.arange(len(found.rows))[:, None]
    place = jnp.where(found.rows < 0, 2 * m, found.rows)
    signed = jnp.zeros((len(found.rows), 2 * m), found.multipliers.dtype)
    signed = signed.at[block, place].set(found.multipliers, mode="drop")
    return signed[:, :m].T, signed[:, m:].T


# ----------------------------------------------------------------------------------- iterations


def iterate_to_the_end(factors: Factors, source: Source, solution: Solution) -> Solution:
    """Solve by ADMM and Newton's method, then by an interior point method; refute the rest."""
    A = factors.rows
    quadratic = interior_point.program(factors.hessian, jnp.concatenate([A, -A]))
    elastic = farkas.elastic_program(factors.hessian, A)
    size, rare_size = block_sizes()

    def rescue_all(solution, caution):
        method = partial(rescue, factors, quadratic, caution)
        return improve(method, rare_size, factors, source, solution), None

    solution = improve(partial(split, factors), size, factors, source, solution)
    # A scan compiles one program for both: the cautious method for what the bold one leaves.
    cautions = Caution(*jnp.array([BOLD, CAUTIOUS], A.dtype).T)
    solution, _ = jax.lax.scan(rescue_all, solution, cautions)
    return improve(partial(refute, factors, elastic), rare_size, factors, source, solution)


def split(
    factors: Factors, block: Instances, best: Iterate
) -> tuple[Iterate, Bool[Array, " batch"]]:
    """Improve a block by ADMM and Newton steps, (3)."""
    optimum = matmul(factors.optimum, block.q)
    best = fixed_point.keep_better(factors, block, best, optimum, jnp.zeros_like(best.y))
    x, y = fixed_point.admm(factors, block, optimum, ITERATIONS)
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
    method: Method, size: int, factors: Factors, source: Source, solution: Solution
) -> Solution:
    """Apply a method once to every unsolved instance, `size` of them at a time."""

    def improve_block(data: PyTree, solution: Solution) -> Solution:
        block, _ = form_block(factors, source.form, data)
        y = (solution.multipliers * factors.row_norms).T
        best, infeasible = method(block, Iterate(solution.x.T, y, solution.residual))
        return as_solution(factors, best, infeasible)

    pending = find_pending(solution)
    return update_in_blocks(improve_block, size, pending, source.data, solution)
