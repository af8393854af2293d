"""Closed paths: whose end meets their start in the same direction.

Source: new.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from jaxtube.paths.cells import make_chain
from jaxtube.paths.pieces import Piece
from jaxtube.paths.places import Note, place_of
from jaxtube.paths.rows import take_rows

WIDEST = 2.0
"""Track widths between start and end at most, where rows are not further apart."""

STEPS = 1.5
"""The same, in the usual distances between cells."""

SIDEWAYS = 0.5
"""Gap across the path in track widths at most."""

LARGEST_TURN = np.deg2rad(45.0)
"""Angle between the directions at the end and at the start at most."""

SHORTEST_LAP = 3.0
"""Length of a lap at least, in the widest gaps."""

LEVER = 2
"""Cells over which a direction is taken."""


class Closed(NamedTuple):
    """A closed piece: its rows up to where it meets its start, the gap (m) from there on to the
    start, negative where noise puts the end beyond the start, and what was changed."""

    piece: Piece
    gap: float
    notes: list[Note]


def close(piece: Piece, track_width: float) -> Closed | None:
    """Return a piece as a closed path; None where its end does not meet its start.

    What leads on beyond the start is left out.
    """
    chain = make_chain(piece.raw.positions, piece.radius)
    steps = np.linalg.norm(np.diff(chain.means, axis=0), axis=1)
    if len(steps) < 2 * LEVER:
        return None
    widest = max(WIDEST * track_width, STEPS * float(np.median(steps)))
    if steps.sum() < SHORTEST_LAP * widest:
        return None
    to_end = np.append(np.cumsum(steps[::-1])[::-1], 0.0)
    late = np.flatnonzero(to_end <= widest)
    gaps = np.linalg.norm(chain.means[late] - chain.means[0], axis=1)
    last = int(late[np.argmin(gaps)])
    arrival = _unit(chain.means[last] - chain.means[last - LEVER])
    departure = _unit(chain.means[LEVER] - chain.means[0])
    forwards = _unit(arrival + departure)
    gap = chain.means[0] - chain.means[last]
    along = float(gap @ forwards)
    across = float(np.abs(gap[0] * forwards[1] - gap[1] * forwards[0]))
    is_closed = (
        arrival @ departure > np.cos(LARGEST_TURN)
        and across <= SIDEWAYS * track_width
        and -2.0 * piece.radius <= along <= widest
    )
    if not is_closed:
        return None
    end = int(chain.last[last])
    notes = [Note(place_of(piece.raw, end), f"meets its start, {across:.3f} m beside it: closed")]
    if last < len(chain.means) - 1:
        text = f"{to_end[last]:.2f} m beyond the start of the closed path left out"
        notes.append(Note(place_of(piece.raw, end), text))
    return Closed(piece._replace(raw=take_rows(piece.raw, slice(end + 1))), along, notes)


def _unit(step: Float[np.ndarray, "2"]) -> Float[np.ndarray, "2"]:
    return step / max(float(np.linalg.norm(step)), 1e-12)
