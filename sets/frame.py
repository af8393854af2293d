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
from typing import NamedTuple

import highspy
import numpy as np
from jaxtyping import Float, Int
from scipy.linalg import qr
from scipy.spatial import ConvexHull, KDTree, QhullError

FLAT = 1e-9
"""Relative thickness below which a set has no interior."""

SAME = 1e-11
"""Relative distance below which two points or facets are one."""

FAR = 1e-11
"""A vertex further away than 1 / FAR unit sizes is a ray."""

ROUNDING = 1e-14
"""Relative error of data that went through a few operations."""

DEEP = 10.0
"""Depth, in unit sizes, at which the search stops: only unbounded sets reach it."""

PLAIN = 1e-2
"""Depth, in unit sizes, at which no doubt about the interior is left."""

HULL_DIMENSION = 4
"""Above this dimension vertices may explode: the support function goes by linear programs."""


SOLVER_OPTIONS = {
    "output_flag": False,
    "primal_feasibility_tolerance": 1e-10,
    "dual_feasibility_tolerance": 1e-10,
}
"""Of HiGHS."""


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
    def isotropic(
        self,
    ) -> tuple[Float[np.ndarray, "k d"], Float[np.ndarray, "d n"], Float[np.ndarray, "e n"]]:
        """Isotropic coordinates of 0 and the polar points, the map to them, and the lines of the
        set."""
        return flatten(_with_origin(self.polar))

    @cached_property
    def generators(
        self,
    ) -> tuple[Float[np.ndarray, "v d"], Float[np.ndarray, "r d"], Float[np.ndarray, "l d"]]:
        """Vertices, rays and lines whose sum is the set, each (count, d)."""
        points, _, _ = _find_generators(self.polar)
        # A deepest point can lie at one end of the set: the second pass starts at the middle of
        # the vertices that the first one found.
        middle = points.sum(axis=0) / (len(points) + 1)
        room = 1 - self.polar @ middle
        points, rays, lines = _find_generators(self.polar / room[:, None])
        points = points + middle
        lengths = np.linalg.norm(self.polar, axis=1)
        excess = (self.polar @ points.T - 1) / lengths[:, None]
        size = np.linalg.norm(points, axis=1).max()
        if excess.max(initial=0.0) > FLAT * size:
            raise ArithmeticError(
                "vertices violate their rows: rescale the coordinates of the polytope"
            )
        return points, rays, lines

    @cached_property
    def facets(self) -> Int[np.ndarray, " facets"]:
        """Positions in `rows` of the rows that are not redundant."""
        coordinates, _, _ = self.isotropic
        _, _, corners = find_hull(coordinates)
        candidates = corners[corners > 0] - 1
        proper = [self._supports_facet(self.polar[i]) for i in candidates]
        return candidates[np.array(proper, dtype=bool)]

    def _supports_facet(self, row: Float[np.ndarray, " d"]) -> bool:
        """Return whether a row touches the set in a facet.

        Rounding makes facets of rows that touch it in a face of lower dimension.
        """
        points, rays, lines = self.generators
        length = np.linalg.norm(row)
        size = np.linalg.norm(points, axis=1).max()
        touching = points[abs(points @ row - 1) <= FLAT * size * length]
        ray_lengths = np.linalg.norm(rays, axis=1)
        parallel = rays[abs(rays @ row) <= FLAT * length * ray_lengths]
        if not len(touching):
            return False
        face = np.vstack([touching - touching[:1], parallel, lines])
        return bool(np.linalg.matrix_rank(face, tol=FLAT * size) >= len(row) - 1)

    def support(self, directions: Float[np.ndarray, "*shape n"]) -> Float[np.ndarray, "*shape"]:
        """Return h_P(d) = d centre + max {d basis y : polar y <= 1}; rays within 1e-9 of right
        angles to d stay out."""
        local = directions @ self.basis
        if self.basis.shape[1] > HULL_DIMENSION:
            flat = local.reshape(-1, local.shape[-1])
            highest = [self._support_by_program(row) for row in flat]
            return directions @ self.centre + np.reshape(highest, local.shape[:-1])
        points, rays, lines = self.generators
        cone = np.vstack([rays, lines, -lines]).T
        size = abs(directions) @ abs(self.basis) @ abs(cone)
        is_open = (local @ cone > FLAT * size).any(axis=-1)
        highest = (local @ points.T).max(axis=-1)
        return np.where(is_open, np.inf, directions @ self.centre + highest)

    def _support_by_program(self, direction: Float[np.ndarray, " d"]) -> float:
        size = np.linalg.norm(direction)
        if size == 0:
            return 0.0
        cost = -direction / size
        if has_falling_ray(self.polar, cost):
            return np.inf
        solution, _ = solve_program(cost, self.polar, np.ones(len(self.polar)))
        return float(direction @ solution)


class _Depth(NamedTuple):
    """A deepest point, and how sure its depth is.

    `extent` bounds the numbers computed with so far; a depth below `doubt` may be rounding. The
    `tight` rows bind: their multipliers are positive and sum to zero with their normals, so at
    depth zero each of them holds with equality on the whole set.
    """

    centre: Float[np.ndarray, " n"]
    basis: Float[np.ndarray, "n d"]
    extent: Float[np.ndarray, " n"]
    depth: float
    doubt: float
    tight: Int[np.ndarray, " t"]


def find_frame(normals: Float[np.ndarray, "m n"], offsets: Float[np.ndarray, " m"]) -> Frame | None:
    """Return the frame of {x : normals x <= offsets}, None if empty: it sheds equalities until
    there is interior."""
    dimension = normals.shape[1]
    sizes = np.linalg.norm(normals, axis=1)
    if not sizes.all():
        return None
    unit = normals / sizes[:, None]
    heights = offsets / sizes
    rows = np.arange(len(unit))
    equalities = np.zeros(0, dtype=int)
    centre = np.zeros(dimension)
    basis = np.eye(dimension)
    extent = np.zeros(dimension)
    while basis.shape[1]:
        deepest = _find_deepest(unit[rows], heights[rows], centre, basis, extent)
        centre, basis, extent, depth, doubt, tight = deepest
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
    polar = normals[rows] @ basis / slacks[:, None]
    return Frame(centre, basis, polar, slacks, rows, equalities)


def _find_deepest(unit, heights, centre, basis, extent) -> _Depth:
    """Move the centre to the deepest point, in coordinates rescaled until its depth is plain to
    see."""
    depth = doubt = np.nan
    tight = np.zeros(0, dtype=int)
    for _ in range(3):
        slacks = heights - unit @ centre
        noise = ROUNDING * (abs(heights) + abs(unit) @ extent)
        local = unit @ basis
        scales = _find_column_scales(local, np.where(abs(slacks) > noise, slacks, 0.0))
        basis = basis * scales
        local = local * scales
        extent = np.maximum(extent, abs(centre) + abs(basis).sum(axis=1))
        lengths = np.linalg.norm(local, axis=1)
        cap = np.eye(len(scales) + 1)[-1:]
        balls = np.column_stack([local / lengths[:, None], np.ones(len(local))])
        limits = np.append(slacks / lengths, DEEP)
        solution, weights = solve_program(-cap[0], np.vstack([balls, cap]), limits)
        centre = centre + basis @ solution[:-1]
        depth = solution[-1]
        tight = np.flatnonzero(weights[:-1] > 1e-4)
        doubt = max(FLAT, (noise / lengths)[tight].min(initial=DEEP))
        if depth > PLAIN:
            break
    return _Depth(centre, basis, extent, depth, doubt, tight)


def _find_column_scales(
    rows: Float[np.ndarray, "k n"], slacks: Float[np.ndarray, " k"]
) -> Float[np.ndarray, " n"]:
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
            squares = table**2
            row_heads = table.max(axis=1, keepdims=True)
            column_heads = table.max(axis=0, keepdims=True, initial=0.0)
            counts = (squares > 1e-16 * (row_heads * column_heads)).sum(axis=axis, keepdims=True)
            means = squares.sum(axis=axis, keepdims=True) / np.maximum(counts, 1)
            factors = np.sqrt(means)
            factors[factors == 0] = 1.0
            table = table / factors
        scales = scales / factors[0]
        if abs(np.log(factors)).max() < 0.1:
            break
    return scales[:-1] / scales[-1]


def solve_program(
    cost: Float[np.ndarray, " n"], rows: Float[np.ndarray, "m n"], limits: Float[np.ndarray, " m"]
) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " m"]]:
    """Minimise cost x over rows x <= limits; return x and the multipliers, optimal to 1e-8 by their
    own residuals.

    Raises:
        ArithmeticError: no method of the solver gets that far; the program must be feasible and
            bounded.
    """
    for solver in ("choose", "simplex", "ipm"):
        solution, multipliers = _run_solver(solver, cost, rows, limits)
        if _compute_misfit(cost, rows, limits, solution, multipliers) <= 1e-8:
            return solution, multipliers
    raise ArithmeticError(
        "linear program not solved to 1e-8: rescale the coordinates of the polytope"
    )


def _run_solver(
    solver: str,
    cost: Float[np.ndarray, " n"],
    rows: Float[np.ndarray, "m n"],
    limits: Float[np.ndarray, " m"],
) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " m"]]:
    """Return x and multipliers as HiGHS leaves them; NaN where it has none."""
    highs = _start_solver(solver, cost, rows, limits)
    return _read_answer(highs, rows)


def _start_solver(
    solver: str,
    cost: Float[np.ndarray, " n"],
    rows: Float[np.ndarray, "m n"],
    limits: Float[np.ndarray, " m"],
) -> highspy.Highs:
    """Return HiGHS with a program."""
    count, dimension = rows.shape
    program = highspy.HighsLp()
    program.num_col_ = dimension
    program.num_row_ = count
    program.col_cost_ = cost
    program.col_lower_ = np.full(dimension, -np.inf)
    program.col_upper_ = np.full(dimension, np.inf)
    program.row_lower_ = np.full(count, -np.inf)
    program.row_upper_ = limits
    program.a_matrix_.format_ = highspy.MatrixFormat.kRowwise
    program.a_matrix_.start_ = dimension * np.arange(count + 1)
    program.a_matrix_.index_ = np.tile(np.arange(dimension), count)
    program.a_matrix_.value_ = rows.ravel()
    highs = highspy.Highs()
    for option, value in SOLVER_OPTIONS.items():
        highs.setOptionValue(option, value)
    highs.setOptionValue("solver", solver)
    highs.passModel(program)
    return highs


def _read_answer(
    highs: highspy.Highs, rows: Float[np.ndarray, "m n"]
) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " m"]]:
    """Run HiGHS and return x and multipliers; NaN where it has none."""
    highs.run()
    answer = highs.getSolution()
    if not (answer.value_valid and answer.dual_valid):
        return np.full(rows.shape[1], np.nan), np.full(len(rows), np.nan)
    return np.array(answer.col_value), -np.array(answer.row_dual)


def solve_programs(
    costs: Float[np.ndarray, "k n"], rows: Float[np.ndarray, "m n"], limits: Float[np.ndarray, " m"]
) -> Float[np.ndarray, "k n"]:
    """Minimise each cost x over rows x <= limits; return every x, optimal to 1e-8 by its own
    residuals. Each program begins with the answer of the one before.

    Raises:
        ArithmeticError: as `solve_program`.
    """
    highs = _start_solver("choose", costs[0], rows, limits)
    columns = np.arange(rows.shape[1], dtype=np.int32)
    answers = []
    for cost in costs:
        highs.changeColsCost(len(columns), columns, cost)
        solution, multipliers = _read_answer(highs, rows)
        if not _compute_misfit(cost, rows, limits, solution, multipliers) <= 1e-8:
            solution, _ = solve_program(cost, rows, limits)
        answers.append(solution)
    return np.array(answers)


def _compute_misfit(cost, rows, limits, solution, multipliers) -> float:
    """Return the largest residual of the optimality conditions."""
    value = cost @ solution
    violation = (rows @ solution - limits) / (1 + abs(limits))
    gap = abs(value + multipliers @ limits) / (1 + abs(value))
    return max(
        violation.max(initial=0.0),
        -multipliers.min(initial=0.0),
        abs(cost + multipliers @ rows).max(),
        gap,
    )


def has_falling_ray(rows: Float[np.ndarray, "m n"], cost: Float[np.ndarray, " n"]) -> bool:
    """Return whether cost x falls along a ray of rows x <= 0, hence without bound over rows x <=
    limits if not empty."""
    lengths = np.linalg.norm(rows, axis=1, keepdims=True)
    unit = rows / np.maximum(lengths, np.finfo(float).tiny)
    cube = np.vstack([np.eye(len(cost)), -np.eye(len(cost))])
    limits = np.append(np.zeros(len(rows)), np.ones(len(cube)))
    solution, _ = solve_program(cost, np.vstack([unit, cube]), limits)
    return bool(cost @ solution < -FLAT)


def _with_origin(polar: Float[np.ndarray, "k d"]) -> Float[np.ndarray, "k+1 d"]:
    return np.vstack([np.zeros(polar.shape[1]), polar])


def _find_generators(
    polar: Float[np.ndarray, "k d"],
) -> tuple[Float[np.ndarray, "v d"], Float[np.ndarray, "r d"], Float[np.ndarray, "l d"]]:
    """Return vertices, rays and lines of {y : polar y <= 1} from the hull of polar and 0."""
    coordinates, inverse, lines = flatten(_with_origin(polar))
    normals, offsets, _ = find_hull(coordinates)
    heights = offsets - normals @ coordinates[0]
    far = heights <= FAR
    points = normals[~far] @ inverse / heights[~far, None]
    return points, _without_rounding(normals[far] @ inverse), _without_rounding(lines)


def _without_rounding(cone: Float[np.ndarray, "k d"]) -> Float[np.ndarray, "k d"]:
    """Take for zero the entries of each row that are small beside its largest one."""
    sizes = abs(cone).max(axis=1, initial=0.0, keepdims=True)
    return np.where(abs(cone) <= 1e-12 * sizes, 0.0, cone)


def flatten(
    points: Float[np.ndarray, "k n"],
) -> tuple[Float[np.ndarray, "k d"], Float[np.ndarray, "d n"], Float[np.ndarray, "e n"]]:
    """Return isotropic coordinates of a cloud in its affine hull, the map x -> coordinates, and the
    hull's normals."""
    extent = np.ptp(points, axis=0)
    reach = abs(points).max(axis=0)
    rounding = np.maximum(ROUNDING * reach, 4 * np.finfo(float).eps * reach.max(initial=0.0))
    is_constant = extent <= rounding
    scale = np.where(is_constant, extent.max(initial=0.0) or 1.0, extent)
    scaled = np.where(is_constant, 0.0, (points - points.mean(axis=0)) / scale)
    _, spread, axes = np.linalg.svd(np.linalg.qr(scaled, mode="r"))
    doubt = max(FLAT, ROUNDING * (reach / scale).max(initial=0.0))
    rank = int((spread > doubt * spread.max(initial=0.0)).sum())
    spread = spread[:rank] / np.sqrt(len(points))
    coordinates = scaled @ axes[:rank].T / spread
    inverse = axes[:rank] / scale / spread[:, None]
    return coordinates, inverse, axes[rank:] / scale


def multiply(
    left: Float[np.ndarray, "m k"], right: Float[np.ndarray, "k n"]
) -> Float[np.ndarray, "m n"]:
    """Multiply, and take for zero the entries that are mere rounding: in badly scaled coordinates
    they would bind."""
    product = left @ right
    size = abs(left) @ abs(right)
    return np.where(abs(product) <= ROUNDING * size, 0.0, product)


def find_hull(
    points: Float[np.ndarray, "k d"],
) -> tuple[Float[np.ndarray, "f d"], Float[np.ndarray, " f"], Int[np.ndarray, " v"]]:
    """Return facets a y <= b of a cloud that is not flat, and its extreme points; qhull begins at
    dimension two.

    Raises:
        ArithmeticError: too many points are almost equal.
    """
    if points.shape[1] == 0:
        return np.zeros((1, 0)), np.ones(1), np.zeros(1, dtype=int)
    if points.shape[1] == 1:
        ends = np.array([points.argmax(), points.argmin()])
        signs = np.array([1.0, -1.0])
        return signs[:, None], points[ends, 0] * signs, ends
    for apart, options in ((SAME, None), (100 * SAME, "QJ")):
        distinct = _find_distinct(points, apart)
        try:
            hull = ConvexHull(points[distinct], qhull_options=options)
        except QhullError:
            # Clusters of almost equal points can stop qhull, unless it may displace them by 1e-10.
            continue
        facets = hull.equations[_find_distinct(hull.equations, apart)]
        return facets[:, :-1], -facets[:, -1], distinct[hull.vertices]
    raise ArithmeticError(
        f"hull of {len(points)} points not found: drop points closer than 1e-9 of their spread"
    )


def _find_distinct(points: Float[np.ndarray, "k d"], apart: float) -> Int[np.ndarray, " kept"]:
    """Return indices of points such that each one left out lies within `apart` of an earlier
    one."""
    _, first = np.unique(points, axis=0, return_index=True)
    first = np.sort(first)
    pairs = KDTree(points[first]).query_pairs(apart, output_type="ndarray")
    return np.delete(first, pairs.max(axis=1))
