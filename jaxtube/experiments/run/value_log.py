"""The log of a command that computes values one by one: an interrupted run goes on from those that
its folder holds."""

from __future__ import annotations

import hashlib
import json
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from jaxtube.experiments.run import folder as run_folder
from jaxtube.experiments.run.folder import RunFolder
from jaxtube.experiments.run.store_owner import StoreOwner
from jaxtube.scenario.tree import Scenario, to_toml


class ValueLog(StoreOwner):
    """JSON values that survive an interruption, in the order in which they were added; each is an
    entry of a store, which belongs to this object until it is closed."""

    def __init__(self, folder: Path, identity: Mapping[str, Any]) -> None:
        """Open the log in a folder, made where it is absent.

        Args:
            folder: `RUN/NAME`, where RUN is what `--out` names; it holds nothing else.
            identity: all that determines the values, as plain JSON values.

        Raises:
            ScenarioError: the folder cannot be written to, is open in another process, or holds
                entries with another identity.
            StoreError: the disk failed.
        """
        super().__init__(folder, identity)
        self.records: list[dict] = []
        with self._opening("the log"):
            entries = self._store.read_all("computed again")
        self._count = 1 + max(map(int, entries), default=-1)
        self.records += [entry.header["value"] for entry in entries.values()]

    def append(self, record: dict) -> None:
        """Add a value; once this returns, it outlives the process.

        Raises:
            StoreError: the disk failed.
        """
        name = f"{self._count:06d}"
        with self._explain_failure(f"logging {name}"):
            self._store.write(name, {"value": record}, {})
            entry = self._store.read(name)
        self._count += 1
        self.records.append(entry.header["value"])

    def _say_what_is_safe(self) -> str:
        return f"the {len(self.records)} results logged there are safe"


def open_log(folder: RunFolder, name: str, settings: dict, scenario: Scenario) -> ValueLog:
    """Open a log of values in a folder of its own for each scenario, settings and code."""
    identity = {
        "scenario": to_toml(scenario),
        "settings": settings,
        "source_sha256": run_folder.source_hashes(),
    }
    digest = hashlib.sha256(json.dumps(identity).encode()).hexdigest()[:12]
    log = ValueLog(folder.path / f"{name}-{digest}", identity)
    for line in log.damaged:
        print(line, file=sys.stderr)
    return log
