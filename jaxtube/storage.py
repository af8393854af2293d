"""Results in folders.

    result.json      what kind of result it is, its plain numbers and names, and the SHA-256 of each
                     other file and of itself
    scenario.toml    the scenario with every key spelled out
    arrays.npz       its arrays, without pickles
    reference.*, slips.*    copies of the files that the scenario names

Each file appears complete or not at all, and while they are written result.json says so: a save
that was broken off is told from a result. A folder that was moved still reads, one of whose files
any byte was changed does not.
"""

from __future__ import annotations

import contextlib
import io
import os
from collections.abc import Mapping
from pathlib import Path, PurePosixPath
from typing import Any, NamedTuple

import msgspec
import numpy as np

from jaxtube.atomic import write_atomically
from jaxtube.numpy_archive import read_archive
from jaxtube.scenario.folders import (
    FACTS,
    MANIFEST,
    SCENARIO,
    SCHEMA,
    UNFINISHED,
    is_inside,
    read_bytes,
    read_facts,
    read_loosely,
    refuse_folder,
)
from jaxtube.scenario.reading import FILE_KEYS, load
from jaxtube.scenario.refusal import ScenarioError, refusal
from jaxtube.scenario.tree import Scenario, to_toml
from jaxtube.sealed import hash_bytes, seal

Arrays = Mapping[str, Any]
"""Arrays, numbers and lists of them by name, or such mappings again."""

ARRAYS = "arrays.npz"
FILES = (FACTS, SCENARIO, ARRAYS)
COPIES = {"reference.file": "reference", "slip.recording": "slips"}
"""What the copy of a file that a key names is called, before its suffix."""
ADDED = ("kind", "schema", "files")
"""What result.json holds beside the facts of a result."""

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
    parts = _make_parts(result)
    header = {"kind": result.kind, "schema": SCHEMA}
    files = {name: hash_bytes(content) for name, content in parts.items()}
    try:
        path.mkdir(parents=True, exist_ok=True)
        replaced = _find_replaced(path, result.kind)
        names = sorted({*parts, *replaced})
        _write(path / FACTS, seal({**header, UNFINISHED: True, "files": names}))
        for name, content in parts.items():
            (path / name).parent.mkdir(parents=True, exist_ok=True)
            _write(path / name, content)
        for name in replaced - set(parts):
            _remove(path, name)
        _write(path / FACTS, seal({**result.facts, **header, "files": files}))
    except OSError as error:
        problem = f"cannot be written ({error.strerror})"
        raise _refuse_to_save(path, problem) from None
    return path


def _remove(folder: Path, name: str) -> None:
    """Remove a file of a result that was replaced, and the folders that are then empty."""
    (folder / name).unlink(missing_ok=True)
    for above in list(PurePosixPath(name).parents)[:-1]:
        with contextlib.suppress(OSError):
            (folder / above).rmdir()


def _make_parts(result: StoredResult) -> dict[str, bytes]:
    """Return all files of a result but result.json, by name."""
    copies = {}
    names = {}
    for key, stem in COPIES.items():
        section, _, name = key.partition(".")
        file = getattr(getattr(result.scenario, section), name)
        if file and _is_read(result.scenario, key):
            names[key] = f"{stem}{Path(file).suffix}"
            copies |= _copy(key, Path(file), names[key])
    packed = io.BytesIO()
    np.savez_compressed(packed, allow_pickle=False, **result.arrays)
    text = to_toml(_rename_files(result.scenario, names))
    return {SCENARIO: text.encode(), ARRAYS: packed.getvalue(), **copies}


def _is_read(scenario: Scenario, key: str) -> bool:
    """Tell whether a scenario reads the file that a key names."""
    return key != "slip.recording" or scenario.slip.process == "recorded"


def _rename_files(scenario: Scenario, names: Mapping[str, str]) -> Scenario:
    """Return a scenario that names files by other names, which nobody looks for yet."""
    for key, name in names.items():
        section, _, field = key.partition(".")
        table = msgspec.structs.replace(getattr(scenario, section), **{field: name})
        scenario = msgspec.structs.replace(scenario, **{section: table})
    return scenario


def _copy(key: str, source: Path, name: str) -> dict[str, bytes]:
    """Return a file, or all files of a folder, as parts of a result.

    Raises:
        ScenarioError: one line, where it cannot be read.
    """
    try:
        if not source.is_dir():
            return {name: source.read_bytes()}
        below = [path for path in sorted(source.rglob("*")) if path.is_file()]
        return {
            f"{name}/{path.relative_to(source).as_posix()}": path.read_bytes() for path in below
        }
    except OSError as error:
        problem = f"cannot be read ({error.strerror})"
        cure = "put the file back: a copy of it is part of the result"
        raise refusal("save", key, str(source), problem, cure) from None


def _find_replaced(path: Path, kind: str) -> set[str]:
    """Return the files of the result that lies in a folder, none in an empty one.

    Raises:
        ScenarioError: one line, for a folder with anything but a result of a kind.
    """
    present = sorted(entry.name for entry in path.iterdir())
    told = read_loosely(path) if FACTS in present else {}
    files = told.get("files")
    listed = files if isinstance(files, list | dict) else ()
    own: set[str] = {name for name in listed if is_inside(name)}
    own.update(FILES)
    entries = {name.split("/")[0] for name in own}
    names = [name for name in present if not _is_leftover(name, entries)]
    foreign = [name for name in names if name not in entries]
    if names and (foreign or FACTS not in names):
        shown = ", ".join((foreign or names)[:SHOWN_NAMES])
        raise _refuse_to_save(path, f"holds files that no result has saved ({shown})")
    if names and "kind" not in told:
        raise refuse_folder(path, "is damaged: result.json tells no kind of result")
    if names and told["kind"] != kind:
        raise _refuse_to_save(path, f"holds {told['kind']!r}, another kind of result than {kind!r}")
    return own - {FACTS}


def _is_leftover(name: str, entries: set[str]) -> bool:
    """Tell whether a name is that of a file that a killed process was writing."""
    return any(name.startswith(f".{entry}.") for entry in entries)


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
    facts = read_facts(path)
    try:
        arrays = read_archive(read_bytes(path, ARRAYS))
    except ValueError as error:
        raise refuse_folder(path, f"is damaged: {ARRAYS} {error}") from None
    scenario = load(path / SCENARIO)
    _refuse_files_elsewhere(path, scenario, facts["files"])
    plain = {name: value for name, value in facts.items() if name not in ADDED}
    return StoredResult(facts["kind"], scenario, plain, arrays)


def _refuse_files_elsewhere(path: Path, scenario: Scenario, files: Mapping[str, str]) -> None:
    """Raise ScenarioError where a scenario reads a file that is no part of its result."""
    tops = {name.split("/")[0] for name in files}
    for key in FILE_KEYS:
        section, _, name = key.partition(".")
        file = getattr(getattr(scenario, section), name)
        if not file or not _is_read(scenario, key):
            continue
        if Path(file).name not in tops or Path(file).parent != Path.cwd() / path:
            raise refuse_folder(path, f"is damaged: {key} names a file outside the folder")


def _refuse_what_holds_no_result(path: Path) -> None:
    """Raise ScenarioError where there is no folder, that of a run, or one without a result."""
    if not os.path.exists(path):
        raise refuse_folder(path, "does not exist")
    if not os.path.isdir(path):
        raise refuse_folder(path, "is a file")
    if os.path.exists(path / FACTS):
        return
    if os.path.exists(path / MANIFEST) and os.path.exists(path / SCENARIO):
        cure = f"give jt.design(jt.load({str(path)!r})) to design it again"
        raise refusal("read", "folder", str(path), "is a run folder of the command line", cure)
    raise refuse_folder(path, "holds no result.json")


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


def _write(path: Path, content: bytes) -> None:
    write_atomically(path, lambda file: file.write(content))
