"""Laws of text tables: every cell is there in its order, and no line is wider than the terminal
where words allow it."""

import re

import pytest

from jaxtube.experiments.run import table
from jaxtube.experiments.run.table import Column, format_table, left

COLUMNS = [left("limit"), Column("usage\nby gradient"), Column("margin", "m"), left("where")]
ROWS = [
    ["error", "0.99", "0.001", "step 5, lateral error <= 0.3 m, of the whole lap"],
    ["  wheels", "1", "-2", ""],
]


def test_headings_units_and_alignment():
    assert format_table(COLUMNS[:3], [row[:3] for row in ROWS]).splitlines() == [
        "                usage",
        "limit     by gradient  margin [m]",
        "---------------------------------",
        "error            0.99       0.001",
        "  wheels            1          -2",
    ]


@pytest.mark.parametrize("width", [80, 60, 45, 38])
def test_a_wide_table_is_wrapped_and_loses_no_word(width):
    text = format_table(COLUMNS, ROWS, width)
    assert max(map(len, text.splitlines())) <= width
    natural = format_table(COLUMNS, ROWS)
    assert sorted(re.findall(r"[^\s-][^\s]*", text)) == sorted(re.findall(r"[^\s-][^\s]*", natural))


def test_a_word_is_never_cut():
    assert "gradient" in format_table(COLUMNS, ROWS, 5)


def test_the_terminal_bounds_the_width(monkeypatch):
    monkeypatch.setattr(table, "find_width", lambda: 50)
    assert max(map(len, format_table(COLUMNS, ROWS, 110).splitlines())) <= 50
