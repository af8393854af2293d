"""Missions: the pieces of a path that a robot drives, each as a reference that its wheels can run,
and what was cut, changed or refused on the way.

Source: new; its parts name theirs.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from jaxtube.paths.cells import make_chain
from jaxtube.paths.closing import close
from jaxtube.paths.driving import Drive, Mission, drive_curve
from jaxtube.paths.pieces import Piece, cut_path
from jaxtube.paths.places import Note, line_of, place_of
from jaxtube.paths.profile import NoSpeedError
from jaxtube.paths.refusals import Failure, cut_at_corner, explain
from jaxtube.paths.rows import arrange_rows, polygon_length
from jaxtube.paths.smoothing import smooth
from jaxtube.recordings.path import RawPath

FAR_APART = 2.0
"""Track widths from row to row beyond which the curve between them is a guess."""

MOST_WIDENED = 4
"""Curves with widened turns that are tried."""


class Refused(NamedTuple):
    """A piece that is not driven, with the note that says where and why, and what helps."""

    piece: Piece
    note: Note


class PathPlan(NamedTuple):
    """What becomes of a path: pieces in their order, and all that was changed."""

    raw: RawPath
    outcomes: list[Mission | Refused]
    notes: list[Note]

    @property
    def missions(self) -> list[Mission]:
        """The pieces that are driven."""
        return [outcome for outcome in self.outcomes if isinstance(outcome, Mission)]

    @property
    def refused(self) -> list[Refused]:
        """The pieces that are not."""
        return [outcome for outcome in self.outcomes if isinstance(outcome, Refused)]


def plan_path(raw: RawPath, drive: Drive) -> PathPlan:
    """Return what becomes of a path.

    Args:
        raw: as its file has it.
        drive: how it is to be driven.

    Raises:
        ValueError: in one line, for rows that are no path.
    """
    rows = arrange_rows(raw, drive.largest_deviation)
    cut = cut_path(rows.raw, drive.limits.track_width, drive.through_stops)
    notes = [*rows.notes, *cut.notes]
    outcomes = []
    for piece in cut.pieces:
        outcomes += _drive_piece(piece, drive, notes)
    if not cut.pieces:
        notes.append(Note(None, "no stretch between breaks is as long as two effective tracks"))
    return PathPlan(rows.raw, outcomes, sorted(notes, key=line_of))


def _drive_piece(piece: Piece, drive: Drive, notes: list[Note]) -> list[Mission | Refused]:
    """Return what becomes of a piece; one that turns on the spot within its own curve is cut."""
    if piece.backwards:
        length = polygon_length(make_chain(piece.raw.positions, piece.radius).means)
        text = f"reverses for {length:.2f} m; references drive forwards"
        return [Refused(piece, Note(place_of(piece.raw, 0), text))]
    width = drive.limits.track_width
    closed = close(piece, width)
    if closed is not None:
        outcome = _try_smoother(closed.piece, drive, closed.gap)
        if isinstance(outcome, Mission):
            notes += [*closed.notes, *_find_gap(closed.piece, width)]
            return [outcome]
    outcome = _try_smoother(piece, drive, None)
    if isinstance(outcome, Mission):
        notes += _find_gap(piece, width)
        return [outcome]
    halves = cut_at_corner(piece, outcome, width)
    if halves is None:
        return [Refused(piece, explain(piece, outcome, drive.limits))]
    notes.append(halves.note)
    return [result for half in halves.pieces for result in _drive_piece(half, drive, notes)]


def _find_gap(piece: Piece, track_width: float) -> list[Note]:
    """Return a note on rows so far apart that the curve between them is a guess."""
    steps = np.linalg.norm(np.diff(piece.raw.positions, axis=0), axis=1)
    widest = int(np.argmax(steps))
    if steps[widest] <= FAR_APART * track_width:
        return []
    text = f"rows up to {steps[widest]:.2f} m apart: the curve between them is a guess"
    return [Note(place_of(piece.raw, widest), text)]


def _try_smoother(piece: Piece, drive: Drive, gap: float | None) -> Mission | Failure:
    """Drive a piece along the least smooth curve that can be driven; else return what stands
    against the last one that was tried."""
    failure = None
    widened = 0
    sharpest = drive.limits.sharpest_curvature
    for fit in smooth(piece, gap, drive.largest_deviation, sharpest):
        if fit.unbent_deviation > drive.largest_deviation or widened == MOST_WIDENED:
            return failure or Failure(fit, None, drive.largest_deviation)
        widened += fit.curve is not fit.unbent
        failure = Failure(fit, None, drive.largest_deviation)
        if fit.curve.sharpest > sharpest or fit.largest_deviation > drive.largest_deviation:
            continue
        try:
            return drive_curve(piece, fit, drive)
        except NoSpeedError as error:
            failure = Failure(fit, error.at, drive.largest_deviation)
    assert failure is not None  # `smooth` yields one fit at least
    return failure
