# ruff: noqa: E741 -- l and u are the letters of the problem
"""Prove that l <= A x <= u has no solution, for a batch of bounds l, u and one A with rows of unit
2-norm.

(1) Elastic problem: minimise t subject to l - t <= A x <= u + t and t >= -1; `rounds` solves it. It
    always has interior points, so that the interior point method is safe; where its optimum is
    positive its multipliers y_u, y_l >= 0 add up to one.
(2) Check, whatever (1) returned: every x inside the bounds has l'y_l - u'y_u <= -g'x with g =
    A'(y_u - y_l), and x'H x <= S, where H = sum_i a_i a_i' / (1 + max(l_i^2, u_i^2)) + I / X^2 over
    the rows with two finite bounds and S = their number + 1. So there is none if l'y_l - u'y_u >
    sqrt(S g' H^-1 g).

The proof excludes every x with |x|_2 <= X. Where the two-sided rows bound x by themselves this is
no restriction. Source: Boyd and Vandenberghe, Convex Optimization 2004, sections 5.8 (alternatives)
and 11.4 (phase I).
"""

import jax.numpy as jnp
from jax import Array
from jaxtyping import Bool, Float

from jaxtube.qp import batched_ldl, interior_point
from jaxtube.qp.batched_ldl import matmul

LARGEST_NORM = {8: 1e6, 4: 1e2}
"""X, by bytes of a float: I / X^2 must stay above the rounding of H."""


def elastic_program(
    hessian: Float[Array, "n n"], rows: Float[Array, "m n"]
) -> interior_point.Program:
    """Return problem (1) in (x, t); a very small multiple of `hessian` as its cost makes the answer
    unique."""
    m, n = rows.shape
    dtype = rows.dtype
    cost_of_x = jnp.finfo(dtype).eps ** 0.66 * hessian / jnp.max(jnp.abs(hessian))
    cost = jnp.zeros((n + 1, n + 1), dtype).at[:n, :n].set(cost_of_x)
    of_x = jnp.concatenate([rows, -rows, jnp.zeros((1, n), dtype)])
    of_t = -jnp.ones((2 * m + 1, 1), dtype)
    return interior_point.program(cost, jnp.concatenate([of_x, of_t], axis=1))


def interior_t(missed: Float[Array, " batch"]) -> Float[Array, " batch"]:
    """Return a t well inside problem (1), `missed` being the most by which x misses a bound."""
    return jnp.maximum(missed, 0.0) + 1.0


def excludes(
    rows: Float[Array, "m n"],
    l: Float[Array, "m batch"],
    u: Float[Array, "m batch"],
    upper: Float[Array, "m batch"],
    lower: Float[Array, "m batch"],
    tolerance: float,
) -> Bool[Array, " batch"]:
    """Return whether (2) proves that no x meets the bounds.

    Args:
        rows: A.
        l: lower bounds.
        u: upper bounds.
        upper: y_u >= 0, to any common scale.
        lower: y_l >= 0, to the same scale.
        tolerance: what the proof must exceed, relative to its terms; far above rounding.
    """
    size = jnp.sum(upper + lower, axis=0)
    upper = upper / size
    lower = lower / size
    g = matmul(rows.T, upper - lower)
    largest, is_positive = largest_product(rows, l, u, g)
    from_below = jnp.where(lower > 0, lower * l, 0.0)
    from_above = jnp.where(upper > 0, upper * u, 0.0)
    terms = jnp.sum(jnp.abs(from_below) + jnp.abs(from_above), axis=0)
    margin = tolerance * jnp.maximum(1.0, terms)
    return is_positive & (jnp.sum(from_below - from_above, axis=0) > largest + margin)


def largest_product(
    rows: Float[Array, "m n"],
    l: Float[Array, "m batch"],
    u: Float[Array, "m batch"],
    g: Float[Array, "n batch"],
) -> tuple[Float[Array, " batch"], Bool[Array, " batch"]]:
    """Return sqrt(S g' H^-1 g), which |g'x| cannot exceed within the bounds, and whether H is
    positive definite to rounding."""
    n = rows.shape[1]
    identity = jnp.eye(n, dtype=rows.dtype) / LARGEST_NORM[rows.dtype.itemsize] ** 2
    two_sided = jnp.isfinite(l) & jnp.isfinite(u)
    weights = jnp.where(two_sided, 1 / (1 + jnp.maximum(l * l, u * u)), 0.0)
    products = matmul(batched_ldl.pair_products(rows), weights)
    ldl = batched_ldl.factorise(batched_ldl.pack(identity)[:, None] + products)
    length = jnp.sum(g * batched_ldl.solve(ldl, g), axis=0)
    S = 1 + jnp.sum(two_sided, axis=0).astype(g.dtype)
    return jnp.sqrt(S * jnp.maximum(length, 0.0)), jnp.all(ldl.inverse_pivots > 0, axis=0)
