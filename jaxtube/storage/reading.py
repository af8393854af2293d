"""Results read from their folders."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path

from jaxtube.numpy_archive import read_archive
from jaxtube.scenario.folders import (
    FACTS,
    MANIFEST,
    SCENARIO,
    read_bytes,
    read_facts,
    refuse_folder,
)
from jaxtube.scenario.reading import FILE_KEYS, load
from jaxtube.scenario.refusal import refusal
from jaxtube.scenario.tree import Scenario
from jaxtube.storage.stored import ADDED, ARRAYS, StoredResult, reads_file


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
        if not file or not reads_file(scenario, key):
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
