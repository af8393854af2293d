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

import functools
import operator
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Float, Int

from jaxtube.qp.blocks import on_accelerator

FEW_TERMS = 5
"""Terms up to which an accelerator adds up a product by itself."""

SHORT = 16
"""Terms up to which the product with a batch of vectors is written out."""


def matmul(one: Float[Array, "*stack m k"], other: Float[Array, "*stack k n"]):
    """Return the product of matrices in full precision.

    Accelerators round the factors of a product to fewer bits unless told not to; an error of 1e-2
    would follow here. There a product of few terms is written out: it then joins the kernel of what
    is done to it next, and a batch of results that only their extremes are asked of is never
    stored.
    """
    terms = other.shape[-2]
    if terms > FEW_TERMS or not on_accelerator():
        return jnp.matmul(one, other, precision=jax.lax.Precision.HIGHEST)
    return add_up([one[..., :, k, None] * other[..., None, k, :] for k in range(terms)])


def product(matrix: Float[Array, "m k"], vectors: Float[Array, "k batch"]):
    """Return the product of a matrix with a batch of vectors, the batch last.

    Where these are short it is written out, as a loop over the batch that joins what is done to it
    next; a product by itself would be stored.
    """
    terms = matrix.shape[1]
    if terms > SHORT:
        return matmul(matrix, vectors)
    return add_up([matrix[:, k, None] * vectors[k] for k in range(terms)])


def add_up(terms: list[Array]) -> Array:
    """Return a sum, written out."""
    return functools.reduce(operator.add, terms)


class LDL(NamedTuple):
    """Factors of a batch of matrices: columns[k] is column k of L without its unit diagonal, and
    the inverse of D."""

    columns: Float[Array, "n n batch"]
    inverse_pivots: Float[Array, "n batch"]


def pack(matrix: Float[Array, "*stack n n"]) -> Float[Array, "*stack pairs"]:
    """Return a symmetric matrix, numpy or jax, packed."""
    first, second = np.triu_indices(matrix.shape[-1])
    return matrix[..., first, second]


def pair_products(rows: Float[Array, "*stack m n"]) -> Float[Array, "*stack pairs m"]:
    """Return the constant matrix that maps weights d to the packed A' diag(d) A, A being `rows`,
    numpy or jax."""
    first, second = np.triu_indices(rows.shape[-1])
    columns = rows.swapaxes(-1, -2)
    return columns[..., first, :] * columns[..., second, :]


def factorise(packed: Float[Array, "pairs batch"]) -> LDL:
    """Return the factors of packed positive definite matrices; a pivot that rounding spoilt (not >
    0) gives a zero in x."""
    position = unpacking(packed.shape[0])
    n = len(position)
    index = np.arange(n)
    below = index[:, None]

    def eliminate(k, s):
        row = jax.lax.dynamic_index_in_dim(s, k, 0, keepdims=False)
        # Equal to `row` by symmetry, read as a column all the same: the loop then vectorises, three
        # times as fast.
        column = jax.lax.dynamic_index_in_dim(s, k, 1, keepdims=False)
        multiplier = jnp.where(below > k, column / row[k], 0.0)
        return s - multiplier[:, None] * row[None]

    upper = jax.lax.fori_loop(0, n, eliminate, packed[position], unroll=on_accelerator())
    pivots = upper[index, index]
    inverse_pivots = jnp.where(pivots > 0, 1 / pivots, 0.0)
    strictly_upper = np.triu(np.ones((n, n), bool), 1)[..., None]
    columns = jnp.where(strictly_upper, upper * inverse_pivots[:, None], 0.0)
    return LDL(columns, inverse_pivots)


def unpacking(pairs: int) -> Int[np.ndarray, "n n"]:
    """Return where each entry of a symmetric matrix stands in its packed form."""
    n = round((2 * pairs + 0.25) ** 0.5 - 0.5)
    first, second = np.triu_indices(n)
    position = np.zeros((n, n), int)
    position[first, second] = np.arange(pairs)
    position[second, first] = np.arange(pairs)
    return position


def solve(ldl: LDL, right: Float[Array, "n batch"]) -> Float[Array, "n batch"]:
    """Return the answers of a factorised batch of systems."""
    n = right.shape[0]
    columns, inverse_pivots = ldl

    def forward(k, x):
        return x - columns[k] * x[k]

    def backward(j, x):
        k = n - 1 - j
        return x.at[k].add(-jnp.sum(columns[k] * x, axis=0))

    scaled = jax.lax.fori_loop(0, n, forward, right, unroll=on_accelerator()) * inverse_pivots
    return jax.lax.fori_loop(0, n, backward, scaled, unroll=on_accelerator())
