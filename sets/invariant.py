"""Robust positively invariant sets of x+ = Phi_i x + w, w in W, for every vertex loop Phi_i, by pruning in the dual.

    O = {x : c_k x <= 1}   <->   dual points c_k;   a row c is implied by O exactly when c lies in the hull of the c_k
    predecessor of a row:  c x <= 1  becomes  (c Phi_i) x <= 1 - h_W(c)

* the maximal set inside given constraints (Gilbert and Tan 1991; Kolmanovsky and Gilbert 1998; Blanchini 1999), or the
  proof that there is none: a product of loops and disturbances that carries the origin out of the constraints;
* an outer bound of the minimal set that is itself invariant (fixed point on given facet normals);
* an invariant set of few facets, grown inside the maximal one by a sequence of linear programs.

Every loop must be stable for one constant schedule at least and W must contain the origin. Then a non-empty closed
invariant set contains the origin (take w = 0), hence everything reached from it: a reach that leaves proves emptiness.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.optimize import linprog
from scipy.spatial import ConvexHull, QhullError

from sets.polytope import Polytope

SupportFunction = Callable[[Float[np.ndarray, "k n"]], Float[np.ndarray, " k"]]

INFLATION = 1e-6
"""Sets are built for (1 + INFLATION) W, so that the invariance of the exact W holds with a margin above rounding."""

PRUNING = 1e-9
"""A row that cuts less than this share of the set is taken as implied; far below what INFLATION leaves."""

BACK_OFF = 1e-5
"""Few-facet sets stay this share inside the constraints: room to repair what a linear program's tolerance leaves."""


@dataclass(frozen=True)
class Escape:
    """Proof that no invariant set exists: the reach of the origin along `loops` passes `normal` x <= `offset`.

    `loops` are vertex indices in the order in which they act; the reach is the sum of h_W over the transported normals.
    """

    normal: Float[np.ndarray, " n"]
    offset: float
    loops: tuple[int, ...]


@dataclass(frozen=True)
class MaximalRpi:
    """The maximal robust positively invariant set, or the escape that proves it empty (neither: undecided)."""

    polytope: Polytope | None
    escape: Escape | None
    iterations: int


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
        return _Rows(self.normals[index], self.offsets[index], self.roots[index], [self.paths[i] for i in index])

    def join(self, other: _Rows) -> _Rows:
        return _Rows(
            np.concatenate([self.normals, other.normals]),
            np.concatenate([self.offsets, other.offsets]),
            np.concatenate([self.roots, other.roots]),
            self.paths + other.paths,
        )

    def predecessors(self, loops: Float[np.ndarray, "v n n"], room: Float[np.ndarray, " k"]) -> _Rows:
        return _Rows(
            np.concatenate([self.normals @ loop for loop in loops]),
            np.tile(room, len(loops)),
            np.tile(self.roots, len(loops)),
            [(*path, i) for i in range(len(loops)) for path in self.paths],
        )


def maximal_rpi(
    loops: Float[np.ndarray, "v n n"],
    constraints: Polytope,
    disturbance: SupportFunction,
    max_iterations: int = 2000,
) -> MaximalRpi:
    """Return the largest set O inside `constraints` with Phi_i O + (1 + INFLATION) W in O for all i.

    `constraints` must be bounded with the origin inside; `disturbance` is the support function of W.
    Raises ValueError where the origin is not inside.
    """
    if np.any(constraints.offsets <= 0):
        raise ValueError(f"constraints: smallest offset {constraints.offsets.min():.3g}: the origin must lie inside")
    rows = _Rows(
        constraints.normals, constraints.offsets, np.arange(len(constraints.offsets)), [()] * len(constraints.offsets)
    )
    rows = new = rows.take(ConvexHull(rows.dual).vertices)
    for iteration in range(max_iterations):
        room = new.offsets - (1 + INFLATION) * disturbance(new.normals)
        if np.any(room <= 0):
            worst = int(np.argmin(room))
            root = new.roots[worst]
            path = tuple(reversed(new.paths[worst]))
            return MaximalRpi(
                None, Escape(constraints.normals[root], float(constraints.offsets[root]), path), iteration
            )
        candidates = new.predecessors(loops, room)
        hull = ConvexHull(rows.dual)
        outside = np.max(candidates.dual @ _facet_points(hull).T, axis=1) > 1 + PRUNING
        candidates = candidates.take(np.flatnonzero(outside))
        kept = ConvexHull(np.concatenate([rows.dual, candidates.dual])).vertices
        fresh = kept[kept >= len(rows.offsets)]
        if len(fresh) == 0:
            return MaximalRpi(Polytope(rows.dual, np.ones(len(rows.offsets))), None, iteration)
        joined = rows.join(candidates)
        new, rows = joined.take(fresh), joined.take(kept)
    return MaximalRpi(None, None, max_iterations)


def _facet_points(hull: ConvexHull) -> Float[np.ndarray, "f n"]:
    """Return y_f with hull = {c : c y_f <= 1}: facets of the dual hull are the vertices of the set itself."""
    return hull.equations[:, :-1] / -hull.equations[:, -1:]


def minimal_rpi_bound(
    loops: Float[np.ndarray, "v n n"],
    disturbance: SupportFunction,
    normals: Float[np.ndarray, "k n"],
    max_iterations: int = 5000,
) -> Polytope | None:
    """Return an invariant outer bound {normals x <= b} of the minimal RPI set, or None where these normals carry none.

    The monotone map b -> max_i h_{P(b)}(normals Phi_i) + (1 + INFLATION) h_W(normals) is iterated from below; where it
    settles P(b) is invariant, and every invariant set contains the minimal one. With these normals it is the smallest.
    """
    steps = (1 + INFLATION) * disturbance(normals)
    images = np.concatenate([normals @ loop for loop in loops])
    offsets = steps.copy()
    for _ in range(max_iterations):
        points = _vertices(normals, offsets)
        reach = np.max(images @ points.T, axis=1).reshape(len(loops), -1).max(axis=0) + steps
        if not np.all(reach < 1e6 * steps.max()):
            return None
        if np.max(reach / offsets - 1) < 1e-3 * INFLATION * np.min(steps / offsets):
            return Polytope(normals, np.maximum(reach, offsets))
        offsets = np.maximum(offsets, reach)
    return None


def _vertices(normals: Float[np.ndarray, "k n"], offsets: Float[np.ndarray, " k"]) -> Float[np.ndarray, "v n"]:
    return _facet_points(ConvexHull(normals / offsets[:, None]))


def few_facet_rpi(
    loops: Float[np.ndarray, "v n n"],
    constraints: Polytope,
    disturbance: SupportFunction,
    maximal: Polytope,
    facets: int = 40,
    target: float = 0.85,
) -> Polytope | None:
    """Return an invariant set of at most `facets` facets inside `maximal`, grown towards `target` of its volume.

    On fixed normals C the offsets b must satisfy, with multipliers L >= 0, L C = C Phi_i:  L b + (1 + INFLATION) h_W <= b.
    From the smallest solution, linear programs in b (multipliers of the last set, facet areas as objective) enlarge the
    volume; every step stays invariant. Normals come spread over the rows of the maximal set for a somewhat larger W,
    whose rows are closer to being closed under the loops. Returns None where no such set was found.
    """
    if len(maximal.offsets) <= facets:
        return maximal
    full, best, best_volume = maximal.volume(), None, 0.0
    for normals in _templates(loops, constraints, disturbance, maximal, facets):
        start = minimal_rpi_bound(loops, disturbance, normals)
        if start is None or constraints.containment_margin(start) < 0:
            continue
        offsets, volume = _grow(loops, constraints, (1 + INFLATION) * disturbance(normals), normals, start.offsets)
        if volume > best_volume:
            best, best_volume = Polytope(normals, offsets), volume
        if best_volume >= target * full:
            break
    return best


def _templates(loops, constraints, disturbance, maximal: Polytope, facets: int):
    """Yield sets of facet normals, the most promising first."""
    sources = [maximal]
    for inflation in (1.06, 1.2):
        larger = maximal_rpi(loops, constraints, lambda rows, s=inflation: s * disturbance(rows), max_iterations=60)
        if larger.polytope is not None:
            sources.insert(0, larger.polytope)
    for seed in range(2):
        for source in sources[:2]:
            yield _spread(source.normals / source.offsets[:, None], facets, seed)


def _spread(points: Float[np.ndarray, "k n"], count: int, seed: int) -> Float[np.ndarray, "count n"]:
    """Choose `count` rows far from each other, the extremes along every axis first."""
    scaled = points / np.abs(points).max(axis=0)
    chosen = list(dict.fromkeys([*scaled.argmax(axis=0).tolist(), *scaled.argmin(axis=0).tolist()]))
    if seed:
        chosen.append(int(np.random.default_rng(seed).integers(len(points))))
    distance = np.min(np.linalg.norm(scaled[:, None] - scaled[chosen], axis=2), axis=1)
    while len(chosen) < min(count, len(points)):
        chosen.append(int(np.argmax(distance)))
        distance = np.minimum(distance, np.linalg.norm(scaled - scaled[chosen[-1]], axis=1))
    return points[np.unique(chosen)]


def _volume_and_slope(normals, offsets) -> tuple[float, Float[np.ndarray, " k"]]:
    """Return the volume of {normals x <= offsets} and its derivative: a cone over facet k has d volume / d b_k = n cone_k / b_k."""
    hull = ConvexHull(_vertices(normals, offsets))
    dimension = normals.shape[1]
    corners = hull.points[hull.simplices]
    cones = np.abs(np.linalg.det(corners)) / np.prod(np.arange(1, dimension + 1))
    owner = np.argmax((normals / offsets[:, None]) @ corners.mean(axis=1).T, axis=0)
    slope = np.zeros(len(offsets))
    np.add.at(slope, owner, dimension * cones / offsets[owner])
    return float(cones.sum()), slope


def _multipliers(normals, offsets, directions) -> Float[np.ndarray, "d k"]:
    """Return L >= 0 with L normals = directions and L offsets = support numbers: barycentres on the dual hull's facets."""
    dual = normals / offsets[:, None]
    hull = ConvexHull(dual)
    simplices = hull.simplices[np.argmax(directions @ _facet_points(hull).T, axis=1)]
    weights = np.linalg.solve(dual[simplices].transpose(0, 2, 1), directions[:, :, None])[..., 0]
    multipliers = np.zeros((len(directions), len(offsets)))
    np.put_along_axis(multipliers, simplices, np.maximum(weights, 0) / offsets[simplices], axis=1)
    return multipliers


def _grow(loops, constraints: Polytope, steps, normals, offsets, patience: int = 4):
    """Enlarge {normals x <= offsets} by linear programs that keep it invariant and inside `constraints`."""
    generator = np.random.default_rng(0)
    images = np.concatenate([normals @ loop for loop in loops])
    invariance = np.tile(np.eye(len(offsets)), (len(loops), 1))
    bounds = np.concatenate([-np.tile(steps, len(loops)), constraints.offsets * (1 - BACK_OFF)])
    volume, slope = _volume_and_slope(normals, offsets)
    stalled = 0
    while stalled <= patience:
        # At a stall the multipliers of a nearby set open another convex piece of the feasible offsets.
        near = offsets * np.exp(generator.normal(size=len(offsets)) * 0.02 * generator.random() * (stalled > 0))
        near = np.minimum(near, np.max(normals @ _vertices(normals, near).T, axis=1))
        rows = np.concatenate(
            [
                _multipliers(normals, near, images) - invariance,
                _multipliers(normals, near, constraints.normals),
            ]
        )
        stalled += 1
        for step in (1e3, 0.2, 0.03):
            answer = linprog(
                -slope, A_ub=rows, b_ub=bounds, bounds=np.stack([offsets / (1 + step), offsets * (1 + step)], 1)
            )
            candidate = _restored(loops, constraints, steps, normals, answer.x) if answer.status == 0 else None
            if candidate is None:
                continue
            new_volume, new_slope = _volume_and_slope(normals, candidate)
            if new_volume > volume * (1 + 1e-5):
                offsets, volume, slope, stalled = candidate, new_volume, new_slope, 0
    return offsets, volume


def _restored(loops, constraints: Polytope, steps, normals, offsets) -> Float[np.ndarray, " k"] | None:
    """Return offsets repaired to invariance in float64 (a solver's answer misses it by 1e-7), or None."""
    images = np.concatenate([normals @ loop for loop in loops])
    for _ in range(100):
        try:
            points = _vertices(normals, offsets)
        except QhullError:
            return None
        tight = np.max(normals @ points.T, axis=1)
        reach = np.max(images @ points.T, axis=1).reshape(len(loops), -1).max(axis=0) + steps
        if np.all(reach <= tight * (1 + 1e-3 * INFLATION)):
            inside = np.all(constraints.normals @ points.T <= constraints.offsets[:, None])
            return tight if inside else None
        offsets = np.maximum(tight, reach)
    return None
