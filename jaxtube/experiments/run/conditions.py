"""The conditions of a certificate as lines of text."""

from __future__ import annotations

import textwrap

from sets.certificate import Certificate

WIDTH = 110
INDENT = " " * 9
SIGNS = {(True, True): "holds", (True, False): "FAILS", (False, True): "yes", (False, False): "no"}
"""Words of a condition, by whether it is required and whether it holds."""


def condition_lines(certificate: Certificate, required: bool) -> list[str]:
    """Return the conditions of a certificate as lines: those required, or those for information."""
    lines = []
    for condition in certificate.checked:
        if condition.required == required:
            sign = SIGNS[required, condition.holds]
            lines.append(f"  {sign:<6} {condition.name:<32} margin {condition.margin:10.3g}")
            lines += textwrap.wrap(
                condition.sentence, WIDTH, initial_indent=INDENT, subsequent_indent=INDENT
            )
    return lines
