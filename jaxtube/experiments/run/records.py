"""The records of a long Monte Carlo run: nothing computed is lost, however often the process is
killed.

Block i holds the realisations i b .. (i+1) b - 1 of a run, b to the block; the last block may be
partial. Its statistics are one file, written atomically, and 64 aligned files of full blocks become
one: of n blocks, about 64 log_64 n files are left. The statistics of n realisations are a fold over
a tree that n and b alone determine,

    S[a, a + 64 s) = (..(S[a, a + s) + S[a + s, a + 2 s)) + ..) + S[a + 63 s, a + 64 s),

with + the run's own merge, so even sums of floats are the same bits for every order of arrival and
any interruption.

    blocks-FIRST-LAST.record     the statistics of a range of blocks
    lock                         held while the records are open
"""

import contextlib
import fcntl
import functools
import json
import os
import re
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any, BinaryIO, Self

from jaxtube.experiments.run.atomic import write_atomically
from jaxtube.experiments.run.record_file import (
    DamagedError,
    Statistics,
    decode,
    differences,
    encode,
    plain,
)
from jaxtube.scenario.refusal import refusal

FORMAT = 1
SIZES = tuple(64**level for level in range(6))  # blocks in one file


class RecordsError(ValueError):
    """The disk failed; the message is one line with what happened, what is safe, and how to go on."""


class Records:
    """The records in one folder, which belongs to this object until it is closed.

    damaged: a line for each damaged file met at opening; those files are gone and their blocks are
    missing again.
    """

    damaged: list[str]

    def __init__(
        self,
        folder: Path,
        identity: Mapping[str, Any],
        merge: Callable[[Statistics, Statistics], Statistics],
        block_size: int,
    ) -> None:
        """Open the records in a folder, made where it is absent, and clear up what a killed process
        left there.

        Args:
            folder: `RUN/records`, where RUN is what `--out` names.
            identity: all that determines the statistics of a block, as plain JSON values, nested as
                you like.
            merge: joins the statistics of two ranges of blocks; associative and commutative, up to
                rounding.
            block_size: realisations in a full block.

        Raises:
            ScenarioError: the folder cannot be written to, is open in another process, or holds
                records with another identity; in this last case no record was touched.
            RecordsError: the disk failed later.
        """
        self.damaged = []
        self._folder, self._merge, self._block_size = folder, merge, block_size
        self._identity = json.loads(
            json.dumps({"record_format": FORMAT, "block_size": block_size, **identity})
        )
        self._laps: dict[range, int] = {}
        self._lock = self._locked()
        try:
            with self._explained("opening the records"):
                self._clear(self._scan())
                for blocks in sorted(self._laps, key=len):
                    self._compact(blocks)
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
    def laps(self) -> int:
        """Laps recorded so far."""
        return sum(self._laps.values())

    def missing(self, realisations: int) -> Iterator[int]:
        """Name in order the blocks still to be computed; blocks may be added meanwhile.

        The last block of a shorter run is missing in a longer one unless it was full.

        Raises: ScenarioError when more realisations are recorded than asked for.
        """
        recorded = max(
            (blocks.start * self._block_size + laps for blocks, laps in self._laps.items()),
            default=0,
        )
        if recorded > realisations:
            problem = f"{self._folder} goes up to {recorded}, and the statistics of fewer cannot be cut out of it"
            cure = f"ask for at least {recorded}, or name another --out"
            raise refusal("command line", "--realisations", realisations, problem, cure)
        return self._missing(realisations)

    def add(self, block: int, laps: int, statistics: Mapping[str, Any]) -> None:
        """Record a missing block; once this returns, the block outlives the process.

        Args:
            laps: realisations counted in it; fewer than block_size in a partial block only.
            statistics: arrays of integers or floats.

        Raises: RecordsError when the disk failed; ValueError for a block that is not missing and
        for other arrays.
        """
        if block < 0 or not 0 < laps <= self._block_size:
            raise ValueError(
                f"block {block}, laps = {laps}: out of range; count 1 to {self._block_size} laps"
            )
        if laps <= self._recorded(block):
            raise ValueError(
                f"block {block}, laps = {laps}: as many are recorded; add what is missing"
            )
        blocks = range(block, block + 1)
        with self._explained(f"recording block {block}"):
            self._write(blocks, int(laps), statistics)
            self._laps[blocks] = int(laps)
            self._compact(blocks)

    def merged(self) -> Statistics:
        """Return the statistics of all recorded blocks, by sorted name; empty before the first.

        Once nothing is missing they are the same bytes for every order of arrival and any
        interruption.

        Raises: RecordsError for a file that was damaged since the opening.
        """
        with self._explained("reading the records"):
            return self._fold(sorted(self._laps, key=lambda blocks: blocks.start))

    # -------------------------------------------------------------------------------------------------
    # what is there

    def _missing(self, realisations: int) -> Iterator[int]:
        block, b = 0, self._block_size
        while block * b < realisations:
            if self._recorded(block) < min(b, realisations - block * b):
                yield block
            blocks = self._range_of(block)
            block = blocks.stop if blocks else block + 1

    def _recorded(self, block: int) -> int:
        blocks = self._range_of(block)
        return min(self._laps[blocks], self._block_size) if blocks else 0

    def _range_of(self, block: int) -> range | None:
        """Return the range whose record holds a block."""
        return next(
            (blocks for size in SIZES if (blocks := _aligned(block, size)) in self._laps), None
        )

    def _scan(self) -> list[Path]:
        """Find the records that count, changing nothing, and return the files that are of no use."""
        ranges = {path: _blocks(path.name) for path in sorted(self._folder.glob("blocks-*.record"))}
        useless = list(self._folder.glob(".blocks-*"))
        for path, blocks in sorted(ranges.items(), key=lambda item: -len(item[1])):
            # A process killed between a merge and its clearing up leaves parts of a larger range.
            if not blocks or self._range_of(blocks.start) or not self._count(blocks):
                useless.append(path)
        self.damaged += [
            f"{path}: is no record; it is removed" for path, blocks in ranges.items() if not blocks
        ]
        return useless

    def _count(self, blocks: range) -> bool:
        """Take a record into account unless it is damaged."""
        try:
            self._laps[blocks] = self._read(blocks)[0]
        except DamagedError:
            path, named = self._path(blocks), f"blocks {blocks[0]} to {blocks[-1]}"
            self.damaged.append(
                f"{path}: is damaged; it is removed, and {named} are computed again"
            )
        return blocks in self._laps

    def _clear(self, useless: list[Path]) -> None:
        for path in useless:
            path.unlink()

    # ----------------------------------------------------------------------------------------------------
    # compaction

    def _compact(self, blocks: range) -> None:
        """Merge the siblings of a range into one record once all are there and full; then their
        parent's likewise."""
        if len(blocks) == SIZES[-1]:
            return
        whole = _aligned(blocks.start, SIZES[SIZES.index(len(blocks)) + 1])
        parts = [range(first, first + len(blocks)) for first in whole[:: len(blocks)]]
        if any(self._laps.get(part, 0) < len(part) * self._block_size for part in parts):
            return
        laps = len(whole) * self._block_size
        self._write(whole, laps, self._fold(parts))
        # With the power a rename may be lost; the parts may go only when the whole is on the disk
        # for good.
        _synchronise(self._folder)
        self._laps = {kept: count for kept, count in self._laps.items() if kept not in parts} | {
            whole: laps
        }
        self._clear([self._path(part) for part in parts])
        self._compact(whole)

    def _fold(self, ranges: list[range]) -> Statistics:
        if not ranges:
            return {}
        return plain(functools.reduce(self._merge, map(self._load, ranges)))

    def _load(self, blocks: range) -> Statistics:
        try:
            return self._read(blocks)[1]
        except DamagedError:
            del self._laps[blocks]
            raise self._error(f"{_name(blocks)} was damaged meanwhile") from None

    # ---------------------------------------------------------------------------------------------------------
    # files

    def _path(self, blocks: range) -> Path:
        return self._folder / _name(blocks)

    def _write(self, blocks: range, laps: int, statistics: Mapping[str, Any]) -> None:
        header = {"first": blocks[0], "last": blocks[-1], "laps": laps, "identity": self._identity}
        record = encode(header, statistics)
        write_atomically(self._path(blocks), lambda file: file.write(record))

    def _read(self, blocks: range) -> tuple[int, Statistics]:
        """Return the laps and the statistics of a record.

        Raises: DamagedError; ScenarioError when its identity is another.
        """
        header, statistics = decode(self._path(blocks).read_bytes())
        if found := differences(header["identity"], self._identity):
            problem, cure = (
                f"{self._folder} holds another run: {found}",
                "name another --out, or delete that folder",
            )
            raise refusal("command line", "--out", str(self._folder.parent), problem, cure)
        if range(header["first"], header["last"] + 1) != blocks:
            raise DamagedError
        return header["laps"], statistics

    def _locked(self) -> BinaryIO:
        """Make the folder and take its lock, which the system gives back when the process ends,
        killed or not."""
        try:
            self._folder.mkdir(parents=True, exist_ok=True)
            with contextlib.ExitStack() as unless_taken:
                lock = unless_taken.enter_context((self._folder / "lock").open("ab"))
                fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
                unless_taken.pop_all()
                return lock
        except BlockingIOError:
            problem, cure = (
                "another process is writing there",
                "wait for it, stop it, or name another --out",
            )
        except OSError as error:
            problem, cure = (
                f"cannot be written to ({error.strerror})",
                "name a folder you may write to",
            )
        raise refusal("command line", "--out", str(self._folder.parent), problem, cure)

    @contextlib.contextmanager
    def _explained(self, action: str) -> Iterator[None]:
        """Turn an error of the disk into one line."""
        try:
            yield
        except OSError as error:
            raise self._error(f"{action} failed ({error.strerror or error})") from error

    def _error(self, problem: str) -> RecordsError:
        safe = f"the {self.laps} laps recorded there are safe"
        return RecordsError(
            f"{self._folder}: {problem}; {safe}; run the same command again to continue"
        )


def _aligned(block: int, size: int) -> range:
    first = block - block % size
    return range(first, first + size)


def _name(blocks: range) -> str:
    return f"blocks-{blocks[0]:010d}-{blocks[-1]:010d}.record"


def _blocks(name: str) -> range:
    """Return the range a file's name tells; empty for a name that no record has."""
    match = re.fullmatch(r"blocks-([0-9]{10,18})-([0-9]{10,18})\.record", name)
    blocks = range(int(match[1]), int(match[2]) + 1) if match else range(0)
    known = (
        len(blocks) in SIZES
        and blocks == _aligned(blocks.start, len(blocks))
        and _name(blocks) == name
    )
    return blocks if known else range(0)


def _synchronise(folder: Path) -> None:
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
