"""Breaks of a path: where the robot stops, turns on the spot, turns back, jumps, or reverses.

A turn of more than `SHARPEST` within two cells of the chain that are near each other is a corner; a
cell in which the robot stays for much longer than in the others is a stop.

Source: new.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Int

from jaxtube.paths.cells import Chain
from jaxtube.paths.places import Place, place_of
from jaxtube.paths.turns import (
    describe_turn,
    find_corner_row,
    find_sharpness,
    find_turn,
    wrap_angles,
)
from jaxtube.recordings.path import RawPath

SHARPEST = np.deg2rad(75.0)
"""Turn within two cells above which the robot turns on the spot, where they are near each other."""

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
        turn = find_turn(chain, cell, by_way_of_it=True)
        found.append(
            Break(
                ends=int(rows[0]),
                begins=int(rows[-1]),
                place=place_of(raw, int(rows[0])),
                turn=turn,
                stop=f"stands for {dwell[cell]:.3g} {unit}",
                motion=describe_turn(raw, chain, cell, turn) if turn > PAUSE_TURN else "",
            )
        )
    return found


def _find_corners(raw: RawPath, chain: Chain, track_width: float) -> list[Break]:
    """Return where the chain turns by more than a curve would; the sharpest cell of each corner.

    A turn that the next one takes back is jitter.
    """
    sharp = find_sharpness(chain, track_width)
    found = []
    cell = 0
    while cell < len(sharp):
        if sharp[cell] <= SHARPEST:
            cell += 1
            continue
        end = cell + int(np.argmin(np.append(sharp[cell:] > SHARPEST, False)))
        turns = [find_turn(chain, corner) for corner in range(cell, end)]
        turn = max(turns)
        if turn > SHARPEST:
            corner = cell + turns.index(turn)
            row = find_corner_row(raw, chain, corner)
            place = place_of(raw, row)
            motion = describe_turn(raw, chain, corner, turn)
            found.append(Break(row, row, place, turn, motion=motion))
        cell = end
    return found


def _find_turns_on_the_spot(raw: RawPath, chain: Chain) -> list[Break]:
    """Return where the heading turns while the robot stays in its cell."""
    if raw.headings is None:
        return []
    found = []
    for first, last in zip(chain.first.tolist(), chain.last.tolist(), strict=True):
        turn = float(np.abs(wrap_angles(np.diff(raw.headings[first : last + 1])).sum()))
        if turn > SHARPEST:
            text = f"turns on the spot by {np.degrees(turn):.0f} deg"
            found.append(Break(first, last, place_of(raw, first), turn, motion=text))
    return found


def _rows_near_mean(raw: RawPath, chain: Chain, cell: int) -> Int[np.ndarray, " k"]:
    """Return the rows of a cell near its mean: a robot that stops there drives into it first."""
    rows = np.arange(chain.first[cell], chain.last[cell] + 1)
    off = np.linalg.norm(raw.positions[rows] - chain.means[cell], axis=1)
    return rows[off <= max(chain.radius / 2.0, off.min())]


def _merge(found: list[Break]) -> list[Break]:
    """Join breaks that overlap: the robot stands where it turns."""
    merged: list[Break] = []
    for entry in found:
        if merged and entry.ends <= merged[-1].begins:
            merged[-1] = merged[-1].join(entry)
        else:
            merged.append(entry)
    return merged
