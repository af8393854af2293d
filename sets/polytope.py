"""Polytopes {x : H x <= h} whose operations are exact and reduce to the support function h_P(d) =
max {d x : x in P}.

Support numbers answer inclusion, P contains Q if and only if h_Q(H_i) <= h_i for all rows, and the
Pontryagin difference, P - Q = {x : H x <= h - h_Q(H)} (Kolmanovsky and Gilbert 1998, Math. Probl.
Eng. 4, section 2). Vertices serve sums, hulls and singular images.

A set thinner than 1e-9 of its width, or than the rounding of its own data, is flat; results are
exact to 1e-9 of the set's size.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Bool, Float
from scipy.spatial import ConvexHull

from sets.frame import (
    Frame,
    find_frame,
    find_hull,
    flatten,
    has_falling_ray,
    multiply,
    solve_program,
)

SupportFunction = Callable[[Float[np.ndarray, "k n"]], Float[np.ndarray, " k"]]
"""Takes directions as rows and returns the support numbers of a set along them."""


@dataclass(frozen=True, eq=False)
class Polytope:
    """The set {x : normals x <= offsets}; rows `0 x <= h >= 0` and rows with offset +inf are
    dropped."""

    normals: Float[np.ndarray, "facets dimension"]
    offsets: Float[np.ndarray, " facets"]

    def __post_init__(self):
        normals = np.array(self.normals, dtype=float)
        offsets = np.array(self.offsets, dtype=float)
        if normals.ndim != 2 or normals.shape[1] == 0 or offsets.shape != normals.shape[:1]:
            raise ValueError(
                f"normals {normals.shape}, offsets {offsets.shape}: "
                "give (facets, dimension), (facets,)"
            )
        if not np.isfinite(normals).all():
            raise ValueError("normals: NaN or infinite entry; give finite facet normals")
        if np.isnan(offsets).any() or (offsets == -np.inf).any():
            raise ValueError(
                "offsets: NaN or -inf entry; "
                "give finite offsets, or +inf for a row that does not bind"
            )
        binds = (offsets < np.inf) & (normals.any(axis=1) | (offsets < 0))
        self._keep("normals", normals[binds])
        self._keep("offsets", offsets[binds])

    def _keep(self, name: str, array: np.ndarray) -> None:
        array.flags.writeable = False
        object.__setattr__(self, name, array)

    @staticmethod
    def box(
        lower: Float[np.ndarray, " dimension"], upper: Float[np.ndarray, " dimension"]
    ) -> Polytope:
        """Build {x : lower <= x <= upper}; infinite bounds do not bind, crossed bounds give the
        empty set."""
        lower, upper = np.broadcast_arrays(np.atleast_1d(lower), np.atleast_1d(upper))
        identity = np.eye(lower.size)
        return Polytope(np.vstack([identity, -identity]), np.concatenate([upper, -lower]))

    @staticmethod
    def from_vertices(points: Float[np.ndarray, "points dimension"]) -> Polytope:
        """Build the convex hull of points; directions in which they are flat become two opposite
        rows."""
        points = _check_cloud(points)
        if not len(points):
            return Polytope(np.zeros((1, points.shape[1])), -np.ones(1))
        coordinates, inverse, flat = flatten(points)
        facets, _, _ = find_hull(coordinates)
        normals = np.vstack([multiply(facets, inverse), flat])
        lengths = np.linalg.norm(normals, axis=1, keepdims=True)
        normals = normals / np.maximum(lengths, np.finfo(float).tiny)
        # Support numbers of the cloud itself, so that the rounding of its hull cuts no point off.
        numbers, constants = np.split(points @ normals.T, [len(facets)], axis=1)
        level = constants.mean(axis=0)
        return Polytope(
            np.vstack([normals, -normals[len(facets) :]]),
            np.concatenate([numbers.max(axis=0), level, -level]),
        )

    @property
    def dimension(self) -> int:
        """Dimension of the space the set lives in."""
        return self.normals.shape[1]

    @cached_property
    def _frame(self) -> Frame | None:
        return find_frame(self.normals, self.offsets)

    def support(
        self, directions: Float[np.ndarray, "*directions dimension"]
    ) -> Float[np.ndarray, "*directions"]:
        """Return max {d x : x in P} for each direction d: exact, +inf where unbounded, -inf if P is
        empty."""
        directions = self._check("directions", directions)
        if not np.isfinite(directions).all():
            raise ValueError("directions: NaN or infinite entry; give finite directions")
        if self._frame is None:
            return np.full(directions.shape[:-1], -np.inf)[()]
        return self._frame.support(directions)[()]

    def vertices(self) -> Float[np.ndarray, "vertices dimension"]:
        """Return the vertices, (0, dimension) if empty.

        Raises:
            ValueError: the set is unbounded.
        """
        if self._frame is None:
            return np.zeros((0, self.dimension))
        points, rays, lines = self._frame.generators
        if len(rays) or len(lines):
            raise ValueError("polytope is unbounded: intersect it with a box to give it vertices")
        return self._frame.centre + points @ self._frame.basis.T

    def volume(self) -> float:
        """Return the volume: 0 if empty or flat, inf if unbounded with interior."""
        if self._frame is None or self.is_flat():
            return 0.0
        if not self.is_bounded():
            return np.inf
        coordinates, inverse, _ = flatten(self.vertices())
        size = np.ptp(coordinates) if self.dimension == 1 else ConvexHull(coordinates).volume
        return float(size / abs(np.linalg.det(inverse)))

    def chebyshev(self) -> tuple[Float[np.ndarray, " dimension"], float]:
        """Return a centre and the radius of a largest ball in P; the ball is inside, for the radius
        is its margin.

        Flat: radius 0 about a point of P. Balls without bound: radius inf. Empty: radius -inf and
        no centre (NaN).
        """
        frame = self._frame
        if frame is None:
            return np.full(self.dimension, np.nan), -np.inf
        if frame.equalities.size:
            return frame.centre, 0.0
        # In units of the radius about the frame's centre the ball's weight in every row is at most
        # one. Solvers drop coefficients below 1e-9, and a larger weight only asks for more room.
        distances = frame.slacks / np.linalg.norm(self.normals[frame.rows], axis=1)
        weights = np.maximum(distances.min(initial=np.inf) / distances, 2e-9)
        _, inverse, _ = frame.isotropic
        weighted = np.column_stack([frame.polar @ inverse.T, weights])
        cost = -np.eye(weighted.shape[1])[-1]
        if has_falling_ray(weighted, cost):
            return frame.centre, np.inf
        solution, _ = solve_program(cost, weighted, np.ones(len(weighted)))
        # The step back costs 1e-9 of the radius and gives far rows the room that the solver's
        # tolerance took.
        centre = frame.centre + (1 - 1e-9) * (frame.basis @ (solution[:-1] @ inverse))
        return centre, float(self.margin(centre))

    def is_empty(self) -> bool:
        """Return whether no point satisfies all rows."""
        return self._frame is None

    def is_flat(self) -> bool:
        """Return whether the set is not empty and has no interior."""
        return self._frame is not None and self._frame.equalities.size > 0

    def is_bounded(self) -> bool:
        """Return whether the set, empty ones included, fits in a box."""
        identity = np.eye(self.dimension)
        return bool((self.support(np.vstack([identity, -identity])) < np.inf).all())

    def contains(
        self, points: Float[np.ndarray, "*points dimension"], tolerance: float = 0.0
    ) -> Bool[np.ndarray, "*points"]:
        """Return which points satisfy H x <= h + tolerance ||H_i||; a NaN is outside every proper
        subset."""
        lengths = np.linalg.norm(self.normals, axis=1)
        slacks = self._compute_slacks(points)
        return (slacks >= -tolerance * lengths).all(axis=-1)

    def margin(
        self, points: Float[np.ndarray, "*points dimension"]
    ) -> Float[np.ndarray, "*points"]:
        """Return min_i (h_i - H_i x) / ||H_i||: the distance to the nearest facet plane, negative
        outside."""
        return self._find_least(self._compute_slacks(points))

    def containment_margin(self, other: Polytope) -> float:
        """Return min_i (h_i - h_other(H_i)) / ||H_i||: >= 0 if and only if other is a subset.

        It is +inf if other is empty and -inf if other is unbounded along one of the rows.
        """
        self._check("other.normals", other.normals)
        slacks = self.offsets - other.support(self.normals)
        return float(self._find_least(slacks))

    def intersect(self, other: Polytope) -> Polytope:
        """Return the points in both sets."""
        self._check("other.normals", other.normals)
        normals = np.vstack([self.normals, other.normals])
        return Polytope(normals, np.concatenate([self.offsets, other.offsets]))

    def preimage(
        self,
        matrix: Float[np.ndarray, "dimension k"],
        shift: Float[np.ndarray, " dimension"] | None = None,
    ) -> Polytope:
        """Return {x : matrix x + shift in P}: exact for every matrix, no vertices."""
        matrix = np.asarray(matrix, dtype=float)
        shift = np.zeros(self.dimension) if shift is None else np.asarray(shift, dtype=float)
        if matrix.ndim != 2 or len(matrix) != self.dimension or shift.shape != (self.dimension,):
            raise ValueError(
                f"matrix {matrix.shape}, shift {shift.shape}: "
                f"give ({self.dimension}, k), ({self.dimension},)"
            )
        size = abs(self.offsets) + abs(self.normals) @ abs(shift)
        offsets = _subtract(self.offsets, self.normals @ shift, size)
        return Polytope(multiply(self.normals, matrix), offsets)

    def image(self, matrix: Float[np.ndarray, "k dimension"]) -> Polytope:
        """Return {matrix x : x in P}: exact, by the inverse where it is well conditioned, else by
        the vertices.

        Raises:
            ValueError: the set is unbounded and its vertices are needed.
        """
        matrix = self._check("matrix", matrix)
        rows = abs(matrix).max(axis=1, initial=0.0, keepdims=True)
        columns = (abs(matrix) / np.where(rows > 0, rows, 1.0)).max(axis=0, initial=0.0)
        is_square = matrix.shape[0] == matrix.shape[1]
        if is_square and rows.all() and columns.all():
            scaled = matrix / rows / columns
            if np.linalg.cond(scaled) <= 1e6:
                normals = multiply(self.normals / columns, np.linalg.inv(scaled))
                return Polytope(normals / rows[:, 0], self.offsets)
        return Polytope.from_vertices(self.vertices() @ matrix.T)

    def minkowski_sum(self, other: Polytope) -> Polytope:
        """Return {x + y : x in P, y in other}: exact, by the hull of all sums of vertices; both
        bounded."""
        self._check("other.normals", other.normals)
        sums = self.vertices()[:, None, :] + other.vertices()[None, :, :]
        return Polytope.from_vertices(sums.reshape(-1, self.dimension))

    def pontryagin_difference(self, other: ConvexSet) -> Polytope:
        """Return {x : x + other in P}, exact, of any set that has or is a support function."""
        support = support_function(other, "other")
        axes = np.vstack([np.eye(self.dimension), -np.eye(self.dimension)])
        numbers = np.asarray(support(np.vstack([self.normals, axes])), dtype=float)
        along_normals, along_axes = np.split(numbers, [len(self.normals)])
        widths = np.where(np.isfinite(along_axes), abs(along_axes), 0.0)
        extent = widths.reshape(2, -1).max(axis=0)
        size = abs(self.offsets) + abs(self.normals) @ extent
        offsets = _subtract(self.offsets, along_normals, size)
        if (offsets == -np.inf).any():
            return Polytope.from_vertices(np.zeros((0, self.dimension)))
        return Polytope(self.normals, offsets)

    def scale(self, factor: float) -> Polytope:
        """Return {factor x : x in P} for factor >= 0; factor 0 gives the origin alone."""
        if not 0 <= factor < np.inf:
            raise ValueError(
                f"factor {factor}: give a finite factor >= 0 (a reflection is image(-identity))"
            )
        if factor == 0 and not self.is_empty():
            return Polytope.box(np.zeros(self.dimension), np.zeros(self.dimension))
        return Polytope(self.normals, self.offsets * (factor or 1.0))

    def with_unit_normals(self) -> Polytope:
        """Return the same set by rows of norm one; none may be zero."""
        norms = np.linalg.norm(self.normals, axis=1)
        return Polytope(self.normals / norms[:, None], self.offsets / norms)

    def reduce(self) -> Polytope:
        """Return the same set by rows of which none is redundant; implicit equalities become two
        opposite rows."""
        frame = self._frame
        if frame is None:
            return Polytope.from_vertices(np.zeros((0, self.dimension)))
        facets = frame.rows[frame.facets]
        flat = frame.equalities
        return Polytope(
            np.vstack([self.normals[facets], self.normals[flat], -self.normals[flat]]),
            np.concatenate([self.offsets[facets], self.offsets[flat], -self.offsets[flat]]),
        )

    def _compute_slacks(self, points):
        return self.offsets - self._check("points", points) @ self.normals.T

    def _find_least(self, slacks):
        """Return the least slack as a distance; a row of zeros that fails is infinitely far."""
        with np.errstate(divide="ignore"):
            distances = slacks / np.linalg.norm(self.normals, axis=1)
        return distances.min(axis=-1, initial=np.inf)

    def _check(self, name, value):
        """Return the array, refused unless its last axis has the dimension of the set."""
        value = np.asarray(value, dtype=float)
        if value.ndim == 0 or value.shape[-1] != self.dimension:
            raise ValueError(
                f"{name}: shape {value.shape}; "
                f"the last axis must have the set's dimension {self.dimension}"
            )
        return value


@runtime_checkable
class HasSupport(Protocol):
    """A convex set that knows its support numbers, such as a `Polytope` or a tube's `Section`."""

    def support(self, directions: Float[np.ndarray, "k n"], /) -> Float[np.ndarray, " k"]:
        """Return max {d x : x in the set} for each row d."""
        ...


ConvexSet = HasSupport | SupportFunction
"""A convex set by its support numbers: an object with a method `support`, or that function."""


def support_function(convex_set: ConvexSet, name: str = "convex_set") -> SupportFunction:
    """Return the support function of a set that has or is one.

    Raises:
        TypeError: it neither has nor is one; the message begins with `name`.
    """
    if isinstance(convex_set, HasSupport):
        return convex_set.support
    if callable(convex_set):
        return convex_set
    raise TypeError(
        f"{name}: {type(convex_set).__name__} has no support function; "
        "give a Polytope or a function of directions"
    )


def convex_hull(polytopes: Sequence[Polytope]) -> Polytope:
    """Return the hull of the union of bounded polytopes: exact, by their vertices."""
    dimensions = {polytope.dimension for polytope in polytopes}
    if len(dimensions) != 1:
        raise ValueError("polytopes: give at least one, all of the same dimension")
    return Polytope.from_vertices(np.vstack([polytope.vertices() for polytope in polytopes]))


def hull_vertices(
    points: Float[np.ndarray, "points dimension"],
) -> Float[np.ndarray, "vertices dimension"]:
    """Return the extreme points of a cloud, flat clouds included; points closer than 1e-10 of its
    size are one."""
    points = _check_cloud(points)
    if not len(points):
        return points
    coordinates, _, _ = flatten(points)
    _, _, corners = find_hull(coordinates)
    return points[corners]


def _subtract(left, right, size):
    """Subtract, and take for zero what rounding leaves of two equal numbers that came from terms of
    the given size."""
    difference = left - right
    return np.where(abs(difference) <= 1e-12 * size, 0.0, difference)


def _check_cloud(points):
    points = np.asarray(points, dtype=float)
    if points.ndim != 2 or points.shape[1] == 0 or not np.isfinite(points).all():
        raise ValueError(
            f"points: shape {points.shape}; give finite points of shape (points, dimension)"
        )
    return points
