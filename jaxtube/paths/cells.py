"""Cells: a path as a chain of places where the robot was near each other, row after row.

A cell takes up rows as long as they stay within its radius of the mean of those it holds. While the
robot moves a cell is a short stretch; while it stands, however its position jitters, it is one
cell. The chain of the cells' means is neither longer nor less straight than the drive, as the
polygon through noisy rows is.

Source: stay points as in Li, Zheng, Xie, Chen, Liu, Ma 2008, Mining user similarity based on
location history, section 4; the running mean is new.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from jaxtube.paths.rows import measure_noise
from jaxtube.recordings.path import RawPath

NOISES = 6.0
"""Radius of a cell in noises: a robot that stands leaves it once in 10^7 rows."""

WIDTH_SHARE = 0.05
"""Least radius of a cell in track widths."""


@dataclass(frozen=True, eq=False)
class Chain:
    """Cells of a path.

    Attributes:
        means: of the cells' positions, m.
        first: row that each begins with; row n ends the last one.
        radius: of the cells, m.
        rows: how many rows the path has.
    """

    means: Float[np.ndarray, "cells 2"]
    first: Int[np.ndarray, " cells"]
    radius: float
    rows: int

    @property
    def counts(self) -> Int[np.ndarray, " cells"]:
        """How many rows each cell holds."""
        return np.diff(self.first, append=self.rows)

    @property
    def last(self) -> Int[np.ndarray, " cells"]:
        """The row that each cell ends with."""
        return self.first + self.counts - 1

    def dwell(self, raw: RawPath) -> Float[np.ndarray, " cells"]:
        """Return how long the robot stays in each cell: s, or rows where the path has no time.

        Of a step to the next cell a cell counts as much as lies within its radius, half at most: a
        robot that is not seen for a while has not stood.
        """
        clock = np.arange(float(self.rows)) if raw.time is None else raw.time
        inside = clock[self.last] - clock[self.first]
        leaves = self.last[:-1]
        enters = self.first[1:]
        step = np.linalg.norm(raw.positions[enters] - raw.positions[leaves], axis=1)
        edge = (clock[enters] - clock[leaves]) * np.minimum(0.5, self.radius / step)
        return inside + np.append(edge, 0.0) + np.append(0.0, edge)


def find_radius(positions: Float[np.ndarray, "n 2"], track_width: float) -> float:
    """Return the radius of the cells of a path, m."""
    return max(WIDTH_SHARE * track_width, NOISES * measure_noise(positions))


def make_chain(positions: Float[np.ndarray, "n 2"], radius: float) -> Chain:
    """Collect rows into cells of a radius (m), in their order."""
    first = []
    means = []
    count = 0
    x_mean = np.inf
    y_mean = np.inf
    for row, (x, y) in enumerate(positions.tolist()):
        if (x - x_mean) ** 2 + (y - y_mean) ** 2 > radius**2:
            first.append(row)
            means.append((x, y))
            count = 1
        else:
            count += 1
            means[-1] = (x_mean + (x - x_mean) / count, y_mean + (y - y_mean) / count)
        x_mean, y_mean = means[-1]
    return Chain(np.array(means), np.array(first), radius, len(positions))


def arc_lengths(positions: Float[np.ndarray, "n 2"], chain: Chain) -> Float[np.ndarray, " n"]:
    """Return how far along its chain each row of a path lies, m: the middle row of a cell at its
    mean, rows between in proportion."""
    middle = (chain.first + chain.last) / 2.0
    rows = np.concatenate([[0.0], middle[1:-1], [chain.rows - 1.0]])
    corners = np.concatenate([positions[:1], chain.means[1:-1], positions[-1:]])
    lengths = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(corners, axis=0), axis=1)))
    return np.interp(np.arange(float(chain.rows)), rows, lengths)
