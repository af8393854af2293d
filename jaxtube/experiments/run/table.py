"""Tables of text that fit the terminal: columns with headings, units and alignment.

A table wider than 80 characters, or than the terminal, wraps the cells of its widest columns, words
whole.
"""

from __future__ import annotations

import itertools
import shutil
import sys
import textwrap
from collections.abc import Iterable, Sequence
from typing import Literal, NamedTuple

WIDTH = 100
"""Characters of a line of a paragraph."""
TABLE_WIDTH = 80
"""Characters of a line of a table, which a terminal shows unbroken."""
GAP = "  "
"""Between two columns."""


class Column(NamedTuple):
    """A column: its heading, a new line in it is kept; its unit, in brackets; numbers go to the
    right."""

    heading: str
    unit: str = ""
    align: Literal["left", "right"] = "right"

    @property
    def title(self) -> str:
        """The heading with its unit."""
        return f"{self.heading} [{self.unit}]" if self.unit else self.heading

    def pad(self, text: str, width: int) -> str:
        """Return one line of a cell at the column's width."""
        return text.ljust(width) if self.align == "left" else text.rjust(width)


def left(heading: str) -> Column:
    """Return a column of words."""
    return Column(heading, align="left")


def format_table(
    columns: Sequence[Column], rows: Iterable[Sequence[str]], width: int = TABLE_WIDTH
) -> str:
    """Return a table as text, a rule below its headings.

    Args:
        columns: one for each cell of a row.
        rows: cells as text; a new line in a cell is kept.
        width: characters of a line at most; those of the terminal where it has fewer. A word is
            never cut: where words need more, lines are longer.
    """
    body = [tuple(row) for row in rows]
    head = tuple(column.title for column in columns)
    cells = list(zip(*[head, *body], strict=True))
    widths = [max(map(_length, column)) for column in cells]
    least = [max(map(_longest_word, column)) for column in cells]
    gaps = len(GAP) * (len(columns) - 1)
    _narrow(widths, least, min(width, find_width()) - gaps)
    rule = "-" * (sum(widths) + gaps)
    lines = [*_lines(columns, head, widths, above=True), rule]
    for row in body:
        lines += _lines(columns, row, widths)
    return "\n".join(lines)


def wrap(text: str, indent: str = "") -> list[str]:
    """Return a paragraph as lines of at most `WIDTH` characters, those after the first indented."""
    return textwrap.wrap(text, WIDTH, subsequent_indent=indent, break_on_hyphens=False)


def find_width() -> int:
    """Return the columns of the terminal; without one, more than any table has."""
    return shutil.get_terminal_size().columns if sys.stdout.isatty() else sys.maxsize


def _narrow(widths: list[int], least: list[int], room: int) -> None:
    """Take from the widest column that can be wrapped until all fit, or none can be."""
    while sum(widths) > room:
        wrapped = [i for i, width in enumerate(widths) if width > least[i]]
        if not wrapped:
            return
        widths[max(wrapped, key=lambda i: widths[i])] -= 1


def _lines(
    columns: Sequence[Column], row: Sequence[str], widths: Sequence[int], above: bool = False
) -> list[str]:
    """Lay out one row; `above` puts the empty lines of its shorter cells on top."""
    cells = [_wrap(text, width) for text, width in zip(row, widths, strict=True)]
    height = max(map(len, cells))
    if above:
        cells = [[""] * (height - len(cell)) + cell for cell in cells]
    lines = []
    for parts in itertools.zip_longest(*cells, fillvalue=""):
        padded = [
            column.pad(part, width)
            for column, part, width in zip(columns, parts, widths, strict=True)
        ]
        lines.append(GAP.join(padded).rstrip())
    return lines


def _wrap(text: str, width: int) -> list[str]:
    lines = []
    for line in text.split("\n"):
        lines += textwrap.wrap(line, width, break_long_words=False, break_on_hyphens=False)
    return lines or [""]


def _length(text: str) -> int:
    return max(map(len, text.split("\n")))


def _longest_word(text: str) -> int:
    return max(map(len, text.split()), default=0)
