"""Files of missions: references as tables, each row a pose and the wheel speeds held from there on.

The header is that of a recorded path with three more columns, so that whatever reads such a path
reads a mission; read as a mission, its wheel speeds are those that were checked, to the last bit.

Source: RFC 4180 for CSV; the header is this project's.
"""

from __future__ import annotations

import csv
import io
from pathlib import Path

import numpy as np
from jaxtyping import Float

from jaxtube.plant.reference import Reference, count_periods, make_reference
from jaxtube.recordings.delimiter import is_number

COLUMNS = ("time_s", "x_m", "y_m", "heading_rad", "right_mps", "left_mps")

SAME_POSE = 1e-6
"""Largest difference between the poses of a file and those that its wheels lead to, m and rad."""


def write_mission(reference: Reference, origin: Float[np.ndarray, "2"]) -> str:
    """Return the file of a reference's run, without its preview, as text.

    Args:
        reference: with positions from an origin.
        origin: of its positions, m: the file's are counted from zero.
    """
    steps = reference.steps
    times = reference.dt * np.arange(steps + 1)
    poses = reference.poses[: steps + 1] + np.append(origin, 0.0)
    # Nothing follows upon the last pose: the wheels of the last period stand there again.
    wheels = reference.wheels[[*range(steps), steps - 1]]
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(COLUMNS)
    for time, row in zip(times, np.column_stack([poses, wheels]).tolist(), strict=True):
        writer.writerow([f"{time:.9g}", *map(repr, row)])
    return text.getvalue()


def read_mission(
    path: str | Path, dt: float, preview: int, track_width: float, duration: float | None
) -> Reference | None:
    """Read a mission; past its end its last wheel speeds are held.

    Args:
        path: of the file.
        dt: s.
        preview: periods known beyond the run.
        track_width: m.
        duration: of the run, s, a whole number of periods; None for the whole mission.

    Returns:
        The reference; None for a file that is no mission, or one for another period, another
        distance between the wheels, or a shorter run.
    """
    table = _read_table(path)
    if table is None or len(table) < 2:
        return None
    steps = len(table) - 1 if duration is None else count_periods(duration, dt)
    if steps >= len(table):
        return None
    times = dt * np.arange(len(table))
    wheels = np.pad(table[:-1, 4:], ((0, preview), (0, 0)), "edge")
    reference = make_reference(
        start=table[0, 1:4],
        speeds=wheels.mean(axis=1),
        yaw_rates=wheels @ np.array([1.0, -1.0]) / track_width,
        dt=dt,
        steps=steps,
        track_width=track_width,
    )
    off = np.abs(reference.poses[: len(table)] - table[:, 1:4]).max()
    if not (np.allclose(times, table[:, 0], rtol=1e-6, atol=1e-9) and off <= SAME_POSE):
        return None
    known = steps + preview
    return Reference(reference.wheels[:known], reference.poses[: known + 1], dt, steps)


def _read_table(path: str | Path) -> Float[np.ndarray, "rows 6"] | None:
    """Return the numbers of a mission's file; None for any other."""
    try:
        with Path(path).open(newline="", encoding="utf-8") as file:
            reader = csv.reader(file)
            if tuple(next(reader, ())) != COLUMNS:
                return None
            rows = list(reader)
    except (ValueError, csv.Error):
        return None
    if any(len(row) != len(COLUMNS) or not all(map(is_number, row)) for row in rows):
        return None
    return np.array([[float(cell) for cell in row] for row in rows]).reshape(-1, len(COLUMNS))
