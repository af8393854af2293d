"""The conditions of a certificate as lines of text."""

from __future__ import annotations

import textwrap

from sets.certificate import Certificate

WIDTH = 110
INDENT = " " * 9
REQUIRED = {True: "holds", False: "FAILS"}
INFORMATIVE = {True: "yes", False: "no"}
"""A condition that holds, and one that does not, in a word."""


def condition_lines(certificate: Certificate, required: bool) -> list[str]:
    """Return the conditions of a certificate as lines: those required, or those for information."""
    words = REQUIRED if required else INFORMATIVE
    lines = []
    for condition in certificate.checked:
        if condition.required != required:
            continue
        word = words[condition.holds]
        lines.append(f"  {word:<6} {condition.name:<32} margin {condition.margin:10.3g}")
        lines += textwrap.wrap(
            condition.sentence, WIDTH, initial_indent=INDENT, subsequent_indent=INDENT
        )
    return lines
