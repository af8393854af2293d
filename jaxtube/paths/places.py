"""Where on a path something was found, changed or refused: nothing of that is ever silent.

Source: new.
"""

from typing import NamedTuple

from jaxtube.recordings.path import RawPath


class PathWarning(UserWarning):
    """A file is driven otherwise than it was recorded."""


class Place(NamedTuple):
    """A row of a path's file: number and word for it, such as line 7; `time` in s from the first
    row on, None where the file has none; `x` and `y` in m as the file has them."""

    line: int
    word: str
    time: float | None
    x: float
    y: float

    def __str__(self) -> str:
        when = f"{self.word} {self.line}" if self.time is None else f"{self.time:.1f} s"
        return f"{when}, ({self.x:.2f}, {self.y:.2f}) m"


class Note(NamedTuple):
    """What was changed or refused, at `place`; None where the whole file is meant."""

    place: Place | None
    text: str

    def __str__(self) -> str:
        return self.text if self.place is None else f"{self.place}: {self.text}"


def place_of(raw: RawPath, row: int) -> Place:
    """Return the place of a row."""
    x, y = raw.positions[row] + raw.origin
    time = None if raw.time is None else float(raw.time[row])
    return Place(int(raw.lines[row]), raw.word, time, float(x), float(y))


def line_of(note: Note) -> int:
    """Return the line of a note, 0 for one about the whole file: notes are listed by it."""
    return 0 if note.place is None else note.place.line
