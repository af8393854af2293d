"""The log of a tuning run: every evaluation outlives the process, and a resumed run replays what is
logged.

Algorithms that are deterministic functions of the answers they get ask the same questions again
when they start again. The i-th question of a stream is answered from the log where its entry is
there and was the answer to the same bits; otherwise the answer is computed and logged. So a resumed
run goes on where it was killed, and ends at the same bits.

    STREAM-NUMBER.record     question and answer number i of a stream, such as adam-000012.record
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from jaxtube.experiments.run.record_file import Arrays, plain
from jaxtube.experiments.run.store import SUFFIX
from jaxtube.experiments.run.store_owner import StoreOwner

GIVEN = "given "
ANSWER = "answer "
"""Prefixes of the arrays of a question and of its answer."""


class TuningLog(StoreOwner):
    """The log in one folder, which belongs to this object until it is closed."""

    def __init__(self, folder: Path, identity: Mapping[str, Any]) -> None:
        """Open the log in a folder, made where it is absent, and clear up what a killed process
        left there.

        Args:
            folder: `RUN/NAME`, where RUN is what `--out` names; it holds nothing else.
            identity: all that determines questions and answers, as plain JSON values, nested as you
                like.

        Raises:
            ScenarioError: the folder cannot be written to, is open in another process, or holds
                entries with another identity; in this last case no entry was touched.
            StoreError: the disk failed later.
        """
        super().__init__(folder, identity)
        self._entries: dict[str, Arrays] = {}
        self._asked: Counter[str] = Counter()
        with self._opening("the log"):
            for name, entry in self._store.read_all("computed again").items():
                self._entries[name] = entry.arrays

    @property
    def entries(self) -> int:
        """Entries logged so far, in all streams."""
        return len(self._entries)

    def remember(
        self, stream: str, given: Mapping[str, Any], compute: Callable[[], Mapping[str, Any]]
    ) -> dict[str, np.ndarray]:
        """Answer the next question of a stream, from the log or by computing; once answered, it
        outlives the process.

        Args:
            stream: small letters, digits, - and _; its questions come in the same order each run.
            given: arrays of integers or floats that the answer depends on.
            compute: returns arrays of integers or floats; what it raises passes through, and
                nothing is logged.

        Returns:
            The arrays of the answer by sorted name, the same bits, types and layout from the log or
            not.

        Raises:
            ScenarioError: the log answers another question.
            StoreError: the disk failed.
            ValueError: for other names and arrays.
        """
        if not re.fullmatch("[a-z][a-z0-9_-]*", stream):
            raise ValueError(
                f"stream = {stream!r}: cannot name an entry; use small letters, digits, - and _"
            )
        name = f"{stream}-{self._asked[stream]:06d}"
        question = _prefix(GIVEN, given)
        if name not in self._entries:
            self._add(name, question | _prefix(ANSWER, compute()))
        difference = _find_difference(_part(GIVEN, self._entries[name]), _part(GIVEN, question))
        if difference:
            folder = self._store.folder
            raise self._store.refuse(
                f"{folder / name}{SUFFIX} answers another {difference}, so other code or settings "
                "wrote it",
                f"name another --out, or delete {folder}",
            )
        self._asked[stream] += 1
        return _part(ANSWER, self._entries[name])

    def _add(self, name: str, arrays: Arrays) -> None:
        with self._explain_failure(f"logging {name}{SUFFIX}"):
            self._store.write(name, {}, arrays)
            # As a resumed run will read them: with the same layout in memory, too.
            self._entries[name] = self._store.read(name).arrays

    def _say_what_is_safe(self) -> str:
        return f"the {self.entries} evaluations logged there are safe"


def _prefix(prefix: str, arrays: Mapping[str, Any]) -> Arrays:
    return {prefix + name: array for name, array in plain(arrays).items()}


def _part(prefix: str, arrays: Arrays) -> Arrays:
    """Return the arrays of a prefix, without it."""
    return {
        name.removeprefix(prefix): array
        for name, array in arrays.items()
        if name.startswith(prefix)
    }


def _find_difference(there: Arrays, here: Arrays) -> str:
    """Name the first array that differs in any bit, in type or in shape; empty when none does."""
    for name in sorted(there | here):
        if _bits(there.get(name)) != _bits(here.get(name)):
            return name
    return ""


def _bits(array: np.ndarray | None) -> tuple | None:
    return None if array is None else (array.dtype, array.shape, array.tobytes())
