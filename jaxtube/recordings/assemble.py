"""A log from samples of wheels, poses and commands, whichever file they come from.

Source: new.
"""

from __future__ import annotations

from decimal import Decimal
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from jaxtube.recordings.hints import Hints
from jaxtube.recordings.log import Log
from jaxtube.recordings.poses import describe_headings, describe_origin, find_origin
from jaxtube.recordings.samples import FEWEST_SAMPLES, hold, order_samples
from jaxtube.recordings.stamps import Stamps
from jaxtube.recordings.wheels import find_wheel_speeds


class Samples(NamedTuple):
    """Samples of one source.

    Attributes:
        path: the file, for messages.
        stamps: their times.
        values: of wheels (right, left) as measured; of poses (x m, y m, heading rad); of commands
            (speed m/s, yaw rate rad/s); of steps their numbers.
        marks: where they stand in the file.
        word: for a mark, such as "line".
    """

    path: str
    stamps: Stamps
    values: Float[np.ndarray, "n ..."]
    marks: Int[np.ndarray, "n"]
    word: str


class Sources(NamedTuple):
    """What a log is made of.

    Attributes:
        wheels: as measured.
        wheel_unit: of them.
        poses: positions and headings.
        commands: None where not recorded.
        steps: numbers of commands; None where not recorded.
        guesses: what was taken for what.
    """

    wheels: Samples
    wheel_unit: str
    poses: Samples
    commands: Samples | None
    steps: Samples | None
    guesses: tuple[str, ...]


def assemble_log(path: str, sources: Sources, hints: Hints) -> Log:
    """Return the log of some samples, over the time since its first wheel speed.

    Raises:
        ValueError: in one line, for times that go back or do not overlap, too few samples, and
            sizes that a unit needs.
    """
    wheels, wheel_changes = _order("wheel samples", sources.wheels)
    poses, pose_changes = _order("poses", sources.poses)
    _require_samples("wheel samples", wheels)
    _require_samples("poses", poses)
    speeds = find_wheel_speeds(path, wheels.stamps.since, wheels.values, sources.wheel_unit, hints)
    start = wheels.stamps.first + Decimal(float(speeds.time[0]))
    time = speeds.time - speeds.time[0]
    pose_time = _count_from(start, poses)
    _refuse_gap(sources, time, pose_time)
    origin = find_origin(poses.values[:, :2])
    positions = poses.values[:, :2] - origin
    steps = _hold("steps", sources.steps, start, time)
    return Log(
        path=path,
        time=time,
        wheels=speeds.speeds,
        pose_time=pose_time,
        poses=np.column_stack([positions, np.unwrap(poses.values[:, 2])]),
        step=None if steps is None else np.rint(steps).astype(int),
        commands=_hold("commands", sources.commands, start, time),
        guesses=(
            *sources.guesses,
            *speeds.guesses,
            *wheel_changes,
            *pose_changes,
            *describe_origin(origin),
            *describe_headings(positions, poses.values[:, 2]),
        ),
    )


def _order(what: str, samples: Samples) -> tuple[Samples, tuple[str, ...]]:
    """Return samples in the order of their times, and what was changed.

    Raises:
        ValueError: in one line, for times that go back, and numbers that are not finite.
    """
    numbers = samples.values.reshape(len(samples.marks), -1)
    infinite = np.flatnonzero(~np.isfinite(numbers).all(axis=1))
    if infinite.size:
        row = int(infinite[0])
        raise ValueError(
            f"{samples.path}: {what}, {samples.word} {samples.marks[row]}: {numbers[row].tolist()} "
            "is not finite; name another source, or record it again"
        )
    order = order_samples(samples.path, what, samples.stamps.since, samples.marks, samples.word)
    stamps = samples.stamps._replace(since=samples.stamps.since[order.rows])
    ordered = samples._replace(
        stamps=stamps, values=samples.values[order.rows], marks=samples.marks[order.rows]
    )
    return ordered, order.guesses


def _require_samples(what: str, samples: Samples) -> None:
    """Refuse a log that is too short to see anything."""
    count = len(samples.marks)
    if count < FEWEST_SAMPLES:
        raise ValueError(
            f"{samples.path}: {count} {what} of different times are too few; record at least "
            f"{FEWEST_SAMPLES}"
        )


def _count_from(start: Decimal, samples: Samples) -> Float[np.ndarray, "n"]:
    """Return times since some instant on the same clock, s."""
    return samples.stamps.since + float(samples.stamps.first - start)


def _hold(
    what: str, samples: Samples | None, start: Decimal, time: Float[np.ndarray, "n"]
) -> Float[np.ndarray, "n ..."] | None:
    """Return the values that hold at some times, None where there are none at all."""
    if samples is None:
        return None
    ordered, _ = _order(what, samples)
    return hold(_count_from(start, ordered), ordered.values, time)


def _refuse_gap(
    sources: Sources, time: Float[np.ndarray, "n"], pose_time: Float[np.ndarray, "m"]
) -> None:
    """Refuse wheels and poses that were not recorded at the same time."""
    if pose_time[0] < time[-1] and time[0] < pose_time[-1]:
        return
    raise ValueError(
        f"{sources.wheels.path}: its wheels end after {time[-1]:.6g} s, the poses of "
        f"{sources.poses.path} run from {pose_time[0]:.6g} to {pose_time[-1]:.6g} s on that clock: "
        "they do not overlap; give wheels and poses of one recording and one clock"
    )
