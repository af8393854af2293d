"""Exact re-check of tubes under decoupled gains: enclosures of the loops, and margins along a known
schedule.

Sampled loop at wheel speeds (V_r, V_l), with Om = (V_r - V_l)/b, V = (V_r + V_l)/2, x = T Om/2, K
exact:

    h = tan x      c = T V tan(x)/x      K = [-k1, -Om, 0; 0, -k2, -k3]

    Phi = [     1 - T k1           0               0        ]
          [ -h (2 - T k1)    1 - c T k2/2    c (1 - T k3/2) ]
          [       0              -T k2          1 - T k3    ]

Phi is affine in (h, c) alone: four vertices of a box around (h, c), or of one around c +- b h, the
ways of the wheels, cover every schedule in a box of wheel speeds. h and c are enclosed by partial
sums of the alternating series of sine and cosine, rounded outwards. Margins: as in `sets.exact`.
Source: Chisci, Rossiter, Zappa 2001 (restarted tubes and the shifted plan).
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property
from itertools import chain, product
from math import ceil, floor, lcm
from typing import Protocol

import numpy as np
from jaxtyping import Float

from sets.exact import Halfspaces, Matrix, NumberRows, Numbers, Row, dot, exact_row, exact_rows

Interval = tuple[Fraction, Fraction]
GridRow = tuple[tuple[int, int], ...]
GridMatrix = tuple[GridRow, ...]

GRID = 2**80
"""Enclosures are rounded outwards to multiples of 1/GRID, so that numerators stay short."""


@dataclass(frozen=True)
class ScheduleBox:
    """Rational bounds of h = tan(T Om/2), c = T V tan(T Om/2)/(T Om/2) in m and of Om in rad/s
    (positive left)."""

    turn: Interval
    advance: Interval
    yaw_rate: Interval


def _outwards(lower: Fraction, upper: Fraction) -> Interval:
    return Fraction(floor(lower * GRID), GRID), Fraction(ceil(upper * GRID), GRID)


def _alternating(square: Fraction, first: int) -> Interval:
    """Enclose sum_m (-square)^m first!/(first + 2 m)!: cos x for first = 0, sin(x)/x for first = 1,
    square = x^2 <= 1.

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
        raise ValueError(
            f"x: half a turn of {float(x):.3g} rad in a period: shorten the period, 1 rad is the limit"
        )
    sine, cosine = _alternating(x * x, 1), _alternating(x * x, 0)
    return _outwards(sine[0] / cosine[1], sine[1] / cosine[0])


def schedule_box(lower: Numbers, upper: Numbers, dt: float, track_width: float) -> ScheduleBox:
    """Enclose h, c and Om over all wheel speeds between `lower` and `upper`, pairs (right, left) in
    m/s.

    Om, and with it h, is monotone in each wheel: extremes at opposite corners. c grows with either
    wheel, dc/dV = (T/2) (t +- (V T/b) t') with t = tan(x)/x >= 1, as long as |V| T/b |t'| <= 1, and
    |t'| <= 2 |x| up to |x| = 1 since t'(x)/x grows up to 1.87 there: extremes at the two equal
    corners. Both ranges are thus the exact ones, rounded outwards. Raises ValueError for an empty
    box or where the robot turns too far in a period.
    """
    T, b, low, high = (
        Fraction(dt),
        Fraction(track_width),
        exact_row(lower, "lower"),
        exact_row(upper, "upper"),
    )
    if not all(bottom <= top for bottom, top in zip(low, high, strict=True)):
        raise ValueError(f"lower: {lower} exceeds {upper}: order the bounds of both wheels")
    yaw_rate = (low[0] - high[1]) / b, (high[0] - low[1]) / b
    turns = [T * rate / 2 for rate in yaw_rate]
    steepest = 2 * max(map(abs, turns)) * max(abs(sum(low)), abs(sum(high))) / 2 * T / b
    if steepest > 1:
        raise ValueError(
            f"dt: {dt} is too long: at these speeds {float(steepest):.3g} <= 1 must hold; shorten it"
        )
    corners = [sorted(x * ratio for ratio in tangent_ratio(x)) for x in turns]
    advances = [
        sorted(
            T * (right + left) / 2 * ratio for ratio in tangent_ratio(T * (right - left) / (2 * b))
        )
        for right, left in (low, high)
    ]
    return ScheduleBox(
        _outwards(corners[0][0], corners[1][1]), _outwards(advances[0][0], advances[1][1]), yaw_rate
    )


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


def wheel_loops(
    gains: Numbers, lower: Numbers, upper: Numbers, dt: float, track_width: float
) -> list[Matrix]:
    """Return Phi at the four vertices of p, q = c +- b h = T V_r tan(x)/x, T V_l tan(x)/x over a
    box of wheel speeds.

    Phi is affine in (p, q) too, and tan(x)/x is all but one: where the vertices of (h, c) allow the
    fastest turn at the highest speed, these follow the wheels, so that reach is less and invariant
    sets are larger. Outer, all but tight.
    """
    k, T, b = exact_row(gains, "gains"), Fraction(dt), Fraction(track_width)
    low, high = exact_row(lower, "lower"), exact_row(upper, "upper")
    turns = [T * (low[0] - high[1]) / (2 * b), T * (high[0] - low[1]) / (2 * b)]
    least = max(turns[0], -turns[1], Fraction(0))
    ratios = tangent_ratio(least)[0], tangent_ratio(max(map(abs, turns)))[1]
    travels = [
        sorted(T * speed * ratio for speed in ends for ratio in ratios)
        for ends in zip(low, high, strict=True)
    ]
    right, left = ((travel[0], travel[-1]) for travel in travels)
    return [_loop(k, (p - q) / (2 * b), (p + q) / 2, T) for p, q in product(right, left)]


def vertex_feedbacks(gains: Numbers, box: ScheduleBox) -> list[Matrix]:
    """Return K at both ends of the range of Om."""
    (k1, k2, k3), zero = exact_row(gains, "gains"), Fraction(0)
    return [((-k1, -rate, zero), (zero, -k2, -k3)) for rate in box.yaw_rate]


class UsedOffsets(Protocol):
    """Offsets of the sets that a controller uses on line, window by window."""

    @property
    def errors(self) -> Float[np.ndarray, "windows horizon 6"]: ...
    @property
    def inputs(self) -> Float[np.ndarray, "windows horizon k"]: ...
    @property
    def terminal_normals(self) -> Float[np.ndarray, "facets 3"]: ...
    @property
    def terminal(self) -> Float[np.ndarray, "windows facets"]: ...


def _hull(matrices: Sequence[Matrix]) -> GridMatrix:
    """Return the range of every entry, rounded outwards, in units of 1/GRID."""
    stacked = (zip(*rows, strict=True) for rows in zip(*matrices, strict=True))
    return tuple(
        tuple((floor(min(range_) * GRID), ceil(max(range_) * GRID)) for range_ in row)
        for row in stacked
    )


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
    """One stretch of N schedules: loops, the rows of E and of D K + C as rows on the error, and the
    offsets used."""

    loops: list[GridMatrix]
    rows: dict[str, list[list[GridRow]]]
    used: dict[str, Matrix]
    terminal: Halfspaces
    points: list[list[int]]  # of W in units of 1/share
    share: int

    def reach(self, row: GridRow, stage: int) -> Interval:
        """Return upper bounds of h_W(row Phi_{j-1} .. Phi_1), j = stage, and of the support of R_j
        along the row."""
        points, last, total = self.points, 0, 0
        for m in range(stage, 0, -1):
            (a, b), (c, d), (e, f) = row
            sums = (
                (b if x > 0 else a) * x + (d if y > 0 else c) * y + (f if z > 0 else e) * z
                for x, y, z in points
            )
            last = max(sums)
            total += last
            row = _enclosed(row, self.loops[m - 1]) if m > 1 else row
        return Fraction(last, GRID * self.share), Fraction(total, GRID * self.share)

    @cached_property
    def _extents(self) -> Row:
        axes = exact_rows(np.vstack([np.eye(3), -np.eye(3)]))
        return tuple(map(max, *(map(self.terminal.bound, half) for half in (axes[:3], axes[3:]))))

    def planned(self, row: GridRow) -> Fraction:
        """Return an upper bound of row e over the terminal set and the rows of the interval."""
        middle = tuple(Fraction(low + high, 2 * GRID) for low, high in row)
        return self.terminal.bound(middle) + dot(
            (Fraction(high - low, 2 * GRID) for low, high in row), self._extents
        )


def _under(feedback: GridMatrix, inputs: Row, errors: Row) -> GridRow:
    """Enclose the row D K + C."""
    pairs = zip(_enclosed(_point(inputs), feedback), _point(errors), strict=True)
    return tuple((a + c, b + d) for (a, b), (c, d) in pairs)


def _window(
    stages, points: Matrix, error_rows: Matrix, input_rows, used: UsedOffsets, index: int
) -> _Window:
    share = lcm(*(a.denominator for point in points for a in point))
    return _Window(
        [loop for loop, _ in stages],
        {
            "errors": [[_point(row) for row in error_rows]] * len(stages),
            "inputs": [[_under(feedback, *row) for row in input_rows] for _, feedback in stages],
        },
        {
            name: tuple(exact_row(row, name) for row in getattr(used, name)[index])
            for name in ("errors", "inputs")
        },
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
    input_set: tuple[NumberRows, NumberRows, Numbers],
    invariant_set: tuple[NumberRows, Numbers],
    used: UsedOffsets,
    slack: Fraction | float = 0,
) -> dict[str, Fraction]:
    """Return the least margins of the tube conditions along known schedules, by name.

    `boxes[w][j]` encloses stage j of window w, `followers` are pairs (window, window one step
    later; none where the run ends). Sets are rows and offsets; `input_set` is (D, C, d) of D u + C
    e <= d, with rows D K + C on the error under u = K e. With Psi = Phi_{j-1} .. Phi_1 along the
    window:

        nonempty   the origin lies in every set used
        reach      used_j + h_{R_j}(c) <= offset of E, U;  T + R_N in Omega
        shifted    used_j + h_W(Psi^T c) <= used_{j-1} of the next window + slack,  j = 1 .. N-1
        returns    T + Psi W, j = N, within the last E, U (after K) and T (after Phi) of the next window

    The last two prove by themselves that a plan shifted by one step is admissible again. Tubes that
    meet `shifted` with equality need `slack` for the rounding of their offsets: it is granted, not
    proved. Raises ValueError where shapes differ or a follower is not its window one step later.
    """
    if any(len(offsets) != len(boxes) for offsets in (used.errors, used.inputs, used.terminal)):
        raise ValueError(
            f"used: {len(used.errors)} windows of offsets for {len(boxes)} windows: give one a window"
        )
    points = exact_rows(disturbance_vertices, "disturbance_vertices")
    error_rows = exact_rows(error_set[0], "error_set")
    input_rows = [(exact_row(D), exact_row(C)) for D, C in zip(*input_set[:2], strict=True)]
    whole = {
        "errors": exact_row(error_set[1], "error_set"),
        "inputs": exact_row(input_set[2], "input_set"),
    }
    invariant = Halfspaces(*invariant_set)
    known = {
        box: (_hull(vertex_loops(gains, box, dt)), _hull(vertex_feedbacks(gains, box)))
        for box in set(chain.from_iterable(boxes))
    }
    stages = [[known[box] for box in row] for row in boxes]
    windows = [
        _window(row, points, error_rows, input_rows, used, w) for w, row in enumerate(stages)
    ]
    following: dict[int, list[_Window]] = defaultdict(list)
    for now, later in set(followers):
        if list(boxes[now][1:]) != list(boxes[later][:-1]):
            raise ValueError(
                f"followers: {now, later}: the second must be the first one step later"
            )
        following[now].append(windows[later])
    rooms: dict[str, list[Fraction]] = defaultdict(list)
    for w, window in enumerate(windows):
        conditions = [_stages(window, following[w], whole), _terminal(window, invariant)]
        conditions += [_returns(window, later) for later in following[w]]
        for name, room in chain.from_iterable(conditions):
            rooms[name].append(room + Fraction(slack) if name.endswith("shifted") else room)
    return {name: min(found) for name, found in rooms.items()}


def _stages(
    window: _Window, following: list[_Window], whole: dict[str, Row]
) -> Iterator[tuple[str, Fraction]]:
    """Yield the room of `reach` and `shifted` along every row of E and U at every stage."""
    for name, stages in window.rows.items():
        for j, (rows, used) in enumerate(zip(stages, window.used[name], strict=True)):
            for i, (row, kept, offset) in enumerate(zip(rows, used, whole[name], strict=True)):
                last, reach = window.reach(row, j)
                yield f"{name} reach", offset - kept - reach
                for later in following if j else ():
                    yield f"{name} shifted", later.used[name][j - 1][i] - kept - last


def _terminal(window: _Window, invariant: Halfspaces) -> Iterator[tuple[str, Fraction]]:
    """Yield the least offset used in the window and the room of T + R_N in the invariant set."""
    yield "nonempty", min(*map(min, chain(*window.used.values())), *window.terminal.offsets)
    for normal, offset in zip(invariant.normals, invariant.offsets, strict=True):
        row = _point(normal)
        yield (
            "terminal reach",
            offset - window.planned(row) - window.reach(row, len(window.loops))[1],
        )


def _returns(window: _Window, later: _Window) -> Iterator[tuple[str, Fraction]]:
    """Yield the room of T + Psi W along the rows of the last stage of the next window."""
    targets = [
        ("terminal", _enclosed(_point(normal), later.loops[-1]))
        for normal in later.terminal.normals
    ]
    targets += [(name, row) for name, stages in later.rows.items() for row in stages[-1]]
    limits = [
        *later.terminal.offsets,
        *chain.from_iterable(used[-1] for used in later.used.values()),
    ]
    for (name, row), limit in zip(targets, limits, strict=True):
        yield (
            f"{name} returns",
            limit - window.planned(row) - window.reach(row, len(window.loops))[0],
        )
