"""Solve some instances of a parametric quadratic program: batches whose numbers are affine in a few
parameters p of each instance.

    minimise over x   1/2 x' P x + (F p)' x   subject to   l <= R p + A x <= u

Those that are not wanted cost nothing, and q and bounds are formed for blocks of the others alone:
in a batch of which few rows are active nothing but p is as long as the batch.

Source: as `solver`; Bemporad, Morari, Dua, Pistikopoulos 2002, "The explicit linear quadratic
regulator for constrained systems", Automatica 38(1), for the form.
"""

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import Array
from jaxtyping import Bool, Float, Int

from jaxtube.qp import sensitivity
from jaxtube.qp.batched_ldl import matmul, product
from jaxtube.qp.blocks import block_sizes, update_in_blocks
from jaxtube.qp.factors import Factors
from jaxtube.qp.fixed_point import Instances, make_instances
from jaxtube.qp.regions import AnyArray, Regions
from jaxtube.qp.sensitivity import find_row_type
from jaxtube.qp.solver import find_rows_of_solved, finish, pull_back
from jaxtube.qp.source import Solution, Source
from jaxtube.qp.stages import look_up_block, solve_constrained
from jaxtube.qp.status import SOLVED, UNSOLVED


class Parametric(NamedTuple):
    """How q and the bounds depend on p."""

    linear: Float[AnyArray, "n k"]  # F
    rows: Float[AnyArray, "m k"]  # R
    lower: Float[AnyArray, " m"]  # l
    upper: Float[AnyArray, " m"]  # u


@jax.custom_vjp
def solve_parametric(
    factors: Factors,
    program: Parametric,
    parameters: Float[Array, "batch k"],
    is_wanted: Bool[Array, " batch"],
    known: Regions | None,
) -> Solution:
    """Solve the instances that are wanted.

    Args:
        factors: of P and A, by `factorise`.
        program: what makes instances of parameters.
        parameters: p of every instance.
        is_wanted: the instances to solve; the others' x is zero, and they are UNSOLVED.
        known: critical regions of the program. An answer found there is taken only if its residual
            would be accepted.

    Returns:
        As `solver.solve`, with its derivative; where that is taken, x and multipliers are zero
        wherever the status is not SOLVED. A wanted instance is solved as one that its unconstrained
        optimum does not solve.
    """
    batch = len(parameters)
    m, n = factors.rows.shape
    dtype = parameters.dtype
    is_sound = is_wanted & jnp.all(jnp.isfinite(parameters), axis=1)
    nothing = Solution(
        x=jnp.zeros((batch, n), dtype),
        multipliers=jnp.zeros((batch, m), dtype),
        status=jnp.full(batch, UNSOLVED, jnp.int32),
        residual=jnp.where(is_sound, 1.0, jnp.inf).astype(dtype),
    )
    source = make_source(factors, program, parameters)
    return finish(solve_constrained(factors, source, known, nothing))


def look_up(
    factors: Factors, program: Parametric, parameters: Float[Array, "batch k"], known: Regions
) -> Solution:
    """Return what known critical regions say of every instance: UNSOLVED where that is no
    answer."""
    source = make_source(factors, program, parameters)
    return finish(look_up_block(factors, source, known, parameters))


def make_source(
    factors: Factors, program: Parametric, parameters: Float[Array, "batch k"]
) -> Source:
    """Return the numbers of the instances, with rows of unit norm."""
    of_units = Parametric(program.linear, *(_of_units(factors, part) for part in program[1:]))
    return Source(parameters, partial(form_block, factors, of_units))


def _of_units(factors: Factors, array: Array) -> Array:
    """Return what belongs to the caller's rows, for those of unit norm."""
    norms = factors.row_norms
    return array / (norms if array.ndim == 1 else norms[:, None])


def form_block(
    factors: Factors, program: Parametric, parameters: Float[Array, "block k"]
) -> Instances:
    """Return the instances of a program of unit rows."""
    p = parameters.T
    shift = product(program.rows, p)
    lower = program.lower[:, None] - shift
    upper = program.upper[:, None] - shift
    return make_instances(factors, product(program.linear, p), lower, upper)


def form(
    program: Parametric, parameters: Float[Array, "batch k"]
) -> tuple[Float[Array, "batch n"], Float[Array, "batch m"], Float[Array, "batch m"]]:
    """Return q and the bounds of A x."""
    shift = matmul(parameters, program.rows.T)
    q = matmul(parameters, program.linear.T)
    return q, program.lower - shift, program.upper - shift


class Found(NamedTuple):
    """What reverse mode keeps of answers: they follow from it without a solver."""

    active: Int[Array, "batch n"]  # rows, as `sensitivity.find_active_rows`
    is_solved: Bool[Array, " batch"]


def find_rows(
    factors: Factors, program: Parametric, parameters: Float[Array, "batch k"], solution: Solution
) -> Found:
    """Return the active rows of solved instances."""
    source = make_source(factors, program, parameters)
    return Found(find_rows_of_solved(factors, source, solution), solution.status == SOLVED)


def find_nothing(factors: Factors, batch: int) -> Found:
    """Return what is found of instances none of which is solved."""
    m, n = factors.rows.shape
    active = jnp.full((batch, n), 2 * m, find_row_type(m))
    return Found(active, jnp.zeros(batch, bool))


@jax.custom_vjp
def recall(
    factors: Factors, program: Parametric, parameters: Float[Array, "batch k"], found: Found
) -> Solution:
    """Return the solved instances from their active rows, with their derivative; the others' x is
    zero, and they are UNSOLVED. Residuals, which have none, are zero."""
    source = make_source(factors, program, parameters)
    x, multipliers = answer_from_rows(factors, source, *found)
    status = jnp.where(found.is_solved, SOLVED, UNSOLVED).astype(jnp.int32)
    return Solution(x, multipliers, status, jnp.zeros_like(parameters[:, 0]))


def _recall_and_remember(factors, program, parameters, found) -> tuple[Solution, tuple]:
    solution = recall(factors, program, parameters, found)
    return solution, (factors, program, parameters, found.active, solution)


def _pull_back_recalled(saved: tuple, cotangent: Solution) -> tuple:
    return *_pull_back(saved, cotangent), None


recall.defvjp(_recall_and_remember, _pull_back_recalled)


def _solve_and_remember(factors, program, parameters, is_wanted, known) -> tuple[Solution, tuple]:
    solution = solve_parametric(factors, program, parameters, is_wanted, known)
    found = find_rows(factors, program, parameters, solution)
    recalled = recall(factors, program, parameters, found)
    solution = solution._replace(x=recalled.x, multipliers=recalled.multipliers)
    return solution, (factors, program, parameters, found.active, solution)


def answer_from_rows(
    factors: Factors,
    source: Source,
    active: Int[Array, "batch n"],
    is_solved: Bool[Array, " batch"],
) -> tuple[Float[Array, "batch n"], Float[Array, "batch m"]]:
    """Return x and multipliers of solved instances from their active rows; zero for the others."""

    def answer(data, _):
        of_instances, active = data
        block = source.form(of_instances)
        bounds = jnp.concatenate([block.u, block.l])
        b = jnp.take_along_axis(bounds, active.T, axis=0, mode="fill", fill_value=0.0)
        x, of_rows = sensitivity.minimise_on_rows(factors, active.T, block.q, b)
        upper, lower = sensitivity.spread(factors, active.T, of_rows)
        return x.T, (upper + lower).T / factors.row_norms

    batch, n = active.shape
    m, _ = factors.rows.shape
    dtype = factors.rows.dtype
    nothing = (jnp.zeros((batch, n), dtype), jnp.zeros((batch, m), dtype))
    size, _ = block_sizes(batch)
    return update_in_blocks(answer, size, is_solved, (source.data, active), nothing)


def _pull_back(saved: tuple, cotangent: Solution) -> tuple:
    """Return the cotangents of the factors, the program and the parameters."""
    factors, program, parameters, active, solution = saved
    _, pull = jax.vjp(form, program, parameters)
    of_factors, *of_instances = pull_back((factors, solution, active), cotangent)
    return of_factors, *pull(tuple(of_instances))


def _pull_back_solved(saved: tuple, cotangent: Solution) -> tuple:
    return *_pull_back(saved, cotangent), None, None


solve_parametric.defvjp(_solve_and_remember, _pull_back_solved)
