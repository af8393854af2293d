"""Delimited text tables of numbers: named columns whose cells know their lines.

A table is opened by its first rows; its cells are read when the columns that are wanted are known,
so that what nobody asks for is neither kept nor judged.

Source: RFC 4180 for CSV, read generously; TUM RGB-D benchmark, "File formats", for poses.
"""

from __future__ import annotations

import csv
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import compress
from operator import itemgetter
from pathlib import Path
from typing import NoReturn

import numpy as np
from jaxtyping import Bool, Float, Int

from jaxtube.recordings.delimiter import MISSING, Layout, find_layout, is_number, split_rows
from jaxtube.recordings.poses import find_bad_quaternions
from jaxtube.recordings.text import read_text

POSE_NAMES = ("timestamp", "tx", "ty", "tz", "qx", "qy", "qz", "qw")
"""The columns of a TUM pose file, which has no header."""

SHOWN_NAMES = 16
"""Columns that a message lists."""

LONGEST_SHOWN = 40
"""Characters of the user's own text that a message shows."""


@dataclass(frozen=True, eq=False)
class Table:
    """A table, its rows not yet read.

    Attributes:
        path: the file, for messages.
        content: its text.
        names: of the columns; their numbers from 1 on where the file names none.
        has_names: the file names its columns.
        header_line: line of the header, 0 where no row is one.
        delimiter: between two cells.
        has_decimal_comma: numbers are written as 1,5.
        first_row: for messages.
        guesses: what was taken for what, a clause each.
    """

    path: str
    content: str
    names: tuple[str, ...]
    has_names: bool
    header_line: int
    delimiter: str
    has_decimal_comma: bool
    first_row: str
    guesses: tuple[str, ...]

    def list_names(self) -> str:
        """Return the names of the columns, for a message."""
        more = len(self.names) - SHOWN_NAMES
        shown = ", ".join(shorten(name) for name in self.names[:SHOWN_NAMES])
        return f"{shown} and {more} more" if more > 0 else shown


@dataclass(frozen=True, eq=False)
class Cells:
    """Columns of a table as text.

    Attributes:
        table: that they belong to.
        lines: numbers of the rows' lines in the file.
        columns: the cells by the places of their columns.
    """

    table: Table
    lines: Int[np.ndarray, "n"]
    columns: dict[int, list[str]]

    def take(self, rows: Bool[np.ndarray, "n"]) -> Cells:
        """Return the cells of some of the rows."""
        columns = {place: list(compress(cells, rows)) for place, cells in self.columns.items()}
        return Cells(self.table, self.lines[rows], columns)


def open_table(path: str | Path) -> Table:
    """Open a table: find its encoding, delimiter, decimal sign and header.

    Raises:
        ValueError: in one line, for a file that cannot be read or is no table of numbers.
    """
    text = read_text(path)
    if not text.content.strip():
        raise ValueError(f"{path}: is empty; name another file")
    layout = find_layout(text.content)
    if layout is None:
        raise ValueError(
            f"{path}: is no table of numbers; give rows of two columns or more, delimited by "
            "comma, semicolon, tab or blanks"
        )
    is_pose_file = not layout.header and _holds_poses(layout)
    guesses = text.guesses
    if is_pose_file:
        guesses = (*guesses, f"TUM pose file: {' '.join(POSE_NAMES)}")
    names = list(POSE_NAMES) if is_pose_file else layout.header
    has_names = bool(names)
    return Table(
        str(path),
        text.content,
        tuple(map(join_lines, names or map(str, range(1, layout.width + 1)))),
        has_names,
        layout.header_line,
        layout.delimiter,
        layout.has_decimal_comma,
        shorten(", ".join(layout.first_cells)),
        guesses,
    )


def _holds_poses(layout: Layout) -> bool:
    """Say whether the first row is a stamp, a position and a unit quaternion, as in a TUM file."""
    cells = layout.first_cells
    if len(cells) != len(POSE_NAMES) or not all(is_number(cell) for cell in cells):
        return False
    quaternion = [float(cell.replace(",", ".", 1)) for cell in cells[4:]]
    return not find_bad_quaternions(np.array([quaternion])).size


def read_cells(table: Table, places: Sequence[int]) -> Cells:
    """Read the cells of some columns.

    Args:
        table: to read.
        places: of the columns, from 0 on.

    Raises:
        ValueError: in one line, for rows of another width than the header's, no row, or what is no
            CSV.
    """
    wanted = sorted(set(places))
    pick = itemgetter(*wanted, wanted[0])  # one name more, for a tuple even of one column
    width = len(table.names)
    lines = []
    picked = []
    try:
        for line, cells in split_rows(table.content, table.delimiter):
            if len(cells) != width and line != table.header_line:
                _check_width(table, line, cells)
            if line != table.header_line:
                lines.append(line)
                picked.append(pick(cells))
    except csv.Error as error:
        raise ValueError(
            f"{table.path}: is not CSV ({error}); mend the quotes, or save it as CSV in UTF-8"
        ) from None
    if not lines:
        raise ValueError(f"{table.path}: has no rows; give a recording")
    columns = [list(column) for column in zip(*picked, strict=True)]
    return Cells(table, np.array(lines), dict(zip(wanted, columns, strict=False)))


def _check_width(table: Table, line: int, cells: Sequence[str]) -> None:
    """Refuse a row that lacks cells or has some too many; empty ones at the end do no harm."""
    width = len(table.names)
    if len(cells) < width or any(cell.strip() for cell in cells[width:]):
        given = "the header names" if table.header_line else "most rows have"
        raise ValueError(
            f"{table.path}: line {line} has {len(cells)} cell{'s' if len(cells) != 1 else ''}, "
            f"{given} {width}; mend or drop that line, or name every column in the header"
        )


def read_numbers(cells: Cells, place: int) -> Float[np.ndarray, "n"]:
    """Return the numbers of a column, NaN where a cell is empty or says that it has none.

    Raises:
        ValueError: in one line, for a cell that is no finite number.
    """
    texts = write_points(cells, place)
    numbers = _read_at_once(texts)
    if numbers is None:
        numbers = np.array([_read_number(cells, place, row) for row in range(len(texts))])
    infinite = np.flatnonzero(np.isinf(numbers))
    if infinite.size:
        refuse_cell(cells, place, int(infinite[0]))
    return numbers


def _read_at_once(texts: list[str]) -> Float[np.ndarray, "n"] | None:
    """Read numbers quickly, None where one of them needs a second look."""
    together = "".join(texts)
    if not together.isascii() or "_" in together:
        return None
    try:
        return np.array(list(map(float, texts)))
    except ValueError:
        return None


def write_points(cells: Cells, place: int) -> list[str]:
    """Return the cells of a column with decimal points."""
    texts = cells.columns[place]
    return [text.replace(",", ".", 1) for text in texts] if cells.table.has_decimal_comma else texts


def _read_number(cells: Cells, place: int, row: int) -> float:
    """Read the number of one cell, NaN where there is none."""
    text = cells.columns[place][row].strip()
    if text.lower() in MISSING:
        return float("nan")
    is_readable = is_number(text) and (cells.table.has_decimal_comma or "," not in text)
    if not is_readable:
        refuse_cell(cells, place, row)
    return float(text.replace(",", ".", 1))


def refuse_cell(cells: Cells, place: int, row: int, problem: str = "no finite number") -> NoReturn:
    """Refuse a cell.

    Raises:
        ValueError: always, in one line.
    """
    text = cells.columns[place][row]
    shown = repr(shorten(text)) if text.strip() else "nothing"
    raise ValueError(
        f"{cells.table.path}: column {cells.table.names[place]}, line {cells.lines[row]}: {shown} "
        f"is {problem}; mend or drop the row"
    )


def join_lines(text: str) -> str:
    """Return a text in one line, for messages: a header may hold any character that ends one."""
    return " ".join(text.splitlines())


def shorten(text: str, longest: int = LONGEST_SHOWN) -> str:
    """Return a text cut to what a message shows, in one line."""
    text = join_lines(text)
    return text if len(text) <= longest else f"{text[: longest - 3]}..."
