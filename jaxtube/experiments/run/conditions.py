"""The conditions of a certificate as plain values."""

from __future__ import annotations

from sets.certificate import Certificate

VERDICTS = ("holds", "margin", "scope")
WHOLE = ("holds", "margin", "required", "scope", "sentence")
"""What is kept of a condition: its verdict, or all of it."""


def condition_metrics(certificate: Certificate, kept: tuple[str, ...] = VERDICTS) -> dict:
    """Return what is kept of every condition of a certificate as plain values, by name."""
    return {
        name: {field: getattr(condition, field) for field in kept}
        for name, condition in certificate.conditions.items()
    }
