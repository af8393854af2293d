"""The delimiter of a table, its decimal sign and its header, told from its first rows.

Rows are split at every delimiter in question; the right one gives most cells that are numbers and
fewest that are not.

Source: new; csv.Sniffer judges by letters alone and takes a decimal comma for a delimiter.
"""

from __future__ import annotations

import csv
import io
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from contextlib import suppress
from itertools import islice
from typing import NamedTuple

DELIMITERS = ("\t", ";", ",", " ")
"""In the order of preference where two explain a table equally well; a blank stands for any number
of blanks and tabs."""

SAMPLE_ROWS = 50
"""First rows by which a table is judged."""

SAMPLE_CHARACTERS = 2**18
"""First characters that are looked at for them."""

PENALTY = 0.5
"""What a cell that is no number takes from the score of a delimiter; a number gives 1."""

MISSING = ("", "nan", "null", "none", "na", "n/a", "-")
"""Cells that say that there is no number, in lower case."""


class Row(NamedTuple):
    """The cells of one row and the number of its last line in the file."""

    line: int
    cells: list[str]


class Layout(NamedTuple):
    """How a table is written.

    Attributes:
        delimiter: between two cells.
        has_decimal_comma: numbers are written as 1,5.
        header: the names of the columns, empty without a header.
        header_line: line of the header where it is a row, 0 where it is a comment or absent.
        width: cells of a row.
        first_cells: of the first row below the header.
    """

    delimiter: str
    has_decimal_comma: bool
    header: list[str]
    header_line: int
    width: int
    first_cells: list[str]


def split_rows(content: str, delimiter: str) -> Iterator[Row]:
    """Split a text into rows, blank lines and comments left out.

    Raises:
        csv.Error: for quotes that do not match or a cell beyond csv.field_size_limit().
    """
    lines = io.StringIO(content, newline="")
    if delimiter == " ":
        yield from _split_at_blanks(lines)
        return
    if "#" in content:
        # A comment becomes a blank line, so that the reader's count of lines stays right.
        lines = ("\n" if _is_comment(line) else line for line in lines)
    reader = csv.reader(lines, delimiter=delimiter, skipinitialspace=True, strict=True)
    try:
        for cells in reader:
            if any(cells):
                yield Row(reader.line_num, cells)
    except csv.Error as error:
        raise csv.Error(f"line {reader.line_num}: {error}") from None


def _split_at_blanks(lines: Iterable[str]) -> Iterator[Row]:
    """Split lines at blanks and tabs."""
    longest = csv.field_size_limit()
    for number, line in enumerate(lines, 1):
        if len(line) > longest and max(map(len, line.split()), default=0) > longest:
            raise csv.Error(f"line {number}: field larger than field limit ({longest})")
        if not _is_comment(line) and not line.isspace():
            yield Row(number, line.split())


def _is_comment(line: str) -> bool:
    return line.lstrip().startswith("#")


def find_layout(content: str) -> Layout | None:
    """Return how a table is written, None for a text that is no table of numbers."""
    head = content[: content.rfind("\n", 0, SAMPLE_CHARACTERS) + 1] or content
    samples = {name: _sample(head, name) for name in DELIMITERS}
    scores = {name: _score(sample) for name, sample in samples.items()}
    delimiter = max(scores, key=lambda name: scores[name])  # the first of equals
    if scores[delimiter] <= 0.0:
        return None
    rows = samples[delimiter]
    has_header = len(rows) > 1 and _is_header(rows[0].cells, rows[1:])
    width = Counter(len(row.cells) for row in rows[has_header:]).most_common(1)[0][0]
    cells = (cell for row in rows[has_header:] for cell in row.cells)
    has_decimal_comma = any("," in cell for cell in cells if is_number(cell))
    if has_header:
        header = _strip_names(rows[0].cells)
    else:
        header = _find_commented_header(head, delimiter, rows[0].line, width)
    return Layout(
        delimiter,
        has_decimal_comma,
        header,
        rows[0].line if has_header else 0,
        width,
        rows[has_header].cells,
    )


def _sample(content: str, delimiter: str) -> list[Row]:
    """Return the first rows under one delimiter, as far as they can be split."""
    rows = []
    with suppress(csv.Error):
        rows.extend(islice(split_rows(content, delimiter), SAMPLE_ROWS))
    return rows


def _score(rows: Sequence[Row]) -> float:
    """Return how well a delimiter explains the rows; the first may be a header."""
    judged = rows[1:] or rows
    if not judged or max(len(row.cells) for row in judged) < 2:
        return 0.0
    filled = [cell for row in judged for cell in row.cells if cell.strip()]
    numbers = sum(is_number(cell) for cell in filled)
    return numbers - PENALTY * (len(filled) - numbers)


def is_number(cell: str) -> bool:
    """Say whether a cell holds a number, with a decimal point or a decimal comma.

    Python reads 1_0 as ten and digits of all scripts; no program that writes tables means that.
    """
    text = cell.strip()
    if not text.isascii() or "_" in text:
        return False
    try:
        float(text.replace(",", ".", 1))
    except ValueError:
        return False
    return True


def _is_header(first: Sequence[str], others: Sequence[Row]) -> bool:
    """Say whether the first row names the columns: it has a word where another has a number, or no
    number at all."""
    words = [place for place, cell in enumerate(first) if cell.strip() and not is_number(cell)]
    stands_above_number = any(
        place < len(row.cells) and is_number(row.cells[place]) for row in others for place in words
    )
    return stands_above_number or not any(is_number(cell) for cell in first)


def _find_commented_header(content: str, delimiter: str, first_line: int, width: int) -> list[str]:
    """Return the names that the last comment before the first row gives, as in `# x_m; y_m`; none
    where it is no header."""
    lines = list(islice(io.StringIO(content, newline=""), first_line))
    comments = [line.strip().lstrip("# ") for line in lines if _is_comment(line)]
    if not comments:
        return []
    separator = None if delimiter == " " else delimiter
    names = _strip_names(comments[-1].split(separator))
    is_header = len(names) == width and not any(is_number(name) for name in names)
    return names if is_header else []


def _strip_names(cells: Iterable[str]) -> list[str]:
    """Return names without blanks around them and without empty ones at the end."""
    names = [cell.strip() for cell in cells]
    while names and not names[-1]:
        names.pop()
    return names
