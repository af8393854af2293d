"""Exact re-check of a certificate: every decision is taken in rational arithmetic.

Every float handed in stands for the binary rational it is. Floats only propose which rows of a
polytope bound a direction; the multipliers are then solved for, and their signs read, as integers
over a common denominator:

    multipliers >= 0,  multipliers H = d    =>    d x <= multipliers h  for all x with H x <= h

Margins are in the units of the offsets; those >= 0 prove their condition, without any tolerance.
Source: Farkas 1902 (multipliers). Loops of decoupled gains and tubes along a schedule:
`sets.robot.exact_tube`.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from fractions import Fraction
from functools import lru_cache
from itertools import chain, combinations, product
from math import lcm
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

Row = tuple[Fraction, ...]
Matrix = tuple[Row, ...]
Integers = tuple[int, ...]
Numbers = Sequence[Fraction | float] | Float[np.ndarray, " k"]
NumberRows = Sequence[Sequence[Fraction | float]] | Float[np.ndarray, "k n"]

PROPOSED = 1e-9
"""Relative error up to which floats may misjudge a sign or a determinant in what they propose."""


def exact_row(values: Numbers, name: str = "values") -> Row:
    """Return the rationals that these numbers are.

    Raises:
        ValueError: a number is not finite.
    """
    if not np.all(np.isfinite(np.asarray(values, dtype=float))):
        raise ValueError(f"{name}: {values} is not finite: every number of an exact check must be")
    return tuple(Fraction(value) for value in values)


def exact_rows(rows: NumberRows, name: str = "rows") -> Matrix:
    """Return the rationals that these rows of three numbers are.

    Raises:
        ValueError: a row of another width, or a number that is not finite.
    """
    if any(len(row) != 3 for row in rows):
        raise ValueError(f"{name}: rows of {len(rows[0])} numbers: errors have three coordinates")
    return tuple(exact_row(row, name) for row in rows)


def dot(left: Iterable[Fraction], right: Iterable[Fraction]) -> Fraction:
    """Return the sum of products."""
    return sum((a * b for a, b in zip(left, right, strict=True)), Fraction(0))


def times(row: Row, matrix: Matrix) -> Row:
    """Return row @ matrix."""
    return tuple(dot(row, column) for column in zip(*matrix, strict=True))


def _dot(a: Integers, b: Integers) -> int:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def _cross(a: Integers, b: Integers) -> Integers:
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


def mapped_rows(inputs: NumberRows, errors: NumberRows, gains: Sequence[Matrix]) -> list[Row]:
    """Return D K + C for every gain: rows D u + C e under u = K e as rows on e."""
    input_rows = [exact_row(D, "inputs") for D in inputs]
    error_rows = exact_rows(errors, "errors")
    return [
        _add(times(D, gain), C)
        for gain in gains
        for D, C in zip(input_rows, error_rows, strict=True)
    ]


def _add(left: Row, right: Row) -> Row:
    return tuple(a + b for a, b in zip(left, right, strict=True))


def _common_integers(row: Row) -> tuple[Integers, int]:
    """Return integers and their least common denominator."""
    share = lcm(*(a.denominator for a in row))
    return tuple(a.numerator * (share // a.denominator) for a in row), share


class _Corner(NamedTuple):
    """The point in which three rows meet, and whose multiples of `sides` their multipliers are, all
    as integers."""

    sides: tuple[Integers, ...]
    point: Integers
    determinant: int


@lru_cache(maxsize=16)
def _find_spanning(normals: Matrix) -> tuple[np.ndarray, np.ndarray]:
    """Return all triples of rows that span the space, and the inverses of their normals, floats."""
    rows = np.array(normals, dtype=float)
    triples = np.array(list(combinations(range(len(rows)), 3)), dtype=int).reshape(-1, 3)
    volumes = np.abs(np.linalg.det(rows[triples]))
    lengths = np.linalg.norm(rows[triples], axis=2)
    spanning = triples[volumes > PROPOSED * np.prod(lengths, axis=1)]
    return spanning, np.linalg.inv(rows[spanning])


class Halfspaces:
    """{x in R^3 : normals x <= offsets}, with proved upper bounds of linear functions over it."""

    def __init__(self, normals: NumberRows, offsets: Numbers):
        """Keep the rows as rationals, and as floats the triples of rows that meet in a corner of
        the set."""
        self.normals = exact_rows(normals, "normals")
        self.offsets = exact_row(offsets, "offsets")
        if len(self.normals) != len(self.offsets):
            raise ValueError(
                f"offsets: {len(self.offsets)} for {len(self.normals)} normals: give one a row"
            )
        self._triples, self._inverses = _find_spanning(self.normals)
        rows = np.array(self.normals, dtype=float)
        limits = np.array(self.offsets, dtype=float)
        self._points = np.einsum("tij,tj->ti", self._inverses, limits[self._triples])
        size = np.abs(self._points) @ np.abs(rows).T + np.abs(limits)
        is_inside = self._points @ rows.T - limits <= PROPOSED * size
        # Triples that meet in a corner of the set come first; an empty set has none, but bounds all
        # the same.
        corners = np.flatnonzero(np.all(is_inside, axis=1))
        self._tried = (corners, np.arange(len(self._triples)))
        flat, self._normal_share = _common_integers(tuple(a for row in self.normals for a in row))
        self._rows = [flat[i : i + 3] for i in range(0, len(flat), 3)]
        self._limits, self._offset_share = _common_integers(self.offsets)
        self._corners: dict[int, _Corner] = {}

    def bound(self, row: Row) -> Fraction:
        """Return a proved upper bound of row x over the set: the maximum itself, but for what
        rounding may reorder.

        Floats order the triples by the bound they promise; the first whose exact multipliers have
        no negative sign is taken.

        Raises:
            ValueError: no triple bounds the direction.
        """
        integers, share = _common_integers(row)
        direction = np.array(row, dtype=float)
        proposals = (self._propose(direction, tried) for tried in self._tried)
        for triple in chain.from_iterable(proposals):
            corner = self._find_corner(triple)
            if corner.determinant and min(_dot(integers, side) for side in corner.sides) >= 0:
                scale = share * corner.determinant * self._offset_share
                return Fraction(self._normal_share * _dot(integers, corner.point), scale)
        raise ValueError(
            f"normals: no three rows bound the direction {direction.tolist()}: close the polytope"
        )

    def _propose(self, direction: np.ndarray, tried: np.ndarray) -> list[int]:
        """Return which of these triples may bound a direction, those that promise least first."""
        weights = direction @ self._inverses[tried]
        is_proposed = weights.min(axis=1) >= -PROPOSED * np.abs(weights).max(axis=1)
        proposed = tried[is_proposed]
        promised = self._points[proposed] @ direction
        return proposed[np.argsort(promised, kind="stable")].tolist()

    def _find_corner(self, index: int) -> _Corner:
        if index not in self._corners:
            triple = self._triples[index].tolist()
            rows = [self._rows[i] for i in triple]
            limits = [self._limits[i] for i in triple]
            self._corners[index] = _solve_corner(rows, limits)
        return self._corners[index]


def _solve_corner(rows: Sequence[Integers], limits: Sequence[int]) -> _Corner:
    """Solve for the corner of three rows by Cramer's rule: multipliers = row . sides /
    determinant."""
    a, b, c = rows
    sides = (_cross(b, c), _cross(c, a), _cross(a, b))
    determinant = _dot(a, sides[0])
    if determinant < 0:
        sides = tuple(tuple(-entry for entry in side) for side in sides)
        determinant = -determinant
    point = tuple(_dot(tuple(limits), entries) for entries in zip(*sides, strict=True))
    return _Corner(sides, point, determinant)


def _find_widest(points: Matrix, row: Row) -> Fraction:
    return max(dot(point, row) for point in points)


def exact_containment_margin(
    normals: NumberRows, offsets: Numbers, rows: NumberRows, bounds: Numbers
) -> Fraction:
    """Return the least of bounds - rows x over the polytope {normals x <= offsets}."""
    polytope = Halfspaces(normals, offsets)
    limits = exact_row(bounds, "bounds")
    pairs = zip(exact_rows(rows), limits, strict=True)
    return min(limit - polytope.bound(row) for row, limit in pairs)


def exact_invariance_margin(
    normals: NumberRows, offsets: Numbers, loops: Sequence[Matrix], disturbance_vertices: NumberRows
) -> Fraction:
    """Return the least of h_i - h_W(c_i) - max c_i Phi x over facets and loops; >= 0 proves Phi
    Omega + W in Omega.

    It then holds for every Phi in the hull of `loops`. W is the hull of its vertices.
    """
    polytope = Halfspaces(normals, offsets)
    points = exact_rows(disturbance_vertices, "disturbance_vertices")
    margins = []
    for normal, offset in zip(polytope.normals, polytope.offsets, strict=True):
        room = offset - _find_widest(points, normal)
        reach = max(polytope.bound(times(normal, loop)) for loop in loops)
        margins.append(room - reach)
    return min(margins)


def smallest_pivot(matrix: Matrix) -> Fraction:
    """Return the smallest pivot of L D L^T; it is >= 0 exactly when the symmetric matrix is
    positive semidefinite.

    A zero pivot with other entries in its column counts as minus the largest of them. Ends at the
    first negative one.

    Raises:
        ValueError: the matrix is not symmetric.
    """
    if tuple(zip(*matrix, strict=True)) != tuple(map(tuple, matrix)):
        raise ValueError("matrix: not symmetric: give the symmetric part")
    rows = [list(row) for row in matrix]
    pivots = []
    while rows:
        (pivot, *column), *rest = rows
        pivots.append(pivot if pivot else -max(map(abs, column), default=Fraction(0)))
        if pivots[-1] < 0:
            break
        scale = 1 / pivot if pivot else Fraction(0)
        rows = [_eliminate(row, scale, column) for row in rest]
    return min(pivots)


def _eliminate(row: Sequence[Fraction], scale: Fraction, column: Sequence[Fraction]) -> list:
    """Take the multiple of the pivot's row off another row, whose first entry thereby goes."""
    first, *others = row
    return [a - first * scale * b for a, b in zip(others, column, strict=True)]


def _form(weight: Matrix, matrix: Matrix) -> Matrix:
    """Return M^T weight M."""
    columns = tuple(zip(*matrix, strict=True))
    return tuple(times(times(column, weight), matrix) for column in columns)


def decrease_pivot(
    cost: NumberRows,
    loops: Sequence[Matrix],
    feedbacks: Sequence[Matrix],
    error_weight: NumberRows,
    input_weight: Sequence[Sequence[float]] | Float[np.ndarray, "2 2"],
) -> Fraction:
    """Return the smallest pivot of P, R and P - Phi^T P Phi - Q - K^T R K over all pairs of a loop
    and a feedback.

    Where it is >= 0 the cost decreases for every Phi and K in their hulls, since the difference is
    concave in them.
    """
    P = exact_rows(cost, "cost")
    Q = exact_rows(error_weight, "error_weight")
    R = tuple(exact_row(row, "input_weight") for row in input_weight)
    pivots = [smallest_pivot(P), smallest_pivot(R)]
    for loop, feedback in product(loops, feedbacks):
        decrease = _subtract(P, _form(P, loop))
        stage = _form(R, feedback)
        pivots.append(smallest_pivot(_subtract(_subtract(decrease, Q), stage)))
    return min(pivots)


def _subtract(left: Matrix, right: Matrix) -> Matrix:
    pairs = zip(left, right, strict=True)
    return tuple(tuple(a - b for a, b in zip(*rows, strict=True)) for rows in pairs)


@dataclass(frozen=True)
class ExactReport:
    """Proved margins by name; the certificate holds where none is negative."""

    margins: dict[str, Fraction] = field(default_factory=dict)

    @property
    def failing(self) -> list[str]:
        """Names of the conditions that are not proved."""
        return [name for name, margin in self.margins.items() if margin < 0]

    @property
    def holds(self) -> bool:
        """Whether there are conditions, and all of them are proved."""
        return bool(self.margins) and not self.failing
