"""Solve (C + A' diag(d_b) A) x_b = r_b for a batch of positive weights d_b and right hand sides
r_b.

C (symmetric positive definite) and A are shared by the batch, so the lower triangles of all its
matrices are one product of a constant matrix, the columns of A multiplied in pairs, with the
weights. The factorisation L D L' runs over the columns; the batch is the last axis, so that every
operation is a long loop over neighbouring numbers.

Notation: a symmetric matrix is packed row by row of its upper triangle, (0,0), (0,1), ..., (0,n-1),
(1,1), ...; pairs = n (n+1) / 2. Source: Golub and Van Loan, Matrix Computations, 4th edition 2013,
section 4.1.
"""

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Float

# Accelerators round the factors of a product to fewer bits unless told not to; an error of 1e-2
# would follow here.
matmul = partial(jnp.matmul, precision=jax.lax.Precision.HIGHEST)


class LDL(NamedTuple):
    """Factors of a batch of matrices: columns[k] is column k of L without its unit diagonal, and
    the inverse of D."""

    columns: Float[Array, "n n batch"]
    inverse_pivots: Float[Array, "n batch"]


def pack(matrix: Float[Array, "n n"]) -> Float[Array, " pairs"]:
    """Pack a symmetric matrix."""
    return matrix[np.triu_indices(matrix.shape[0])]


def pair_products(rows: Float[Array, "m n"]) -> Float[Array, "pairs m"]:
    """Return the constant matrix that maps weights d to the packed A' diag(d) A, A being `rows`."""
    first, second = np.triu_indices(rows.shape[1])
    return (rows[:, first] * rows[:, second]).T


def factorise(packed: Float[Array, "pairs batch"]) -> LDL:
    """Factorise packed positive definite matrices; a pivot that rounding spoilt (not > 0) gives a
    zero in x instead."""
    n = round((2 * packed.shape[0] + 0.25) ** 0.5 - 0.5)
    first, second = np.triu_indices(n)
    position = np.zeros((n, n), int)
    position[first, second] = position[second, first] = np.arange(first.size)
    below = np.arange(n)[:, None]

    def eliminate(k, s):
        row = jax.lax.dynamic_index_in_dim(s, k, 0, keepdims=False)
        # Equal to `row` by symmetry, read as a column all the same: the loop then vectorises, three
        # times as fast.
        column = jax.lax.dynamic_index_in_dim(s, k, 1, keepdims=False)
        multiplier = jnp.where(below > k, column / row[k], 0.0)
        return s - multiplier[:, None] * row[None]

    upper = jax.lax.fori_loop(0, n, eliminate, packed[position])
    pivots = upper[np.arange(n), np.arange(n)]
    inverse_pivots = jnp.where(pivots > 0, 1 / pivots, 0.0)
    strictly_upper = np.triu(np.ones((n, n), bool), 1)[..., None]
    return LDL(jnp.where(strictly_upper, upper * inverse_pivots[:, None], 0.0), inverse_pivots)


def solve(ldl: LDL, right: Float[Array, "n batch"]) -> Float[Array, "n batch"]:
    """Solve a factorised batch of systems."""
    n = right.shape[0]
    columns, inverse_pivots = ldl

    def forward(k, x):
        return x - columns[k] * x[k]

    def backward(j, x):
        k = n - 1 - j
        return x.at[k].add(-jnp.sum(columns[k] * x, axis=0))

    return jax.lax.fori_loop(
        0, n, backward, jax.lax.fori_loop(0, n, forward, right) * inverse_pivots
    )
