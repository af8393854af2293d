"""The conditions of a certificate as lines of text."""

from __future__ import annotations

import textwrap

from sets.certificate import Certificate

WIDTH = 110


def condition_lines(certificate: Certificate, required: bool) -> list[str]:
    """Return the conditions of a certificate as lines."""
    lines = []
    for name, condition in certificate.conditions.items():
        if condition.required == required:
            sign = {
                (True, True): "holds",
                (True, False): "FAILS",
                (False, True): "yes",
                (False, False): "no",
            }
            lines.append(
                f"  {sign[required, condition.holds]:<6} {name:<32} margin {condition.margin:10.3g}"
            )
            lines += textwrap.wrap(
                condition.sentence, WIDTH, initial_indent=" " * 9, subsequent_indent=" " * 9
            )
    return lines
