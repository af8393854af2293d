"""Recorded paths: a CSV file of times and positions, read and checked.

Stamps since 1970 lose digits as floating-point numbers, so that times are exact decimals until the
first one is subtracted.

Source: RFC 4180 for CSV; the header is this project's.
"""

import csv
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from decimal import Decimal, InvalidOperation
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

COLUMNS = ("time_s", "x_m", "y_m")

FEWEST_ROWS = 4
"""A cubic spline through fewer points would have freedom left to invent."""

SLOWEST_RECORDING = 1e-3
"""Speed in m/s below which a recorded path has no heading."""

STAMP_UNITS = (
    (1e17, "nanoseconds", "1e9"),
    (1e14, "microseconds", "1e6"),
    (1e11, "milliseconds", "1e3"),
)
"""Least stamp since 1970 that must be in a unit other than seconds, the unit, and its divisor; 1e11
seconds after 1970 is the year 5138."""

LONGEST_SHOWN = 40
"""Characters of the user's own text that a message shows."""


class RecordedRow(NamedTuple):
    """One row of the file."""

    line: int
    time: Decimal  # s, as recorded: stamps since 1970 lose digits as floats
    x: float  # m
    y: float  # m


@dataclass(frozen=True, eq=False)
class Recording:
    """A recorded path.

    Attributes:
        path: the file, for messages.
        lines: numbers of the rows' lines in the file.
        time: since the first row, s, increasing.
        positions: (x, y), m, world frame.
    """

    path: str | Path
    lines: list[int]
    time: Float[np.ndarray, "rows"]
    positions: Float[np.ndarray, "rows 2"]

    @property
    def duration(self) -> float:
        """Time from the first to the last row, s."""
        return float(self.time[-1])


def read_recording(path: str | Path) -> Recording:
    """Read and check a recorded path.

    Raises:
        ValueError: in one line, for a file that is not UTF-8 CSV, a missing column, too few rows, a
            bad number, or time that does not increase or is not in seconds.
    """
    try:
        with Path(path).open(newline="", encoding="utf-8-sig") as file:
            rows = list(_read_rows(path, file))
    except UnicodeDecodeError:
        raise ValueError(f"{path}: is not UTF-8 text; save it as CSV in UTF-8") from None
    except csv.Error as error:
        raise ValueError(f"{path}: is not CSV ({error}); save it as CSV in UTF-8") from None
    if len(rows) < FEWEST_ROWS:
        raise ValueError(
            f"{path}: {len(rows)} rows of {COLUMNS[0]} are too few; record at least {FEWEST_ROWS}"
        )
    first = rows[0].time
    _refuse_stamps(path, float(first))
    time = np.array([float(row.time - first) for row in rows])
    stalled = np.flatnonzero(np.diff(time) <= 0.0)
    if stalled.size:
        before = rows[stalled[0]]
        after = rows[stalled[0] + 1]
        raise ValueError(
            f"{path}: column time_s does not increase in line {after.line}: {before.time} then "
            f"{after.time}; sort the rows and drop repeated times"
        )
    positions = np.array([[row.x, row.y] for row in rows])
    recording = Recording(path, [row.line for row in rows], time, positions)
    _refuse_slowness(recording)
    return recording


def _read_rows(path: str | Path, file: Iterable[str]) -> Iterator[RecordedRow]:
    """Read the rows of a CSV file, its columns by their names."""
    reader = csv.reader(file)
    header = [name.strip() for name in next(reader, [])]
    for column in COLUMNS:
        if column not in header:
            raise ValueError(
                f"{path}: column {column} is missing from the header {_shorten(','.join(header))}; "
                f"write the header {','.join(COLUMNS)}, as CSV in UTF-8"
            )
    places = [header.index(column) for column in COLUMNS]
    for fields in reader:
        if not fields:
            continue  # a blank line
        line = reader.line_num
        texts = [fields[place] if place < len(fields) else None for place in places]
        time = _read_number(path, COLUMNS[0], line, texts[0])
        x = _read_number(path, COLUMNS[1], line, texts[1])
        y = _read_number(path, COLUMNS[2], line, texts[2])
        yield RecordedRow(line, time, float(x), float(y))


def _read_number(path: str | Path, column: str, line: int, text: str | None) -> Decimal:
    """Read one finite number."""
    try:
        number = Decimal(text or "")
        is_number = bool(np.isfinite(float(number)))
    except (InvalidOperation, ValueError):
        is_number = False
    if not is_number:
        shown = "nothing" if text is None else repr(_shorten(text))
        raise ValueError(
            f"{path}: column {column}, line {line}: {shown} is no finite number; "
            "mend or drop the row"
        )
    return number


def _shorten(text: str) -> str:
    """Return a text cut to what a message shows."""
    return text if len(text) <= LONGEST_SHOWN else f"{text[: LONGEST_SHOWN - 3]}..."


def _refuse_stamps(path: str | Path, first_stamp: float) -> None:
    """Refuse stamps since 1970 that cannot be seconds."""
    for least, unit, divisor in STAMP_UNITS:
        if first_stamp >= least:
            raise ValueError(
                f"{path}: column time_s starts at {first_stamp:.4g}: {unit} since 1970; "
                f"give seconds, divide the column by {divisor}"
            )


def _refuse_slowness(recording: Recording) -> None:
    """Refuse a robot so slow that time must be in another unit."""
    length = float(np.linalg.norm(np.diff(recording.positions, axis=0), axis=1).sum())
    mean_speed = length / recording.duration
    if 0.0 < mean_speed < SLOWEST_RECORDING:
        raise ValueError(
            f"{recording.path}: column time_s: the path moves at {mean_speed:.2g} m/s on average; "
            "give seconds (divide milliseconds by 1e3, microseconds by 1e6, nanoseconds by 1e9)"
        )
