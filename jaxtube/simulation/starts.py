"""Initial errors of the realisations: one for all, or drawn uniformly from a convex set of errors.

A convex polytope that contains the origin is the union of the simplices that its facets, cut into
triangles, span with the origin. A simplex is drawn with probability proportional to its volume,
then a point in it: the ordered gaps of three uniform numbers are uniform weights of its four
corners (Devroye, Non-Uniform Random Variate Generation, 1986, theorem V.2.1).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from types import ModuleType
from typing import Any, Protocol

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Float, Key
from scipy.spatial import ConvexHull

from jaxtube.plant.streams import Stream


class Starts(Protocol):
    """Initial errors as functions of the keys of realisations."""

    def draw(self, keys: Key[Array, " batch"]) -> Float[Array, "batch 3"]:
        """Return the initial true errors, (m, m, rad)."""
        ...

    def sample(self, generator: np.random.Generator, count: int) -> Float[np.ndarray, "count 3"]:
        """Return so many of the same law, off line."""
        ...


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class FixedStart:
    """The same initial error, (m, m, rad), for every realisation."""

    error: Float[Array, "3"]

    def draw(self, keys: Key[Array, " batch"]) -> Float[Array, "batch 3"]:
        """Return the initial errors."""
        return jnp.broadcast_to(self.error, (len(keys), len(self.error)))

    def sample(self, generator: np.random.Generator, count: int) -> Float[np.ndarray, "count 3"]:
        """Return the initial error so many times."""
        return np.tile(np.asarray(self.error), (count, 1))


@partial(
    jax.tree_util.register_dataclass, data_fields=["triangles", "cumulative"], meta_fields=["edge"]
)
@dataclass(frozen=True)
class UniformStart:
    """Initial errors uniform in a polytope, or their projections from the origin on its edge; by
    `uniform_start`.

    Attributes:
        triangles: (corner, coordinate) of each simplex; its fourth corner is the origin.
        cumulative: shares of the volume, summed up, without the last.
        edge: project the errors on the edge.
    """

    triangles: Float[Array, "simplices 3 3"]
    cumulative: Float[Array, " simplices"]
    edge: bool = False

    def draw(self, keys: Key[Array, " batch"]) -> Float[Array, "batch 3"]:
        """Return the initial errors."""
        dtype = self.triangles.dtype
        draws = jax.vmap(
            lambda key: jax.random.uniform(
                jax.random.fold_in(key, Stream.INITIAL_ERROR), (self._uniforms,), dtype
            )
        )(keys)
        return self._place(draws, jnp)

    def sample(self, generator: np.random.Generator, count: int) -> Float[np.ndarray, "count 3"]:
        """Return so many of the same law, off line."""
        on_the_host = jax.tree.map(np.asarray, self)
        return on_the_host._place(generator.random((count, on_the_host._uniforms)), np)

    @property
    def _uniforms(self) -> int:
        """Uniform numbers of a draw: one for the simplex, one for each coordinate in it."""
        return 1 + self.triangles.shape[-1]

    def _place(self, draws: Float[Any, "batch n+1"], xp: ModuleType) -> Float[Any, "batch 3"]:
        """Return the errors of their uniform numbers."""
        chosen = self.triangles[xp.searchsorted(self.cumulative, draws[:, 0], side="right")]
        weights = xp.diff(xp.sort(draws[:, 1:], axis=1), prepend=0.0, axis=1)
        if self.edge:
            weights = weights / xp.sum(weights, axis=1, keepdims=True)
        return xp.sum(weights[:, :, None] * chosen, axis=1)


def uniform_start(points: Float[np.ndarray, "k 3"], edge: bool = False) -> UniformStart:
    """Return starts uniform in the convex hull of points, which must contain the origin, or
    projected on its edge.

    Raises:
        ValueError: where the origin lies outside the hull.
    """
    triangles = _find_facets(points)
    shares = np.cumsum(np.abs(np.linalg.det(triangles)))
    return UniformStart(jnp.asarray(triangles), jnp.asarray(shares[:-1] / shares[-1]), edge)


def _find_facets(points: Float[np.ndarray, "k n"]) -> Float[np.ndarray, "simplices n n"]:
    """Return the facets of a hull around the origin, cut into simplices: of numbers both ends."""
    if points.shape[1] == 1:
        ends = np.array([points.min(), points.max()])
        surrounds = ends[0] < 0 < ends[1]
        facets = ends[:, None, None]
    else:
        hull = ConvexHull(points)
        surrounds = bool(np.all(hull.equations[:, -1] <= 0))
        facets = points[hull.simplices]
    if not surrounds:
        raise ValueError(
            "starts: points do not surround the origin; give points on all sides of it"
        )
    return facets
