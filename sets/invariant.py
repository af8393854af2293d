"""Robust positively invariant sets of x+ = Phi_i x + w, w in W, for every vertex loop Phi_i, by
pruning in the dual.

    O = {x : c_k x <= 1}   <->   dual points c_k;   a row c is implied by O exactly when c lies in the hull of the c_k
    predecessor of a row:  c x <= 1  becomes  (c Phi_i) x <= 1 - h_W(c)

* the maximal set inside given constraints (Gilbert and Tan 1991; Kolmanovsky and Gilbert 1998;
  Blanchini 1999), or the proof that there is none: a product of loops and disturbances that carries
  the origin out of the constraints;
* an outer bound of the minimal set that is itself invariant (fixed point on given facet normals);
* an invariant set of few facets, grown inside the maximal one by linear programs in its normals and
  its offsets.

Every loop must be stable for one constant schedule at least and W must contain the origin. Then a
non-empty closed invariant set contains the origin (take w = 0), hence everything reached from it: a
reach that leaves proves emptiness.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.optimize import linprog
from scipy.sparse import csr_array
from scipy.spatial import ConvexHull, QhullError

from sets.polytope import Polytope

SupportFunction = Callable[[Float[np.ndarray, "k n"]], Float[np.ndarray, " k"]]
Disturbance = SupportFunction | Sequence[SupportFunction]
"""The support function of W, or one for each loop where W depends on which loop acts."""

INFLATION = 1e-6
"""Sets are built for (1 + INFLATION) W, so that the invariance of the exact W holds with a margin
above rounding."""

PRUNING = 1e-9
"""A row that cuts less than this share of the set is taken as implied; far below what INFLATION
leaves."""

BACK_OFF = 1e-5
"""Few-facet sets stay this share inside the constraints: room to repair what a linear program's
tolerance leaves."""

MOVES, FIRST_RADIUS, LAST_RADIUS = 40, 0.05, 2e-3
"""Moves of the facets at most; how far a normal may turn at first, as a share of the largest, and
where that ends."""


@dataclass(frozen=True)
class Escape:
    """Proof that no invariant set exists: the reach of the origin along `loops` passes `normal` x
    <= `offset`.

    `loops` are vertex indices in the order in which they act; the reach is the sum of h_W over the
    transported normals.
    """

    normal: Float[np.ndarray, " n"]
    offset: float
    loops: tuple[int, ...]


@dataclass(frozen=True)
class MaximalRpi:
    """The maximal robust positively invariant set, or the escape that proves it empty (neither:
    undecided).

    roots, paths: of every row of the polytope, the constraint whose predecessor it is and the loops on the way: the row
        is  c Phi_{i1} .. Phi_{im} x <= d - (1 + INFLATION) sum over l < m of h_W(c Phi_{i1} .. Phi_{il}),  scaled.
    """

    polytope: Polytope | None
    escape: Escape | None
    iterations: int
    roots: tuple[int, ...] = ()
    paths: tuple[tuple[int, ...], ...] = ()


@dataclass
class _Rows:
    """Constraint rows with their history: each is the predecessor of another along a path of loops."""

    normals: Float[np.ndarray, "k n"]
    offsets: Float[np.ndarray, " k"]
    roots: np.ndarray
    paths: list[tuple[int, ...]]

    @property
    def dual(self) -> Float[np.ndarray, "k n"]:
        return self.normals / self.offsets[:, None]

    def take(self, index: np.ndarray) -> _Rows:
        return _Rows(
            self.normals[index],
            self.offsets[index],
            self.roots[index],
            [self.paths[i] for i in index],
        )

    def join(self, other: _Rows) -> _Rows:
        return _Rows(
            np.concatenate([self.normals, other.normals]),
            np.concatenate([self.offsets, other.offsets]),
            np.concatenate([self.roots, other.roots]),
            self.paths + other.paths,
        )

    def predecessors(
        self, loops: Float[np.ndarray, "v n n"], room: Float[np.ndarray, "v k"]
    ) -> _Rows:
        return _Rows(
            np.concatenate([self.normals @ loop for loop in loops]),
            room.ravel(),
            np.tile(self.roots, len(loops)),
            [(*path, i) for i in range(len(loops)) for path in self.paths],
        )


def maximal_rpi(
    loops: Float[np.ndarray, "v n n"],
    constraints: Polytope,
    disturbance: Disturbance,
    max_iterations: int = 2000,
) -> MaximalRpi:
    """Return the largest set O inside `constraints` with Phi_i O + (1 + INFLATION) W_i in O for all
    i.

    `constraints` must be bounded, in two dimensions or more. Raises ValueError where the origin is
    not inside.
    """
    if np.any(constraints.offsets <= 0):
        raise ValueError(
            f"constraints: smallest offset {constraints.offsets.min():.3g}: the origin must lie inside"
        )
    k = len(constraints.offsets)
    rows = _Rows(constraints.normals, constraints.offsets, np.arange(k), [()] * k)
    rows = new = rows.take(ConvexHull(rows.dual).vertices)
    for iteration in range(max_iterations):
        room = new.offsets - (1 + INFLATION) * _steps(disturbance, new.normals, len(loops))
        if np.any(room <= 0):
            worst = int(np.argmin(room.min(axis=0)))
            root, path = new.roots[worst], tuple(reversed(new.paths[worst]))
            escape = Escape(constraints.normals[root], float(constraints.offsets[root]), path)
            return MaximalRpi(None, escape, iteration)
        candidates = new.predecessors(loops, room)
        outside = (
            np.max(candidates.dual @ _facet_points(ConvexHull(rows.dual)).T, axis=1) > 1 + PRUNING
        )
        candidates = candidates.take(np.flatnonzero(outside))
        kept = ConvexHull(np.concatenate([rows.dual, candidates.dual])).vertices
        fresh = kept[kept >= len(rows.offsets)]
        if len(fresh) == 0:
            found = Polytope(rows.dual, np.ones(len(rows.offsets)))
            return MaximalRpi(found, None, iteration, tuple(rows.roots.tolist()), tuple(rows.paths))
        joined = rows.join(candidates)
        new, rows = joined.take(fresh), joined.take(kept)
    return MaximalRpi(None, None, max_iterations)


def _steps(
    disturbance: Disturbance, normals: Float[np.ndarray, "k n"], loops: int
) -> Float[np.ndarray, "v k"]:
    """Return h_{W_i} along every normal, loop by loop."""
    if callable(disturbance):
        return np.broadcast_to(disturbance(normals), (loops, len(normals)))
    return np.stack([support(normals) for support in disturbance])


def _facet_points(hull: ConvexHull) -> Float[np.ndarray, "f n"]:
    """Return y_f with hull = {c : c y_f <= 1}: facets of the dual hull are the vertices of the set
    itself."""
    return hull.equations[:, :-1] / -hull.equations[:, -1:]


def minimal_rpi_bound(
    loops: Float[np.ndarray, "v n n"],
    disturbance: Disturbance,
    normals: Float[np.ndarray, "k n"],
    max_iterations: int = 5000,
) -> Polytope | None:
    """Return an invariant outer bound {normals x <= b} of the minimal RPI set, or None where these
    normals carry none.

    The monotone map b -> max_i h_{P(b)}(normals Phi_i) + (1 + INFLATION) h_{W_i}(normals) is
    iterated from below; where it settles P(b) is invariant, and every invariant set contains the
    minimal one. With these normals it is smallest.
    """
    by_loop = (1 + INFLATION) * _steps(disturbance, normals, len(loops))
    images = np.concatenate([normals @ loop for loop in loops])
    steps = by_loop.max(axis=0)
    offsets = steps.copy()
    for _ in range(max_iterations):
        points = _vertices(normals, offsets)
        reach = np.max(np.max(images @ points.T, axis=1).reshape(len(loops), -1) + by_loop, axis=0)
        if not np.all(reach < 1e6 * steps.max()):
            return None
        if np.max(reach / offsets - 1) < 1e-3 * INFLATION * np.min(steps / offsets):
            return Polytope(normals, np.maximum(reach, offsets))
        offsets = np.maximum(offsets, reach)
    return None


def _vertices(
    normals: Float[np.ndarray, "k n"], offsets: Float[np.ndarray, " k"]
) -> Float[np.ndarray, "v n"]:
    return _facet_points(ConvexHull(normals / offsets[:, None]))


def few_facet_rpi(
    loops: Float[np.ndarray, "v n n"],
    constraints: Polytope,
    disturbance: SupportFunction,
    maximal: Polytope,
    facets: int = 40,
    target: float = 0.95,
) -> Polytope | None:
    """Return an invariant set of at most `facets` facets inside `maximal`, grown towards `target`
    of its volume.

    The smallest invariant set on normals spread over the rows of the maximal one is enlarged by
    pairs of linear programs: one turns the normals, to first order; one finds the best offsets of
    the turned normals, exactly. Every set on the way is invariant. Returns None where the chosen
    normals carry no invariant set inside `constraints`.
    """
    if len(maximal.offsets) <= facets:
        return maximal
    normals = _spread(maximal.normals / maximal.offsets[:, None], facets)
    start = minimal_rpi_bound(loops, disturbance, normals)
    if start is None or constraints.containment_margin(start) < 0:
        return None
    dual, wanted = normals / start.offsets[:, None], target * maximal.volume()
    volume, slope = _volume_and_slope(dual)
    radius, growth = (
        0.0,
        1e3,
    )  # first the offsets alone, in ever smaller steps, then the normals turn as well
    for _ in range(MOVES):
        moved = _turned(loops, constraints, disturbance, dual, slope, radius) if radius else dual
        found = _refitted(loops, constraints, disturbance, moved, slope, growth)
        measured = (0.0, slope) if found is None else _volume_and_slope(found)
        if found is not None and measured[0] > volume * (1 + 1e-5):
            dual, (volume, slope), radius = found, measured, min(1.5 * radius, 0.2)
        elif growth > 0.1:
            growth /= 30
        else:
            radius = 0.4 * radius if radius else FIRST_RADIUS
        if volume >= wanted or 0 < radius < LAST_RADIUS:
            break
    return Polytope(dual, np.ones(len(dual)))


def _spread(points: Float[np.ndarray, "k n"], count: int) -> Float[np.ndarray, "count n"]:
    """Choose `count` rows far from each other, the extremes along every axis first."""
    scaled = points / np.abs(points).max(axis=0)
    chosen = list(dict.fromkeys([*scaled.argmax(axis=0).tolist(), *scaled.argmin(axis=0).tolist()]))
    distance = np.min(np.linalg.norm(scaled[:, None] - scaled[chosen], axis=2), axis=1)
    while len(chosen) < count:
        chosen.append(int(np.argmax(distance)))
        distance = np.minimum(distance, np.linalg.norm(scaled - scaled[chosen[-1]], axis=1))
    return points[chosen]


def _volume_and_slope(dual: Float[np.ndarray, "k n"]) -> tuple[float, Float[np.ndarray, "k n"]]:
    """Return the volume of {dual x <= 1} and its derivative: a cone over facet k has dV / dc_k = -n
    cone centre."""
    hull = ConvexHull(_facet_points(ConvexHull(dual)))
    n = dual.shape[1]
    corners = hull.points[hull.simplices]
    cones, centres = np.abs(np.linalg.det(corners)) / math.factorial(n), corners.mean(axis=1)
    slope = np.zeros_like(dual)
    np.add.at(slope, np.argmax(dual @ centres.T, axis=0), -n * cones[:, None] * centres)
    return float(cones.sum()), slope


def _turned(
    loops, constraints: Polytope, disturbance, dual, slope, radius: float
) -> Float[np.ndarray, "k n"]:
    """Return rows c within `radius` that gain the most volume while c_k Phi_i y + h_W(c_k) <= 1 at
    every vertex y.

    To first order, with h_W frozen, where a vertex y is on the facets s and a row r = sum w_s c_s
    is nearly tight: d(r y) = dr y - sum w_s dc_s y.
    """
    k, n = dual.shape
    simplices, inverses = _simplices(dual)
    vertices = inverses.sum(axis=2)
    limits = constraints.normals / constraints.offsets[:, None]
    rows = np.concatenate([*(dual @ loop for loop in loops), limits])
    steps = (1 + INFLATION) * disturbance(dual)
    room = np.concatenate([np.tile(1 - steps, len(loops)), np.full(len(limits), 1 - BACK_OFF)])
    slack = room[:, None] - rows @ vertices.T
    row, at = np.nonzero(slack < radius)
    weights = np.einsum("an,anm->am", rows[row], inverses[at])
    change, entry = np.zeros((len(row), k, n)), np.arange(len(row))
    for m in range(n):
        change[entry, simplices[at, m]] -= weights[:, m, None] * vertices[at]
    own = np.flatnonzero(row < k * len(loops))
    change[own, row[own] % k] += np.einsum("anm,am->an", loops[row[own] // k], vertices[at[own]])
    width = np.tile(radius * np.abs(dual).max(axis=0), k)
    limit, change = np.maximum(slack[row, at], 0), csr_array(change.reshape(len(row), -1))
    answer = linprog(
        -slope.ravel(), A_ub=change, b_ub=limit, bounds=np.stack([-width, width], axis=1)
    )
    return dual + answer.x.reshape(k, n) if answer.status == 0 else dual


def _refitted(
    loops, constraints: Polytope, disturbance, dual, slope, growth: float
) -> Float[np.ndarray, "k n"] | None:
    """Return the rows scaled to offsets b that make {dual x <= b} invariant and large, or None.

    Multipliers L >= 0, L dual = dual Phi_i, turn invariance into L b + h_W <= b; those of the tight
    rows are taken.
    """
    v, steps, images = (
        len(loops),
        (1 + INFLATION) * disturbance(dual),
        np.concatenate([dual @ loop for loop in loops]),
    )
    try:
        offsets = np.max(dual @ _facet_points(ConvexHull(dual)).T, axis=1)
        scaled = dual / offsets[:, None]
        invariance = _multipliers(scaled, images) / offsets - np.tile(np.eye(len(dual)), (v, 1))
        rows = np.concatenate([invariance, _multipliers(scaled, constraints.normals) / offsets])
        bounds = np.concatenate([-np.tile(steps, v), constraints.offsets * (1 - BACK_OFF)])
        step = np.stack([offsets / (1 + growth), offsets * (1 + growth)], axis=1)
        answer = linprog(np.einsum("kn,kn->k", slope, dual), A_ub=rows, b_ub=bounds, bounds=step)
        return _restored(images, constraints, steps, dual, answer.x) if answer.status == 0 else None
    except QhullError:
        return None


def _multipliers(dual, directions) -> Float[np.ndarray, "d k"]:
    """Return L >= 0 with L dual = directions and L 1 = support numbers: barycentres on facets of
    the dual hull."""
    simplices, inverses = _simplices(dual)
    weights = np.einsum("dn,fnm->dfm", directions, inverses)
    hit = np.argmax(
        weights.min(axis=2), axis=1
    )  # the simplex the direction passes through: no weight is negative
    multipliers, each = np.zeros((len(directions), len(dual))), np.arange(len(directions))
    np.put_along_axis(multipliers, simplices[hit], np.maximum(weights[each, hit], 0), axis=1)
    return multipliers


def _simplices(dual: Float[np.ndarray, "k n"]):
    """Return the facets of the dual hull as n rows each, and the inverses of those; slivers left
    out."""
    simplices = ConvexHull(dual).simplices
    solid = np.abs(np.linalg.det(dual[simplices])) > 1e-12 * np.prod(np.abs(dual).max(axis=0))
    return simplices[solid], np.linalg.inv(dual[simplices[solid]])


def _restored(
    images, constraints: Polytope, steps, dual, offsets
) -> Float[np.ndarray, "k n"] | None:
    """Return the rows with offsets repaired to invariance in float64 (a solver's answer misses it
    by 1e-7), or None."""
    for _ in range(100):
        points = _vertices(dual, offsets)
        tight = np.max(dual @ points.T, axis=1)
        reach = np.max(images @ points.T, axis=1).reshape(-1, len(dual)).max(axis=0) + steps
        if np.all(reach <= tight * (1 + 1e-3 * INFLATION)):
            inside = np.all(constraints.normals @ points.T <= constraints.offsets[:, None])
            return dual / tight[:, None] if inside else None
        offsets = np.maximum(tight, reach)
    return None
