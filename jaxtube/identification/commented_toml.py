"""Tables of TOML whose keys have comments above them.

Source: TOML 1.0.
"""

from __future__ import annotations

import math
import textwrap
from collections.abc import Iterable
from typing import NamedTuple

WIDTH = 100
DIGITS = 4
"""After the point."""


class Line(NamedTuple):
    """One key of the file."""

    key: str
    value: str
    comment: str


def write_table(name: str, lines: Iterable[Line]) -> str:
    """Return a table, a comment above each key that has one."""
    texts = [f"[{name}]"]
    for line in lines:
        if line.comment:
            texts.append(write_comment(f"{line.key}: {line.comment}"))
        texts.append(f"{line.key} = {line.value}")
    return "\n".join(texts)


def write_comment(text: str) -> str:
    """Return a text as lines of a comment."""
    lines = textwrap.wrap(text, WIDTH - 2, break_on_hyphens=False)
    return "\n".join(f"# {line}" for line in lines)


def round_near(value: float) -> str:
    """Return a number to `DIGITS` places."""
    return repr(round(value, DIGITS))


def round_up(value: float) -> str:
    """Return the least number of `DIGITS` places that is no smaller."""
    return repr(math.ceil(value * 10**DIGITS) / 10**DIGITS)


def round_down(value: float) -> str:
    """Return the greatest number of `DIGITS` places that is no larger."""
    return repr(math.floor(value * 10**DIGITS) / 10**DIGITS)
