"""Entries of a long run in one folder, which one process holds: each outlives the process that
wrote it.

An entry is one file, written atomically and checksummed, which names the run it belongs to. Entries
of another run are refused; damaged ones are reported and removed, and whoever wrote them computes
them again.

    NAME.record    an entry: a header of plain JSON values, and arrays
    lock           held while the store is open
"""

from __future__ import annotations

import contextlib
import fcntl
import json
import os
from collections.abc import Callable, Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any, BinaryIO, NamedTuple, Self

from jaxtube.atomic import write_atomically
from jaxtube.experiments.run.record_file import (
    Arrays,
    DamagedError,
    decode,
    differences,
    encode,
)
from jaxtube.scenario.refusal import ScenarioError, refusal

FORMAT = 2
"""Of the entries; those of another format are refused like those of another run."""
SUFFIX = ".record"


class StoreError(ValueError):
    """The disk failed; the message is one line with what happened, what is safe and how to go
    on."""


class Entry(NamedTuple):
    """One entry as it was written."""

    header: dict[str, Any]
    arrays: Arrays


class Store:
    """The entries in one folder, which belongs to this object until it is closed.

    damaged: a line for each damaged file that was met.
    """

    damaged: list[str]

    def __init__(self, folder: Path, identity: Mapping[str, Any]) -> None:
        """Make the folder where it is absent, and take its lock.

        Args:
            folder: `RUN/NAME`, where RUN is what `--out` names; it holds nothing else.
            identity: all that determines the entries, as plain JSON values, nested as you like.

        Raises:
            ScenarioError: the folder cannot be written to, or is open in another process.
        """
        self.folder = folder
        self.damaged = []
        self._identity = json.loads(json.dumps({"record_format": FORMAT, **identity}))
        self._lock = self._take_lock()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Leave the folder to others."""
        self._lock.close()

    def paths(self) -> list[Path]:
        """Return the files of all entries, whole or damaged, by name."""
        return sorted(self.folder.glob(f"*{SUFFIX}"))

    def leftovers(self) -> list[Path]:
        """Return the files that a killed process was writing."""
        return list(self.folder.glob(f".*{SUFFIX}.*"))

    def read(self, name: str) -> Entry:
        """Return the entry NAME.record.

        Raises:
            DamagedError: when any byte differs from what was written.
            ScenarioError: for an entry of another run.
            OSError: where the disk fails.
        """
        header, arrays = decode((self.folder / f"{name}{SUFFIX}").read_bytes())
        if "identity" not in header:
            raise DamagedError
        difference = differences(header["identity"], self._identity)
        if difference:
            raise self.refuse(
                f"{self.folder} holds another run: {difference}",
                "name another --out, or delete that folder",
            )
        if header.get("name") != name:
            raise DamagedError
        return Entry(header, arrays)

    def read_all(self, consequence: str) -> dict[str, Entry]:
        """Return all entries by name, and remove what is of no use.

        Nothing is removed before all was read, so that the folder of another run stays as it is.

        Args:
            consequence: what becomes of a damaged entry, such as "is computed again".

        Raises:
            ScenarioError: for entries of another run.
            OSError: where the disk fails.
        """
        entries = {}
        useless = self.leftovers()
        for path in self.paths():
            try:
                entries[path.stem] = self.read(path.stem)
            except DamagedError:
                self.damaged.append(f"{path}: is damaged; it is removed and {consequence}")
                useless.append(path)
        self.remove(useless)
        return entries

    def write(self, name: str, header: Mapping[str, Any], arrays: Mapping[str, Any]) -> None:
        """Write an entry; once this returns, it outlives the process.

        Raises:
            ValueError: for arrays that are neither integers nor floats.
            OSError: where the disk fails.
        """
        record = encode({"name": name, "identity": self._identity, **header}, arrays)
        write_atomically(self.folder / f"{name}{SUFFIX}", lambda file: file.write(record))

    def remove(self, paths: Iterable[Path]) -> None:
        """Remove files."""
        for path in paths:
            path.unlink()

    def synchronise(self) -> None:
        """Return once all that was written into the folder would survive a loss of power."""
        descriptor = os.open(self.folder, os.O_RDONLY)
        try:
            os.fsync(descriptor)
        finally:
            os.close(descriptor)

    def refuse(self, problem: str, cure: str) -> ScenarioError:
        """Return the one line that refuses the folder."""
        return refusal("command line", "--out", str(self.folder.parent), problem, cure)

    def fail(self, problem: str, safe: str) -> StoreError:
        """Return the one line of a disk that failed."""
        return StoreError(
            f"{self.folder}: {problem}; {safe}; run the same command again to continue"
        )

    @contextlib.contextmanager
    def explain_failure(self, action: str, safe: Callable[[], str]) -> Iterator[None]:
        """Turn an error of the disk into one line.

        Args:
            action: what is tried, such as "recording block 3".
            safe: is asked after the failure what outlives it.
        """
        try:
            yield
        except OSError as error:
            raise self.fail(f"{action} failed ({error.strerror or error})", safe()) from error

    def _take_lock(self) -> BinaryIO:
        """Take the folder's lock, which the system gives back when the process ends, killed or
        not."""
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
            with contextlib.ExitStack() as unless_taken:
                lock = unless_taken.enter_context((self.folder / "lock").open("ab"))
                fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
                unless_taken.pop_all()
                return lock
        except BlockingIOError:
            problem = "another process is writing there"
            raise self.refuse(problem, "wait for it, stop it, or name another --out") from None
        except OSError as error:
            problem = f"cannot be written to ({error.strerror})"
            raise self.refuse(problem, "name a folder you may write to") from None
