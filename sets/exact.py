"""Exact re-check of the certificate of decoupled gains: every decision is taken in rational arithmetic.

Every float handed in stands for the binary rational it is. Floats only propose which rows of a polytope bound a
direction; the multipliers are then solved for, and their signs read, as fractions:

    multipliers >= 0,  multipliers H = d      =>      d x <= multipliers h   for every x with H x <= h

Sampled loop at wheel speeds (V_r, V_l), with Om = (V_r - V_l)/b, V = (V_r + V_l)/2, x = T Om/2, K exact:

    h = tan x      c = T V tan(x)/x      K = [-k1, -Om, 0; 0, -k2, -k3]

    Phi = [     1 - T k1           0               0        ]
          [ -h (2 - T k1)    1 - c T k2/2    c (1 - T k3/2) ]
          [       0              -T k2          1 - T k3    ]

Phi is affine in (h, c) alone: four vertices of a box around (h, c), or of one around c +- b h, the ways of the wheels,
cover every schedule in a box of wheel speeds. h and c are enclosed by partial sums of the alternating series of sine
and cosine, rounded outwards.
Margins are in the units of the offsets; those >= 0 prove their condition, without any tolerance.
Sources: Farkas 1902 (multipliers); Chisci, Rossiter, Zappa 2001 (restarted tubes and the shifted plan).
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from fractions import Fraction
from functools import cached_property
from itertools import chain, combinations, product
from math import ceil, floor, lcm
from typing import Protocol

import numpy as np
from jaxtyping import Float

Row = tuple[Fraction, ...]
Matrix = tuple[Row, ...]
Interval = tuple[Fraction, Fraction]
GridRow = tuple[tuple[int, int], ...]
GridMatrix = tuple[GridRow, ...]
Numbers = Sequence[Fraction | float] | Float[np.ndarray, " k"]
NumberRows = Sequence[Sequence[Fraction | float]] | Float[np.ndarray, "k 3"]

GRID = 2**80
"""Enclosures are rounded outwards to multiples of 1/GRID, so that numerators stay short."""

PROPOSED = 1e-9
"""Relative error up to which floats may misjudge a multiplier's sign, or a determinant, in what they propose."""


def exact_row(values: Numbers, name: str = "values") -> Row:
    """Return the rationals that these numbers are; raise ValueError where one is not finite."""
    if not np.all(np.isfinite(np.asarray(values, dtype=float))):
        raise ValueError(f"{name}: {values} is not finite: every number of an exact check must be")
    return tuple(Fraction(value) for value in values)


def exact_rows(rows: NumberRows, name: str = "rows") -> Matrix:
    """Return the rationals that these rows of three numbers are; raise ValueError for other widths."""
    if any(len(row) != 3 for row in rows):
        raise ValueError(f"{name}: rows of {len(rows[0])} numbers: errors have three coordinates")
    return tuple(exact_row(row, name) for row in rows)


# 1. Enclosures of h and c


@dataclass(frozen=True)
class ScheduleBox:
    """Rational bounds of h = tan(T Om/2), c = T V tan(T Om/2)/(T Om/2) in m and of Om in rad/s (positive left)."""

    turn: Interval
    advance: Interval
    yaw_rate: Interval


def _outwards(lower: Fraction, upper: Fraction) -> Interval:
    return Fraction(floor(lower * GRID), GRID), Fraction(ceil(upper * GRID), GRID)


def _alternating(square: Fraction, first: int) -> Interval:
    """Enclose sum_m (-square)^m first!/(first + 2 m)!: cos x for first = 0, sin(x)/x for first = 1, square = x^2 <= 1.

    The terms fall, so that two consecutive partial sums lie on either side of the limit.
    """
    before, after, term, k = Fraction(0), Fraction(1), Fraction(1), first
    while abs(term) * GRID > 1:
        term *= -square / ((k + 1) * (k + 2))
        before, after, k = after, after + term, k + 2
    return min(before, after), max(before, after)


def tangent_ratio(x: Fraction) -> Interval:
    """Enclose tan(x)/x (1 at x = 0) for an angle of at most 1 rad; raise ValueError beyond."""
    if abs(x) > 1:
        raise ValueError(f"x: half a turn of {float(x):.3g} rad in a period: shorten the period, 1 rad is the limit")
    sine, cosine = _alternating(x * x, 1), _alternating(x * x, 0)
    return _outwards(sine[0] / cosine[1], sine[1] / cosine[0])


def schedule_box(lower: Numbers, upper: Numbers, dt: float, track_width: float) -> ScheduleBox:
    """Enclose h, c and Om over all wheel speeds between `lower` and `upper`, pairs (right, left) in m/s.

    Om, and with it h, is monotone in each wheel: extremes at opposite corners. c grows with either wheel,
    dc/dV = (T/2) (t +- (V T/b) t') with t = tan(x)/x >= 1, as long as |V| T/b |t'| <= 1, and |t'| <= 2 |x| up to
    |x| = 1 since t'(x)/x grows up to 1.87 there: extremes at the two equal corners. Both ranges are thus the exact
    ones, rounded outwards. Raises ValueError for an empty box or where the robot turns too far in a period.
    """
    T, b = Fraction(dt), Fraction(track_width)
    low, high = exact_row(lower, "lower"), exact_row(upper, "upper")
    if not all(bottom <= top for bottom, top in zip(low, high, strict=True)):
        raise ValueError(f"lower: {lower} exceeds {upper}: order the bounds of both wheels")
    yaw_rate = (low[0] - high[1]) / b, (high[0] - low[1]) / b
    turns = [T * rate / 2 for rate in yaw_rate]
    steepest = 2 * max(map(abs, turns)) * max(abs(sum(low)), abs(sum(high))) / 2 * T / b
    if steepest > 1:
        raise ValueError(
            f"dt: {dt} is too long for these wheel speeds: the monotonicity of c needs {float(steepest):.3g} <= 1"
        )
    corners = [sorted(x * ratio for ratio in tangent_ratio(x)) for x in turns]
    advances = [
        sorted(T * (right + left) / 2 * ratio for ratio in tangent_ratio(T * (right - left) / (2 * b)))
        for right, left in (low, high)
    ]
    return ScheduleBox(_outwards(corners[0][0], corners[1][1]), _outwards(advances[0][0], advances[1][1]), yaw_rate)


def _loop(gains: Row, turn: Fraction, advance: Fraction, T: Fraction) -> Matrix:
    (k1, k2, k3), h, c, zero = gains, turn, advance, Fraction(0)
    return (
        (1 - T * k1, zero, zero),
        (-h * (2 - T * k1), 1 - c * T * k2 / 2, c * (1 - T * k3 / 2)),
        (zero, -T * k2, 1 - T * k3),
    )


def vertex_loops(gains: Numbers, box: ScheduleBox, dt: float) -> list[Matrix]:
    """Return Phi at the four vertices of (h, c); `gains` are k1 in 1/s, k2 in rad/s/m, k3 in 1/s."""
    k, T = exact_row(gains, "gains"), Fraction(dt)
    return [_loop(k, turn, advance, T) for turn, advance in product(box.turn, box.advance)]


def wheel_loops(gains: Numbers, lower: Numbers, upper: Numbers, dt: float, track_width: float) -> list[Matrix]:
    """Return Phi at the four vertices of p, q = c +- b h = T V_r tan(x)/x, T V_l tan(x)/x over a box of wheel speeds.

    Phi is affine in (p, q) too, and tan(x)/x is all but one: where the vertices of (h, c) allow the fastest turn at the
    highest speed, these follow the wheels, so that reach is less and invariant sets are larger. Outer, all but tight.
    """
    k, T, b = exact_row(gains, "gains"), Fraction(dt), Fraction(track_width)
    low, high = exact_row(lower, "lower"), exact_row(upper, "upper")
    turns = [T * (low[0] - high[1]) / (2 * b), T * (high[0] - low[1]) / (2 * b)]
    least = max(turns[0], -turns[1], Fraction(0))
    ratios = tangent_ratio(least)[0], tangent_ratio(max(map(abs, turns)))[1]
    travels = [sorted(T * speed * ratio for speed in ends for ratio in ratios) for ends in zip(low, high, strict=True)]
    right, left = ((travel[0], travel[-1]) for travel in travels)
    return [_loop(k, (p - q) / (2 * b), (p + q) / 2, T) for p, q in product(right, left)]


def vertex_feedbacks(gains: Numbers, box: ScheduleBox) -> list[Matrix]:
    """Return K at both ends of the range of Om."""
    (k1, k2, k3), zero = exact_row(gains, "gains"), Fraction(0)
    return [((-k1, -rate, zero), (zero, -k2, -k3)) for rate in box.yaw_rate]


# 2. Polytopes and disturbances


def _dot(left: Iterable[Fraction], right: Iterable[Fraction]) -> Fraction:
    return sum((a * b for a, b in zip(left, right, strict=True)), Fraction(0))


def _times(row: Row, matrix: Matrix) -> Row:
    return tuple(_dot(row, column) for column in zip(*matrix, strict=True))


def _cross(a: Row, b: Row) -> Row:
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


def mapped_rows(rows: Sequence[Sequence[Fraction | float]] | np.ndarray, matrices: Sequence[Matrix]) -> list[Row]:
    """Return the products of every row with every matrix: rows on u = K e become rows on e."""
    return [_times(exact_row(row, "rows"), matrix) for matrix in matrices for row in rows]


class Halfspaces:
    """{x in R^3 : normals x <= offsets}, with proved upper bounds of linear functions over it."""

    def __init__(self, normals: NumberRows, offsets: Numbers):
        """Keep the rows as rationals, and as floats the inverses of all triples of normals that span the space."""
        self.normals, self.offsets = exact_rows(normals, "normals"), exact_row(offsets, "offsets")
        if len(self.normals) != len(self.offsets):
            raise ValueError(f"offsets: {len(self.offsets)} for {len(self.normals)} normals: give one a row")
        rows = np.array(self.normals, dtype=float)
        triples = np.array(list(combinations(range(len(rows)), 3)), dtype=int).reshape(-1, 3)
        spans = np.abs(np.linalg.det(rows[triples])) > PROPOSED * np.prod(np.linalg.norm(rows[triples], axis=2), axis=1)
        self._triples, self._inverses = triples[spans], np.linalg.inv(rows[triples[spans]])
        self._costs = np.array(self.offsets, dtype=float)[self._triples]

    def bound(self, row: Row) -> Fraction:
        """Return a proved upper bound of row x over the set: the maximum itself, but for what rounding may reorder.

        Floats order the triples by the bound they promise; the first whose exact multipliers have no negative sign
        is taken. Raises ValueError where no triple bounds the direction.
        """
        weights = np.einsum("i,tij->tj", np.array(row, dtype=float), self._inverses)
        proposed = np.flatnonzero(weights.min(axis=1) >= -PROPOSED * np.abs(weights).max(axis=1))
        promised = np.sum(weights[proposed] * self._costs[proposed], axis=1)
        for triple in self._triples[proposed[np.argsort(promised)]].tolist():
            multipliers = self._multipliers(triple, row)
            if min(multipliers) >= 0:
                return _dot(multipliers, (self.offsets[i] for i in triple))
        raise ValueError(f"normals: no three rows bound the direction {[float(a) for a in row]}: close the polytope")

    def _multipliers(self, triple: list[int], row: Row) -> Row:
        """Solve multipliers @ normals[triple] = row by Cramer's rule."""
        a, b, c = (self.normals[i] for i in triple)
        turned = _cross(b, c), _cross(c, a), _cross(a, b)
        determinant = _dot(a, turned[0])
        if determinant == 0:
            return (Fraction(-1),) * 3
        return tuple(_dot(row, side) / determinant for side in turned)


def _widest(points: Matrix, row: Row) -> Fraction:
    return max(_dot(point, row) for point in points)


def containment_margin(normals: NumberRows, offsets: Numbers, rows: NumberRows, bounds: Numbers) -> Fraction:
    """Return the least of bounds - rows x over the polytope {normals x <= offsets}."""
    polytope = Halfspaces(normals, offsets)
    limits = exact_row(bounds, "bounds")
    return min(b - polytope.bound(row) for row, b in zip(exact_rows(rows), limits, strict=True))


def invariance_margin(
    normals: NumberRows, offsets: Numbers, loops: Sequence[Matrix], disturbance_vertices: NumberRows
) -> Fraction:
    """Return the least of h_i - h_W(c_i) - max c_i Phi x over facets and loops; >= 0 proves Phi Omega + W in Omega.

    It then holds for every Phi in the hull of `loops`. W is the hull of its vertices.
    """
    polytope, points = Halfspaces(normals, offsets), exact_rows(disturbance_vertices, "disturbance_vertices")
    return min(
        offset - _widest(points, normal) - polytope.bound(_times(normal, loop))
        for normal, offset in zip(polytope.normals, polytope.offsets, strict=True)
        for loop in loops
    )


# 3. Decrease of the cost


def smallest_pivot(matrix: Matrix) -> Fraction:
    """Return the smallest pivot of L D L^T; it is >= 0 exactly when the symmetric matrix is positive semidefinite.

    A zero pivot with other entries in its column counts as minus the largest of them. Ends at the first negative one.
    """
    if any(matrix[i][j] != matrix[j][i] for i in range(len(matrix)) for j in range(i)):
        raise ValueError("matrix: not symmetric: give the symmetric part")
    rows, pivots = [list(row) for row in matrix], []
    while rows:
        (pivot, *column), *rest = rows
        pivots.append(pivot if pivot else -max(map(abs, column), default=Fraction(0)))
        if pivots[-1] < 0:
            break
        scale = 1 / pivot if pivot else Fraction(0)
        rows = [[a - row[0] * scale * b for a, b in zip(row[1:], column, strict=True)] for row in rest]
    return min(pivots)


def _form(weight: Matrix, matrix: Matrix) -> Matrix:
    """Return M^T weight M."""
    columns = tuple(zip(*matrix, strict=True))
    return tuple(_times(_times(column, weight), matrix) for column in columns)


def decrease_pivot(
    cost: NumberRows,
    loops: Sequence[Matrix],
    feedbacks: Sequence[Matrix],
    error_weight: NumberRows,
    input_weight: Sequence[Sequence[float]] | Float[np.ndarray, "2 2"],
) -> Fraction:
    """Return the smallest pivot of P, R and P - Phi^T P Phi - Q - K^T R K over all pairs of a loop and a feedback.

    Where it is >= 0 the cost decreases for every Phi and K in their hulls, since the difference is concave in them.
    """
    P, Q = exact_rows(cost, "cost"), exact_rows(error_weight, "error_weight")
    R = tuple(exact_row(row, "input_weight") for row in input_weight)
    pivots = [smallest_pivot(P), smallest_pivot(R)]
    for loop, feedback in product(loops, feedbacks):
        taken = zip(P, _form(P, loop), Q, _form(R, feedback), strict=True)
        left = tuple(tuple(p - a - q - b for p, a, q, b in zip(*rows, strict=True)) for rows in taken)
        pivots.append(smallest_pivot(left))
    return min(pivots)


# 4. Tubes along a known schedule


class UsedOffsets(Protocol):
    """Offsets of the sets that a controller uses on line, window by window."""

    errors: Float[np.ndarray, "windows horizon 6"]
    inputs: Float[np.ndarray, "windows horizon 4"]
    terminal_normals: Float[np.ndarray, "facets 3"]
    terminal: Float[np.ndarray, "windows facets"]


def _hull(matrices: Sequence[Matrix]) -> GridMatrix:
    """Return the range of every entry, rounded outwards, in units of 1/GRID."""
    stacked = (zip(*rows, strict=True) for rows in zip(*matrices, strict=True))
    return tuple(tuple((floor(min(range_) * GRID), ceil(max(range_) * GRID)) for range_ in row) for row in stacked)


def _point(row: Row) -> GridRow:
    return _hull(((row,),))[0]


def _enclosed(row: GridRow, matrix: GridMatrix) -> GridRow:
    """Enclose the products of all rows and matrices in these ranges."""
    entries = []
    for column in zip(*matrix, strict=True):
        ends = [(a * c, a * d, b * c, b * d) for (a, b), (c, d) in zip(row, column, strict=True)]
        entries.append((sum(map(min, ends)) // GRID, -(-sum(map(max, ends)) // GRID)))
    return tuple(entries)


@dataclass(frozen=True)
class _Window:
    """One stretch of N schedules: loops, the rows of E and of U K as rows on the error, and the offsets used."""

    loops: list[GridMatrix]
    rows: dict[str, list[list[GridRow]]]
    used: dict[str, Matrix]
    terminal: Halfspaces
    points: list[list[int]]  # vertices of W in units of 1/share
    share: int

    def steps(self, row: GridRow, stage: int) -> list[Fraction]:
        """Return h_W of row, row Phi_{j-1}, .., row Phi_{j-1} .. Phi_1, whose sum is the support of R_j, j = stage."""
        found = []
        for m in range(stage, 0, -1):
            widest = max(sum(ends[w >= 0] * w for ends, w in zip(row, point, strict=True)) for point in self.points)
            found.append(Fraction(widest, GRID * self.share))
            row = _enclosed(row, self.loops[m - 1]) if m > 1 else row
        return found

    @cached_property
    def _extents(self) -> Row:
        axes = ((1, 0, 0), (0, 1, 0), (0, 0, 1))
        return tuple(max(self.terminal.bound(tuple(Fraction(s * a) for a in axis)) for s in (1, -1)) for axis in axes)

    def planned(self, row: GridRow) -> Fraction:
        """Return an upper bound of row e over the terminal set and the rows of the interval."""
        middle = tuple(Fraction(low + high, 2 * GRID) for low, high in row)
        return self.terminal.bound(middle) + _dot((Fraction(high - low, 2 * GRID) for low, high in row), self._extents)


def _window(boxes, gains, dt, points: Matrix, error_rows: Matrix, input_rows, used: UsedOffsets, index: int) -> _Window:
    share = lcm(*(a.denominator for point in points for a in point))
    feedbacks = [_hull(vertex_feedbacks(gains, box)) for box in boxes]
    return _Window(
        [_hull(vertex_loops(gains, box, dt)) for box in boxes],
        {
            "errors": [[_point(row) for row in error_rows]] * len(boxes),
            "inputs": [[_enclosed(_point(row), feedback) for row in input_rows] for feedback in feedbacks],
        },
        {name: tuple(exact_row(row, name) for row in getattr(used, name)[index]) for name in ("errors", "inputs")},
        Halfspaces(used.terminal_normals, used.terminal[index]),
        [[int(a * share) for a in point] for point in points],
        share,
    )


def sequence_margins(
    boxes: Sequence[Sequence[ScheduleBox]],
    followers: Iterable[tuple[int, int]],
    gains: Numbers,
    dt: float,
    disturbance_vertices: NumberRows,
    error_set: tuple[NumberRows, Numbers],
    input_set: tuple[NumberRows, Numbers],
    invariant_set: tuple[NumberRows, Numbers],
    used: UsedOffsets,
    slack: Fraction | float = 0,
) -> dict[str, Fraction]:
    """Return the least margins of the tube conditions along known schedules, by name.

    `boxes[w][j]` encloses stage j of window w, `followers` are pairs (window, window one step later; none where the run
    ends), sets are rows and offsets, inputs are u = K e. With Psi = Phi_{j-1} .. Phi_1 along the window:

        nonempty   the origin lies in every set used
        reach      used_j + h_{R_j}(c) <= offset of E, U;  T + R_N in Omega
        shifted    used_j + h_W(Psi^T c) <= used_{j-1} of the next window + slack,  j = 1 .. N-1
        returns    T + Psi W, j = N, within the last E, U (after K) and T (after Phi) of the next window

    The last two prove by themselves that a plan shifted by one step is admissible again. Tubes that meet `shifted` with
    equality need `slack` for the rounding of their offsets: it is granted, not proved. Raises ValueError where shapes
    differ or a follower is not its window one step later.
    """
    if any(len(offsets) != len(boxes) for offsets in (used.errors, used.inputs, used.terminal)):
        raise ValueError(f"used: {len(used.errors)} windows of offsets for {len(boxes)} windows: give one a window")
    points = exact_rows(disturbance_vertices, "disturbance_vertices")
    error_rows, input_rows = (tuple(exact_row(row) for row in rows) for rows in (error_set[0], input_set[0]))
    whole = {"errors": exact_row(error_set[1], "error_set"), "inputs": exact_row(input_set[1], "input_set")}
    invariant = Halfspaces(*invariant_set)
    windows = [_window(row, gains, dt, points, error_rows, input_rows, used, w) for w, row in enumerate(boxes)]
    following: dict[int, list[_Window]] = defaultdict(list)
    for now, later in set(followers):
        if list(boxes[now][1:]) != list(boxes[later][:-1]):
            raise ValueError(f"followers: {now, later}: the second must be the first one step later")
        following[now].append(windows[later])
    rooms: dict[str, list[Fraction]] = defaultdict(list)
    for w, window in enumerate(windows):
        conditions = [_stages(window, following[w], whole), _terminal(window, invariant)]
        conditions += [_returns(window, later) for later in following[w]]
        for name, room in chain.from_iterable(conditions):
            rooms[name].append(room + Fraction(slack) if name.endswith("shifted") else room)
    return {name: min(found) for name, found in rooms.items()}


def _stages(window: _Window, following: list[_Window], whole: dict[str, Row]) -> Iterator[tuple[str, Fraction]]:
    """Yield the room of `reach` and `shifted` along every row of E and U at every stage."""
    for name, stages in window.rows.items():
        for j, (rows, used) in enumerate(zip(stages, window.used[name], strict=True)):
            for i, (row, kept, offset) in enumerate(zip(rows, used, whole[name], strict=True)):
                steps = window.steps(row, j)
                yield f"{name} reach", offset - kept - sum(steps)
                for later in following if j else ():
                    yield f"{name} shifted", later.used[name][j - 1][i] - kept - steps[-1]


def _terminal(window: _Window, invariant: Halfspaces) -> Iterator[tuple[str, Fraction]]:
    """Yield the least offset used in the window and the room of T + R_N in the invariant set."""
    yield "nonempty", min(*map(min, chain(*window.used.values())), *window.terminal.offsets)
    for normal, offset in zip(invariant.normals, invariant.offsets, strict=True):
        row = _point(normal)
        yield "terminal reach", offset - window.planned(row) - sum(window.steps(row, len(window.loops)))


def _returns(window: _Window, later: _Window) -> Iterator[tuple[str, Fraction]]:
    """Yield the room of T + Psi W along the rows of the last stage of the next window."""
    targets = [("terminal", _enclosed(_point(normal), later.loops[-1])) for normal in later.terminal.normals]
    targets += [(name, row) for name, stages in later.rows.items() for row in stages[-1]]
    limits = [*later.terminal.offsets, *chain.from_iterable(used[-1] for used in later.used.values())]
    for (name, row), limit in zip(targets, limits, strict=True):
        yield f"{name} returns", limit - window.planned(row) - window.steps(row, len(window.loops))[-1]


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
