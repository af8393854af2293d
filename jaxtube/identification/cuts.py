"""Where the pose of a log cannot be trusted: jumps, stretches in which it was lost, and gaps.

From one pose to the next the body moves by what the wheels make expect, save for slip and noise:

    jump:   |p_{k+1} - p_k - R(phi) (d, 0)| > 6 sigma + 0.6 d + 0.1 m,   or the same of the turn
    lost:   three jumps and more, none further than two seconds from the next
    gap:    no new pose for a second, while the wheels rolled

with d the expected way and sigma the spread of what poses miss of their neighbours' mean. A window
that touches a cut is not used.

Source: new.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from jaxtube.identification.clocks import Clock
from jaxtube.identification.samples import Poses, Travel
from jaxtube.recordings.spread import find_spread

SIGMAS = 6.0

SHARE_OF_WAY = 0.6
"""Of the expected motion, by which slip and sideslip may change it."""

LEAST_JUMP = np.array([0.1, 0.1])
"""Smaller ones are noise, m and rad."""

LOST_S = 2.0
"""Between two jumps of one stretch at most."""

LOST_JUMPS = 3
"""Of a lost stretch at least."""

GAP_S = 1.0
"""Without a new pose, at least."""

ROLLED_M = 0.05
"""In a gap at least: a pose that stands still with its wheels is not missing."""


class Cut(NamedTuple):
    """A stretch of time in which the pose is not trusted."""

    kind: Literal["jump", "lost", "gap"]
    start: float  # s, last good pose
    end: float  # s, next good pose
    jumps: int
    largest: float  # m, of a jump; of a gap the way of the wheels
    turn: float  # rad, of the largest jump of the heading


@dataclass(frozen=True, eq=False)
class Cuts:
    """All cuts of a log, in order of time."""

    cuts: tuple[Cut, ...]

    def touch(
        self, start: Float[np.ndarray, "k"], end: Float[np.ndarray, "k"]
    ) -> Bool[np.ndarray, "k"]:
        """Tell which spans of time touch a cut."""
        touched = np.zeros(len(start), dtype=bool)
        for cut in self.cuts:
            touched |= (end > cut.start) & (start < cut.end)
        return touched

    def of_kind(self, kind: str) -> list[Cut]:
        """Return the cuts of one kind."""
        return [cut for cut in self.cuts if cut.kind == kind]


def find_cuts(travel: Travel, poses: Poses, clock: Clock) -> Cuts:
    """Find jumps, lost stretches and gaps of a log."""
    start = poses.time[:-1]
    end = poses.time[1:]
    expected = clock.predict(travel, start, end)
    size = _measure_jumps(poses, expected)
    limit = SIGMAS * _find_noise(poses) + SHARE_OF_WAY * np.abs(expected) + LEAST_JUMP
    is_jump = np.any(size > limit, axis=1)
    way = np.abs(travel.between(start - clock.offset, end - clock.offset)).max(axis=1)
    is_gap = (end - start > GAP_S) & (way > ROLLED_M)
    gaps = [
        Cut("gap", float(start[k]), float(end[k]), 0, float(way[k]), 0.0)
        for k in np.flatnonzero(is_gap)
    ]
    jumps = np.flatnonzero(is_jump & ~is_gap)
    groups = np.split(jumps, np.flatnonzero(np.diff(start[jumps]) > LOST_S) + 1)
    found = [cut for group in groups for cut in _describe(group, start, end, size)]
    return Cuts(tuple(sorted([*found, *gaps], key=lambda cut: cut.start)))


def _measure_jumps(poses: Poses, expected: Float[np.ndarray, "k 2"]) -> Float[np.ndarray, "k 2"]:
    """Return by how much each pose misses the expected one (m, rad)."""
    moved = np.diff(poses.pose, axis=0)
    towards = poses.pose[:-1, 2] + expected[:, 1] / 2.0
    ahead = np.column_stack([np.cos(towards), np.sin(towards)]) * expected[:, :1]
    missed = np.linalg.norm(moved[:, :2] - ahead, axis=1)
    return np.column_stack([missed, np.abs(moved[:, 2] - expected[:, 1])])


def _find_noise(poses: Poses) -> Float[np.ndarray, "2"]:
    """Return the spread of poses about the mean of their neighbours (m, rad)."""
    bent = poses.pose[1:-1] - (poses.pose[2:] + poses.pose[:-2]) / 2.0
    spread = find_spread(bent, axis=0)
    return np.array([max(spread[0], spread[1]), spread[2]])


def _describe(
    group: np.ndarray,
    start: Float[np.ndarray, "k"],
    end: Float[np.ndarray, "k"],
    size: Float[np.ndarray, "k 2"],
) -> list[Cut]:
    """Return one lost stretch for a group of many jumps, else each jump on its own."""
    if len(group) >= LOST_JUMPS:
        parts = [group]
    else:
        parts = np.array_split(group, len(group)) if len(group) else []
    kind = "lost" if len(group) >= LOST_JUMPS else "jump"
    cuts = []
    for part in parts:
        largest, turn = size[part].max(axis=0).tolist()
        cuts.append(
            Cut(kind, float(start[part[0]]), float(end[part[-1]]), len(part), largest, turn)
        )
    return cuts
