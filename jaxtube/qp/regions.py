"""A bank of critical regions: answers of a parametric program that are known beforehand.

Where the data of a strictly convex program depend on three numbers p,

    minimise over x   1/2 x' P x + (F p)' x   subject to   l <= R p + A x <= u,

each set of active rows has a region of p, a polytope, in which x and the multipliers are affine in
p. To look p up costs a product with the facets of all regions that the bank holds. What is found is
checked like any other answer; what is not found is left to a solver.

Source: Bemporad, Morari, Dua, Pistikopoulos 2002, "The explicit linear quadratic regulator for
constrained systems", Automatica 38(1).
"""

from __future__ import annotations

import functools
from typing import Any, NamedTuple

import jax.numpy as jnp
from jax import Array
from jaxtyping import Float, Int

from jaxtube.qp.batched_ldl import product
from jaxtube.qp.tags import read_tag, tag

AnyArray = Any
"""A design holds numpy arrays, a controller jax arrays."""


class Regions(NamedTuple):
    """The regions of a program, or of a stack of programs."""

    normals: Float[AnyArray, "*stack facets k 3"]
    offsets: Float[AnyArray, "*stack facets k"]  # infinite where a region has fewer facets
    optimum: Float[AnyArray, "*stack k n 4"]
    multipliers: Float[AnyArray, "*stack k a 4"]
    rows: Int[AnyArray, "*stack k a"]  # of the multipliers; beyond the last one where there is none


def look_up(
    regions: Regions, p: Float[Array, "batch 3"], row_count: int
) -> tuple[Float[Array, "n batch"], Float[Array, "m batch"]]:
    """Return x and multipliers of the first region that holds p, or of the nearest one."""
    facets, count, _ = regions.normals.shape
    beyond = [
        product(regions.normals[facet], p.T) - regions.offsets[facet, :, None]
        for facet in range(facets)
    ]
    farthest = functools.reduce(jnp.maximum, beyond)
    tagged = tag(farthest, jnp.arange(count)[:, None], count)
    region = read_tag(jnp.min(tagged, axis=0), count)
    extended = jnp.concatenate([p, jnp.ones_like(p[:, :1])], axis=1)[:, None]
    x = jnp.sum(regions.optimum[region] * extended, axis=-1)
    active = jnp.sum(regions.multipliers[region] * extended, axis=-1)
    instance = jnp.arange(len(p))[:, None]
    y = jnp.zeros((row_count, len(p)), p.dtype)
    return x.T, y.at[regions.rows[region], instance].set(active, mode="drop")
