"""Folders that hold a scenario: those of results that were saved, and those of runs.

A saved result names the SHA-256 of each of its files in result.json, which carries its own; the
manifest of a run names that of its scenario.toml. Nothing is read from a folder whose files are not
the ones that were written.
"""

from __future__ import annotations

import json
import os
from pathlib import Path, PurePosixPath
from typing import Any

from jaxtube.scenario.refusal import ScenarioError, refusal
from jaxtube.sealed import hash_bytes, unseal

FACTS = "result.json"
SCENARIO = "scenario.toml"
MANIFEST = "manifest.json"
SCHEMA = 3
"""Of result.json: raised where an older reader would misunderstand a newer folder."""
UNFINISHED = "unfinished"
"""Stands in result.json while the other files are written."""


def find_scenario(folder: Path) -> Path:
    """Return the scenario.toml of a saved result, or of a run of the command line.

    Raises:
        ScenarioError: one line, for a folder that is neither, or whose files were changed.
    """
    if os.path.exists(folder / FACTS):
        read_facts(folder)
    elif os.path.exists(folder / MANIFEST):
        _check_run(folder)
    else:
        problem = "is a folder without result.json and manifest.json"
        cure = "name a saved result, the folder of a run, or a file that ends in .toml"
        raise refusal("scenario", "name", str(folder), problem, cure)
    return folder / SCENARIO


def holds_design(folder: str | Path) -> bool:
    """Tell whether a path names the folder of a result that says it is a design."""
    path = Path(folder)
    return os.path.isfile(path / FACTS) and read_loosely(path).get("kind") == "design"


def read_facts(folder: Path) -> dict[str, Any]:
    """Return what stands in the result.json of a saved result, all of whose files are whole.

    Raises:
        ScenarioError: one line, for a folder that is damaged, unfinished or of another version.
    """
    told = read_loosely(folder)
    if "kind" not in told:
        raise refuse_folder(folder, "is damaged: result.json tells no kind of result")
    if told.get("schema") != SCHEMA:
        raise refuse_folder(folder, f"holds a {told['kind']!r} of another version")
    if UNFINISHED in told:
        raise refuse_folder(folder, f"holds a {told['kind']!r} whose saving was broken off")
    data = read_bytes(folder, FACTS)
    try:
        facts = unseal(data)
    except ValueError as error:
        raise refuse_folder(folder, f"is damaged: result.json {error}") from None
    _check_files(folder, facts.get("files"))
    return facts


def read_loosely(folder: Path) -> dict[str, Any]:
    """Return what stands in a result.json whose seal is not looked at; nothing where that is no
    table.

    Raises:
        ScenarioError: one line, for a file that cannot be read.
    """
    data = read_bytes(folder, FACTS)
    try:
        told = json.loads(data)
    except (ValueError, RecursionError):
        return {}
    return told if isinstance(told, dict) else {}


def read_bytes(folder: Path, name: str) -> bytes:
    """Return the bytes of a file of a folder.

    Raises:
        ScenarioError: one line, where it cannot be read.
    """
    try:
        return (folder / name).read_bytes()
    except OSError as error:
        problem = f"is damaged: {name} cannot be read ({error.strerror})"
        raise refuse_folder(folder, problem) from None


def is_inside(name: Any) -> bool:
    """Tell whether a name is that of a file in a folder or below it, whatever the folder."""
    if not isinstance(name, str) or not name or "\0" in name:
        return False
    path = PurePosixPath(name)
    return not path.is_absolute() and ".." not in path.parts and path.as_posix() == name != "."


def leads_out(folder: Path, name: str) -> bool:
    """Tell whether a name leads out of its folder by a link."""
    return not (folder / name).resolve().is_relative_to(folder.resolve())


def refuse_folder(folder: str | Path, problem: str) -> ScenarioError:
    """Return the refusal of a folder."""
    cure = "name a folder that the `save` of a result has written"
    return refusal("read", "folder", str(folder), problem, cure)


def _check_files(folder: Path, files: Any) -> None:
    """Raise ScenarioError unless the files of a result are those that were written."""
    if not isinstance(files, dict) or SCENARIO not in files or not all(map(is_inside, files)):
        raise refuse_folder(folder, "is damaged: result.json names other files than its own")
    for name, digest in files.items():
        if leads_out(folder, name):
            raise refuse_folder(folder, f"is damaged: {name} is a link to another place")
        if hash_bytes(read_bytes(folder, name)) != digest:
            raise refuse_folder(folder, f"is damaged: {name} differs from what was written")


def _check_run(folder: Path) -> None:
    """Raise ScenarioError unless the scenario of a run is that of its manifest."""
    cure = "run the command again, or name the scenario it was run with"
    try:
        manifest = json.loads((folder / MANIFEST).read_bytes())
        digest = manifest["scenario_sha256"]
        same = hash_bytes((folder / SCENARIO).read_bytes()) == digest
    except OSError as error:
        problem = f"is a run that cannot be read ({error.strerror})"
        raise refusal("scenario", "name", str(folder), problem, cure) from None
    except (ValueError, LookupError, TypeError, RecursionError):
        problem = "is a run whose manifest.json is damaged"
        raise refusal("scenario", "name", str(folder), problem, cure) from None
    if not same:
        problem = "is a run whose scenario.toml was changed"
        cure = f"give --scenario {folder / SCENARIO} to use it as it is"
        raise refusal("scenario", "name", str(folder), problem, cure)
