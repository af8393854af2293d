"""Plans of the tube-MPC: one condensed QP per instance, with matrices shared along the reference.

    min_g  sum_{j<N} e_j^T Q e_j + g_j^T R g_j + e_N^T P e_N
    s.t.   e_{j+1} = A(th_{k+j}) e_j + B g_j,   e_j in E_j,   g_j in U_j,   e_N in Omega_N

While no row is active the optimum is linear, g = G e, and so is what the rows see of it: a batch
that meets all its bounds this way is answered without a solver. Only the others go to the
solver, with the critical regions that laps are known to meet (`synthesis.regions`).

Source: Gonzalez, Fiacchini, Guzman, Alamo 2009, eqs. (12)-(15) and (31), condensed.
"""

from __future__ import annotations

import functools
import operator
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import Array
from jaxtyping import Bool, Float, Int

from jaxtube import qp
from jaxtube.columns import MOST
from jaxtube.qp.batched_ldl import add_up, matmul
from jaxtube.qp.parametric import Parametric, look_up, solve_parametric
from jaxtube.qp.regions import AnyArray, Regions


class HalfSpaces(NamedTuple):
    """Errors e with normals e <= offsets."""

    normals: Float[AnyArray, "k 3"]
    offsets: Float[AnyArray, " k"]  # infinite for a row that is only padding


class CondensedQp(NamedTuple):
    """The QP of one window of the reference, condensed: all that the controller knows of what lies
    ahead. A stack of them has a leading axis over the distinct windows.

    Rows that no input reaches are kept apart as `check_*`: they only say whether the present error
    is admissible.
    """

    factors: qp.Factors
    linear: Float[AnyArray, "n 3"]  # q = linear e
    cost_unit: Float[AnyArray, ""]  # what the QP's cost is divided by
    row_errors: Float[AnyArray, "m 3"]  # lower <= row_errors e + rows g <= upper
    lower: Float[AnyArray, " m"]
    upper: Float[AnyArray, " m"]
    check_errors: Float[AnyArray, "c 3"]
    check_lower: Float[AnyArray, " c"]
    check_upper: Float[AnyArray, " c"]
    free_inputs: Float[AnyArray, "n 3"]  # G: without constraints g = G e
    free_rows: Float[AnyArray, "m 3"]  # row_errors + rows G
    free_scale: Float[AnyArray, ""]  # of rounding in H G e + F e: |H| |G| + |F|, row sum
    tube_gain: Float[AnyArray, "2 3"]  # K(th_k)
    terminal_gain: Float[AnyArray, "2 3"]  # Gamma(th_k)
    transition: Float[AnyArray, "3 3"]  # A(th_k)
    input_matrix: Float[AnyArray, "3 2"]  # B(th_k)
    regions: Regions | None = None  # of e, that are known beforehand
    # Errors whose plan without constraints is the plan, by the rows that bound them; None where all
    # rows are to be tested.
    free_region: HalfSpaces | None = None

    @property
    def inputs(self) -> int:
        """How many inputs a period has."""
        return self.input_matrix.shape[-1]

    @property
    def parametric(self) -> Parametric:
        """The QP as one of parameters e."""
        return Parametric(self.linear, self.row_errors, self.lower, self.upper)


class Plan(NamedTuple):
    """Inputs g_0 .. g_{N-1} of every instance, and the outcome of its QP."""

    inputs: Float[Array, "batch horizon 2"]
    status: Int[Array, " batch"]  # qp.SOLVED where there is a plan
    residual: Float[Array, " batch"]
    active: Bool[Array, " batch"]


def plan(condensed: CondensedQp, errors: Float[Array, "batch 3"]) -> Plan:
    """Solve the QP of every instance from its own error.

    Args:
        condensed: one QP (no leading axis).
        errors: start of each prediction, (m, m, rad).

    Returns:
        The plans. An instance has one where it is solved and the rows that no input reaches hold to
        the solver's tolerance. Its `residual` is that of the optimality conditions, or a bound on
        it.
    """
    return jax.lax.cond(
        are_all_free(condensed, errors), free_plan, constrained_plan, condensed, errors
    )


def are_all_free(condensed: CondensedQp, errors: Float[Array, "batch 3"]) -> Bool[Array, ""]:
    """Return whether the plan without constraints is that of every instance; only the extremes of
    each row over the batch are compared."""
    region = condensed.free_region
    if region is not None:
        return jnp.all(_is_within(region, errors))
    check_lower, check_upper = _check_bounds(condensed, errors)
    plans_fit = _extremes_fit(condensed.lower, condensed.free_rows, errors, condensed.upper)
    errors_fit = _extremes_fit(check_lower, condensed.check_errors, errors, check_upper)
    return plans_fit & errors_fit


def _is_within(region: HalfSpaces, errors: Float[Array, "batch 3"]) -> Bool[Array, " batch"]:
    """Return which errors lie within; written out, for one kernel."""
    within = [
        sum(region.normals[row, i] * errors[:, i] for i in range(errors.shape[1]))
        <= region.offsets[row]
        for row in range(len(region.offsets))
    ]
    return functools.reduce(operator.and_, within)


def _extremes_fit(
    lower: Float[Array, " m"],
    rows: Float[AnyArray, "m 3"],
    errors: Float[Array, "batch 3"],
    upper: Float[Array, " m"],
) -> Bool[Array, ""]:
    values = matmul(rows, errors.T)
    return jnp.all(lower <= values.min(axis=1)) & jnp.all(values.max(axis=1) <= upper)


def is_free(condensed: CondensedQp, errors: Float[Array, "batch 3"]) -> Bool[Array, " batch"]:
    """Return which instances the plan without constraints serves, were their errors admissible; no
    other ones where the region of such errors is known."""
    region = condensed.free_region
    if region is not None:
        return _is_within(region, errors)
    values = image(condensed.free_rows, errors)
    return jnp.all((condensed.lower <= values) & (values <= condensed.upper), axis=1)


def _is_admissible(
    condensed: CondensedQp, errors: Float[Array, "batch 3"]
) -> Bool[Array, " batch"]:
    """Return which errors meet the rows that no input reaches."""
    lower, upper = _check_bounds(condensed, errors)
    values = image(condensed.check_errors, errors)
    return jnp.all((lower <= values) & (values <= upper), axis=1)


def _check_bounds(
    condensed: CondensedQp, errors: Float[Array, "batch 3"]
) -> tuple[Float[Array, " c"], Float[Array, " c"]]:
    """Return the bounds of the rows that no input reaches, widened to be as exact as the rows of
    the QP: what an admissible plan meets with equality, it meets to rounding when shifted."""
    slack = qp.TOLERANCE[errors.dtype.itemsize]
    return condensed.check_lower - slack, condensed.check_upper + slack


@jax.custom_vjp
def image(
    matrix: Float[AnyArray, "m n"], vectors: Float[Array, "batch n"]
) -> Float[Array, "batch m"]:
    """Return matrix @ vector of every instance as a sum over few columns, which fuses with what is
    done to it next."""
    columns = jnp.unstack(vectors, axis=1)
    if 0 < len(matrix) <= MOST:
        return jnp.stack([_weigh(row, columns) for row in jnp.unstack(matrix)], axis=1)
    terms = [column[:, None] * matrix[:, i] for i, column in enumerate(columns)]
    return functools.reduce(operator.add, terms)


def _weigh(weights: Float[Array, " n"], columns: tuple[Float[Array, " batch"], ...]):
    """Return the weighted sum of columns."""
    return add_up([weights[i] * column for i, column in enumerate(columns)])


def _image_and_arguments(matrix, vectors) -> tuple[Array, tuple[Array, Array]]:
    return image(matrix, vectors), (matrix, vectors)


def _pull_image_back(saved: tuple[Array, Array], cotangent: Array) -> tuple[Array, Array]:
    """Return the cotangents as products: those of the sum over columns pass over the batch once for
    each entry."""
    matrix, vectors = saved

    def pull(cotangent):
        return matmul(cotangent.T, vectors), image(matrix.T, cotangent)

    def pull_nothing(cotangent):
        return jnp.zeros_like(matrix), jnp.zeros_like(vectors)

    if len(matrix) <= MOST:
        return pull(cotangent)
    # Nothing comes back from most plans but what is due of them.
    return jax.lax.cond(jnp.any(cotangent != 0), pull, pull_nothing, cotangent)


image.defvjp(_image_and_arguments, _pull_image_back)


def free_plan(condensed: CondensedQp, errors: Float[Array, "batch 3"]) -> Plan:
    """Return the plans without constraints: the answer of every instance that meets all of them
    this way."""
    batch = len(errors)
    inputs = image(condensed.free_inputs, errors)
    rounding = (inputs.shape[1] + 5) * jnp.finfo(errors.dtype).eps * condensed.free_scale
    residual = rounding * jnp.max(jnp.abs(errors), axis=1)
    solved = jnp.full(batch, qp.SOLVED, jnp.int32)
    plans = inputs.reshape(batch, -1, condensed.inputs)
    return Plan(plans, solved, residual, jnp.zeros(batch, bool))


@jax.jit  # long to trace, and asked for in several places of a program
def constrained_plan(condensed: CondensedQp, errors: Float[Array, "batch 3"]) -> Plan:
    """Return the plans of a batch of which some instance needs the solver; those with a free plan
    are not handed to it."""
    # An instance with a free plan takes it even here: its plan must not depend on the others.
    free = is_free(condensed, errors)
    return choose_plan(condensed, errors, free, solve_some(condensed, errors, ~free))


def known_plan(condensed: CondensedQp, errors: Float[Array, "batch 3"]) -> Plan:
    """Return the plans of a batch as far as no solver is needed: free ones and those of the regions
    that the QP has; UNSOLVED elsewhere.

    Raises:
        ValueError: where the QP has no regions.
    """
    known = condensed.regions
    if known is None:
        raise ValueError("regions = None: the QP has none; ask for `free_plan`")
    free = is_free(condensed, errors)
    solution = look_up(condensed.factors, condensed.parametric, errors, known)
    return choose_plan(condensed, errors, free, solution)


def solve_some(
    condensed: CondensedQp, errors: Float[Array, "batch 3"], is_wanted: Bool[Array, " batch"]
) -> qp.Solution:
    """Return the plans that are wanted, as answers of the QP."""
    return solve_parametric(
        condensed.factors, condensed.parametric, errors, is_wanted, condensed.regions
    )


def choose_plan(
    condensed: CondensedQp,
    errors: Float[Array, "batch 3"],
    free: Bool[Array, " batch"],
    solution: qp.Solution,
) -> Plan:
    """Return the free plan where it serves, and what a solver says elsewhere, if the error is
    admissible."""
    active = (solution.status == qp.SOLVED) & jnp.any(jnp.abs(solution.multipliers) > 0, axis=1)
    inputs = solution.x.reshape(len(errors), -1, condensed.inputs)
    solved = Plan(inputs, solution.status, solution.residual, active)
    plan = select(free, free_plan(condensed, errors), solved)
    # Data that are not numbers are no proof of anything; their residual is infinite.
    excluded = ~_is_admissible(condensed, errors) & jnp.isfinite(plan.residual)
    status = jnp.where(excluded, qp.INFEASIBLE, plan.status)
    return plan._replace(status=status, active=plan.active & ~excluded)


def select(first_where: Bool[Array, " batch"], first: Any, second: Any) -> Any:
    """Return, instance by instance, the first pytree or the second."""

    def select(a, b):
        condition = jnp.expand_dims(first_where, tuple(range(1, a.ndim)))
        return jnp.where(condition, a, b)

    return jax.tree.map(select, first, second)


def predict(
    condensed: CondensedQp, nominal: Float[Array, "batch 3"], inputs: Float[Array, "batch 2"]
) -> Float[Array, "batch 3"]:
    """Return A e + B g, the nominal error one step ahead."""
    return image(condensed.transition, nominal) + image(condensed.input_matrix, inputs)


def take_qp(qps: CondensedQp, index: Int[Array, ""] | int) -> CondensedQp:
    """Return the QP of one window."""
    regions = qps.regions
    of_window = jax.tree.map(lambda array: array[index], qps._replace(regions=None))
    # The regions of all windows stay where they are: a copy of those of one takes longer than to
    # look some errors up in them.
    return of_window._replace(regions=None if regions is None else regions.take(index))
