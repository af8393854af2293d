"""A log out of tables: wheels and poses in one, or poses in a second one beside it.

Source: new.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

from jaxtube.recordings.assemble import Samples, Sources
from jaxtube.recordings.columns import Columns, find_columns, find_wheel_unit, require_columns
from jaxtube.recordings.delimiter import is_number
from jaxtube.recordings.groups import Group, has_quaternion, read_group, read_pose_group
from jaxtube.recordings.hints import Hints
from jaxtube.recordings.stamps import Stamps, read_stamps
from jaxtube.recordings.table import Cells, Table, open_table, read_cells, shorten
from jaxtube.recordings.usual_names import (
    HEADING,
    LEFT,
    PATH_ROLES,
    RIGHT,
    SPEED,
    STEP,
    TIME,
    YAW_RATE,
    Role,
    X,
    Y,
)

WHEEL_ROLES = (TIME, LEFT, RIGHT, SPEED, YAW_RATE, STEP)


class Reading(NamedTuple):
    """A table that was read.

    Attributes:
        cells: of the columns that were found.
        columns: by the names of their roles.
        stamps: times of its rows.
    """

    cells: Cells
    columns: Columns
    stamps: Stamps


def read_sources(path: str, hints: Hints) -> Sources:
    """Read what a log is made of from a table, and from the pose file beside it if there is one.

    Raises:
        ValueError: in one line, for columns that are not there and cells that are no numbers.
    """
    table = open_table(path)
    if hints.pose_file is None:
        roles = (*WHEEL_ROLES, *PATH_ROLES[1:])
        required = (TIME, LEFT, RIGHT, X, Y, HEADING)
        reading = _read_table(table, roles, required, hints)
        poses, pose_clauses = _take_poses(reading)
    else:
        reading = _read_table(table, WHEEL_ROLES, (TIME, LEFT, RIGHT), hints)
        poses, pose_clauses = read_pose_file(hints)
    columns = reading.columns
    unit = find_wheel_unit(table, columns)
    wheels = read_group(reading.cells, [columns["right"], columns["left"]], "wheel speeds")
    commands, command_clauses = _take_optional(reading, ("cmd_v", "cmd_w"), "commands")
    steps, step_clauses = _take_steps(reading, hints)
    return Sources(
        wheels=_take(reading, wheels),
        wheel_unit=unit,
        poses=poses,
        commands=commands,
        steps=steps,
        guesses=(
            *table.guesses,
            columns["time"].describe(),
            *wheels.describe("wheel speeds"),
            *pose_clauses,
            *command_clauses,
            *step_clauses,
        ),
    )


def read_pose_file(hints: Hints) -> tuple[Samples, list[str]]:
    """Read the poses of the table beside a log.

    Returns:
        Samples of (x m, y m, heading rad), and what was taken for them, a clause each.

    Raises:
        ValueError: as `read_sources`.
    """
    table = open_table(str(hints.pose_file))
    reading = _read_table(table, PATH_ROLES, (TIME, X, Y, HEADING), hints.of_pose_file())
    poses, clauses = _take_poses(reading)
    stamp = reading.columns["time"].describe()
    return poses, [*table.guesses, f"poses of {table.path}: {stamp}", *clauses]


def _read_table(
    table: Table, roles: Sequence[Role], required: Sequence[Role], hints: Hints
) -> Reading:
    """Find and read the columns of a table."""
    columns = find_columns(table, roles, hints)
    is_spare = has_quaternion(columns)
    require_columns(
        table, columns, [role for role in required if not (role is HEADING and is_spare)]
    )
    places = [place for column in columns.values() for place in column.places]
    cells = read_cells(table, places)
    stamps, time = read_stamps(cells, columns["time"])
    return Reading(cells, {**columns, "time": time}, stamps)


def _take(reading: Reading, group: Group) -> Samples:
    """Return the samples of a group at the times of its rows."""
    stamps = reading.stamps._replace(since=reading.stamps.since[group.rows])
    lines = reading.cells.lines[group.rows]
    return Samples(reading.cells.table.path, stamps, group.values, lines, "line")


def _take_poses(reading: Reading) -> tuple[Samples, list[str]]:
    """Return the poses of a table, and what was taken for them."""
    group = read_pose_group(reading.cells, reading.columns)
    return _take(reading, group), group.describe("poses")


def _take_optional(
    reading: Reading, names: Sequence[str], what: str
) -> tuple[Samples | None, list[str]]:
    """Return samples that a log may lack, None where it does."""
    columns = [reading.columns[name] for name in names if name in reading.columns]
    if len(columns) < len(names):
        return None, []
    group = read_group(reading.cells, columns, what)
    return _take(reading, group), group.describe(what)


def _take_steps(reading: Reading, hints: Hints) -> tuple[Samples | None, list[str]]:
    """Return the numbers of the commands, None where a log has none; words that only happen to
    stand in a column of such a name are left aside."""
    step = reading.columns.get("step")
    if step is not None and "step" not in hints.columns:
        filled = filter(str.strip, reading.cells.columns[step.places[0]])
        word = next((cell for cell in filled if not is_number(cell)), None)
        if word is not None:
            return None, [f"steps: none read, {step.name} holds words such as {shorten(word)}"]
    steps, clauses = _take_optional(reading, ("step",), "steps")
    return (None if steps is None else steps._replace(values=steps.values[:, 0])), clauses
