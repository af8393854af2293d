"""Arrays by name: nested and side by side, and whether they agree."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from jaxtube.scenario.refusal import refusal

Arrays = Mapping[str, Any]
"""Arrays, numbers and lists of them by name, or such mappings again."""

AGREEMENT = 1e-9
"""Largest difference, relative and absolute, of an array of a design that is made again."""


def flatten(nested: Arrays, above: str = "") -> dict[str, np.ndarray]:
    """Return nested arrays side by side, each named by its path, such as `error/worst/usage`."""
    flat = {}
    for name, value in nested.items():
        path = f"{above}{name}"
        if isinstance(value, Mapping):
            flat |= flatten(value, f"{path}/")
        else:
            flat[path] = np.asarray(value)
    return flat


def nest(flat: Mapping[str, np.ndarray]) -> dict[str, Any]:
    """Return what `flatten` was given, but for empty mappings."""
    nested: dict[str, Any] = {}
    for path, value in flat.items():
        *above, name = path.split("/")
        inner = nested
        for part in above:
            inner = inner.setdefault(part, {})
        inner[name] = value
    return nested


def refuse_differences(saved: Mapping[str, np.ndarray], made: Mapping[str, np.ndarray]) -> None:
    """Raise ScenarioError where an array that was saved differs from one that was made again."""
    for name in sorted({*saved, *made}):
        if name not in saved or name not in made or not _agree(saved[name], made[name]):
            problem = "differs from that of the scenario designed again"
            cure = "use the version of jaxtube that saved it, or save it again"
            raise refusal("read", "array", name, problem, cure)


def _agree(one: np.ndarray, other: np.ndarray) -> bool:
    if one.shape != other.shape or one.dtype != other.dtype:
        return False
    return np.allclose(one, other, rtol=AGREEMENT, atol=AGREEMENT)
