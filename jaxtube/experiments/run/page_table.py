"""Tables of reports as tables of a page."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from jaxtube.experiments.run.table import Column
from jaxtube.reporting.page import Heading, Table


def make_table(
    columns: Sequence[Column], rows: Iterable[Sequence[str]], title: str = "", note: str = ""
) -> Table:
    """Return a table as a page shows it, from what `format_table` makes text of."""
    headings = [
        Heading(column.title.replace("\n", " ").strip(), column.align == "right")
        for column in columns
    ]
    return Table(title, headings, [tuple(row) for row in rows], note)
