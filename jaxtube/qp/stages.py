"""The stages through which the instances of a batch go that their unconstrained optimum does not
solve: known regions, the dual active-set method, rounds of iterations.

Each takes what the ones before it left. An answer is taken where its residual says so, and
infeasibility where it is proved. Notation and source: `solver`.
"""

from collections.abc import Callable
from functools import partial

import jax
import jax.numpy as jnp
from jax import Array
from jaxtyping import Float, Int, PyTree

from jaxtube.qp import dual_active_set, fixed_point, regions
from jaxtube.qp.batched_ldl import matmul, product
from jaxtube.qp.blocks import block_sizes, gather, on_accelerator, update_in_blocks
from jaxtube.qp.dual_active_set import Found, Start
from jaxtube.qp.exchange import make_program
from jaxtube.qp.factors import Factors
from jaxtube.qp.fixed_point import TOLERANCE, Instances, Iterate
from jaxtube.qp.regions import Regions
from jaxtube.qp.rounds import play_rounds
from jaxtube.qp.source import (
    Solution,
    Source,
    as_solution,
    find_pending,
    is_excluded,
)
from jaxtube.qp.status import INFEASIBLE

MISSED = 1e-2
"""By how much the dual active-set method may miss a row, by the tolerance of the residual."""
MISSED_ROUNDING = 4
"""The same, by the rounding of a row's value."""

LANES = 16
"""Instances that a processor solves side by side by the dual active-set method: their matrices stay
in the first cache, and few wait for the last one."""


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
    size, _ = block_sizes(len(solution.x))
    if known is not None:

        def look_up(parameters, _):
            return look_up_block(factors, source, known, parameters)

        pending = find_pending(solution)
        solution = update_in_blocks(look_up, size, pending, source.data, solution)
    solution = _where_any(partial(search_active_sets, factors, source), solution)
    if factors.iterated is None:
        return solution
    rounds = partial(play_rounds, factors, factors.iterated, source)
    return _where_any(rounds, solution)


def _where_any(method: Callable[[Solution], Solution], solution: Solution) -> Solution:
    """Apply a method where any instance is pending."""
    is_any = jnp.any(find_pending(solution))
    return jax.lax.cond(is_any, method, lambda solution: solution, solution)


def look_up_block(
    factors: Factors, source: Source, known: Regions, parameters: Float[Array, "block 3"]
) -> Solution:
    """Return the answers of known regions, where they are answers."""
    block = source.form(parameters)
    x, y = regions.look_up(known, parameters, len(factors.rows))
    return as_solution(factors, Iterate(x, y, fixed_point.residual(factors, block, x, y)))


def answer_of(factors: Factors, block: Instances, y: Float[Array, "m block"]) -> Iterate:
    """Return what multipliers say of a block of instances."""
    x = product(factors.optimum, block.q + matmul(factors.rows.T, y))
    return Iterate(x, y, fixed_point.residual(factors, block, x, y))


def search_active_sets(factors: Factors, source: Source, solution: Solution) -> Solution:
    """Solve by the dual active-set method; refute what it says has no answer."""
    size, rare_size = block_sizes(len(solution.x))
    program = make_program(factors.whitened)
    load = partial(load_lanes, factors, source)
    pending = find_pending(solution)
    width = rare_size if on_accelerator() else LANES
    found = dual_active_set.find_active_sets(program, load, pending, width)
    data = (source.data, found)
    judge = partial(judge_block, factors, source)
    solution = update_in_blocks(judge, size, pending, data, solution)
    doubtful = found.is_ray & find_pending(solution)
    check = partial(check_rays, factors, source)
    return update_in_blocks(check, rare_size, doubtful, data, solution)


def load_lanes(factors: Factors, source: Source, places: Int[Array, " lanes"]) -> Start:
    """Return the instances at places in the batch as the dual active-set method wants them."""
    block = source.form(gather(places, source.data))
    z = product(factors.root, -block.q)
    bounds = jnp.concatenate([block.u, -block.l])
    eps = jnp.finfo(z.dtype).eps
    longest = jnp.sqrt(jnp.max(jnp.sum(factors.whitened**2, axis=1)))
    rounding = MISSED_ROUNDING * eps * longest * jnp.sqrt(jnp.sum(z * z, axis=0))
    tolerance = jnp.maximum(MISSED * TOLERANCE[z.dtype.itemsize], rounding)
    # Of data that are not numbers nothing is proved.
    return Start(z, bounds, jnp.where(jnp.isnan(bounds).any(axis=0), jnp.inf, tolerance))


def judge_block(
    factors: Factors, source: Source, data: tuple[PyTree, Found], _: Solution
) -> Solution:
    """Return what active sets say of a block of instances."""
    of_instances, found = data
    block = source.form(of_instances)
    is_guess = jnp.all(jnp.isfinite(found.multipliers), axis=1) & ~found.is_ray
    upper, lower = push_of(found, len(factors.rows))
    y = jnp.where(is_guess, upper - lower, 0.0)
    best = answer_of(factors, block, y)
    return as_solution(factors, best, fixed_point.has_crossing_bounds(block))


def check_rays(
    factors: Factors, source: Source, data: tuple[PyTree, Found], solution: Solution
) -> Solution:
    """Return a block of solutions, INFEASIBLE where the rays found are proofs of it."""
    of_instances, found = data
    block = source.form(of_instances)
    excluded = is_excluded(factors, block, *push_of(found, len(factors.rows)))
    return solution._replace(status=jnp.where(excluded, INFEASIBLE, solution.status))


def push_of(found: Found, m: int) -> tuple[Float[Array, "m block"], Float[Array, "m block"]]:
    """Return the multipliers y_u, y_l >= 0 of all rows."""
    lanes = len(found.rows)
    place = jnp.where(found.rows < 0, 2 * m, found.rows)
    signed = jnp.zeros((2 * m, lanes), found.multipliers.dtype)
    # With the lanes last, products of the result need no transposition.
    signed = signed.at[place, jnp.arange(lanes)[:, None]].set(found.multipliers, mode="drop")
    return signed[:m], signed[m:]
