"""The first line of every report: what came out, short enough to be read at a glance."""

from __future__ import annotations

import textwrap
from collections.abc import Collection

LONGEST = 99
"""Characters of the line."""


def fit_line(text: str) -> str:
    """Return a text as one line, cut at a word where it is longer than that."""
    return textwrap.shorten(text, LONGEST, placeholder=" ...")


def list_names(names: Collection[str], room: int) -> str:
    """Return names in a list of at most some characters; those that do not fit are counted."""
    shown = list(names)
    while shown:
        left_out = len(names) - len(shown)
        text = ", ".join(shown) + (f" and {left_out} more" if left_out else "")
        if len(text) <= room:
            return text
        shown.pop()
    return f"{len(names)} conditions"
