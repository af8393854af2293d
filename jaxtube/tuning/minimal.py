"""The outer bound of the minimal RPI set as a function of the local gains, differentiable.

    b_k = max_i h_{P(b)}(n_k Phi_i) + (1 + INFLATION) h_W(n_k),        P(b) = {x : n_k x <= b_k for all k}

At the least fixed point one loop i(k) attains each maximum, at a vertex of P(b) where three facets
s(k) meet. By duality n_k Phi_i(k) = lambda_k N_s(k) with lambda_k >= 0, hence

    b = L b + (1 + INFLATION) h_W(N),        h_{P(b)}(c) = mu b_s,   mu N_s = c

with L the lambda_k in the columns s(k). Loops and facets are found once, offline (`active_facets`),
and held: then b is a smooth function of loops, normals and W, and by the envelope theorem its
derivative is that of the bound itself, as long as no other loop or vertex attains a maximum as
well.

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

from jaxtube.synthesis.certificate.fill import RING
from jaxtube.synthesis.problem import Problem
from jaxtube.tuning.tube import largest, rows_under, support
from sets.invariant import INFLATION, minimal_rpi_bound

FLAT = 1e-12
"""Facets of the dual hull of a smaller determinant, as a share of its box, are slivers and meet in
no vertex."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class ActiveFacets:
    """What attains the maxima: the loop and three facets for each normal, and three facets for each
    direction."""

    loop: Int[Array, " k"]
    facets: Int[Array, "k 3"]
    directions: Int[Array, "d 3"]


def active_facets(
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
    loops, generators, normals = (
        np.asarray(array, float) for array in (loops, generators, normals)
    )
    bound = minimal_rpi_bound(loops, lambda rows: np.abs(rows @ generators.T).sum(axis=1), normals)
    if bound is None:
        return None
    images = np.concatenate([normals @ loop for loop in loops])
    asked = np.concatenate([images, np.asarray(directions, float)])
    facets, numbers = _supporting_facets(normals / bound.offsets[:, None], asked)
    v, k = len(loops), len(normals)
    loop = np.argmax(numbers[: v * k].reshape(v, k), axis=0)
    held = facets[: v * k].reshape(v, k, 3)[loop, np.arange(k)]
    return ActiveFacets(jnp.asarray(loop), jnp.asarray(held), jnp.asarray(facets[v * k :]))


def _supporting_facets(dual: Float[np.ndarray, "k 3"], rows: Float[np.ndarray, "r 3"]):
    """Return the facets of {dual x <= 1} whose cone holds each row, and the row's support number.

    A row may lie in the common face of several cones: the one it is deepest in, to rounding, has no
    negative weight.
    """
    simplices = ConvexHull(dual).simplices
    solid = np.abs(np.linalg.det(dual[simplices])) > FLAT * np.prod(np.abs(dual).max(axis=0))
    simplices = simplices[solid]
    weights = np.einsum("rn,fnm->rfm", rows, np.linalg.inv(dual[simplices]))
    hit = np.argmax(weights.min(axis=2), axis=1)
    return simplices[hit], weights[np.arange(len(rows)), hit].sum(axis=1)


def minimal_offsets(
    active: ActiveFacets,
    loops: Float[Array, "v 3 3"],
    generators: Float[Array, "g 3"],
    normals: Float[Array, "k 3"],
) -> Float[Array, " k"]:
    """Return the offsets of the bound, its active facets held."""
    images = jnp.einsum("kn,knm->km", normals, loops[active.loop])
    each = jnp.arange(len(normals))[:, None]
    transport = jnp.eye(len(normals), dtype=normals.dtype)
    transport = transport.at[each, active.facets].add(-_multipliers(normals, active.facets, images))
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
    return jnp.sum(
        _multipliers(normals, active.directions, directions) * offsets[active.directions], axis=-1
    )


def _multipliers(
    normals: Float[Array, "k 3"], facets: Int[Array, "r 3"], rows: Float[Array, "r 3"]
) -> Float[Array, "r 3"]:
    """Return the weights of three normals whose sum is the row."""
    return jnp.linalg.solve(jnp.swapaxes(normals[facets], 1, 2), rows[..., None])[..., 0]


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Limits:
    """What the tube may use: |e| <= widths (m, m, rad) and inputs u + errors e <= offsets.

    The second half of the input rows is minus the first.
    """

    widths: Float[Array, "3"]
    inputs: Float[Array, "k 2"]
    errors: Float[Array, "k 3"]
    offsets: Float[Array, " k"]


def limits(problem: Problem) -> Limits:
    """Return what the tube of a design may use."""
    rows = problem.input_rows
    arrays = problem.operating_set.offsets[:3], rows.inputs, rows.errors, rows.offsets
    return Limits(*(jnp.asarray(array) for array in arrays))


def cap_normals(limits: Limits, gains: Float[Array, "v 2 3"]) -> Float[Array, "facets 3"]:
    """Return the facet normals of the bound: the rows of all caps over their offsets, and a ring of
    RING facets.

    Those of the inputs move with the gains; the ring lies in the plane of lateral and heading
    error.
    """
    box = jnp.diag(1.0 / limits.widths)
    under = rows_under(limits.inputs, limits.errors, gains) / limits.offsets[:, None]
    angles = jnp.asarray(2 * np.pi * np.arange(RING) / RING, dtype=gains.dtype)
    ring = [
        jnp.zeros_like(angles),
        jnp.cos(angles) / limits.widths[1],
        jnp.sin(angles) / limits.widths[2],
    ]
    return jnp.concatenate([box, -box, under.reshape(-1, 3), jnp.stack(ring, axis=1)])


def active_caps(
    limits: Limits,
    loops: Float[Array, "v 3 3"],
    generators: Float[Array, "g 3"],
    gains: Float[Array, "w 2 3"],
) -> ActiveFacets | None:
    """Find what `cap_shares` holds, None where no bound was found; offline, anew wherever the gains
    have moved."""
    normals = np.asarray(jax.jit(cap_normals)(limits, gains))
    return active_facets(np.asarray(loops), np.asarray(generators), normals, normals[:-RING])


def cap_shares(
    active: ActiveFacets,
    limits: Limits,
    loops: Float[Array, "v 3 3"],
    generators: Float[Array, "g 3"],
    gains: Float[Array, "w 2 3"],
) -> Float[Array, " caps"]:
    """Return the share of each cap that the tube fills at its widest, active facets held.

    Args:
        active: from `active_caps` at these gains.
        limits: the caps.
        loops: closed loops any of which may act.
        generators: of W.
        gains: whose mixtures hold every gain in use.

    Returns:
        Longitudinal, lateral and heading error, then one for each opposite pair of input rows.
    """
    normals = cap_normals(limits, gains)
    shares = minimal_reach(active, loops, generators, normals, normals[:-RING])
    errors, inputs = shares[:6].reshape(-1, 3), shares[6:].reshape(-1, len(limits.offsets) // 2)
    return jnp.concatenate([largest(errors), largest(inputs)])
