"""Utilisation of each cap by the widest tube, as a differentiable function of the local gains.

    share of a cap = h_R(row) / offset,    R the bound of the minimal RPI set (`tuning.minimal`)

Caps are limits of the measured error and of the inputs. The tube is at its widest in R.
"""

from __future__ import annotations

from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Float

from jaxtube.synthesis.certificate.fill import RING, ring_normals
from jaxtube.synthesis.problem import Problem
from jaxtube.tuning.minimal import ActiveFacets, find_active_facets, minimal_reach
from jaxtube.tuning.tube import closed_loop_rows, largest


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class CapLimits:
    """What the tube may use: |e| <= widths (m, m, rad) and inputs u + errors e <= offsets.

    The second half of the input rows is minus the first.
    """

    widths: Float[Array, "3"]
    inputs: Float[Array, "k 2"]
    errors: Float[Array, "k 3"]
    offsets: Float[Array, " k"]


def make_limits(problem: Problem) -> CapLimits:
    """Return what the tube of a design may use."""
    rows = problem.input_rows
    return CapLimits(
        widths=jnp.asarray(problem.operating_set.offsets[:3]),
        inputs=jnp.asarray(rows.inputs),
        errors=jnp.asarray(rows.errors),
        offsets=jnp.asarray(rows.offsets),
    )


def cap_normals(limits: CapLimits, gains: Float[Array, "v 2 3"]) -> Float[Array, "facets 3"]:
    """Return the facet normals of the bound: the rows of all caps over their offsets, and a ring of
    RING facets.

    The rows of the inputs move with the gains; the ring lies in the plane of lateral and heading
    error.
    """
    box = jnp.diag(1.0 / limits.widths)
    rows = closed_loop_rows(limits.inputs, limits.errors, gains) / limits.offsets[:, None]
    ring = ring_normals(limits.widths, jnp)
    return jnp.concatenate([box, -box, rows.reshape(-1, 3), ring])


def find_active_caps(
    limits: CapLimits,
    loops: Float[Array, "v 3 3"],
    generators: Float[Array, "g 3"],
    gains: Float[Array, "w 2 3"],
) -> ActiveFacets | None:
    """Find what `shares_of_caps` holds, offline and anew wherever the gains have moved.

    Returns:
        None where no bound was found.
    """
    normals = np.asarray(jax.jit(cap_normals)(limits, gains))
    return find_active_facets(np.asarray(loops), np.asarray(generators), normals, normals[:-RING])


def shares_of_caps(
    active: ActiveFacets,
    limits: CapLimits,
    loops: Float[Array, "v 3 3"],
    generators: Float[Array, "g 3"],
    gains: Float[Array, "w 2 3"],
) -> Float[Array, " caps"]:
    """Return the share of each cap that the tube fills at its widest, active facets held.

    Args:
        active: from `find_active_caps` at these gains.
        limits: the caps.
        loops: closed loops any of which may act.
        generators: of W.
        gains: whose mixtures hold every gain in use.

    Returns:
        Longitudinal, lateral and heading error, then one for each opposite pair of input rows.
    """
    normals = cap_normals(limits, gains)
    shares = minimal_reach(active, loops, generators, normals, normals[:-RING])
    errors = shares[:6].reshape(-1, 3)
    inputs = shares[6:].reshape(-1, len(limits.offsets) // 2)
    return jnp.concatenate([largest(errors), largest(inputs)])
