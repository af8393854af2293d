"""Results in folders.

    result.json      what kind of result it is, and its plain numbers and names
    scenario.toml    the scenario with every key spelled out
    arrays.npz       its arrays, without pickles

Each file appears complete or not at all; result.json comes last.
"""

from __future__ import annotations

import json
import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from jaxtube.atomic import write_atomically
from jaxtube.scenario.reading import load
from jaxtube.scenario.refusal import ScenarioError, refusal
from jaxtube.scenario.tree import Scenario, to_toml

Arrays = Mapping[str, Any]
"""Arrays, numbers and lists of them by name, or such mappings again."""

SCHEMA = 1
"""Of result.json: raised where an older reader would misunderstand a newer folder."""
AGREEMENT = 1e-9
"""Largest difference, relative and absolute, of an array of a design that is made again."""


class StoredResult(NamedTuple):
    """A result as it lies in its folder."""

    kind: str
    scenario: Scenario
    facts: dict[str, Any]
    arrays: dict[str, np.ndarray]


def write_result(folder: str | Path, result: StoredResult) -> Path:
    """Write a result into a folder, which is made where it does not exist; return the folder."""
    path = Path(folder)
    path.mkdir(parents=True, exist_ok=True)
    facts = {"kind": result.kind, "schema": SCHEMA, **result.facts}
    _write_text(path / "scenario.toml", to_toml(result.scenario))
    _write_arrays(path / "arrays.npz", result.arrays)
    _write_text(path / "result.json", f"{json.dumps(facts, indent=2, sort_keys=True)}\n")
    return path


def read_result(folder: str | Path) -> StoredResult:
    """Read a result from its folder.

    Raises:
        ScenarioError: one line, for a folder that holds none, is damaged, or was written by another
            version.
    """
    path = Path(folder)
    try:
        facts = json.loads((path / "result.json").read_text(encoding="utf-8"))
        with np.load(path / "arrays.npz", allow_pickle=False) as file:
            arrays = dict(file)
        kind = facts.pop("kind")
        schema = facts.pop("schema")
    except OSError as error:
        problem = f"cannot be read ({error.strerror or 'no file of arrays'})"
        raise refuse_folder(path, problem) from None
    except (ValueError, KeyError, TypeError, AttributeError, zipfile.BadZipFile):
        raise refuse_folder(path, "is damaged, or holds no result") from None
    if schema != SCHEMA:
        raise refuse_folder(path, f"holds a {kind!r} of another version")
    return StoredResult(kind, load(path / "scenario.toml"), facts, arrays)


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


def refuse_folder(folder: str | Path, problem: str) -> ScenarioError:
    """Return the refusal of a folder."""
    cure = "name a folder that the `save` of a result has written"
    return refusal("read", "folder", str(folder), problem, cure)


def refuse_differences(saved: Mapping[str, np.ndarray], made: Mapping[str, np.ndarray]) -> None:
    """Raise ScenarioError where an array that was saved differs from one that was made again."""
    for name, value in made.items():
        if name not in saved or not _agree(saved[name], value):
            problem = "differs from that of the scenario designed again"
            cure = "use the version of jaxtube that saved it, or save it again"
            raise refusal("read", "array", name, problem, cure)


def _agree(one: np.ndarray, other: np.ndarray) -> bool:
    if one.shape != other.shape:
        return False
    return np.allclose(one, other, rtol=AGREEMENT, atol=AGREEMENT, equal_nan=True)


def _write_text(path: Path, text: str) -> None:
    write_atomically(path, lambda file: file.write(text.encode()))


def _write_arrays(path: Path, arrays: Mapping[str, np.ndarray]) -> None:
    write_atomically(path, lambda file: np.savez_compressed(file, allow_pickle=False, **arrays))
