"""Frames x = centre + basis y in which a polytope {x : H x <= h} is {y : p_i y <= 1}, has interior
and is of unit size.

A frame absorbs flat directions, bad scales and offsets far from the origin. The hull of the polar
points p_i and 0 then answers everything: its vertices are the rows that are not redundant, its
facets that miss 0 are the vertices of the set, its facets through 0 are the rays along which the
set is unbounded (Ziegler 1995, Lectures on Polytopes, ch. 2). Flat directions are found one linear
program at a time, by facial reduction (Borwein and Wolkowicz 1981, J. Austral. Math. Soc. 30,
369-380).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float, Int
from scipy.linalg import qr
from scipy.optimize import linprog
from scipy.spatial import ConvexHull, KDTree, QhullError

FLAT = 1e-9  # relative thickness below which a set has no interior
SAME = 1e-11  # relative distance below which two points or facets are one
FAR = 1e-11  # a vertex further than 1 / FAR unit sizes is a ray
ROUNDING = 1e-14  # relative error of data that went through a few operations
DEEP = 10.0  # depth, in unit sizes, that is enough: only unbounded sets reach it
PLAIN = 1e-2  # depth, in unit sizes, at which nothing is in doubt
HULL_DIMENSION = 4  # above it vertices may explode: the support function goes by linear programs


@dataclass(frozen=True)
class Frame:
    """Coordinates x = centre + basis y of the affine hull in which the set is {y : polar y <= 1}.

    `rows` are the facets behind `polar` and `slacks` their h - H centre; the `equalities` hold on
    the whole set.
    """

    centre: Float[np.ndarray, " n"]
    basis: Float[np.ndarray, "n d"]
    polar: Float[np.ndarray, "m d"]
    slacks: Float[np.ndarray, " m"]
    rows: Int[np.ndarray, " m"]
    equalities: Int[np.ndarray, " e"]

    @cached_property
    def isotropic(self):
        """Isotropic coordinates of 0 and the polar points, the map to them, and the lines of the
        set."""
        return flatten(np.vstack([np.zeros(self.polar.shape[1]), self.polar]))

    @cached_property
    def generators(self):
        """Vertices, rays and lines whose sum is the set, each (count, d)."""
        points, _, _ = _dual(self.polar)
        # a second pass about the middle of the first one's vertices, for a deepest point can lie at
        # one end of the set
        middle = points.sum(axis=0) / (len(points) + 1)
        points, rays, lines = _dual(self.polar / (1 - self.polar @ middle)[:, None])
        points = points + middle
        excess = (self.polar @ points.T - 1) / np.linalg.norm(self.polar, axis=1)[:, None]
        if excess.max(initial=0.0) > FLAT * np.linalg.norm(points, axis=1).max():
            raise ArithmeticError(
                "vertices violate their rows: rescale the coordinates of the polytope"
            )
        return points, rays, lines

    @cached_property
    def facets(self):
        """Positions in `rows` of the rows that are not redundant."""
        corners = hull(self.isotropic[0])[2]
        candidates = corners[corners > 0] - 1
        return candidates[
            np.array([self._supports_facet(self.polar[i]) for i in candidates], dtype=bool)
        ]

    def _supports_facet(self, row):
        """Tell whether a row touches the set in more than a face of lower dimension, which rounding
        makes a facet."""
        points, rays, lines = self.generators
        length, size = np.linalg.norm(row), np.linalg.norm(points, axis=1).max()
        touching = points[abs(points @ row - 1) <= FLAT * size * length]
        parallel = rays[abs(rays @ row) <= FLAT * length * np.linalg.norm(rays, axis=1)]
        face = np.vstack([touching - touching[:1], parallel, lines])
        return len(touching) > 0 and np.linalg.matrix_rank(face, tol=FLAT * size) >= len(row) - 1

    def support(self, directions):
        """Return h_P(d) = d centre + max {d basis y : polar y <= 1}; rays within 1e-9 of right
        angles to d stay out."""
        local = directions @ self.basis
        if self.basis.shape[1] > HULL_DIMENSION:
            highest = [self._support_by_program(row) for row in local.reshape(-1, local.shape[-1])]
            return directions @ self.centre + np.reshape(highest, local.shape[:-1])
        points, rays, lines = self.generators
        cone = np.vstack([rays, lines, -lines]).T
        open_ended = local @ cone > FLAT * (abs(directions) @ abs(self.basis) @ abs(cone))
        highest = (local @ points.T).max(axis=-1)
        return np.where(open_ended.any(axis=-1), np.inf, directions @ self.centre + highest)

    def _support_by_program(self, direction):
        size = np.linalg.norm(direction)
        if size == 0:
            return 0.0
        if recedes(self.polar, -direction / size):
            return np.inf
        solution, _ = solve(-direction / size, self.polar, np.ones(len(self.polar)))
        return direction @ solution


def find_frame(normals: Float[np.ndarray, "m n"], offsets: Float[np.ndarray, " m"]) -> Frame | None:
    """Return the frame of {x : normals x <= offsets}, None if empty: it sheds equalities until
    there is interior."""
    sizes, dimension = np.linalg.norm(normals, axis=1), normals.shape[1]
    if not sizes.all():
        return None
    unit, heights = normals / sizes[:, None], offsets / sizes
    rows, equalities = np.arange(len(unit)), np.zeros(0, dtype=int)
    centre, basis, extent = np.zeros(dimension), np.eye(dimension), np.zeros(dimension)
    while basis.shape[1]:
        centre, basis, extent, depth, doubt, tight = _deepest(
            unit[rows], heights[rows], centre, basis, extent
        )
        if depth < -doubt:
            return None
        if depth > doubt or not tight.size:
            break
        local = unit[rows] @ basis
        local = local / np.linalg.norm(local, axis=1, keepdims=True)
        factor, triangle, order = qr(local[tight].T, pivoting=True)  # pyright: ignore[reportAssignmentType]
        rank = int((abs(np.diag(triangle)) > FLAT).sum())
        equalities = np.concatenate([equalities, rows[tight[order[:rank]]]])
        tangent = np.asarray(factor)[:, rank:]
        rows = rows[np.linalg.norm(local @ tangent, axis=1) > FLAT]
        basis = basis @ tangent
    slacks = offsets[rows] - normals[rows] @ centre
    return Frame(centre, basis, normals[rows] @ basis / slacks[:, None], slacks, rows, equalities)


def _deepest(unit, heights, centre, basis, extent):
    """Move the centre to the deepest point, in coordinates rescaled until its depth is plain to
    see.

    Return with it the basis, the extent of what was computed with so far, the depth, the depth
    below which it may be rounding, and the rows that bind: their multipliers are positive and sum
    to zero with their normals, so at depth zero each of them holds with equality on the whole set.
    """
    for _ in range(3):
        slacks, local = heights - unit @ centre, unit @ basis
        noise = ROUNDING * (abs(heights) + abs(unit) @ extent)
        scales = _column_scales(local, np.where(abs(slacks) > noise, slacks, 0.0))
        basis, local = basis * scales, local * scales
        lengths = np.linalg.norm(local, axis=1)
        extent = np.maximum(extent, abs(centre) + abs(basis).sum(axis=1))
        cap = np.eye(len(scales) + 1)[-1:]
        program = np.vstack([np.column_stack([local / lengths[:, None], np.ones(len(local))]), cap])
        solution, weights = solve(-cap[0], program, np.append(slacks / lengths, DEEP))
        centre, depth = centre + basis @ solution[:-1], solution[-1]
        tight = np.flatnonzero(weights[:-1] > 1e-4)
        doubt = max(FLAT, (noise / lengths)[tight].min(initial=DEEP))
        if depth > PLAIN:
            break
    return centre, basis, extent, depth, doubt, tight


def _column_scales(rows, slacks):
    """Return the s that bring the entries of rows s y <= slacks near to one size, rows being free
    to scale.

    Rows and columns of [rows, slacks] are in turn divided by the root mean square of their entries
    (Sinkhorn 1967, Am. Math. Mon. 74, 402-405), so that the large ones decide. Entries small in
    their row and their column do not count: rounding has no say, and the iteration converges for
    every pattern, as its limit with all entries one shows.
    """
    table = abs(np.column_stack([rows, slacks]))
    scales = np.ones(table.shape[1])
    for _ in range(100):
        factors = np.ones(1)
        for axis in (1, 0):
            heads = table.max(axis=1, keepdims=True) * table.max(axis=0, keepdims=True, initial=0.0)
            counts = np.maximum((table**2 > 1e-16 * heads).sum(axis=axis, keepdims=True), 1)
            factors = np.sqrt((table**2).sum(axis=axis, keepdims=True) / counts)
            factors[factors == 0] = 1.0
            table = table / factors
        scales = scales / factors[0]
        if abs(np.log(factors)).max() < 0.1:
            break
    return scales[:-1] / scales[-1]


def solve(
    cost: Float[np.ndarray, " n"], rows: Float[np.ndarray, "m n"], limits: Float[np.ndarray, " m"]
) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " m"]]:
    """Minimise cost x over rows x <= limits; return x and the multipliers, optimal to 1e-8 by their
    own residuals.

    The program must be feasible and bounded; ArithmeticError if no method of the solver gets that
    far.
    """
    options = {"primal_feasibility_tolerance": 1e-10, "dual_feasibility_tolerance": 1e-10}
    for method in ("highs", "highs-ds", "highs-ipm"):
        answer = linprog(cost, rows, limits, bounds=(None, None), method=method, options=options)
        if answer.status != 0:
            continue
        solution, multipliers = answer.x, -answer.ineqlin.marginals
        misfit = max(
            ((rows @ solution - limits) / (1 + abs(limits))).max(initial=0.0),
            -multipliers.min(initial=0.0),
            abs(cost + multipliers @ rows).max(),
            abs(cost @ solution + multipliers @ limits) / (1 + abs(cost @ solution)),
        )
        if misfit <= 1e-8:
            return solution, multipliers
    raise ArithmeticError(
        "linear program not solved to 1e-8: rescale the coordinates of the polytope"
    )


def recedes(rows: Float[np.ndarray, "m n"], cost: Float[np.ndarray, " n"]) -> bool:
    """Tell whether cost x falls along a ray of rows x <= 0, hence without bound over rows x <=
    limits if not empty."""
    rows = rows / np.maximum(np.linalg.norm(rows, axis=1, keepdims=True), np.finfo(float).tiny)
    cube = np.vstack([np.eye(len(cost)), -np.eye(len(cost))])
    solution, _ = solve(
        cost, np.vstack([rows, cube]), np.append(np.zeros(len(rows)), np.ones(len(cube)))
    )
    return bool(cost @ solution < -FLAT)


def _dual(polar):
    """Return vertices, rays and lines of {y : polar y <= 1} from the hull of polar and 0."""
    coordinates, inverse, lines = flatten(np.vstack([np.zeros(polar.shape[1]), polar]))
    normals, offsets, _ = hull(coordinates)
    heights = offsets - normals @ coordinates[0]
    far = heights <= FAR
    rays, lines = (
        np.where(abs(cone) <= 1e-12 * abs(cone).max(axis=1, initial=0.0, keepdims=True), 0.0, cone)
        for cone in (normals[far] @ inverse, lines)
    )
    return normals[~far] @ inverse / heights[~far, None], rays, lines


def flatten(
    points: Float[np.ndarray, "k n"],
) -> tuple[Float[np.ndarray, "k d"], Float[np.ndarray, "d n"], Float[np.ndarray, "e n"]]:
    """Return isotropic coordinates of a cloud in its affine hull, the map x -> coordinates, and the
    hull's normals."""
    extent, reach = np.ptp(points, axis=0), abs(points).max(axis=0)
    constant = extent <= np.maximum(
        ROUNDING * reach, 4 * np.finfo(float).eps * reach.max(initial=0.0)
    )
    scale = np.where(constant, extent.max(initial=0.0) or 1.0, extent)
    scaled = np.where(constant, 0.0, (points - points.mean(axis=0)) / scale)
    _, spread, axes = np.linalg.svd(np.linalg.qr(scaled, mode="r"))
    doubt = max(FLAT, ROUNDING * (reach / scale).max(initial=0.0))
    rank = int((spread > doubt * spread.max(initial=0.0)).sum())
    spread = spread[:rank] / np.sqrt(len(points))
    return (
        scaled @ axes[:rank].T / spread,
        axes[:rank] / scale / spread[:, None],
        axes[rank:] / scale,
    )


def product(
    left: Float[np.ndarray, "m k"], right: Float[np.ndarray, "k n"]
) -> Float[np.ndarray, "m n"]:
    """Multiply, and take for zero the entries that are mere rounding: in badly scaled coordinates
    they would bind."""
    result = left @ right
    return np.where(abs(result) <= ROUNDING * (abs(left) @ abs(right)), 0.0, result)


def hull(
    points: Float[np.ndarray, "k d"],
) -> tuple[Float[np.ndarray, "f d"], Float[np.ndarray, " f"], Int[np.ndarray, " v"]]:
    """Return facets a y <= b of a cloud that is not flat, and its extreme points; qhull begins at
    dimension two."""
    if points.shape[1] == 0:
        return np.zeros((1, 0)), np.ones(1), np.zeros(1, dtype=int)
    if points.shape[1] == 1:
        ends = np.array([points.argmax(), points.argmin()])
        return np.array([[1.0], [-1.0]]), points[ends, 0] * [1.0, -1.0], ends
    for apart, options in ((SAME, None), (100 * SAME, "QJ")):
        distinct = _distinct(points, apart)
        try:
            found = ConvexHull(points[distinct], qhull_options=options)
        except (
            QhullError
        ):  # clusters of almost equal points can stop qhull, unless it may displace them by 1e-10
            continue
        facets = found.equations[_distinct(found.equations, apart)]
        return facets[:, :-1], -facets[:, -1], distinct[found.vertices]
    raise ArithmeticError(
        f"hull of {len(points)} points not found: drop points closer than 1e-9 of their spread"
    )


def _distinct(points, apart):
    """Return indices of points such that those left out lie within `apart` of others."""
    first = np.unique(points, axis=0, return_index=True)[1]
    pairs = KDTree(points[first]).query_pairs(apart, output_type="ndarray")
    return np.sort(np.delete(first, pairs.max(axis=1)))
