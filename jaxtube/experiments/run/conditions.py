"""The conditions of a certificate as lines of text, and as plain values."""

from __future__ import annotations

import textwrap

from sets.certificate import Certificate

WIDTH = 110
INDENT = " " * 9
REQUIRED = {True: "holds", False: "FAILS"}
INFORMATIVE = {True: "yes", False: "no"}
"""A condition that holds, and one that does not, in a word."""
VERDICTS = ("holds", "margin", "scope")
WHOLE = ("holds", "margin", "required", "scope", "sentence")
"""What is kept of a condition: its verdict, or all of it."""


def condition_metrics(certificate: Certificate, kept: tuple[str, ...] = VERDICTS) -> dict:
    """Return what is kept of every condition of a certificate as plain values, by name."""
    return {
        name: {field: getattr(condition, field) for field in kept}
        for name, condition in certificate.conditions.items()
    }


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
