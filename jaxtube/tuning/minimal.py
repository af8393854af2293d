"""The outer bound of the minimal RPI set as a differentiable function of the local gains.

    b_k = max_i h_{P(b)}(n_k Phi_i) + (1 + INFLATION) h_W(n_k)
    P(b) = {x : n_k x <= b_k for all k}

At the least fixed point one loop i(k) attains each maximum, at a vertex of P(b) where three facets
s(k) meet. By duality n_k Phi_i(k) = lambda_k N_s(k) with lambda_k >= 0, hence

    b = L b + (1 + INFLATION) h_W(N),        h_{P(b)}(c) = mu b_s,   mu N_s = c

with L the lambda_k in the columns s(k). Loops and facets are found once, offline
(`find_active_facets`), and held: then b is a smooth function of loops, normals and W, and by the
envelope theorem its derivative is that of the bound itself, as long as no other loop or vertex
attains a maximum as well.

Source: the bound is that of `sets.invariant`; linear programming duality.
"""

from __future__ import annotations

from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Float, Int
from scipy.spatial import ConvexHull

from jaxtube.tuning.tube import support
from sets.invariant import INFLATION, minimal_rpi_bound

FLAT = 1e-12
"""Facets of the dual hull with a smaller determinant, as a share of its box, are slivers and meet
in no vertex."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class ActiveFacets:
    """What attains the maxima: the loop and three facets for each normal, and three facets for each
    direction."""

    loop: Int[Array, " k"]
    facets: Int[Array, "k 3"]
    directions: Int[Array, "d 3"]


def find_active_facets(
    loops: Float[np.ndarray, "v 3 3"],
    generators: Float[np.ndarray, "g 3"],
    normals: Float[np.ndarray, "k 3"],
    directions: Float[np.ndarray, "d 3"],
) -> ActiveFacets | None:
    """Find the bound on the given normals, and what attains its maxima and its support numbers
    along directions.

    Args:
        loops: closed loops any of which may act.
        generators: of W; their support number is positive along every normal.
        normals: facet normals, which bound a set.
        directions: along which `minimal_reach` is asked for.

    Returns:
        None where these normals carry no bound, as of unstable loops.
    """
    loops = np.asarray(loops, float)
    generators = np.asarray(generators, float)
    normals = np.asarray(normals, float)
    bound = minimal_rpi_bound(loops, lambda rows: np.abs(rows @ generators.T).sum(axis=1), normals)
    if bound is None:
        return None
    images = np.concatenate([normals @ loop for loop in loops])
    rows = np.concatenate([images, np.asarray(directions, float)])
    facets, numbers = _supporting_facets(normals / bound.offsets[:, None], rows)
    v = len(loops)
    k = len(normals)
    loop = np.argmax(numbers[: v * k].reshape(v, k), axis=0)
    of_loops = facets[: v * k].reshape(v, k, 3)
    of_normals = of_loops[loop, np.arange(k)]
    of_directions = facets[v * k :]
    return ActiveFacets(jnp.asarray(loop), jnp.asarray(of_normals), jnp.asarray(of_directions))


def _supporting_facets(
    dual: Float[np.ndarray, "k 3"], rows: Float[np.ndarray, "r 3"]
) -> tuple[Int[np.ndarray, "r 3"], Float[np.ndarray, " r"]]:
    """Return the facets of {dual x <= 1} whose cone holds each row, and the row's support number.

    A row may lie in the common face of several cones: the one it is deepest in has no negative
    weight, to rounding.
    """
    simplices = ConvexHull(dual).simplices
    volumes = np.abs(np.linalg.det(dual[simplices]))
    solid = volumes > FLAT * np.prod(np.abs(dual).max(axis=0))
    simplices = simplices[solid]
    weights = np.einsum("rn,fnm->rfm", rows, np.linalg.inv(dual[simplices]))
    deepest = np.argmax(weights.min(axis=2), axis=1)
    numbers = weights[np.arange(len(rows)), deepest].sum(axis=1)
    return simplices[deepest], numbers


def minimal_offsets(
    active: ActiveFacets,
    loops: Float[Array, "v 3 3"],
    generators: Float[Array, "g 3"],
    normals: Float[Array, "k 3"],
) -> Float[Array, " k"]:
    """Return the offsets of the bound, its active facets held."""
    images = jnp.einsum("kn,knm->km", normals, loops[active.loop])
    multipliers = _multipliers(normals, active.facets, images)
    row = jnp.arange(len(normals))[:, None]
    transport = jnp.eye(len(normals), dtype=normals.dtype)
    transport = transport.at[row, active.facets].add(-multipliers)
    return jnp.linalg.solve(transport, (1.0 + INFLATION) * support(generators, normals))


def minimal_reach(
    active: ActiveFacets,
    loops: Float[Array, "v 3 3"],
    generators: Float[Array, "g 3"],
    normals: Float[Array, "k 3"],
    directions: Float[Array, "d 3"],
) -> Float[Array, " d"]:
    """Return the support numbers of the bound along the directions, its active facets held."""
    offsets = minimal_offsets(active, loops, generators, normals)
    multipliers = _multipliers(normals, active.directions, directions)
    return jnp.sum(multipliers * offsets[active.directions], axis=-1)


def _multipliers(
    normals: Float[Array, "k 3"], facets: Int[Array, "r 3"], rows: Float[Array, "r 3"]
) -> Float[Array, "r 3"]:
    """Return the weights of three normals whose sum is the row, by Cramer's rule.

    Not by a batched LAPACK call: two of them in one program may wait for each other (`qp.factors`).
    """
    first, second, third = jnp.moveaxis(normals[facets], 1, 0)
    cofactors = jnp.stack(
        [jnp.cross(second, third), jnp.cross(third, first), jnp.cross(first, second)], axis=1
    )
    determinant = jnp.sum(first * cofactors[:, 0], axis=-1)
    return jnp.einsum("rwn,rn->rw", cofactors, rows) / determinant[:, None]
