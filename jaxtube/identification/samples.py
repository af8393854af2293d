"""Samples of a log: poses without those that were only held, and the travel of the wheels.

A row that repeats the last pose holds no news: kept, it would say that the robot stood still.
Travel S(t) is the integral of the wheel speeds, by the trapezoidal rule between their samples.

Source: new.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from jaxtube.recordings.log import Log


@dataclass(frozen=True, eq=False)
class Poses:
    """Poses that were really taken.

    Attributes:
        time: s, increasing.
        pose: (x m, y m, heading rad unwrapped), world frame.
        held_share: share of the log's poses that repeated the one before, and were dropped.
    """

    time: Float[np.ndarray, "m"]
    pose: Float[np.ndarray, "m 3"]
    held_share: float

    @property
    def period(self) -> float:
        """Median time between two poses, s."""
        return float(np.median(np.diff(self.time)))


def drop_held_poses(log: Log) -> Poses:
    """Return the poses of a log that differ from the one before."""
    is_new = np.any(np.diff(log.poses, axis=0) != 0.0, axis=1)
    kept = np.concatenate([[True], is_new])
    return Poses(log.pose_time[kept], log.poses[kept], 1.0 - float(np.mean(kept)))


@dataclass(frozen=True, eq=False)
class Travel:
    """The travel of the wheels up to each of their samples.

    Attributes:
        time: s.
        way: (right, left), m.
        speed: (right, left), m/s.
    """

    time: Float[np.ndarray, "n"]
    way: Float[np.ndarray, "n 2"]
    speed: Float[np.ndarray, "n 2"]

    def between(
        self, start: Float[np.ndarray, "k"], end: Float[np.ndarray, "k"]
    ) -> Float[np.ndarray, "k 2"]:
        """Return how far the wheels (right, left) rolled from one time to another, m; nothing
        outside of the log."""
        columns = [
            np.interp(end, self.time, way) - np.interp(start, self.time, way) for way in self.way.T
        ]
        return np.column_stack(columns)


def measure_travel(log: Log) -> Travel:
    """Integrate the wheel speeds of a log."""
    middle = (log.wheels[1:] + log.wheels[:-1]) / 2.0
    way = np.cumsum(middle * np.diff(log.time)[:, None], axis=0)
    return Travel(log.time, np.pad(way, ((1, 0), (0, 0))), log.wheels)


@dataclass(frozen=True, eq=False)
class Steps:
    """Motion of the body over short spans, from one pose to a later one.

    Attributes:
        start: of the span, s.
        end: of the span, s.
        forward: along the middle heading, the chord made as long as its arc, m.
        turn: rad.
    """

    start: Float[np.ndarray, "k"]
    end: Float[np.ndarray, "k"]
    forward: Float[np.ndarray, "k"]
    turn: Float[np.ndarray, "k"]


def measure_steps(poses: Poses, span: float) -> Steps:
    """Return the motion from each pose to the first one that is `span` seconds later, or up to half
    as much again; gaps are left out."""
    later = np.searchsorted(poses.time, poses.time + span - 1e-9)
    first = np.flatnonzero(later < len(poses.time))
    last = later[first]
    is_near = poses.time[last] - poses.time[first] <= 1.5 * span
    first = first[is_near]
    last = last[is_near]
    moved = poses.pose[last] - poses.pose[first]
    middle = (poses.pose[last, 2] + poses.pose[first, 2]) / 2.0
    chord = moved[:, 0] * np.cos(middle) + moved[:, 1] * np.sin(middle)
    # np.sinc(x) is sin(pi x) / (pi x); a chord is its arc times the sine of half the turn by that.
    shortening = np.maximum(np.sinc(moved[:, 2] / (2 * np.pi)), 0.5)
    return Steps(poses.time[first], poses.time[last], chord / shortening, moved[:, 2])
