"""Columns that are recorded together, as numbers in SI units.

A row without any of them is a row of another sensor: programs that merge topics into one table
leave the cells of the others empty. A row with some of them is broken.

Source: new.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from jaxtube.recordings.columns import Column, Columns
from jaxtube.recordings.poses import are_degrees, find_bad_quaternions, find_headings
from jaxtube.recordings.table import Cells, read_numbers, refuse_cell

FACTORS = {
    "cm": 0.01,
    "mm": 0.001,
    "deg": np.pi / 180.0,
    "deg/s": np.pi / 180.0,
}
"""What units are in those that are computed with; wheels stay as measured."""


class Group(NamedTuple):
    """Numbers that are recorded together.

    Attributes:
        rows: of the table that have them.
        values: of those rows, a column each.
        columns: they were read from, in the units that were found.
    """

    rows: Bool[np.ndarray, "n"]
    values: Float[np.ndarray, "m k"]
    columns: tuple[Column, ...]

    def describe(self, what: str) -> list[str]:
        """Return what was taken for what, a clause each."""
        clauses = [column.describe() for column in self.columns]
        if not self.rows.all():
            clauses.append(f"{what} in {self.rows.sum()} of {self.rows.size} rows")
        return clauses


def read_group(cells: Cells, columns: Sequence[Column], what: str) -> Group:
    """Read columns that are recorded together.

    Args:
        cells: of the table.
        columns: to read.
        what: they hold, for messages.

    Raises:
        ValueError: in one line, for a cell that is no finite number, a row that has some of the
            numbers only, and a table that has none.
    """
    values = np.column_stack([_read_column(cells, column) for column in columns])
    missing = np.isnan(values)
    rows = np.count_nonzero(missing, axis=1) < len(columns)
    broken = np.argwhere(missing & rows[:, np.newaxis])
    if broken.size:
        row, number = broken[0]
        refuse_cell(cells, columns[number].places[0], int(row))
    if not rows.any():
        names = ", ".join(column.name for column in columns)
        raise ValueError(f"{cells.table.path}: {names} are empty: no {what}; give a recording")
    return Group(rows, values[rows], tuple(columns))


def _read_column(cells: Cells, column: Column) -> Float[np.ndarray, "n"]:
    """Return the numbers of a column in SI units, the mean where several are taken together."""
    numbers = np.array([read_numbers(cells, place) for place in column.places])
    return numbers.mean(axis=0) * FACTORS.get(column.unit, 1.0)


def read_pose_group(cells: Cells, found: Columns) -> Group:
    """Read the positions of a table, and the headings where it has any.

    Returns:
        Of each row that has a pose (x m, y m), and as a third column the heading in rad where the
        table has headings or quaternions.

    Raises:
        ValueError: as `read_group`, and for quaternions that are no rotations.
    """
    position = [found["x"], found["y"]]
    if "heading" in found:
        return _find_degrees(read_group(cells, [*position, found["heading"]], "poses"))
    parts = [found[name] for name in ("qx", "qy", "qz", "qw") if name in found]
    if not has_quaternion(found):
        return read_group(cells, position, "positions")
    group = read_group(cells, [*position, *parts], "poses")
    quaternions = np.zeros((len(group.values), 4))
    quaternions[:, -len(parts) :] = group.values[:, 2:]
    bad = find_bad_quaternions(quaternions)
    if bad.size:
        row = int(np.flatnonzero(group.rows)[bad[0]])
        raise ValueError(
            f"{cells.table.path}: line {cells.lines[row]}: the quaternion in "
            f"{', '.join(part.name for part in parts)} has norm "
            f"{np.linalg.norm(quaternions[bad[0]]):.3g}, not 1; name its columns, such as "
            "--columns qz=NAME,qw=NAME, or mend the row"
        )
    headings = find_headings(quaternions)
    return group._replace(values=np.column_stack([group.values[:, :2], headings]))


def has_quaternion(found: Columns) -> bool:
    """Say whether a table has quaternions: all parts, or those of turns about the vertical."""
    return "qz" in found and "qw" in found and ("qx" in found) == ("qy" in found)


def _find_degrees(group: Group) -> Group:
    """Return poses with headings in rad, where the unit was assumed and they lie better along the
    way in degrees."""
    column = group.columns[-1]
    positions = group.values[:, :2]
    headings = group.values[:, 2]
    if not column.is_assumed or not are_degrees(positions, headings):
        return group
    values = np.column_stack([positions, np.deg2rad(headings)])
    return group._replace(values=values, columns=(*group.columns[:2], column._replace(unit="deg")))
