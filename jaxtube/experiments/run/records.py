"""The records of a long Monte Carlo run: nothing computed is lost, however often the process is
killed.

Block i holds the realisations i b .. (i+1) b - 1 of a run, b to the block; the last block may be
partial. Its statistics are one entry of a store, and 64 aligned entries of full blocks become one:
of n blocks, about 64 log_64 n files are left. The statistics of n realisations are a fold over a
tree that n and b alone determine,

    S[a, a + 64 s) = (..(S[a, a + s) + S[a + s, a + 2 s)) + ..) + S[a + 63 s, a + 64 s),

with + the run's own merge, so even sums of floats are the same bits for every order of arrival and
any interruption.

    blocks-FIRST-LAST.record     the statistics of a range of blocks
"""

from __future__ import annotations

import functools
import re
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

from jaxtube.experiments.run.record_file import Arrays, DamagedError, plain
from jaxtube.experiments.run.store import SUFFIX, Entry
from jaxtube.experiments.run.store_owner import StoreOwner
from jaxtube.scenario.refusal import refusal

SIZES = tuple(64**level for level in range(6))
"""Blocks in one entry."""


class Records(StoreOwner):
    """The records in one folder, which belongs to this object until it is closed."""

    def __init__(
        self,
        folder: Path,
        identity: Mapping[str, Any],
        merge: Callable[[Arrays, Arrays], Arrays],
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
            StoreError: the disk failed later.
        """
        super().__init__(folder, {"block_size": block_size, **identity})
        self._merge = merge
        self._block_size = block_size
        self._laps: dict[range, int] = {}
        with self._opening("the records"):
            self._store.remove(self._scan())
            for blocks in sorted(self._laps, key=len):
                self._compact(blocks)

    @property
    def laps(self) -> int:
        """Laps recorded so far."""
        return sum(self._laps.values())

    def missing(self, realisations: int) -> Iterator[int]:
        """Name in order the blocks still to be computed; blocks may be added meanwhile.

        The last block of a shorter run is missing in a longer one unless it was full.

        Raises:
            ScenarioError: when more realisations are recorded than asked for.
        """
        ends = [blocks.start * self._block_size + laps for blocks, laps in self._laps.items()]
        recorded = max(ends, default=0)
        if recorded > realisations:
            problem = (
                f"{self._store.folder} goes up to {recorded}, and the statistics of fewer cannot "
                "be cut out of it"
            )
            cure = f"ask for at least {recorded}, or name another --out"
            raise refusal("command line", "--realisations", realisations, problem, cure)
        return self._missing(realisations)

    def add(self, block: int, laps: int, statistics: Mapping[str, Any]) -> None:
        """Record a missing block; once this returns, the block outlives the process.

        Args:
            laps: realisations counted in it; fewer than block_size in a partial block only.
            statistics: arrays of integers or floats.

        Raises:
            StoreError: when the disk failed.
            ValueError: for a block that is not missing, and for other arrays.
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
        with self._explain_failure(f"recording block {block}"):
            self._write(blocks, int(laps), statistics)
            self._laps[blocks] = int(laps)
            self._compact(blocks)

    def merge(self) -> Arrays:
        """Return the statistics of all recorded blocks, by sorted name; empty before the first.

        Once nothing is missing they are the same bytes for every order of arrival and any
        interruption.

        Raises:
            StoreError: for a file that was damaged since the opening.
        """
        with self._explain_failure("reading the records"):
            return self._fold(sorted(self._laps, key=lambda blocks: blocks.start))

    def _say_what_is_safe(self) -> str:
        return f"the {self.laps} laps recorded there are safe"

    def _missing(self, realisations: int) -> Iterator[int]:
        block = 0
        size = self._block_size
        while block * size < realisations:
            if self._recorded(block) < min(size, realisations - block * size):
                yield block
            blocks = self._range_of(block)
            block = blocks.stop if blocks else block + 1

    def _recorded(self, block: int) -> int:
        blocks = self._range_of(block)
        return min(self._laps[blocks], self._block_size) if blocks else 0

    def _range_of(self, block: int) -> range | None:
        """Return the range whose record holds a block."""
        ranges = (_aligned(block, size) for size in SIZES)
        return next((blocks for blocks in ranges if blocks in self._laps), None)

    def _scan(self) -> list[Path]:
        """Find the records that count, changing nothing; return the files that are of no use."""
        ranges = {path: _blocks(path.name) for path in self._store.paths()}
        useless = self._store.leftovers()
        for path, blocks in sorted(ranges.items(), key=lambda item: -len(item[1])):
            # A process killed between a merge and its clearing up leaves parts of a larger range.
            if not blocks or self._range_of(blocks.start) or not self._count(blocks):
                useless.append(path)
        for path, blocks in ranges.items():
            if not blocks:
                self.damaged.append(f"{path}: is no record; it is removed")
        return useless

    def _count(self, blocks: range) -> bool:
        """Take a record into account unless it is damaged."""
        try:
            self._laps[blocks] = self._read_laps(blocks)
        except DamagedError:
            path = self._path(blocks)
            self.damaged.append(
                f"{path}: is damaged; it is removed, and blocks {blocks[0]} to {blocks[-1]} are "
                "computed again"
            )
            return False
        return True

    def _read_laps(self, blocks: range) -> int:
        laps = self._read(blocks).header.get("laps")
        if type(laps) is not int or not 0 < laps <= len(blocks) * self._block_size:
            raise DamagedError
        return laps

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
        self._store.synchronise()
        for part in parts:
            del self._laps[part]
        self._laps[whole] = laps
        self._store.remove(map(self._path, parts))
        self._compact(whole)

    def _fold(self, ranges: list[range]) -> Arrays:
        if not ranges:
            return {}
        return plain(functools.reduce(self._merge, map(self._load, ranges)))

    def _load(self, blocks: range) -> Arrays:
        try:
            return self._read(blocks).arrays
        except DamagedError:
            del self._laps[blocks]
            problem = f"{_name(blocks)} was damaged meanwhile"
            raise self._store.fail(problem, self._say_what_is_safe()) from None

    def _path(self, blocks: range) -> Path:
        return self._store.folder / _name(blocks)

    def _write(self, blocks: range, laps: int, statistics: Mapping[str, Any]) -> None:
        self._store.write(_stem(blocks), {"laps": laps}, statistics)

    def _read(self, blocks: range) -> Entry:
        return self._store.read(_stem(blocks))


def _aligned(block: int, size: int) -> range:
    first = block - block % size
    return range(first, first + size)


def _stem(blocks: range) -> str:
    return f"blocks-{blocks[0]:010d}-{blocks[-1]:010d}"


def _name(blocks: range) -> str:
    return f"{_stem(blocks)}{SUFFIX}"


def _blocks(name: str) -> range:
    """Return the range a file's name tells; empty for a name that no record has."""
    match = re.fullmatch(r"blocks-([0-9]{10,18})-([0-9]{10,18})\.record", name)
    if not match:
        return range(0)
    blocks = range(int(match[1]), int(match[2]) + 1)
    is_aligned = len(blocks) in SIZES and blocks == _aligned(blocks.start, len(blocks))
    return blocks if is_aligned and _name(blocks) == name else range(0)
