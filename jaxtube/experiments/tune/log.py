"""The log of a tuning run: every evaluation outlives the process, and a resumed run replays what is
logged.

Algorithms that are deterministic functions of the answers they get ask the same questions again
when they start again. The i-th question of a stream is answered from the log where its entry is
there and was the answer to the same bits; otherwise the answer is computed and logged. So a resumed
run goes on where it was killed, and ends at the same bits.

    STREAM-NUMBER.record     question and answer number i of a stream, such as adam-000012.record
    lock                     held while the log is open
"""

import contextlib
import json
import re
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any, Self

import numpy as np

from jaxtube.experiments.run.atomic import write_atomically
from jaxtube.experiments.run.record_file import (
    DamagedError,
    Statistics,
    decode,
    differences,
    encode,
    plain,
)
from jaxtube.experiments.run.records import Records, RecordsError
from jaxtube.scenario.refusal import ScenarioError, refusal

FORMAT = 1
GIVEN, ANSWER = "given ", "answer "


class Log:
    """The log in one folder, which belongs to this object until it is closed.

    damaged: a line for each damaged file met at opening; those files are gone and their answers are
    computed again.
    """

    damaged: list[str]

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
            RecordsError: the disk failed later.
        """
        self.damaged = []
        self._folder = folder
        self._identity = json.loads(json.dumps({"log_format": FORMAT, **identity}))
        self._entries: dict[str, Statistics] = {}
        self._asked: Counter[str] = Counter()
        # Records without blocks: their lock, and their refusal of a folder that is in use or cannot
        # be written to.
        self._lock = Records(folder, {}, dict.__or__, 1)
        try:
            with self._explained("opening the log"):
                for path in self._scan():
                    path.unlink()
        except BaseException:
            self.close()
            raise

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Leave the folder to others."""
        self._lock.close()

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
            stream: small letters, digits, - and _, other than `blocks`; its questions come in the
                same order each run.
            given: arrays of integers or floats that the answer depends on.
            compute: returns arrays of integers or floats; what it raises passes through, and
                nothing is logged.

        Returns: the arrays of the answer by sorted name, the same bits, types and layout from the
        log or not.

        Raises: ScenarioError where the log answers another question; RecordsError when the disk
            failed; ValueError for other names and arrays.
        """
        # Records would take files called blocks-.. for their own, and clear them away.
        if not re.fullmatch("(?!blocks)[a-z][a-z0-9_-]*", stream):
            raise ValueError(
                f"stream = {stream!r}: cannot name an entry; use small letters, digits, - and _"
            )
        name = _name(stream, self._asked[stream])
        asked = _prefixed(GIVEN, given)
        if name not in self._entries:
            self._add(name, asked | _prefixed(ANSWER, compute()))
        if found := _changed(_part(GIVEN, self._entries[name]), _part(GIVEN, asked)):
            problem = (
                f"{self._folder / name} answers another {found}, so other code or settings wrote it"
            )
            raise self._refusal(problem, f"name another --out, or delete {self._folder}")
        self._asked[stream] += 1
        return _part(ANSWER, self._entries[name])

    # ---------------------------------------------------------------------------------------------------------
    # files

    def _add(self, name: str, arrays: Statistics) -> None:
        record = encode({"name": name, "identity": self._identity}, arrays)
        with self._explained(f"logging {name}"):
            write_atomically(self._folder / name, lambda file: file.write(record))
        # Read back, so that arrays have the layout in memory that they will have in a resumed run.
        self._entries[name] = decode(record)[1]

    def _scan(self) -> list[Path]:
        """Read the entries that count, changing nothing, and return the files that are of no use."""
        useless = list(self._folder.glob(".*.record.*"))
        for path in sorted(self._folder.glob("*.record")):
            try:
                self._entries[path.name] = self._read(path)
            except DamagedError:
                self.damaged.append(f"{path}: is damaged; it is removed and computed again")
                useless.append(path)
        return useless

    def _read(self, path: Path) -> Statistics:
        """Return the arrays of an entry.

        Raises: DamagedError; ScenarioError when its identity is another.
        """
        header, arrays = decode(path.read_bytes())
        if found := differences(header["identity"], self._identity):
            raise self._refusal(
                f"{self._folder} holds another run: {found}", "name another --out, or delete it"
            )
        if header["name"] != path.name:
            raise DamagedError
        return arrays

    def _refusal(self, problem: str, cure: str) -> ScenarioError:
        return refusal("command line", "--out", str(self._folder.parent), problem, cure)

    @contextlib.contextmanager
    def _explained(self, action: str) -> Iterator[None]:
        """Turn an error of the disk into one line."""
        try:
            yield
        except OSError as error:
            problem = f"{action} failed ({error.strerror or error})"
            safe = f"the {self.entries} evaluations logged there are safe"
            raise RecordsError(
                f"{self._folder}: {problem}; {safe}; run the same command again to continue"
            ) from error


def _name(stream: str, number: int) -> str:
    return f"{stream}-{number:06d}.record"


def _prefixed(prefix: str, arrays: Mapping[str, Any]) -> Statistics:
    return {prefix + name: array for name, array in plain(arrays).items()}


def _part(prefix: str, arrays: Statistics) -> Statistics:
    """Return the arrays of a prefix, without it."""
    return {
        name.removeprefix(prefix): array
        for name, array in arrays.items()
        if name.startswith(prefix)
    }


def _changed(there: Statistics, here: Statistics) -> str:
    """Name the first array that differs in any bit, in type or in shape; empty when none does."""
    bits = [
        {name: (a.dtype, a.shape, a.tobytes()) for name, a in arrays.items()}
        for arrays in (there, here)
    ]
    return next(
        (name for name in sorted(there | here) if bits[0].get(name) != bits[1].get(name)), ""
    )
