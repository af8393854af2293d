"""Robust positively invariant sets of x+ = Phi_i x + w, w in W, for every vertex loop Phi_i, by
pruning in the dual.

    O = {x : c_k x <= 1}   <->   dual points c_k
    a row c is implied by O exactly when c lies in the hull of the c_k
    predecessor of a row:  c x <= 1  becomes  (c Phi_i) x <= 1 - h_W(c)

* the maximal set inside given constraints (Gilbert and Tan 1991; Kolmanovsky and Gilbert 1998;
  Blanchini 1999), or the proof that there is none: a product of loops and disturbances that carries
  the origin out of the constraints;
* an outer bound of the minimal set that is itself invariant (fixed point on given facet normals).

Every loop must be stable for one constant schedule at least and W must contain the origin. Then a
non-empty closed invariant set contains the origin (take w = 0), hence everything reached from it: a
reach that leaves proves emptiness. Sets of few facets: `sets.few_facets`.
"""

from __future__ import annotations

import bisect
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.spatial import ConvexHull, QhullError

from sets.polytope import ConvexSet, Polytope, support_function

Disturbance = ConvexSet | Sequence[ConvexSet]
"""W by its support numbers, or one such set for each loop where W depends on which loop acts."""

INFLATION = 1e-6
"""Sets are built for (1 + INFLATION) W, so that the invariance of the exact W holds with a margin
above rounding."""

PRUNING = 1e-9
"""A row that cuts less than this share of the set is taken as implied; far below what INFLATION
leaves."""

FLAT = 1e-9
"""A disturbance whose extent along a normal is below this share of its largest counts as flat, and
normals whose hull holds no ball of this radius about the origin as open."""

SAMPLE = 16
"""Of so many vertices one is asked first whether a row cuts it off."""

MOST_ITERATIONS = 2000
"""Steps after which it is left undecided whether there is a maximal set."""

MOST_GROWTHS = 5000
"""Steps after which an outer bound of the minimal set that still grows is given up."""

TIE = 1e-12
"""Relative difference below which two rows have equal room."""


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

    Attributes:
        polytope, escape: one of them, or neither.
        iterations: steps of the recursion.
        roots, paths: of every row of the polytope, the constraint whose predecessor it is and the
            loops on the way: the row is, scaled,
            c Phi_{i1} .. Phi_{im} x <= d - (1 + INFLATION) sum over l < m of
            h_W(c Phi_{i1} .. Phi_{il}).
    """

    polytope: Polytope | None
    escape: Escape | None
    iterations: int
    roots: tuple[int, ...] = ()
    paths: tuple[tuple[int, ...], ...] = ()


class _History:
    """Of every candidate row, by its number: the row whose predecessor it is, and along which
    loop."""

    def __init__(self, loops: int):
        self._loops = loops
        self._parents: list[Int[np.ndarray, " k"]] = []
        self._starts = [0]

    def number(self, parents: Int[np.ndarray, " k"]) -> Int[np.ndarray, " vk"]:
        """Number the predecessors of rows along every loop; a row of no predecessor has -1."""
        first = self._starts[-1]
        self._parents.append(parents)
        self._starts.append(first + self._loops * len(parents))
        return np.arange(first, self._starts[-1])

    def trace(self, number: int) -> tuple[int, ...]:
        """Return the loops from a constraint to the row of a number."""
        path = []
        while number >= 0:
            generation = bisect.bisect_right(self._starts, number) - 1
            parents = self._parents[generation]
            loop, place = divmod(number - self._starts[generation], len(parents))
            path.append(loop)
            number = int(parents[place])
        return tuple(reversed(path))


@dataclass
class _Rows:
    """Constraint rows: the constraint whose predecessor each is, and its number in the history,
    -1 for the constraint itself."""

    normals: Float[np.ndarray, "k n"]
    offsets: Float[np.ndarray, " k"]
    roots: Int[np.ndarray, " k"]
    numbers: Int[np.ndarray, " k"]

    @property
    def dual(self) -> Float[np.ndarray, "k n"]:
        return self.normals / self.offsets[:, None]

    def take(self, index: Int[np.ndarray, " m"] | Bool[np.ndarray, " k"]) -> _Rows:
        return _Rows(
            self.normals[index], self.offsets[index], self.roots[index], self.numbers[index]
        )

    def join(self, other: _Rows) -> _Rows:
        return _Rows(
            np.concatenate([self.normals, other.normals]),
            np.concatenate([self.offsets, other.offsets]),
            np.concatenate([self.roots, other.roots]),
            np.concatenate([self.numbers, other.numbers]),
        )

    def find_predecessors(
        self, loops: Float[np.ndarray, "v n n"], room: Float[np.ndarray, "v k"], history: _History
    ) -> _Rows:
        return _Rows(
            (self.normals @ loops).reshape(-1, self.normals.shape[1]),
            room.ravel(),
            np.tile(self.roots, len(loops)),
            history.number(self.numbers),
        )


def maximal_rpi(
    loops: Float[np.ndarray, "v n n"],
    constraints: Polytope,
    disturbance: Disturbance,
) -> MaximalRpi:
    """Return the largest set O inside `constraints` with Phi_i O + (1 + INFLATION) W_i in O for all
    i; undecided after MOST_ITERATIONS.

    Args:
        loops: vertex loops Phi_i.
        constraints: bounded, the origin inside, in two dimensions or more.
        disturbance: W, or one W_i a loop; flat ones allowed.

    Raises:
        ValueError: the origin is not inside the constraints, or they are unbounded.
        TypeError: a disturbance without support function.

    Source: Kolmanovsky and Gilbert 1998, section 6; Blanchini 1999.
    """
    if np.any(constraints.offsets <= 0):
        least = constraints.offsets.min()
        raise ValueError(
            f"constraints: smallest offset {least:.3g}: the origin must lie inside; widen them"
        )
    _refuse_open("constraints", constraints.normals)
    k = len(constraints.offsets)
    given = _Rows(constraints.normals, constraints.offsets, np.arange(k), np.full(k, -1))
    history = _History(len(loops))
    hull = ConvexHull(given.dual)
    rows = given.take(hull.vertices)
    new = rows
    for iteration in range(MOST_ITERATIONS):
        steps = compute_steps(disturbance, new.normals, len(loops))
        room = new.offsets - (1 + INFLATION) * steps
        if np.any(room <= 0):
            escape = _find_escape(constraints, new, room.min(axis=0), history)
            return MaximalRpi(None, escape, iteration)
        joined = rows.join(new.find_predecessors(loops, room, history))
        joined, hull = _prune(joined, len(rows.offsets), _take_vertices(hull))
        fresh = hull.vertices[hull.vertices >= len(rows.offsets)]
        if len(fresh) == 0:
            polytope = Polytope(rows.dual, np.ones(len(rows.offsets)))
            roots = tuple(rows.roots.tolist())
            paths = tuple(history.trace(number) for number in rows.numbers.tolist())
            return MaximalRpi(polytope, None, iteration, roots, paths)
        new = joined.take(fresh)
        rows = joined.take(hull.vertices)
    return MaximalRpi(None, None, MOST_ITERATIONS)


def _prune(
    joined: _Rows, known: int, vertices: Float[np.ndarray, "v n"]
) -> tuple[_Rows, ConvexHull]:
    """Return rows without the candidates that do not cut the set of those `known` first, and their
    dual hull; candidates inside the hull may stay."""
    while True:
        hull = ConvexHull(joined.dual)
        fresh = hull.vertices[hull.vertices >= known]
        implied = fresh[~_cut(hull.points[fresh], vertices)]
        if len(implied) == 0:
            return joined, hull
        joined = joined.take(np.delete(np.arange(len(joined.offsets)), implied))


def _cut(
    points: Float[np.ndarray, "k n"], vertices: Float[np.ndarray, "v n"]
) -> Bool[np.ndarray, " k"]:
    """Return which dual points cut off some vertex of a set; most of them cut off many."""
    cuts = np.zeros(len(points), bool)
    for some in (vertices[::SAMPLE], vertices):
        rest = np.flatnonzero(~cuts)
        cuts[rest] = np.max(points[rest] @ some.T, axis=1, initial=0.0) > 1 + PRUNING
    return cuts


def _find_escape(
    constraints: Polytope, rows: _Rows, room: Float[np.ndarray, " k"], history: _History
) -> Escape:
    """Return the run that leaves by the row with least room; among rows equal up to `TIE`, the one
    of the first constraint along the first loops."""
    equal = np.flatnonzero(room <= room.min() + TIE * rows.offsets)
    root, path = min((rows.roots[i], history.trace(int(rows.numbers[i]))) for i in equal)
    return Escape(constraints.normals[root], float(constraints.offsets[root]), path[::-1])


def compute_steps(
    disturbance: Disturbance, normals: Float[np.ndarray, "k n"], loops: int
) -> Float[np.ndarray, "v k"]:
    """Return h_{W_i} along every normal, loop by loop.

    Raises:
        ValueError: the number of sets is not that of the loops.
    """
    if isinstance(disturbance, Sequence):
        if len(disturbance) != loops:
            raise ValueError(
                f"disturbance: {len(disturbance)} sets for {loops} loops; give one a loop"
            )
        # Of few sets that many loops share each is asked once.
        distinct = {id(W): support_function(W, "disturbance") for W in disturbance}
        numbers = {key: support(normals) for key, support in distinct.items()}
        return np.stack([numbers[id(W)] for W in disturbance])
    support = support_function(disturbance, "disturbance")
    return np.broadcast_to(support(normals), (loops, len(normals)))


def find_vertices(
    normals: Float[np.ndarray, "k n"], offsets: Float[np.ndarray, " k"]
) -> Float[np.ndarray, "v n"]:
    """Return the vertices of {normals x <= offsets}, the origin inside: each facet c y <= 1 of the
    hull of the dual points is a vertex y, some of them several times."""
    return _take_vertices(ConvexHull(normals / offsets[:, None]))


def _take_vertices(hull: ConvexHull) -> Float[np.ndarray, "v n"]:
    """Return the vertices of the set whose dual points have this hull."""
    return hull.equations[:, :-1] / -hull.equations[:, -1:]


def _refuse_open(name: str, normals: Float[np.ndarray, "k n"]) -> None:
    """Refuse normals that do not bound a set: those whose hull does not hold the origin inside."""
    dimension = normals.shape[1]
    if dimension < 2:
        raise ValueError(f"{name}: one dimension; give two or more")
    unit = normals / np.linalg.norm(normals, axis=1, keepdims=True)
    try:
        distances = -ConvexHull(unit).equations[:, -1]
    except QhullError:
        distances = np.zeros(1)
    if distances.min() <= FLAT:
        raise ValueError(
            f"{name}: {len(normals)} normals leave a direction open; add rows that bound it"
        )


def minimal_rpi_bound(
    loops: Float[np.ndarray, "v n n"],
    disturbance: Disturbance,
    normals: Float[np.ndarray, "k n"],
) -> Polytope | None:
    """Return an invariant outer bound {normals x <= b} of the minimal RPI set, or None where these
    normals carry none.

    The monotone map b -> max_i h_{P(b)}(normals Phi_i) + (1 + INFLATION) h_{W_i}(normals) is
    iterated from below, MOST_GROWTHS times at most; where it settles P(b) is invariant, and every
    invariant set contains the minimal one. With these normals it is smallest.

    Args:
        loops: vertex loops Phi_i.
        disturbance: W, or one W_i a loop, whose hull has interior.
        normals: rows that bound every direction, in two dimensions or more.

    Raises:
        ValueError: the disturbance is flat along a normal, or the normals leave a direction open.
        TypeError: a disturbance without support function.
    """
    _refuse_open("normals", normals)
    by_loop = (1 + INFLATION) * compute_steps(disturbance, normals, len(loops))
    steps = by_loop.max(axis=0)
    _refuse_flat(normals, steps)
    images = np.concatenate([normals @ loop for loop in loops])
    offsets = steps.copy()
    for _ in range(MOST_GROWTHS):
        vertices = find_vertices(normals, offsets)
        carried = np.max(images @ vertices.T, axis=1).reshape(len(loops), -1)
        reach = np.max(carried + by_loop, axis=0)
        if not np.all(reach < 1e6 * steps.max()):
            return None
        if np.max(reach / offsets - 1) < 1e-3 * INFLATION * np.min(steps / offsets):
            return Polytope(normals, np.maximum(reach, offsets))
        offsets = np.maximum(offsets, reach)
    return None


def _refuse_flat(normals: Float[np.ndarray, "k n"], steps: Float[np.ndarray, " k"]) -> None:
    """Refuse a disturbance without extent along a normal, whose dual points are infinite."""
    extents = steps / np.linalg.norm(normals, axis=1)
    flattest = int(np.argmin(extents))
    if not extents[flattest] > FLAT * extents.max():
        raise ValueError(
            f"disturbance: extent {extents[flattest]:.3g} along the normal "
            f"{normals[flattest].tolist()}, {extents.max():.3g} along others: it is flat; "
            "widen it by a small box"
        )
