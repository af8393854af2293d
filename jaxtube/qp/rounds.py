"""Rounds of iterations for the instances that the dual active-set method leaves, few if any:

    ADMM, then Newton steps;  a bold interior point method, then Newton steps;  a cautious one, then
    Newton steps;  the interior point method on the elastic problem.

Each takes what the ones before it left, keeps an instance's iterate of smallest residual, and
offers its multipliers as a proof of infeasibility.

A compiler takes longer for a round than these ever take to run, so rounds share what they can: the
interior point method solves

    minimise over x, t   1/2 x' P x + q' x + t^2/2   subject to   l <= A x <= u,  t >= -1

and the elastic problem (`farkas`) as programs of one shape, and one scan plays all rounds.
Source: as `solver`; the sharing is new.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import Array
from jaxtyping import Float, Int, PyTree

from jaxtube.qp import farkas, fixed_point, interior_point
from jaxtube.qp.batched_ldl import matmul
from jaxtube.qp.blocks import block_sizes, update_in_blocks
from jaxtube.qp.factors import Factors, Iterated
from jaxtube.qp.fixed_point import Instances, Iterate
from jaxtube.qp.interior_point import BOLD, CAUTIOUS, Caution, Program
from jaxtube.qp.source import (
    Solution,
    Source,
    as_iterate,
    as_solution,
    find_pending,
    is_excluded,
)

ITERATIONS = 30
"""Of ADMM."""
POLISH_STEPS = 4
"""Of Newton's method after it."""
INTERIOR_ITERATIONS = 60
RESCUE_STEPS = 64
"""Of Newton's method after the interior point: where a row misses its bound by 1e-8 they try
several active sets before they settle."""

Push = tuple[Float[Array, "n block"], Float[Array, "m block"], Float[Array, "m block"]]
"""x, and the multipliers y_u, y_l >= 0."""


class Means(NamedTuple):
    """What all instances share: the problem and the elastic one as programs in (x, t)."""

    iterated: Iterated
    problem: Program
    elastic: Program


class Round(NamedTuple):
    """What is iterated, and how it is polished."""

    is_split: Array | bool  # by ADMM, else by the interior point method
    is_elastic: Array | bool  # the elastic problem
    steps: Int[Array, "*rounds"] | int  # of Newton's method
    caution: Caution  # of the interior point method


ROUNDS = (
    Round(True, False, POLISH_STEPS, BOLD),
    Round(False, False, RESCUE_STEPS, BOLD),
    Round(False, False, RESCUE_STEPS, CAUTIOUS),
    Round(False, True, 0, BOLD),
)


def play_rounds(
    factors: Factors, iterated: Iterated, source: Source, solution: Solution
) -> Solution:
    """Return what the rounds make of the instances that are pending."""
    _, size = block_sizes(len(solution.x))
    means = make_means(factors, iterated)

    def play(solution: Solution, now: Round):
        def improve(data: PyTree, before: Solution) -> Solution:
            block = source.form(data)
            best = as_iterate(factors, before)
            x, upper, lower = jax.lax.cond(
                now.is_split, split, penetrate, factors, means, now, block, best
            )
            guess = (x, upper - lower)
            best = fixed_point.polish(factors, iterated, block, best, guess, now.steps)
            return as_solution(factors, best, is_excluded(factors, block, upper, lower))

        pending = find_pending(solution)
        return update_in_blocks(improve, size, pending, source.data, solution), None

    dtype = factors.rows.dtype
    rounds = jax.tree.map(lambda *each: _stack(each, dtype), *ROUNDS)
    return jax.lax.scan(play, solution, rounds)[0]


def _stack(each: tuple, dtype) -> Array:
    kinds = {bool: bool, int: jnp.int32, float: dtype}
    return jnp.array(each, kinds[type(each[0])])


def make_means(factors: Factors, iterated: Iterated) -> Means:
    """Return what the rounds share."""
    m, n = factors.rows.shape
    dtype = factors.rows.dtype
    elastic = farkas.elastic_program(factors.hessian, factors.rows)
    cost = jnp.zeros((n + 1, n + 1), dtype).at[:n, :n].set(factors.hessian).at[n, n].set(1.0)
    rows = elastic.rows.at[: 2 * m, n].set(0.0)
    return Means(iterated, interior_point.program(cost, rows), elastic)


def split(factors: Factors, means: Means, now: Round, block: Instances, best: Iterate) -> Push:
    """Iterate by ADMM from the unconstrained optimum."""
    x, y = fixed_point.admm(factors, means.iterated, block, block.optimum, ITERATIONS)
    return x, jnp.maximum(y, 0.0), jnp.maximum(-y, 0.0)


def penetrate(factors: Factors, means: Means, now: Round, block: Instances, best: Iterate) -> Push:
    """Iterate by the interior point method from the best x; the elastic problem leaves it."""
    m, n = factors.rows.shape

    def choose(of_problem, of_elastic):
        return jnp.where(now.is_elastic, of_elastic, of_problem)

    program = jax.tree.map(choose, means.problem, means.elastic)
    row_values = matmul(factors.rows, best.x)
    missed = jnp.max(jnp.maximum(row_values - block.u, block.l - row_values), axis=0)
    t = jnp.where(now.is_elastic, farkas.interior_t(missed), 0.0)
    one = jnp.where(now.is_elastic, 1.0, 0.0).astype(t.dtype)
    q = jnp.concatenate([(1 - one) * block.q, jnp.broadcast_to(one, (1, len(t)))])
    h = jnp.concatenate([block.u, -block.l, jnp.ones_like(block.u[:1])])
    begin = jnp.concatenate([best.x, t[None]])
    x, y = interior_point.solve(program, q, h, begin, INTERIOR_ITERATIONS, now.caution)
    x = jnp.where(now.is_elastic, best.x, x[:n])
    return x, y[:m], y[m : 2 * m]
