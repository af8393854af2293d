"""Results in folders.

    result.json      what kind of result it is, and its plain numbers and names
    scenario.toml    the scenario with every key spelled out
    arrays.npz       its arrays, without pickles

Each file appears complete or not at all, and while they are written result.json says so: a save
that was broken off is told from a result.
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

FILES = ("result.json", "scenario.toml", "arrays.npz")

SCHEMA = 2
"""Of result.json: raised where an older reader would misunderstand a newer folder."""
UNFINISHED = "unfinished"
"""Stands in result.json while the other files are written."""
SHOWN_NAMES = 3
"""Files named in a message."""
AGREEMENT = 1e-9
"""Largest difference, relative and absolute, of an array of a design that is made again."""


class StoredResult(NamedTuple):
    """A result as it lies in its folder."""

    kind: str
    scenario: Scenario
    facts: dict[str, Any]
    arrays: dict[str, np.ndarray]


def write_result(folder: str | Path, result: StoredResult) -> Path:
    """Write a result into a new or empty folder, or in place of a result of its kind; return the
    folder.

    Raises:
        ScenarioError: one line, for a folder with anything else, or one that cannot be written.
    """
    path = Path(folder)
    facts = {"kind": result.kind, "schema": SCHEMA, **result.facts}
    try:
        path.mkdir(parents=True, exist_ok=True)
        _refuse_to_overwrite(path, result.kind)
        _write_facts(path, {"kind": result.kind, "schema": SCHEMA, UNFINISHED: True})
        _write_text(path / "scenario.toml", to_toml(result.scenario))
        _write_arrays(path / "arrays.npz", result.arrays)
        _write_facts(path, facts)
    except OSError as error:
        problem = f"cannot be written ({error.strerror})"
        raise _refuse_to_save(path, problem) from None
    return path


def _refuse_to_overwrite(path: Path, kind: str) -> None:
    """Raise ScenarioError for a folder with anything but a result of a kind."""
    names = sorted(entry.name for entry in path.iterdir() if not _is_leftover(entry))
    foreign = [name for name in names if name not in FILES]
    if names and (foreign or "result.json" not in names):
        shown = ", ".join((foreign or names)[:SHOWN_NAMES])
        raise _refuse_to_save(path, f"holds files that no result has saved ({shown})")
    present = _read_facts(path).get("kind") if names else kind
    if present != kind:
        raise _refuse_to_save(path, f"holds {present!r}, another kind of result than {kind!r}")


def _is_leftover(entry: Path) -> bool:
    """Tell whether a file is one that a killed process was writing here."""
    return any(entry.name.startswith(f".{name}.") for name in FILES)


def _refuse_to_save(path: Path, problem: str) -> ScenarioError:
    return refusal("save", "folder", str(path), problem, "name a new or an empty folder")


def read_result(folder: str | Path) -> StoredResult:
    """Read a result from its folder.

    Raises:
        ScenarioError: one line, for a folder that holds none, is damaged, or was written by another
            version.
    """
    path = Path(folder)
    _refuse_what_holds_no_result(path)
    facts = _read_facts(path)
    if facts.get("schema") != SCHEMA:
        raise refuse_folder(path, f"holds a {facts['kind']!r} of another version")
    if UNFINISHED in facts:
        raise refuse_folder(path, f"holds a {facts['kind']!r} whose saving was broken off")
    try:
        with np.load(path / "arrays.npz", allow_pickle=False) as file:
            arrays = dict(file)
    except OSError as error:
        problem = f"is damaged: arrays.npz cannot be read ({error.strerror or 'no arrays'})"
        raise refuse_folder(path, problem) from None
    except (ValueError, EOFError, zipfile.BadZipFile):
        raise refuse_folder(path, "is damaged: arrays.npz holds no arrays") from None
    plain = {name: value for name, value in facts.items() if name not in ("kind", "schema")}
    return StoredResult(facts["kind"], load(path / "scenario.toml"), plain, arrays)


def _refuse_what_holds_no_result(path: Path) -> None:
    """Raise ScenarioError where there is no folder, that of a run, or one without a result."""
    if not path.exists():
        raise refuse_folder(path, "does not exist")
    if not path.is_dir():
        raise refuse_folder(path, "is a file")
    if (path / "result.json").exists():
        return
    if (path / "manifest.json").exists() and (path / "scenario.toml").exists():
        cure = f"give jt.design(jt.load({str(path / 'scenario.toml')!r})) to design it again"
        raise refusal("read", "folder", str(path), "is a run folder of the command line", cure)
    raise refuse_folder(path, "holds no result.json")


def _read_facts(path: Path) -> dict[str, Any]:
    """Return what stands in result.json.

    Raises:
        ScenarioError: one line, for a damaged file.
    """
    try:
        facts = json.loads((path / "result.json").read_text(encoding="utf-8"))
    except OSError as error:
        raise refuse_folder(path, f"cannot be read ({error.strerror})") from None
    except ValueError:
        facts = None
    if not isinstance(facts, dict) or "kind" not in facts:
        raise refuse_folder(path, "is damaged: result.json tells no kind of result")
    return facts


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


def _write_facts(path: Path, facts: Mapping[str, Any]) -> None:
    _write_text(path / "result.json", f"{json.dumps(facts, indent=2, sort_keys=True)}\n")


def _write_text(path: Path, text: str) -> None:
    write_atomically(path, lambda file: file.write(text.encode()))


def _write_arrays(path: Path, arrays: Mapping[str, np.ndarray]) -> None:
    write_atomically(path, lambda file: np.savez_compressed(file, allow_pickle=False, **arrays))
