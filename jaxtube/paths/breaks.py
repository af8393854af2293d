"""Breaks of a path: where the robot stops, turns on the spot, turns back, jumps, or reverses.

A robot that drives along a curve turns little between a cell of the chain and the next. A turn of
more than `SHARPEST` within two of them is a corner. Positions alone cannot tell a robot that
reverses from one that turns on the spot by 180 degrees; headings, where the file has them, can.

Source: new.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from jaxtube.paths.cells import Chain
from jaxtube.paths.places import Place, place_of
from jaxtube.recordings.path import RawPath

SHARPEST = np.deg2rad(75.0)
"""Turn within two cells above which the robot turns on the spot, where they are near each other."""

TURNED_BACK = np.deg2rad(135.0)
"""Turn above which the robot may as well have reversed."""

LEVER = 3
"""Cells over which the direction before and after a break is taken."""

STANDS = 5.0
"""Times the usual stay in a cell from which the robot stands there."""

PAUSE_TURN = np.deg2rad(30.0)
"""Angle between the motion before and after a stop up to which a path may lead through it."""

SHORTEST_STOP_S = 1.0
SHORTEST_STOP_ROWS = 10.0

WIDEST_GAP = 4.0
"""Track widths that lie between two rows at most, unless rows are that far apart as a rule."""

GAP_STEPS = 10.0
"""Times the usual distance between cells beyond which a step is a jump."""

SAME_DIRECTION = np.deg2rad(30.0)
"""Angle between heading and motion, in the median of a path, up to which headings are believed."""

FEWEST_CELLS = 3
"""A shorter chain has no direction of motion."""


class Break(NamedTuple):
    """Where a path is broken: it ends at row `ends` and begins anew at row `begins`.

    `turn` is the angle between the motion before and after, rad. A path may be driven through a
    break that is a stop and nothing else: one without `motion`.
    """

    ends: int
    begins: int
    place: Place
    turn: float
    stop: str = ""
    motion: str = ""

    @property
    def text(self) -> str:
        """What the robot does there."""
        return ", ".join(part for part in (self.stop, self.motion) if part)

    def join(self, later: Break) -> Break:
        """Return this break and a later one that it overlaps as one."""
        sharper = max(self, later, key=lambda entry: entry.turn)
        return Break(
            ends=self.ends,
            begins=max(self.begins, later.begins),
            place=self.place,
            turn=sharper.turn,
            stop=self.stop or later.stop,
            motion=sharper.motion or self.motion or later.motion,
        )


def find_breaks(raw: RawPath, chain: Chain, track_width: float) -> list[Break]:
    """Return the breaks of a path in its order."""
    found = [
        *_find_jumps(raw, chain, track_width),
        *_find_stops(raw, chain),
        *_find_corners(raw, chain, track_width),
        *_find_turns_on_the_spot(raw, chain),
    ]
    return _merge(sorted(found, key=lambda entry: (entry.ends, entry.begins)))


def find_heading_problem(raw: RawPath, chain: Chain) -> str:
    """Say why the headings of a path cannot be its robot's; empty where they can be, and where it
    has none.

    A robot that reverses has its heading against its motion: both senses count as fitting.
    """
    if raw.headings is None or len(chain.means) < FEWEST_CELLS:
        return ""
    angles = np.abs(_angles_to_motion(raw, chain))
    off = np.median(np.minimum(angles, np.pi - angles))
    if off < SAME_DIRECTION:
        return ""
    return (
        f"headings are off the direction of motion by {np.degrees(off):.0f} deg in half of the "
        "path, and not used; give them in rad, from the x axis to the left"
    )


def find_reversing(raw: RawPath, chain: Chain) -> Bool[np.ndarray, " cells"]:
    """Return in which cells the robot moves against its heading."""
    return np.abs(_angles_to_motion(raw, chain)) > np.pi / 2.0


def _angles_to_motion(raw: RawPath, chain: Chain) -> Float[np.ndarray, " cells"]:
    """Return the angles from the motion to the heading of each cell, rad."""
    assert raw.headings is not None
    middle = (chain.first + chain.last) // 2
    motion = _direction(np.gradient(chain.means, axis=0))
    return _wrap(raw.headings[middle] - motion)


def _find_jumps(raw: RawPath, chain: Chain, track_width: float) -> list[Break]:
    steps = np.linalg.norm(np.diff(raw.positions, axis=0), axis=1)
    apart = np.linalg.norm(np.diff(chain.means, axis=0), axis=1)
    widest = max(WIDEST_GAP * track_width, GAP_STEPS * float(np.median(apart)) if len(apart) else 0)
    return [
        Break(row, row + 1, place_of(raw, row), 0.0, motion=f"jumps by {steps[row]:.2f} m")
        for row in np.flatnonzero(steps > widest).tolist()
    ]


def _find_stops(raw: RawPath, chain: Chain) -> list[Break]:
    """Return where the robot stays in a cell for much longer than in the others."""
    dwell = chain.dwell(raw)
    shortest = SHORTEST_STOP_ROWS if raw.time is None else SHORTEST_STOP_S
    unit = "rows" if raw.time is None else "s"
    stops = np.flatnonzero(dwell > max(shortest, STANDS * float(np.median(dwell))))
    found = []
    for cell in stops.tolist():
        rows = _rows_near_mean(raw, chain, cell)
        turn = _turn_at(chain, cell, by_way_of_it=True)
        found.append(
            Break(
                ends=int(rows[0]),
                begins=int(rows[-1]),
                place=place_of(raw, int(rows[0])),
                turn=turn,
                stop=f"stands for {dwell[cell]:.3g} {unit}",
                motion=_say_turn(raw, chain, cell, turn) if turn > PAUSE_TURN else "",
            )
        )
    return found


def _find_corners(raw: RawPath, chain: Chain, track_width: float) -> list[Break]:
    """Return where the chain turns by more than a curve would; the sharpest cell of each corner.

    A turn that the next one takes back is jitter.
    """
    sharp = _sharpness(chain, track_width)
    found = []
    cell = 0
    while cell < len(sharp):
        if sharp[cell] <= SHARPEST:
            cell += 1
            continue
        end = cell + int(np.argmin(np.append(sharp[cell:] > SHARPEST, False)))
        turns = [_turn_at(chain, corner) for corner in range(cell, end)]
        turn = max(turns)
        if turn > SHARPEST:
            corner = cell + turns.index(turn)
            row = _corner_row(raw, chain, corner)
            place = place_of(raw, row)
            motion = _say_turn(raw, chain, corner, turn)
            found.append(Break(row, row, place, turn, motion=motion))
        cell = end
    return found


def _find_turns_on_the_spot(raw: RawPath, chain: Chain) -> list[Break]:
    """Return where the heading turns while the robot stays in its cell."""
    if raw.headings is None:
        return []
    found = []
    for first, last in zip(chain.first.tolist(), chain.last.tolist(), strict=True):
        turn = float(np.abs(_wrap(np.diff(raw.headings[first : last + 1])).sum()))
        if turn > SHARPEST:
            text = f"turns on the spot by {np.degrees(turn):.0f} deg"
            found.append(Break(first, last, place_of(raw, first), turn, motion=text))
    return found


def _say_turn(raw: RawPath, chain: Chain, cell: int, turn: float) -> str:
    """Say what the robot does where its motion turns."""
    degrees = f"{np.degrees(turn):.0f} deg"
    if turn < TURNED_BACK:
        return f"turns on the spot by {degrees}"
    if raw.headings is None:
        return f"turns back by {degrees} (reverses or turns on the spot: no headings)"
    before = raw.headings[chain.first[max(cell - 1, 0)]]
    after = raw.headings[chain.last[min(cell + 1, len(chain.means) - 1)]]
    is_spot_turn = np.abs(_wrap(after - before)) > np.pi / 2.0
    return f"turns on the spot by {degrees}" if is_spot_turn else "changes between forth and back"


def _sharpness(chain: Chain, track_width: float) -> Float[np.ndarray, " cells"]:
    """Return the greatest turn at each cell, or over it and the next one, rad; 0 where the turn
    takes a wider circle than one around the robot's own wheel would."""
    steps = np.diff(chain.means, axis=0)
    ways = np.linalg.norm(steps, axis=1)
    directions = _direction(steps)
    sharp = np.zeros(len(chain.means))
    for apart in (1, 2):
        if len(ways) <= apart:
            break
        turns = np.abs(_wrap(directions[apart:] - directions[:-apart]))
        way = np.lib.stride_tricks.sliding_window_view(ways, apart + 1).mean(axis=1) * apart
        turns[way > turns * track_width] = 0.0
        inner = slice(1, len(sharp) - apart)
        sharp[inner] = np.maximum(sharp[inner], turns)
    return sharp


def _turn_at(chain: Chain, cell: int, by_way_of_it: bool = False) -> float:
    """Return the angle between the motion before and after a cell, rad; 0 at an end of the path.

    The directions are those of the cells before and after, or `by_way_of_it` to and from its mean,
    which is known well where the robot stands.
    """
    before = chain.means[max(cell - LEVER, 0) : cell]
    after = chain.means[cell + 1 : cell + 1 + LEVER]
    if not len(before) or not len(after):
        return 0.0
    here = chain.means[cell]
    arrival = (before[-1] if len(before) > 1 and not by_way_of_it else here) - before[0]
    departure = after[-1] - (after[0] if len(after) > 1 and not by_way_of_it else here)
    return float(np.abs(_wrap(_direction(departure) - _direction(arrival))))


def _rows_near_mean(raw: RawPath, chain: Chain, cell: int) -> Int[np.ndarray, " k"]:
    """Return the rows of a cell near its mean: a robot that stops there drives into it first."""
    rows = np.arange(chain.first[cell], chain.last[cell] + 1)
    off = np.linalg.norm(raw.positions[rows] - chain.means[cell], axis=1)
    return rows[off <= max(chain.radius / 2.0, off.min())]


def _corner_row(raw: RawPath, chain: Chain, cell: int) -> int:
    """Return the row of a corner: of the cell and its neighbours the one that lies furthest out."""
    before = max(cell - LEVER, 0)
    after = min(cell + LEVER, len(chain.means) - 1)
    inwards = chain.means[before] + chain.means[after] - 2.0 * chain.means[cell]
    first = int(chain.first[max(cell - 1, 0)])
    last = int(chain.last[min(cell + 2, len(chain.means) - 1)])
    return first + int(np.argmin(raw.positions[first : last + 1] @ inwards))


def _merge(found: list[Break]) -> list[Break]:
    """Join breaks that overlap: the robot stands where it turns."""
    merged: list[Break] = []
    for entry in found:
        if merged and entry.ends <= merged[-1].begins:
            merged[-1] = merged[-1].join(entry)
        else:
            merged.append(entry)
    return merged


def _direction(steps: Float[np.ndarray, "... 2"]) -> Float[np.ndarray, "..."]:
    return np.arctan2(steps[..., 1], steps[..., 0])


def _wrap(angles: Float[np.ndarray, "..."]) -> Float[np.ndarray, "..."]:
    """Return angles in [-pi, pi)."""
    return (angles + np.pi) % (2.0 * np.pi) - np.pi
