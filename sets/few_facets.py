"""An invariant set of few facets, grown inside the maximal one by linear programs in its normals
and its offsets.

    {x : c_k x <= 1},  k <= facets,     c_k Phi_i y + h_W(c_k) <= 1  at every vertex y

for every loop Phi_i, W that of the loop.

Notation: `dual` holds the rows c_k; the loops Phi_i and W are those of `sets.invariant`, and sets
are built for (1 + INFLATION) W.

Source: the conditions on rows and multipliers are those of Bitsoris 1988, Int. J. Control 47,
1713-1726; growing the set by linear programs in turn is new.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int
from scipy.optimize import linprog
from scipy.sparse import csr_array
from scipy.spatial import ConvexHull, QhullError

from sets.invariant import (
    INFLATION,
    Disturbance,
    compute_steps,
    find_vertices,
    minimal_rpi_bound,
)
from sets.polytope import Polytope

BACK_OFF = 1e-5
"""Sets stay this share inside the constraints: room to repair what a linear program's tolerance
leaves."""

TARGET = 0.95
"""Share of the volume of the maximal set at which growth ends."""

MOVES = 40
"""Moves of the facets at most."""

FIRST_RADIUS = 0.05
"""How far a normal may turn at first, as a share of the largest."""

LAST_RADIUS = 2e-3
"""The search ends once normals may turn no further than this share of the largest."""

TIE = 1e-9
"""Relative difference below which two distances are equal: the first of them is taken."""


@dataclass(frozen=True)
class _Problem:
    """Loops, constraints and disturbance of the invariant set."""

    loops: Float[np.ndarray, "v n n"]
    constraints: Polytope
    disturbance: Disturbance

    def compute_steps(self, dual: Float[np.ndarray, "k n"]) -> Float[np.ndarray, "v k"]:
        return (1 + INFLATION) * compute_steps(self.disturbance, dual, len(self.loops))

    def carry(self, dual: Float[np.ndarray, "k n"]) -> Float[np.ndarray, "vk n"]:
        return np.concatenate([dual @ loop for loop in self.loops])


def few_facet_rpi(
    loops: Float[np.ndarray, "v n n"],
    constraints: Polytope,
    disturbance: Disturbance,
    maximal: Polytope,
    facets: int = 40,
) -> Polytope | None:
    """Return an invariant set of at most `facets` facets inside `maximal`, grown towards TARGET of
    its volume.

    The smallest invariant set on normals spread over the rows of the maximal one is enlarged by
    pairs of linear programs: one turns the normals, to first order; one finds the best offsets of
    the turned normals, exactly. Every set on the way is invariant. Returns None where the chosen
    normals carry no invariant set inside `constraints`.

    Args:
        loops: vertex loops Phi_i.
        constraints: that the set keeps.
        disturbance: W, or one W_i a loop.
        maximal: the maximal invariant set.
        facets: at most.

    Raises:
        ValueError: the disturbance is flat.
    """
    if len(maximal.offsets) <= facets:
        return maximal
    problem = _Problem(loops, constraints, disturbance)
    normals = _spread(maximal.normals / maximal.offsets[:, None], facets)
    start = minimal_rpi_bound(loops, problem.disturbance, normals)
    if start is None or constraints.containment_margin(start) < 0:
        return None
    dual = _grow(problem, normals / start.offsets[:, None], TARGET * maximal.volume())
    return Polytope(dual, np.ones(len(dual)))


def _grow(
    problem: _Problem, dual: Float[np.ndarray, "k n"], wanted: float
) -> Float[np.ndarray, "k n"]:
    """Enlarge the set to the volume wanted, as far as the moves lead.

    At first the offsets alone move, in ever smaller steps; then the normals turn as well.
    """
    volume, slope = _measure(dual)
    radius = 0.0
    growth = 1e3
    for _ in range(MOVES):
        turned = _turn(problem, dual, slope, radius) if radius else dual
        refitted = _refit(problem, turned, slope, growth)
        larger, its_slope = (0.0, slope) if refitted is None else _measure(refitted)
        if refitted is not None and larger > volume * (1 + 1e-5):
            dual = refitted
            volume = larger
            slope = its_slope
            radius = min(1.5 * radius, 0.2)
        elif growth > 0.1:
            growth /= 30
        else:
            radius = 0.4 * radius if radius else FIRST_RADIUS
        if volume >= wanted or 0 < radius < LAST_RADIUS:
            break
    return dual


def _spread(points: Float[np.ndarray, "k n"], count: int) -> Float[np.ndarray, "count n"]:
    """Choose `count` rows far from each other, the extremes along every axis first."""
    scaled = points / np.abs(points).max(axis=0)
    extremes = [_find_first_largest(column) for column in [*scaled.T, *-scaled.T]]
    chosen = list(dict.fromkeys(extremes))
    gaps = np.linalg.norm(scaled[:, None] - scaled[chosen], axis=2)
    distance = np.min(gaps, axis=1)
    while len(chosen) < count:
        chosen.append(_find_first_largest(distance))
        gap = np.linalg.norm(scaled - scaled[chosen[-1]], axis=1)
        distance = np.minimum(distance, gap)
    return points[chosen]


def _find_first_largest(values: Float[np.ndarray, " k"]) -> int:
    """Return the index of the largest value; among values equal up to `TIE`, the first."""
    largest = values.max()
    return int(np.flatnonzero(values >= largest - TIE * abs(largest))[0])


def _measure(dual: Float[np.ndarray, "k n"]) -> tuple[float, Float[np.ndarray, "k n"]]:
    """Return the volume of {dual x <= 1} and its derivative: a cone over facet k has dV / dc_k = -n
    cone centre."""
    n = dual.shape[1]
    hull = ConvexHull(find_vertices(dual, np.ones(len(dual))))
    corners = hull.points[hull.simplices]
    cones = np.abs(np.linalg.det(corners)) / math.factorial(n)
    centres = corners.mean(axis=1)
    facets = np.argmax(dual @ centres.T, axis=0)
    slope = np.zeros_like(dual)
    np.add.at(slope, facets, -n * cones[:, None] * centres)
    return float(cones.sum()), slope


def _turn(
    problem: _Problem,
    dual: Float[np.ndarray, "k n"],
    slope: Float[np.ndarray, "k n"],
    radius: float,
) -> Float[np.ndarray, "k n"]:
    """Return rows c within `radius` that gain the most volume while c_k Phi_i y + h_W(c_k) <= 1 at
    every vertex y.

    To first order, with h_W frozen, where a vertex y is on the facets s and a row r = sum w_s c_s
    is nearly tight: d(r y) = dr y - sum w_s dc_s y.
    """
    k, n = dual.shape
    loops = problem.loops
    simplices, inverses = _find_simplices(dual)
    vertices = inverses.sum(axis=2)
    limits = problem.constraints.normals / problem.constraints.offsets[:, None]
    rows = np.concatenate([problem.carry(dual), limits])
    own_room = 1 - problem.compute_steps(dual).ravel()
    room = np.concatenate([own_room, np.full(len(limits), 1 - BACK_OFF)])
    slack = room[:, None] - rows @ vertices.T
    row, at = np.nonzero(slack < radius)
    entry = np.arange(len(row))
    weights = np.einsum("an,anm->am", rows[row], inverses[at])
    change = np.zeros((len(row), k, n))
    for m in range(n):
        change[entry, simplices[at, m]] -= weights[:, m, None] * vertices[at]
    own = np.flatnonzero(row < k * len(loops))
    moved = np.einsum("anm,am->an", loops[row[own] // k], vertices[at[own]])
    change[own, row[own] % k] += moved
    width = np.tile(radius * np.abs(dual).max(axis=0), k)
    answer = linprog(
        -slope.ravel(),
        A_ub=csr_array(change.reshape(len(row), -1)),
        b_ub=np.maximum(slack[row, at], 0),
        bounds=np.stack([-width, width], axis=1),
    )
    return dual + answer.x.reshape(k, n) if answer.status == 0 else dual


def _refit(
    problem: _Problem,
    dual: Float[np.ndarray, "k n"],
    slope: Float[np.ndarray, "k n"],
    growth: float,
) -> Float[np.ndarray, "k n"] | None:
    """Return the rows scaled to offsets b that make {dual x <= b} invariant and large, or None.

    Multipliers L >= 0, L dual = dual Phi_i, turn invariance into L b + h_W <= b; those of the tight
    rows are taken.
    """
    v = len(problem.loops)
    constraints = problem.constraints
    steps = problem.compute_steps(dual)
    images = problem.carry(dual)
    try:
        vertices = find_vertices(dual, np.ones(len(dual)))
        offsets = np.max(dual @ vertices.T, axis=1)
        scaled = dual / offsets[:, None]
        carried = _find_multipliers(scaled, images) / offsets
        invariance = carried - np.tile(np.eye(len(dual)), (v, 1))
        admission = _find_multipliers(scaled, constraints.normals) / offsets
        limits = constraints.offsets * (1 - BACK_OFF)
        answer = linprog(
            np.einsum("kn,kn->k", slope, dual),
            A_ub=np.concatenate([invariance, admission]),
            b_ub=np.concatenate([-steps.ravel(), limits]),
            bounds=np.stack([offsets / (1 + growth), offsets * (1 + growth)], axis=1),
        )
        if answer.status != 0:
            return None
        return _restore(images, constraints, steps, dual, answer.x)
    except QhullError:
        return None


def _find_multipliers(
    dual: Float[np.ndarray, "k n"], directions: Float[np.ndarray, "d n"]
) -> Float[np.ndarray, "d k"]:
    """Return L >= 0 with L dual = directions and L 1 = support numbers: barycentres on facets of
    the dual hull."""
    simplices, inverses = _find_simplices(dual)
    weights = np.einsum("dn,fnm->dfm", directions, inverses)
    # The direction passes through the simplex in which no weight is negative.
    hit = np.argmax(weights.min(axis=2), axis=1)
    shares = np.maximum(weights[np.arange(len(directions)), hit], 0)
    multipliers = np.zeros((len(directions), len(dual)))
    np.put_along_axis(multipliers, simplices[hit], shares, axis=1)
    return multipliers


def _find_simplices(
    dual: Float[np.ndarray, "k n"],
) -> tuple[Int[np.ndarray, "f n"], Float[np.ndarray, "f n n"]]:
    """Return the facets of the dual hull as n rows each, and the inverses of those; slivers left
    out."""
    simplices = ConvexHull(dual).simplices
    size = np.prod(np.abs(dual).max(axis=0))
    is_solid = np.abs(np.linalg.det(dual[simplices])) > 1e-12 * size
    solid = simplices[is_solid]
    return solid, np.linalg.inv(dual[solid])


def _restore(
    images: Float[np.ndarray, "vk n"],
    constraints: Polytope,
    steps: Float[np.ndarray, "v k"],
    dual: Float[np.ndarray, "k n"],
    offsets: Float[np.ndarray, " k"],
) -> Float[np.ndarray, "k n"] | None:
    """Return the rows with offsets repaired to invariance in float64 (a solver's answer misses it
    by 1e-7), or None."""
    for _ in range(100):
        vertices = find_vertices(dual, offsets)
        tight = np.max(dual @ vertices.T, axis=1)
        carried = np.max(images @ vertices.T, axis=1).reshape(-1, len(dual))
        reach = np.max(carried + steps, axis=0)
        if np.all(reach <= tight * (1 + 1e-3 * INFLATION)):
            is_inside = np.all(constraints.normals @ vertices.T <= constraints.offsets[:, None])
            return dual / tight[:, None] if is_inside else None
        offsets = np.maximum(tight, reach)
    return None
