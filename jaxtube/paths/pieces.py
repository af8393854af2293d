"""Pieces of a path: what lies between its breaks, each a drive of its own.

Source: new.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Int

from jaxtube.paths.breaks import Break, find_breaks
from jaxtube.paths.cells import find_radius, make_chain
from jaxtube.paths.headings import find_heading_problem, find_reversing
from jaxtube.paths.places import Note, line_of, place_of
from jaxtube.paths.rows import polygon_length, take_rows
from jaxtube.recordings.path import FEWEST_ROWS, RawPath

SHORTEST = 2.0
"""Length of a piece, in track widths, below which it is no drive."""

PASSED = ": cut out"
"""What is said of a stop that is driven through."""


class Piece(NamedTuple):
    """A piece of a path that is driven in one go.

    Attributes:
        raw: its rows.
        radius: of the cells of its path, m: what noise and jitter stay within.
        begins: what the robot does where it begins, empty at the start of the path.
        ends: the same where it ends.
        backwards: whether the robot reverses along it; None where the file has no headings.
    """

    raw: RawPath
    radius: float
    begins: str
    ends: str
    backwards: bool | None


class Cut(NamedTuple):
    """A path in pieces, and what was cut out of it."""

    pieces: list[Piece]
    notes: list[Note]


def cut_path(raw: RawPath, track_width: float, through_stops: bool) -> Cut:
    """Cut a path into pieces at its breaks.

    Args:
        raw: rows in the order of the drive.
        track_width: m.
        through_stops: drive on through stops before and after which the robot moves in one
            direction, instead of ending a piece there.

    Returns:
        The pieces that are long enough to be driven, and what was cut.
    """
    radius = find_radius(raw.positions, track_width)
    chain = make_chain(raw.positions, radius)
    notes = []
    problem = find_heading_problem(raw, chain)
    if problem:
        notes.append(Note(None, problem))
        raw = replace(raw, headings=None)
    found = find_breaks(raw, chain, track_width)
    for entry in found:
        passes = through_stops and not entry.motion
        notes.append(Note(entry.place, f"{entry.text}{PASSED if passes else ''}"))
    pieces = []
    for stretch in _collect_stretches(found, len(raw.positions), through_stops):
        piece = _make_piece(raw, radius, stretch)
        length = polygon_length(make_chain(piece.raw.positions, radius).means)
        if is_long_enough(piece, track_width):
            pieces.append(piece)
        elif length > 2.0 * radius:
            rows = len(stretch.rows)
            reason = "shorter than two effective tracks" if rows >= FEWEST_ROWS else f"{rows} rows"
            text = f"{length:.2f} m to the next break left out: {reason}"
            notes.append(Note(place_of(piece.raw, 0), text))
    return Cut(pieces, sorted(notes, key=line_of))


def is_long_enough(piece: Piece, track_width: float) -> bool:
    """Say whether a piece can be a drive of its own."""
    means = make_chain(piece.raw.positions, piece.radius).means
    return len(piece.raw.lines) >= FEWEST_ROWS and polygon_length(means) >= SHORTEST * track_width


class _Stretch(NamedTuple):
    """Rows of a piece, and what the robot does at either end."""

    rows: Int[np.ndarray, " k"]
    begins: str
    ends: str


def _collect_stretches(found: list[Break], rows: int, through_stops: bool) -> list[_Stretch]:
    """Return the rows between breaks; a piece that leads through a stop leaves the rows there
    out."""
    stretches = []
    ranges = []
    start = 0
    begins = ""
    for entry in found:
        ranges.append(np.arange(start, entry.ends + 1))
        start = entry.begins
        if through_stops and not entry.motion:
            continue
        stretches.append(_Stretch(np.concatenate(ranges), begins, entry.text))
        ranges = []
        begins = entry.text
    ranges.append(np.arange(start, rows))
    return [*stretches, _Stretch(np.concatenate(ranges), begins, "")]


def _make_piece(raw: RawPath, radius: float, stretch: _Stretch) -> Piece:
    rows = take_rows(raw, stretch.rows)
    backwards = None
    if raw.headings is not None:
        chain = make_chain(rows.positions, radius)
        backwards = len(chain.means) > 1 and bool(np.mean(find_reversing(rows, chain)) > 0.5)
    return Piece(rows, radius, stretch.begins, stretch.ends, backwards)
