"""A path out of a table.

Source: new; race lines as those of TUM FTM, poses as those of the TUM RGB-D benchmark.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from jaxtyping import Float

from jaxtube.recordings.columns import Columns, find_columns, require_columns
from jaxtube.recordings.groups import read_pose_group
from jaxtube.recordings.hints import Hints
from jaxtube.recordings.path import RawPath, count_from_origin
from jaxtube.recordings.poses import align_headings
from jaxtube.recordings.spelling import normalise
from jaxtube.recordings.stamps import read_stamps
from jaxtube.recordings.table import Table, open_table, read_cells, read_numbers
from jaxtube.recordings.usual_names import PATH_ROLES, X, Y

ALIGNED = 0.9
"""Least alignment of numbers with the way for which they are taken for headings."""

INCREASING = 0.9
"""Least share of rows that increase in a column that is taken for the time: stamps of a recording
may be repeated or out of order, now and then."""

LATITUDES = ("lat", "latitude")


def read_path_table(path: str, hints: Hints) -> RawPath:
    """Read a path from a table, its rows as they are.

    Raises:
        ValueError: in one line, for columns that are not there and cells that are no numbers.
    """
    table = open_table(path)
    hints = hints if table.has_names or hints.columns else _guess_columns(table, hints)
    found = find_columns(table, PATH_ROLES, hints)
    _refuse_degrees(table, found)
    require_columns(table, found, (X, Y))
    cells = read_cells(table, [place for column in found.values() for place in column.places])
    group = read_pose_group(cells, found)
    time = None
    clauses = group.describe("positions")
    if "time" in found:
        stamps, column = read_stamps(cells.take(group.rows), found["time"])
        time = stamps.since
        clauses = [column.describe(), *clauses]
    return count_from_origin(
        RawPath(
            path=table.path,
            time=time,
            positions=group.values[:, :2],
            headings=group.values[:, 2] if group.values.shape[1] > 2 else None,
            lines=cells.lines[group.rows],
            word="line",
            guesses=(*table.guesses, *clauses),
        )
    )


def _refuse_degrees(table: Table, found: Columns) -> None:
    """Refuse a path on the globe."""
    latitudes = [name for name in table.names if normalise(name) in LATITUDES]
    if latitudes and "x" not in found:
        raise ValueError(
            f"{table.path}: column {latitudes[0]} is in degrees on the globe; project the path to "
            "metres, such as UTM, and give easting and northing as x_m and y_m"
        )


def _guess_columns(table: Table, hints: Hints) -> Hints:
    """Return hints with the columns of a table without header, as far as their number and their
    numbers tell them."""
    roles = _guess_roles(table)
    columns = {role: str(number) for number, role in enumerate(roles, 1)}
    return replace(hints, columns=columns)


def _guess_roles(table: Table) -> tuple[str, ...]:
    """Return what the columns hold, nothing where it cannot be told."""
    width = len(table.names)
    if width == 2:
        return ("x", "y")
    if width not in (3, 4):
        return ()
    cells = read_cells(table, range(width))
    numbers = np.column_stack([read_numbers(cells, place) for place in range(width)])
    if len(numbers) < 2:
        return ()
    increases = np.mean(np.diff(numbers[:, 0]) > 0.0) >= INCREASING
    if width == 3 and _are_poses(numbers):
        return ("x", "y", "heading")
    if width == 3 and increases:
        return ("time", "x", "y")
    if width == 4 and increases and _are_poses(numbers[:, 1:]):
        return ("time", "x", "y", "heading")
    return ()


def _are_poses(numbers: Float[np.ndarray, "n 3"]) -> bool:
    """Say whether the last of three columns holds headings: it lies along the way that the first
    two make, in rad or in degrees."""
    positions = numbers[:, :2]
    angles = (numbers[:, 2], np.deg2rad(numbers[:, 2]))
    return max(align_headings(positions, angle) for angle in angles) >= ALIGNED
