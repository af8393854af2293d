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

Range = tuple[Fraction, Fraction]
GridRow = tuple[tuple[int, int], ...]
GridMatrix = tuple[GridRow, ...]

GRID = 2**80
"""Enclosures are rounded outwards to multiples of 1/GRID, so that numerators stay short."""


@dataclass(frozen=True)
class ScheduleBox:
    """Rational bounds of h = tan(T Om/2), c = T V tan(T Om/2)/(T Om/2) in m and of Om in rad/s
    (positive left)."""

    turn: Range
    advance: Range
    yaw_rate: Range


def _round_outwards(lower: Fraction, upper: Fraction) -> Range:
    return Fraction(floor(lower * GRID), GRID), Fraction(ceil(upper * GRID), GRID)


def _enclose_series(square: Fraction, first: int) -> Range:
    """Enclose sum_m (-square)^m first!/(first + 2 m)!: cos x for first = 0, sin(x)/x for first = 1,
    square = x^2 <= 1.

    The terms fall, so that two consecutive partial sums lie on either side of the limit.
    """
    before = Fraction(0)
    after = Fraction(1)
    term = Fraction(1)
    k = first
    while abs(term) * GRID > 1:
        term *= -square / ((k + 1) * (k + 2))
        before = after
        after = before + term
        k += 2
    return min(before, after), max(before, after)


def tangent_ratio(x: Fraction) -> Range:
    """Enclose tan(x)/x (1 at x = 0).

    Raises:
        ValueError: the angle is larger than 1 rad.
    """
    if abs(x) > 1:
        raise ValueError(
            f"x: half a turn of {float(x):.3g} rad in a period: "
            "shorten the period, 1 rad is the limit"
        )
    sine = _enclose_series(x * x, 1)
    cosine = _enclose_series(x * x, 0)
    return _round_outwards(sine[0] / cosine[1], sine[1] / cosine[0])


def schedule_box(lower: Numbers, upper: Numbers, dt: float, track_width: float) -> ScheduleBox:
    """Enclose h, c and Om over all wheel speeds between `lower` and `upper`, pairs (right, left) in
    m/s.

    Om, and with it h, is monotone in each wheel: extremes at opposite corners. c grows with either
    wheel, dc/dV = (T/2) (t +- (V T/b) t') with t = tan(x)/x >= 1, as long as |V| T/b |t'| <= 1, and
    |t'| <= 2 |x| up to |x| = 1 since t'(x)/x grows up to 1.87 there: extremes at the two equal
    corners. Both ranges are thus the exact ones, rounded outwards.

    Raises:
        ValueError: an empty box, or the robot turns too far in a period.
    """
    T = Fraction(dt)
    b = Fraction(track_width)
    low = exact_row(lower, "lower")
    high = exact_row(upper, "upper")
    if not all(bottom <= top for bottom, top in zip(low, high, strict=True)):
        raise ValueError(f"lower: {lower} exceeds {upper}: order the bounds of both wheels")
    yaw_rate = _find_yaw_rates(low, high, b)
    turns = [T * rate / 2 for rate in yaw_rate]
    fastest = max(abs(sum(low)), abs(sum(high))) / 2
    steepest = 2 * max(map(abs, turns)) * fastest * T / b
    if steepest > 1:
        raise ValueError(
            f"dt: {dt} is too long: at these speeds {float(steepest):.3g} <= 1 must hold; "
            "shorten it"
        )
    turn_low, _ = _scale_tangent(turns[0], turns[0])
    _, turn_high = _scale_tangent(turns[1], turns[1])
    advance_low, _ = _scale_tangent(T * (low[0] - low[1]) / (2 * b), T * sum(low) / 2)
    _, advance_high = _scale_tangent(T * (high[0] - high[1]) / (2 * b), T * sum(high) / 2)
    return ScheduleBox(
        _round_outwards(turn_low, turn_high),
        _round_outwards(advance_low, advance_high),
        yaw_rate,
    )


def _find_yaw_rates(low: Row, high: Row, track_width: Fraction) -> Range:
    """Return the ends of Om over a box of wheel speeds."""
    return (low[0] - high[1]) / track_width, (high[0] - low[1]) / track_width


def _scale_tangent(x: Fraction, factor: Fraction) -> Range:
    """Enclose factor tan(x)/x."""
    products = [factor * ratio for ratio in tangent_ratio(x)]
    return min(products), max(products)


def _make_loop(gains: Row, turn: Fraction, advance: Fraction, T: Fraction) -> Matrix:
    k1, k2, k3 = gains
    h = turn
    c = advance
    zero = Fraction(0)
    return (
        (1 - T * k1, zero, zero),
        (-h * (2 - T * k1), 1 - c * T * k2 / 2, c * (1 - T * k3 / 2)),
        (zero, -T * k2, 1 - T * k3),
    )


def exact_vertex_loops(gains: Numbers, box: ScheduleBox, dt: float) -> list[Matrix]:
    """Return Phi at the four vertices of (h, c); `gains`: k1 in 1/s, k2 in rad/s/m, k3 in 1/s."""
    k = exact_row(gains, "gains")
    T = Fraction(dt)
    vertices = product(box.turn, box.advance)
    return [_make_loop(k, turn, advance, T) for turn, advance in vertices]


def exact_wheel_loops(
    gains: Numbers, lower: Numbers, upper: Numbers, dt: float, track_width: float
) -> list[Matrix]:
    """Return Phi at the four vertices of p, q = c +- b h = T V_r tan(x)/x, T V_l tan(x)/x over a
    box of wheel speeds.

    Phi is affine in (p, q) too, and tan(x)/x is nearly one: where the vertices of (h, c) allow the
    fastest turn at the highest speed, these follow the wheels, so that reach is less and invariant
    sets are larger. The range is an outer one and nearly tight.
    """
    k = exact_row(gains, "gains")
    T = Fraction(dt)
    b = Fraction(track_width)
    low = exact_row(lower, "lower")
    high = exact_row(upper, "upper")
    turns = [T * rate / 2 for rate in _find_yaw_rates(low, high, b)]
    least = max(turns[0], -turns[1], Fraction(0))
    most = max(map(abs, turns))
    ratios = (tangent_ratio(least)[0], tangent_ratio(most)[1])
    right = _scale_ends(T, (low[0], high[0]), ratios)
    left = _scale_ends(T, (low[1], high[1]), ratios)
    return [_make_loop(k, (p - q) / (2 * b), (p + q) / 2, T) for p, q in product(right, left)]


def _scale_ends(factor: Fraction, ends: Range, ratios: Range) -> Range:
    """Return the range of factor x y over two ranges."""
    products = [factor * x * y for x in ends for y in ratios]
    return min(products), max(products)


def exact_vertex_feedbacks(gains: Numbers, box: ScheduleBox) -> list[Matrix]:
    """Return K at both ends of the range of Om."""
    k1, k2, k3 = exact_row(gains, "gains")
    zero = Fraction(0)
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


def _enclose(matrices: Sequence[Matrix]) -> GridMatrix:
    """Return the range of every entry, rounded outwards, in units of 1/GRID."""
    rows = zip(*matrices, strict=True)
    return tuple(tuple(map(_enclose_entry, zip(*row, strict=True))) for row in rows)


def _enclose_entry(values: Iterable[Fraction]) -> tuple[int, int]:
    scaled = [value * GRID for value in values]
    return floor(min(scaled)), ceil(max(scaled))


def _place(row: Row) -> GridRow:
    """Return a row on the grid."""
    return tuple(_enclose_entry((entry,)) for entry in row)


def _multiply(row: GridRow, matrix: GridMatrix) -> GridRow:
    """Enclose the products of all rows and matrices in these ranges."""
    entries = []
    for column in zip(*matrix, strict=True):
        low = 0
        high = 0
        for (a, b), (c, d) in zip(row, column, strict=True):
            ends = (a * c, a * d, b * c, b * d)
            low += min(ends)
            high += max(ends)
        entries.append((low // GRID, -(-high // GRID)))
    return tuple(entries)


@dataclass(frozen=True)
class _ExactWindow:
    """One stretch of N schedules: loops, the rows of E and of D K + C as rows on the error, and the
    offsets used."""

    loops: list[GridMatrix]
    rows: dict[str, list[list[GridRow]]]
    used: dict[str, Matrix]
    terminal: Halfspaces
    points: list[list[list[int]]]  # of the W of every stage in units of 1/share
    share: int

    def reach(self, row: GridRow, stage: int) -> Range:
        """Return upper bounds of h_W(row Phi_{j-1} .. Phi_1), j = stage, and of the support of R_j
        along the row."""
        last = 0
        total = 0
        for m in range(stage, 0, -1):
            last = max(_find_widest(row, point) for point in self.points[m - 1])
            total += last
            row = _multiply(row, self.loops[m - 1]) if m > 1 else row
        return Fraction(last, GRID * self.share), Fraction(total, GRID * self.share)

    @cached_property
    def _extents(self) -> Row:
        """Largest magnitude of every coordinate over the terminal set."""
        axes = exact_rows(np.vstack([np.eye(3), -np.eye(3)]))
        bounds = [self.terminal.bound(axis) for axis in axes]
        return tuple(map(max, bounds[:3], bounds[3:]))

    def bound_planned(self, row: GridRow) -> Fraction:
        """Return an upper bound of row e over the terminal set and the rows of the interval."""
        middle = tuple(Fraction(low + high, 2 * GRID) for low, high in row)
        halves = tuple(Fraction(high - low, 2 * GRID) for low, high in row)
        return self.terminal.bound(middle) + dot(halves, self._extents)


def _find_widest(row: GridRow, point: Sequence[int]) -> int:
    """Return the largest product of a point and a row of these ranges."""
    (a, b), (c, d), (e, f) = row
    x, y, z = point
    return (b if x > 0 else a) * x + (d if y > 0 else c) * y + (f if z > 0 else e) * z


def _couple(feedback: GridMatrix, inputs: Row, errors: Row) -> GridRow:
    """Enclose the row D K + C."""
    pairs = zip(_multiply(_place(inputs), feedback), _place(errors), strict=True)
    return tuple((a + c, b + d) for (a, b), (c, d) in pairs)


def _make_window(
    stages: Sequence[tuple[GridMatrix, GridMatrix]],
    points: Sequence[Matrix],
    error_rows: Matrix,
    input_rows: Sequence[tuple[Row, Row]],
    used: UsedOffsets,
    index: int,
) -> _ExactWindow:
    """Gather a window whose stages are given by their loops and feedbacks, and by the points of the
    W of each."""
    share = lcm(*(a.denominator for stage in points for point in stage for a in point))
    errors = [_place(row) for row in error_rows]
    inputs = [[_couple(feedback, *row) for row in input_rows] for _, feedback in stages]
    kept_errors = tuple(exact_row(row, "errors") for row in used.errors[index])
    kept_inputs = tuple(exact_row(row, "inputs") for row in used.inputs[index])
    return _ExactWindow(
        loops=[loop for loop, _ in stages],
        rows={"errors": [errors] * len(stages), "inputs": inputs},
        used={"errors": kept_errors, "inputs": kept_inputs},
        terminal=Halfspaces(used.terminal_normals, used.terminal[index]),
        points=[[[int(a * share) for a in point] for point in stage] for stage in points],
        share=share,
    )


def sequence_margins(
    boxes: Sequence[Sequence[ScheduleBox]],
    followers: Iterable[tuple[int, int]],
    gains: Numbers,
    dt: float,
    disturbance_vertices: Sequence[NumberRows],
    error_set: tuple[NumberRows, Numbers],
    input_set: tuple[NumberRows, NumberRows, Numbers],
    invariant_set: tuple[NumberRows, Numbers],
    used: UsedOffsets,
    regimes: Sequence[Sequence[int]] | None = None,
) -> dict[str, Fraction]:
    """Return the least margins of the tube conditions along known schedules, by name.

    `boxes[w][j]` encloses stage j of window w, `followers` are pairs (window, window one step
    later; none where the run ends). Sets are rows and offsets; `input_set` is (D, C, d) of D u + C
    e <= d, with rows D K + C on the error under u = K e. The vertices are those of one W a regime,
    `regimes[w][j]` the regime of stage j, the first unless given. With Psi = Phi_{j-1} .. Phi_1
    along the window:

        nonempty   the origin lies in every set used
        reach      used_j + h_{R_j}(c) <= offset of E, U;  T + R_N in Omega
        shifted    used_j + h_W(Psi^T c) <= used_{j-1} of the next window,  j = 1 .. N-1
        returns    T + Psi W, j = N, within the last E, U (after K) and T (after Phi) of the next
                   window

    The last two prove by themselves that a plan shifted by one step is admissible again.

    Raises:
        ValueError: shapes differ, or a follower is not its window one step later.
    """
    if any(len(offsets) != len(boxes) for offsets in (used.errors, used.inputs, used.terminal)):
        raise ValueError(
            f"used: {len(used.errors)} windows of offsets for {len(boxes)} windows: "
            "give one a window"
        )
    points = [exact_rows(vertices, "disturbance_vertices") for vertices in disturbance_vertices]
    acting = [[0] * len(row) for row in boxes] if regimes is None else regimes
    error_rows = exact_rows(error_set[0], "error_set")
    input_rows = [(exact_row(D), exact_row(C)) for D, C in zip(*input_set[:2], strict=True)]
    whole = {
        "errors": exact_row(error_set[1], "error_set"),
        "inputs": exact_row(input_set[2], "input_set"),
    }
    invariant = Halfspaces(*invariant_set)
    enclosed = _enclose_stages(boxes, gains, dt)
    windows = [
        _make_window(
            [enclosed[box] for box in row],
            [points[regime] for regime in acting[index]],
            error_rows,
            input_rows,
            used,
            index,
        )
        for index, row in enumerate(boxes)
    ]
    following = _find_followers(boxes, followers)
    rooms: dict[str, list[Fraction]] = defaultdict(list)
    for index, window in enumerate(windows):
        later_windows = [windows[later] for later in following[index]]
        conditions = [
            _check_stages(window, later_windows, whole),
            _check_terminal(window, invariant),
            *(_check_returns(window, later) for later in later_windows),
        ]
        for name, room in chain.from_iterable(conditions):
            rooms[name].append(room)
    return {name: min(values) for name, values in rooms.items()}


def _enclose_stages(
    boxes: Sequence[Sequence[ScheduleBox]], gains: Numbers, dt: float
) -> dict[ScheduleBox, tuple[GridMatrix, GridMatrix]]:
    """Enclose the loop and the feedback of every box that occurs."""
    enclosed = {}
    for box in set(chain.from_iterable(boxes)):
        loop = _enclose(exact_vertex_loops(gains, box, dt))
        enclosed[box] = (loop, _enclose(exact_vertex_feedbacks(gains, box)))
    return enclosed


def _find_followers(
    boxes: Sequence[Sequence[ScheduleBox]], followers: Iterable[tuple[int, int]]
) -> dict[int, list[int]]:
    """Return the windows that follow each window."""
    following: dict[int, list[int]] = defaultdict(list)
    for now, later in set(followers):
        if list(boxes[now][1:]) != list(boxes[later][:-1]):
            raise ValueError(
                f"followers: {now, later}: the second must be the first one step later"
            )
        following[now].append(later)
    return following


def _check_stages(
    window: _ExactWindow, following: list[_ExactWindow], whole: dict[str, Row]
) -> Iterator[tuple[str, Fraction]]:
    """Yield the room of `reach` and `shifted` along every row of E and U at every stage."""
    for name, stages in window.rows.items():
        for j, (rows, used) in enumerate(zip(stages, window.used[name], strict=True)):
            for i, (row, kept, offset) in enumerate(zip(rows, used, whole[name], strict=True)):
                last, reach = window.reach(row, j)
                yield f"{name} reach", offset - kept - reach
                if j == 0:
                    continue
                for later in following:
                    yield f"{name} shifted", later.used[name][j - 1][i] - kept - last


def _check_terminal(window: _ExactWindow, invariant: Halfspaces) -> Iterator[tuple[str, Fraction]]:
    """Yield the least offset used in the window and the room of T + R_N in the invariant set."""
    stages = chain(*window.used.values())
    yield "nonempty", min(*map(min, stages), *window.terminal.offsets)
    for normal, offset in zip(invariant.normals, invariant.offsets, strict=True):
        row = _place(normal)
        _, reach = window.reach(row, len(window.loops))
        yield "terminal reach", offset - window.bound_planned(row) - reach


def _check_returns(window: _ExactWindow, later: _ExactWindow) -> Iterator[tuple[str, Fraction]]:
    """Yield the room of T + Psi W along the rows of the last stage of the next window."""
    targets = []
    for normal, limit in zip(later.terminal.normals, later.terminal.offsets, strict=True):
        targets.append(("terminal", _multiply(_place(normal), later.loops[-1]), limit))
    for name, stages in later.rows.items():
        for row, limit in zip(stages[-1], later.used[name][-1], strict=True):
            targets.append((name, row, limit))
    for name, row, limit in targets:
        last, _ = window.reach(row, len(window.loops))
        yield f"{name} returns", limit - window.bound_planned(row) - last
