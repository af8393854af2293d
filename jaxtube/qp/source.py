"""What the stages of the solver pass on: the answers so far, and where the numbers of the instances
come from, so that they are formed when a block is worked on.

Source: new; notation of `solver`.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax.numpy as jnp
from jax import Array
from jaxtyping import Bool, Float, Int, PyTree

from jaxtube.qp import farkas
from jaxtube.qp.factors import Factors
from jaxtube.qp.fixed_point import TOLERANCE, Instances, Iterate
from jaxtube.qp.status import INFEASIBLE, SOLVED, UNSOLVED


class Solution(NamedTuple):
    """Answer of every instance: x and multipliers are finite always, and to be trusted where status
    == SOLVED."""

    x: Float[Array, "batch n"]
    multipliers: Float[Array, "batch m"]
    status: Int[Array, " batch"]
    residual: Float[Array, " batch"]


class Source(NamedTuple):
    """The numbers of the instances: arrays with the batch as leading axis, and what makes instances
    of some rows of them."""

    data: PyTree
    form: Callable[[Any], Instances]


def find_pending(solution: Solution) -> Bool[Array, " batch"]:
    """Return which instances are to be solved: neither solved nor refuted, and their data are
    numbers."""
    return (solution.status == UNSOLVED) & jnp.isfinite(solution.residual)


def as_iterate(factors: Factors, solution: Solution) -> Iterate:
    """Return the answers of a block as iterates."""
    y = (solution.multipliers * factors.row_norms).T
    return Iterate(solution.x.T, y, solution.residual)


def as_solution(
    factors: Factors, best: Iterate, infeasible: Bool[Array, " block"] | bool = False
) -> Solution:
    """Return iterates with the status that their residuals, or a proof, give them."""
    tolerance = TOLERANCE[best.x.dtype.itemsize]
    otherwise = jnp.where(infeasible, INFEASIBLE, UNSOLVED)
    status = jnp.where(best.residual <= tolerance, SOLVED, otherwise)
    multipliers = best.y.T / factors.row_norms
    return Solution(best.x.T, multipliers, status.astype(jnp.int32), best.residual)


def is_excluded(
    factors: Factors,
    block: Instances,
    upper: Float[Array, "m batch"],
    lower: Float[Array, "m batch"],
) -> Bool[Array, " batch"]:
    """Return which instances the multipliers y_u, y_l prove infeasible."""
    tolerance = TOLERANCE[block.q.dtype.itemsize]
    return farkas.excludes(factors.rows, block.l, block.u, upper, lower, tolerance)
