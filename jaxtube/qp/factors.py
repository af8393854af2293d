"""Factors: what a batch of quadratic programs shares, prepared once. P, the rows of A scaled to
unit norm, and what makes the iterations fast.

    K = (P + rho A' A)^-1,    rho = 2 / sqrt(least * largest nonzero eigenvalue of A P^-1 A')

The formulas are written once, for numpy off line and for jax where P and A are differentiated.

Source: rho of the fastest guaranteed rate of ADMM: Giselsson and Boyd, IEEE Transactions on
Automatic Control 2017.
"""

from functools import partial
from types import ModuleType
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.custom_batching import sequential_vmap
from jaxtyping import Float

from jaxtube.qp import batched_ldl


class Iterated(NamedTuple):
    """What the rounds of iterations need, those of the solver's last stage."""

    admm_gain: Float[Array, "*stack n n"]  # K
    packed_hessian: Float[Array, "*stack pairs"]
    pair_products: Float[Array, "*stack pairs m"]


class Factors(NamedTuple):
    """Everything that a batch shares."""

    hessian: Float[Array, "*stack n n"]
    rows: Float[Array, "*stack m n"]  # unit 2-norm, or zero
    row_norms: Float[Array, "*stack m"]
    optimum: Float[Array, "*stack n n"]  # without constraints x = q @ optimum
    optimum_rows: Float[Array, "*stack n m"]  # and A x = q @ optimum_rows, in the caller's scaling
    root: Float[Array, "*stack n n"]  # S, the inverse of the Cholesky factor of P: S P S' = I
    whitened: Float[Array, "*stack m n"]  # rows S': those of S'^-1 x, whose cost is round
    rho: Float[Array, "*stack"]
    # None: a program without the rounds, which take most of the time to compile and hardly ever
    # run. What the dual active-set method leaves stays UNSOLVED.
    iterated: Iterated | None


def factorise(
    P: Float[Array, "*stack n n"], A: Float[Array, "*stack m n"], xp: ModuleType = jnp
) -> Factors:
    """Prepare what the batch shares, once.

    Args:
        P: symmetric positive definite.
        A: rows; one shorter than 64 eps of the longest counts as zero: it only tests whether 0 is
            in [l, u].
        xp: `jax.numpy`, or `numpy` off line, which needs no compilation. Leading axes are those of
            a stack of programs.

    Returns:
        The factors, differentiable in what the answers depend on: `hessian`, `rows` and
        `row_norms`. The others make the solver fast; their derivative is zero.

    Raises:
        ValueError: where shapes do not fit.
        numpy.linalg.LinAlgError: from numpy, where P is not positive definite. With jax every
            answer is then UNSOLVED.
    """
    if P.ndim < 2 or A.ndim < 2 or P.shape[-2:] != (A.shape[-1],) * 2 or not A.shape[-2]:
        raise ValueError(
            f"P, A: shapes {P.shape} and {A.shape}; give (n, n) and (m, n), m >= 1 (one zero row "
            "will do)"
        )
    rows, norms = normalise_rows(A, xp)
    if xp is np:
        parts = compute_accelerators(np, P, rows, norms)
    else:
        parts = accelerators_in_turn(*jax.lax.stop_gradient((P, rows, norms)))
    optimum, optimum_rows, root, whitened, rho, *of_rounds = parts
    iterated = Iterated(*of_rounds)
    return Factors(P, rows, norms, optimum, optimum_rows, root, whitened, rho, iterated)


def normalise_rows(
    A: Float[Array, "*stack m n"], xp: ModuleType
) -> tuple[Float[Array, "*stack m n"], Float[Array, "*stack m"]]:
    """Return the rows scaled to unit 2-norm, or zero, and the norms, 1 where the row is zero."""
    lengths = xp.linalg.norm(A if xp is np else jax.lax.stop_gradient(A), axis=-1)
    smallest = 64 * xp.finfo(A.dtype).eps * xp.max(lengths, axis=-1, keepdims=True)
    is_zero = lengths <= smallest
    # The norm of a zero row has no derivative: the row is replaced before, not only after.
    nonzero = xp.where(is_zero[..., None], 1.0, A)
    norms = xp.where(is_zero, 1.0, xp.linalg.norm(nonzero, axis=-1))
    return xp.where(is_zero[..., None], 0.0, A / norms[..., None]), norms


def compute_accelerators(
    xp: ModuleType,
    P: Float[Array, "*stack n n"],
    rows: Float[Array, "*stack m n"],
    norms: Float[Array, "*stack m"],
) -> tuple[Array, ...]:
    """Return what makes the solver fast and leaves its answers as they are: the fields of `Factors`
    from `optimum` to `rho`, then those of `Iterated`."""
    with jax.default_matmul_precision("highest"):
        columns = xp.swapaxes(rows, -1, -2)
        gram = columns @ rows
        root = xp.linalg.inv(xp.linalg.cholesky(P))
        root_transposed = xp.swapaxes(root, -1, -2)
        optimum = -(root_transposed @ root)
        optimum_rows = (optimum @ columns) * norms[..., None, :]
        # The nonzero part of this spectrum is that of A P^-1 A'.
        spectrum = xp.linalg.eigvalsh(root @ gram @ root_transposed)
        rho = fastest_penalty(spectrum, rows.shape[-2], xp)
        admm_gain = xp.linalg.inv(P + rho[..., None, None] * gram)
        whitened = rows @ root_transposed
    packed_hessian = batched_ldl.pack(P)
    pair_products = batched_ldl.pair_products(rows)
    accelerators = (optimum, optimum_rows, root, whitened, rho)
    return (*accelerators, admm_gain, packed_hessian, pair_products)


accelerators_in_turn = jnp.vectorize(
    sequential_vmap(partial(compute_accelerators, jnp)),
    signature="(n,n),(m,n),(m)->(n,n),(n,m),(n,n),(m,n),(),(n,n),(p),(p,m)",
)
"""`compute_accelerators` of a stack under jax, one program after the other, under `vmap` too.

Two batched LAPACK calls of one compiled program may wait for each other for ever where XLA has a
pool of two threads (jaxlib 0.10): no call here has a batch.
"""


def fastest_penalty(
    spectrum: Float[Array, "*stack n"], rank: int, xp: ModuleType
) -> Float[Array, "*stack"]:
    """Return the rho of the fastest guaranteed rate of ADMM.

    Args:
        spectrum: eigenvalues in ascending order, the nonzero ones those of A P^-1 A'.
        rank: of A at most.
        xp: namespace of the arrays.
    """
    largest = spectrum[..., -1]
    rounding = rank * xp.finfo(spectrum.dtype).eps * largest[..., None]
    smallest = xp.min(xp.where(spectrum > rounding, spectrum, xp.inf), axis=-1)
    geometric_mean = xp.sqrt(smallest * xp.where(largest > 0, largest, 1.0))
    return xp.where(largest > 0, 2 / geometric_mean, 1.0)
