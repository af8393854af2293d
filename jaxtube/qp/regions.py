"""A bank of critical regions: answers of a parametric program that are known beforehand.

Where the data of a strictly convex program depend on three numbers p,

    minimise over x   1/2 x' P x + (F p)' x   subject to   l <= R p + A x <= u,

each set of active rows has a region of p, a polytope, in which the multipliers are affine in p. A
tree of planes guesses the region of p: at each plane it goes to one side, at its end stands a
region. What this costs grows with the depth of the tree, not with the number of regions. A guess is
checked like any other answer; what is not answered so is left to a solver.

Source: Bemporad, Morari, Dua, Pistikopoulos 2002, "The explicit linear quadratic regulator for
constrained systems", Automatica 38(1), for the regions; Tondel, Johansen, Bemporad 2003,
"Evaluation of piecewise affine control via binary search tree", Automatica 39(5), for the tree.
"""

from __future__ import annotations

import functools
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import Array
from jaxtyping import Float, Int

from jaxtube.qp.blocks import on_accelerator

DEEPEST = 20
"""Planes in a row, at most."""

AnyArray = Any
"""A design holds numpy arrays, a controller jax arrays."""


class Regions(NamedTuple):
    """The regions of a program, or of a stack of programs that are numbered in one row, and their
    trees."""

    begin: Int[AnyArray, "*stack"]  # plane at which the tree of a program begins, or ~region
    planes: Float[AnyArray, "s 4"]  # of (p, 1)
    following: Int[AnyArray, "s 2"]  # plane on the negative side, on the other; ~region at an end
    optimum: Float[AnyArray, "k n 4"]  # x, of (p, 1)
    multipliers: Float[AnyArray, "k a 4"]  # of (p, 1), of rows of unit norm
    rows: Int[AnyArray, "k a"]  # of the multipliers; beyond the last one where there is none

    def take(self, program: Int[Array, ""] | int) -> Regions:
        """Return the regions of one program of a stack."""
        return self._replace(begin=self.begin[program])


def look_up(
    regions: Regions, p: Float[Array, "batch 3"], row_count: int
) -> tuple[Float[Array, "n batch"], Float[Array, "m batch"]]:
    """Return x and the multipliers of all rows, as of unit norm, in the region that is guessed to
    hold p."""
    region = guess_region(regions, p)
    extended = jnp.concatenate([p, jnp.ones_like(p[:, :1])], axis=1)[:, None]
    x = jnp.sum(regions.optimum[region] * extended, axis=-1)
    active = jnp.sum(regions.multipliers[region] * extended, axis=-1)
    y = jnp.zeros((row_count, len(p)), p.dtype)
    place = regions.rows[region].T
    return x.T, y.at[place, jnp.arange(len(p))].set(active.T, mode="drop")


def guess_region(regions: Regions, p: Float[Array, "batch 3"]) -> Int[Array, " batch"]:
    """Return the region at the end of the way that each p takes through the tree."""
    begin = jnp.full(len(p), regions.begin, jnp.int32)
    columns = jnp.unstack(regions.planes, axis=1)
    following = regions.following.reshape(-1)

    def is_under_way(node):
        return jnp.any(node >= 0)

    def step(node):
        plane = jnp.maximum(node, 0)
        terms = [columns[i][plane] * p[:, i] for i in range(3)]
        is_beyond = sum(terms, start=columns[3][plane]) >= 0
        place = 2 * plane + is_beyond.astype(plane.dtype)
        return jnp.where(node < 0, node, following[place])

    if on_accelerator():
        # One kernel; of a loop the device would ask the host at every turn.
        return ~functools.reduce(lambda node, _: step(node), range(DEEPEST), begin)
    return ~jax.lax.while_loop(is_under_way, step, begin)
