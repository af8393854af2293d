"""The projection of a polytope of many variables on a few, between two polytopes.

    F = {x : some y has  X x + Y y <= h}

is found by its support numbers, one linear program each. The hull of the points that attain them
lies in F. Along the normal of each of its facets the next support number is asked for, until F
reaches nowhere further out than a share: then the hull and (1 + share) times it enclose F. No
vertex in (x, y) and no elimination of y is needed, whose numbers explode.

Source: Lotov, Bushenkov, Kamenev 2004, Interactive Decision Maps, chapter 8 (estimate refinement).
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.spatial import ConvexHull

from sets.frame import solve_programs
from sets.polytope import Polytope

SHARE = 0.005
"""Of the support number along a facet, by which F may reach beyond the facet."""
MOST_ROUNDS = 200


@dataclass(frozen=True, eq=False)
class Projection:
    """A hull inside of F; F lies in (1 + gap) times it.

    Attributes:
        points: of F, the hull of which is inside of it.
        gap: by how much F reaches beyond a facet at most, as a share of the facet's offset.
    """

    points: Float[np.ndarray, "k n"]
    gap: float

    @property
    def inner(self) -> Polytope:
        """The hull."""
        return Polytope.from_vertices(self.points)


def project(
    kept: Float[np.ndarray, "m n"],
    dropped: Float[np.ndarray, "m d"],
    offsets: Float[np.ndarray, " m"],
    share: float = SHARE,
) -> Projection:
    """Project {(x, y) : kept x + dropped y <= offsets} on x.

    Args:
        kept, dropped, offsets: rows of the polytope; its projection is bounded and holds 0 inside.
        share: by which the projection may reach beyond the facets of the hull returned.

    Raises:
        ArithmeticError: where a linear program is not solved, or the search does not end.
        ValueError: where 0 is not inside of the projection.
    """
    n = kept.shape[1]
    columns = np.hstack([kept, dropped])
    units = 1 / np.abs(columns).max(axis=0)
    rows = columns * units
    axes = np.concatenate([np.eye(n), -np.eye(n)])
    sizes = _find_farthest(rows, offsets, axes)[1].reshape(2, n).max(axis=0)
    if not np.all(sizes > 0):
        raise ValueError("offsets: 0 is not inside of the projection; give rows that it meets")
    # In these units the projection is about as wide along each of its axes.
    rows[:, :n] *= sizes
    corners = np.array(list(itertools.product((-1.0, 1.0), repeat=n)))
    points, _ = _find_farthest(rows, offsets, np.concatenate([axes, corners]))
    settled: dict[tuple[int, ...], float] = {}
    for _ in range(MOST_ROUNDS):
        hull = ConvexHull(points)
        facets = [tuple(sorted(simplex)) for simplex in hull.simplices.tolist()]
        fresh = [i for i, facet in enumerate(facets) if facet not in settled]
        if not fresh:
            gap = max(settled[facet] for facet in facets)
            return Projection(points * sizes * units[:n], gap)
        normals = hull.equations[fresh, :-1]
        farthest, reach = _find_farthest(rows, offsets, normals)
        if not np.all(reach > 0):
            raise ValueError("offsets: 0 is not inside of the projection; give rows that it meets")
        excess = reach + hull.equations[fresh, -1]
        is_settled = excess <= share * (reach - excess)
        for i in np.flatnonzero(is_settled):
            settled[facets[fresh[i]]] = float(excess[i] / (reach[i] - excess[i]))
        points = np.concatenate([points, farthest[~is_settled]])
    raise ArithmeticError(f"projection: not found in {MOST_ROUNDS} rounds")


def _find_farthest(
    rows: Float[np.ndarray, "m n+d"],
    offsets: Float[np.ndarray, " m"],
    directions: Float[np.ndarray, "k n"],
) -> tuple[Float[np.ndarray, "k n"], Float[np.ndarray, " k"]]:
    """Return the points of the projection that are farthest along directions, and how far."""
    n = directions.shape[1]
    costs = np.pad(-directions, ((0, 0), (0, rows.shape[1] - n)))
    points = solve_programs(costs, rows, offsets)[:, :n]
    return points, np.sum(points * directions, axis=1)
