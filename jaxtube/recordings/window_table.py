"""Windows out of a table, a row each.

Source: new.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Bool

from jaxtube.recordings.bag import is_bag
from jaxtube.recordings.columns import (
    Columns,
    find_columns,
    find_place,
    find_wheel_unit,
    require_columns,
)
from jaxtube.recordings.groups import read_group
from jaxtube.recordings.hints import NO_HINTS, NOTHING, Hints
from jaxtube.recordings.spelling import normalise
from jaxtube.recordings.table import Cells, Table, open_table, read_cells, shorten
from jaxtube.recordings.usual_names import (
    BODY_LATERAL,
    BODY_RATE,
    BODY_SPEED,
    LEFT,
    RIGHT,
    STEP,
    TIME,
    WINDOW_ROLES,
)
from jaxtube.recordings.wheels import find_scale, is_counted
from jaxtube.recordings.windows import Windows

LONGEST_STEP = 0.5
"""Step in m between two poses beyond which the pose was lost."""

SORTS = ("robot", "vehicle", "platform", "terrain", "surface", "ground")
"""Columns whose values must not be mixed: windows are of one robot on one ground."""

SHOWN_VALUES = 8
"""Values of a column that a message lists."""

TRUE_WORDS = ("true", "1", "1.0", "yes")
FALSE_WORDS = ("false", "0", "0.0", "no")


def is_window_table(path: str | Path, hints: Hints = NO_HINTS) -> bool:
    """Say whether a table holds windows: speeds of wheels and of the body, and no time.

    Raises:
        ValueError: in one line, for what is no table.
    """
    if is_bag(path):
        return False
    table = open_table(path)
    found = find_columns(table, (TIME, *WINDOW_ROLES), hints)
    needed = ("left", "right", "v", "w")
    return "time" not in found and all(name in found for name in needed)


def read_windows(
    path: str | Path, select: Mapping[str, str] = NOTHING, hints: Hints = NO_HINTS
) -> Windows:
    """Read windows of a log.

    Args:
        path: of the table.
        select: values of columns that a row must have, such as {"robot": "husky"}.
        hints: what the user says about the table.

    Raises:
        ValueError: in one line, for columns, values and units that are missing or unknown, and for
            windows of several robots or grounds.
    """
    table = open_table(path)
    found = find_columns(table, WINDOW_ROLES, hints)
    require_columns(table, found, (STEP, LEFT, RIGHT, BODY_SPEED, BODY_RATE, BODY_LATERAL))
    scale = _find_scale(table, found, hints)
    choices = {find_place(table, "--select", name): select[name] for name in select}
    sorts = [place for place, name in enumerate(table.names) if normalise(name) in SORTS]
    places = [place for column in found.values() for place in column.places]
    cells = read_cells(table, [*places, *sorts, *choices])
    for place, value in choices.items():
        cells = _select(cells, place, value)
    for place in sorts:
        _refuse_mixture(cells, place)
    names = ("step", "right", "left", "v", "w", "vy")
    group = read_group(cells, [found[name] for name in names], "windows")
    cells = cells.take(group.rows)
    return Windows(
        path=table.path,
        command=np.rint(group.values[:, 0]).astype(int),
        wheels=scale * group.values[:, 1:3],
        velocity=group.values[:, 3:],
        steady=_read_steady(cells, found),
        lost=_find_lost(cells, found),
        guesses=(*table.guesses, *group.describe("windows"), *_describe_rest(found, select)),
    )


def _find_scale(table: Table, found: Columns, hints: Hints) -> float:
    """Return the m/s of one unit of the wheels."""
    unit = find_wheel_unit(table, found)
    if is_counted(unit):
        raise ValueError(
            f"{table.path}: the wheels of windows are in {unit}, of which means are no speeds; "
            "give them in m/s, rad/s or rpm"
        )
    return find_scale(table.path, unit, hints)


def _select(cells: Cells, place: int, value: str) -> Cells:
    """Return the rows that have a value in a column.

    Raises:
        ValueError: in one line with the values there are, where no row has it.
    """
    values = [cell.strip() for cell in cells.columns[place]]
    rows = np.array([each == value.strip() for each in values])
    if not rows.any():
        name = cells.table.names[place]
        raise ValueError(
            f"{cells.table.path}: no row has {name} = {shorten(value)}; select one of "
            f"{_list_values(values)}"
        )
    return cells.take(rows)


def _refuse_mixture(cells: Cells, place: int) -> None:
    """Refuse windows of several robots or grounds."""
    values = [cell.strip() for cell in cells.columns[place]]
    if len(set(values)) > 1:
        name = cells.table.names[place]
        raise ValueError(
            f"{cells.table.path}: windows of {len(set(values))} values of {name} would be mixed: "
            f'{_list_values(values)}; select one: --select "{name}={shorten(values[0])}"'
        )


def _list_values(values: Sequence[str]) -> str:
    """Return the values of a column, for a message."""
    known = list(dict.fromkeys(map(shorten, values)))
    more = len(known) - SHOWN_VALUES
    shown = ", ".join(known[:SHOWN_VALUES])
    return f"{shown} and {more} more" if more > 0 else shown


def _read_steady(cells: Cells, found: Columns) -> Bool[np.ndarray, "k"]:
    """Return which windows are steady; all of them where the table does not tell.

    Raises:
        ValueError: in one line, for a cell that is neither true nor false.
    """
    if "steady" not in found:
        return np.ones(len(cells.lines), dtype=bool)
    place = found["steady"].places[0]
    words = [cell.strip().lower() for cell in cells.columns[place]]
    for line, word in zip(cells.lines, words, strict=True):
        if word not in TRUE_WORDS and word not in FALSE_WORDS:
            raise ValueError(
                f"{cells.table.path}: column {found['steady'].name}, line {line}: "
                f"{shorten(word)!r} is neither true nor false; write True or False"
            )
    return np.array([word in TRUE_WORDS for word in words])


def _find_lost(cells: Cells, found: Columns) -> Bool[np.ndarray, "k"]:
    """Return which windows hold a step between poses that is too large to be one."""
    if "largest_step" not in found:
        return np.zeros(len(cells.lines), dtype=bool)
    steps = read_group(cells, [found["largest_step"]], "steps between poses")
    lost = np.ones(len(cells.lines), dtype=bool)
    lost[steps.rows] = steps.values[:, 0] > LONGEST_STEP
    return lost


def _describe_rest(found: Columns, select: Mapping[str, str]) -> list[str]:
    """Return what was taken of the columns that a table of windows may lack, in words."""
    steady = found["steady"].describe() if "steady" in found else "every window taken for steady"
    lost = (
        f"lost where {found['largest_step'].name} is over {LONGEST_STEP} m"
        if "largest_step" in found
        else "no window taken for lost"
    )
    return [steady, lost, *(f"only {name} = {value}" for name, value in select.items())]
