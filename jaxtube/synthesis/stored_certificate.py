"""A certificate as plain values, and whether one that was made again says the same."""

from __future__ import annotations

import math
from typing import Any

from jaxtube.scenario.refusal import refusal
from sets.certificate import Certificate, Condition


def list_certificate_facts(certificate: Certificate) -> dict[str, Any]:
    """Return verdicts, conditions and assumptions as JSON holds them; a margin that is not finite
    is a text."""
    return {
        "verdict": certificate.verdict,
        "holds_for_model": certificate.holds_for_model,
        "holds_for_robot": certificate.holds_for_robot,
        "conditions": [_describe(condition) for condition in certificate.checked],
        "assumptions": list(certificate.assumptions),
    }


def refuse_another_certificate(stored: dict[str, Any], made: Certificate) -> None:
    """Raise ScenarioError, one line, where what was certified anew is judged otherwise than what
    was stored; margins may differ by rounding.

    Raises:
        KeyError, TypeError: where a part of the stored one is missing.
    """
    again = list_certificate_facts(made)
    for name in ("verdict", "holds_for_model", "holds_for_robot"):
        if stored[name] != again[name]:
            problem = f"is {again[name]!r} for the design as it was saved, certified anew"
            cure = "use the version of jaxtube that saved it, or design the scenario again"
            raise refusal("read", f"certificate.{name}", stored[name], problem, cure)
    judged = {condition["name"]: condition["holds"] for condition in stored["conditions"]}
    for name, condition in made.conditions.items():
        if condition.required and judged[name] is not condition.holds:
            problem = "is judged otherwise when it is certified anew"
            cure = "use the version of jaxtube that saved it, or design the scenario again"
            raise refusal("read", f"certificate.{name}", judged[name], problem, cure)


def _describe(condition: Condition) -> dict[str, Any]:
    margin = condition.margin
    return {
        "name": condition.name,
        "holds": bool(condition.holds),
        "margin": float(margin) if math.isfinite(margin) else str(float(margin)),
        "scope": condition.scope,
        "sentence": condition.sentence,
    }
