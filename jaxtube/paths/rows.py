"""Rows of a path in the order of the drive: sorted by time, repeats and stray points left out.

Order: rows are sorted by their stamps where that makes the path shorter or leaves its length; where
it makes it much longer the stamps are those of several drives. Stray points: a row that lies off
the median of its neighbours, coordinate by coordinate, by far more than noise and steps explain.

Source: running medians as in Tukey 1977, Exploratory Data Analysis, chapter 7; the scales are new.
"""

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float
from scipy.ndimage import median_filter

from jaxtube.paths.places import Note, place_of
from jaxtube.recordings.path import FEWEST_ROWS, RawPath
from jaxtube.recordings.spread import find_spread

LONGER_WHEN_SORTED = 1.5
"""Times its length in the order of the file beyond which a path sorted by time is none."""

NEIGHBOURS = 9
"""Rows whose median a stray row is measured from, so that up to four in a row are found."""

STRAY_NOISES = 10.0
"""Noises by which a stray row is off."""

STRAY_STEPS = 5.0
"""Steps of its neighbourhood by which a stray row is off: the median of a path that turns back is
nearer."""

CHANGE_SHARE = 5.0
"""Variance of the change of a row's distance from the chord of its neighbours, in variances of one
coordinate: of 1.5 n_i - 1.5 n_{i-1} - 0.5 n_{i+1} + 0.5 n_{i-2}."""

FEWEST_CHANGES = 10
"""Fewer have no noise to speak of: they are waypoints."""


class Rows(NamedTuple):
    """Rows to be driven, and what was done to the file's."""

    raw: RawPath
    notes: list[Note]


def arrange_rows(raw: RawPath, largest_deviation: float) -> Rows:
    """Return the rows of a path in the order of the drive, without repeats and stray points.

    Args:
        raw: the path as its file has it.
        largest_deviation: m, below which no row is stray.

    Raises:
        ValueError: in one line, for too few rows, or stamps of several drives.
    """
    notes = []
    if raw.time is not None and not np.ptp(raw.time):
        notes.append(Note(None, "all rows have the same time, which is not used"))
        raw = replace(raw, time=None)
    ordered = _sort(raw, notes)
    distinct = _drop_repeats(ordered, notes)
    _refuse_few(distinct)
    _tell_shared_stamps(distinct, notes)
    kept = _drop_strays(distinct, largest_deviation, notes)
    _refuse_few(kept)
    return Rows(kept, notes)


def take_rows(raw: RawPath, rows: np.ndarray | slice) -> RawPath:
    """Return some rows of a path."""
    return replace(
        raw,
        time=None if raw.time is None else raw.time[rows],
        positions=raw.positions[rows],
        headings=None if raw.headings is None else raw.headings[rows],
        lines=raw.lines[rows],
    )


def measure_noise(positions: Float[np.ndarray, "n 2"]) -> float:
    """Return the noise of positions, standard deviation of a coordinate in m.

    It is read off the change, from row to row, of how far rows lie off the chord of their
    neighbours: steady curves lie off it steadily. The faster half of the rows counts: a robot that
    stands may be measured better than one that drives.
    """
    first = positions[1:-1] - positions[:-2]
    chord = positions[2:] - positions[:-2]
    length = np.linalg.norm(chord, axis=1)
    across = chord[:, 0] * first[:, 1] - chord[:, 1] * first[:, 0]
    offset = across / np.where(length > 0.0, length, 1.0)
    shorter = np.minimum(length[1:], length[:-1])
    changes = np.abs(np.diff(offset))[(shorter > 0.0) & (shorter >= np.median(shorter))]
    if len(changes) < FEWEST_CHANGES:
        return 0.0
    return find_spread(changes) / float(np.sqrt(CHANGE_SHARE))


def polygon_length(positions: Float[np.ndarray, "n 2"]) -> float:
    """Return the length of the polygon through positions, m."""
    return float(np.linalg.norm(np.diff(positions, axis=0), axis=1).sum())


def _sort(raw: RawPath, notes: list[Note]) -> RawPath:
    """Return the rows in order of time, those of one stamp in the order of the file."""
    if raw.time is None or not (np.diff(raw.time) < 0.0).any():
        return raw
    falls = np.flatnonzero(np.diff(raw.time) < 0.0) + 1
    ordered = take_rows(raw, np.argsort(raw.time, kind="stable"))
    if polygon_length(ordered.positions) > LONGER_WHEN_SORTED * polygon_length(raw.positions):
        raise ValueError(
            f"{raw.path}: time falls back at {raw.word} {raw.lines[falls[0]]} as if a second drive "
            "began there; write each drive to a file of its own"
        )
    text = f"time falls back {len(falls)} times, first here; rows sorted by time"
    notes.append(Note(place_of(raw, int(falls[0])), text))
    assert ordered.time is not None
    return replace(ordered, time=ordered.time - ordered.time[0])


def _drop_repeats(raw: RawPath, notes: list[Note]) -> RawPath:
    """Leave out rows that repeat position and stamp of the row before; positions held for longer
    are stops, and stay."""
    is_repeat = (np.diff(raw.positions, axis=0) == 0.0).all(axis=1)
    if raw.time is not None:
        is_repeat &= np.diff(raw.time) == 0.0
    repeats = np.flatnonzero(is_repeat) + 1
    if not repeats.size:
        return raw
    what = "positions" if raw.time is None else "rows"
    text = f"{len(repeats)} repeated {what} left out, first here"
    notes.append(Note(place_of(raw, int(repeats[0])), text))
    return take_rows(raw, np.delete(np.arange(len(raw.positions)), repeats))


def _tell_shared_stamps(raw: RawPath, notes: list[Note]) -> None:
    if raw.time is None:
        return
    shared = np.flatnonzero(np.diff(raw.time) == 0.0)
    if shared.size:
        apart = np.linalg.norm(np.diff(raw.positions, axis=0)[shared], axis=1).max()
        text = (
            f"{len(shared)} rows share the stamp of the row before, up to {apart:.3g} m away, "
            "first here; kept in the order of the file"
        )
        notes.append(Note(place_of(raw, int(shared[0]) + 1), text))


def _drop_strays(raw: RawPath, largest_deviation: float, notes: list[Note]) -> RawPath:
    is_stray = _find_strays(raw.positions, largest_deviation)
    for row in np.flatnonzero(is_stray & ~np.append(False, is_stray[:-1])):
        count = int(np.argmin(np.append(is_stray[row:], False)))
        rows = "row" if count == 1 else f"{count} rows"
        text = f"{rows} off its neighbours by {_find_offset(raw.positions)[row]:.2f} m, left out"
        notes.append(Note(place_of(raw, int(row)), text))
    return take_rows(raw, ~is_stray)


def _find_strays(
    positions: Float[np.ndarray, "n 2"], largest_deviation: float
) -> Bool[np.ndarray, " n"]:
    offset = _find_offset(positions)
    steps = np.linalg.norm(np.diff(positions, axis=0, prepend=positions[:1]), axis=1)
    near = STRAY_STEPS * median_filter(steps, NEIGHBOURS, mode="nearest")
    noise = STRAY_NOISES * measure_noise(positions)
    return offset > np.maximum(near, max(noise, 2.0 * largest_deviation))


def _find_offset(positions: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, " n"]:
    """Return how far each row is off the median of its neighbours, m."""
    medians = median_filter(positions, (NEIGHBOURS, 1), mode="nearest")
    return np.linalg.norm(positions - medians, axis=1)


def _refuse_few(raw: RawPath) -> None:
    if len(raw.positions) < FEWEST_ROWS:
        raise ValueError(
            f"{raw.path}: {len(raw.positions)} different rows are no path; give at least "
            f"{FEWEST_ROWS} positions"
        )
