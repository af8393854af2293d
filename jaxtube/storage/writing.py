"""Results written into folders."""

from __future__ import annotations

import contextlib
import io
from collections.abc import Mapping
from pathlib import Path, PurePosixPath

import msgspec
import numpy as np

from jaxtube.atomic import write_atomically
from jaxtube.scenario.folders import (
    FACTS,
    SCENARIO,
    SCHEMA,
    UNFINISHED,
    is_inside,
    leads_out,
    read_loosely,
    refuse_folder,
)
from jaxtube.scenario.refusal import ScenarioError, refusal
from jaxtube.scenario.tree import Scenario, to_toml
from jaxtube.sealed import hash_bytes, seal
from jaxtube.storage.stored import ARRAYS, FILES, StoredResult, reads_file

COPIES = {"reference.file": "reference", "slip.recording": "slips"}
"""What the copy of a file that a key names is called, before its suffix."""

SHOWN_NAMES = 3
"""Files named in a message."""


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
        if file and reads_file(result.scenario, key):
            names[key] = f"{stem}{Path(file).suffix}"
            copies |= _copy(key, Path(file), names[key])
    packed = io.BytesIO()
    np.savez_compressed(packed, allow_pickle=False, **result.arrays)
    text = to_toml(_rename_files(result.scenario, names))
    return {SCENARIO: text.encode(), ARRAYS: packed.getvalue(), **copies}


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
    if any(leads_out(path, name) for name in own):
        raise _refuse_to_save(path, "holds links to other places")
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


def _write(path: Path, content: bytes) -> None:
    write_atomically(path, lambda file: file.write(content))
