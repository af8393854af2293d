"""Poses out of the messages of a bag.

Source: ROS message packages; REP 103 for axes and units, REP 105 for the names of frames.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from jaxtube.recordings.assemble import Samples
from jaxtube.recordings.bag import Bag, Topic, find_stamp
from jaxtube.recordings.hints import Hints
from jaxtube.recordings.poses import find_bad_quaternions, find_headings
from jaxtube.recordings.stamps import count_nanoseconds
from jaxtube.recordings.topics import (
    ODOMETRY,
    OLD_TREE,
    POSE,
    TRANSFORM,
    TREE,
    shorten_type,
)

BODIES = ("base", "body", "robot")
"""Parts of the names of frames that are fixed to a robot."""

SHOWN_FRAMES = 8
"""Pairs of frames that a message lists."""


class Sighting(NamedTuple):
    """One recorded pose.

    Attributes:
        message: its number in the topic, from 1 on.
        stamp: ns.
        position: as ROS writes it.
        orientation: a quaternion, as ROS writes it.
    """

    message: int
    stamp: int
    position: Any
    orientation: Any


def read_poses(bag: Bag, topic: Topic, hints: Hints) -> tuple[Samples, list[str]]:
    """Read the poses of a topic.

    Args:
        bag: that has it.
        topic: to read.
        hints: with the frames, for a topic of transforms.

    Returns:
        Samples of (x m, y m, heading rad), marked by the numbers of the messages, and what was
        taken for them.

    Raises:
        ValueError: in one line, for quaternions that are no rotations, and for transforms of
            several frames where none are named.
    """
    clause = f"poses = {topic.name} ({shorten_type(topic.type)})"
    if topic.type in (TREE, OLD_TREE):
        frames = _find_frames(bag, topic, hints)
        clause += f" from {frames[0]} to {frames[1]}"
        sightings = list(_read_tree(bag, topic, frames))
    else:
        sightings = list(_read_sightings(bag, topic))
    if topic.type == ODOMETRY:
        clause += ", which tell no slip if they are integrated from the wheels"
    numbers = [sighting.message for sighting in sightings]
    poses = flatten_poses(
        bag.path,
        [sighting.position for sighting in sightings],
        [sighting.orientation for sighting in sightings],
        numbers,
    )
    stamps = count_nanoseconds([sighting.stamp for sighting in sightings])
    return Samples(bag.path, stamps, poses, np.array(numbers), "message"), [clause]


def flatten_poses(
    path: str, positions: Sequence[Any], orientations: Sequence[Any], marks: Sequence[int]
) -> Float[np.ndarray, "n 3"]:
    """Return (x m, y m, heading rad) of poses as ROS writes them.

    Raises:
        ValueError: in one line, for quaternions that are no rotations and numbers that are not
            finite.
    """
    places = np.array([(each.x, each.y) for each in positions])
    quaternions = np.array([(each.x, each.y, each.z, each.w) for each in orientations])
    infinite = np.flatnonzero(~np.isfinite(np.column_stack([places, quaternions])).all(axis=1))
    bad = infinite if infinite.size else find_bad_quaternions(quaternions)
    if bad.size:
        row = int(bad[0])
        raise ValueError(
            f"{path}: the pose in message {marks[row]} is none: position {places[row].tolist()}, "
            f"quaternion {quaternions[row].tolist()}; name another topic: --topics poses=NAME"
        )
    return np.column_stack([places, find_headings(quaternions)])


def _read_sightings(bag: Bag, topic: Topic) -> Iterator[Sighting]:
    """Yield the poses of a topic that has one in each message."""
    for number, message in enumerate(bag.read(topic), 1):
        content = message.content
        if topic.type == TRANSFORM:
            moved = content.transform
            yield Sighting(number, message.stamp, moved.translation, moved.rotation)
        else:
            pose = content.pose if topic.type == POSE else content.pose.pose
            yield Sighting(number, message.stamp, pose.position, pose.orientation)


def _read_tree(bag: Bag, topic: Topic, frames: tuple[str, str]) -> Iterator[Sighting]:
    """Yield the poses of one frame in another one."""
    for number, transform in _read_transforms(bag, topic):
        if _name_frames(transform) == frames:
            moved = transform.transform
            stamp = find_stamp(transform.header)
            yield Sighting(number, stamp, moved.translation, moved.rotation)


def _read_transforms(bag: Bag, topic: Topic) -> Iterator[tuple[int, Any]]:
    """Yield all transforms of a topic with the numbers of their messages."""
    for number, message in enumerate(bag.read(topic), 1):
        for transform in message.content.transforms:
            yield number, transform


def _name_frames(transform: Any) -> tuple[str, str]:
    """Return the frames of a transform, the fixed one first."""
    return transform.header.frame_id.strip("/"), transform.child_frame_id.strip("/")


def _find_frames(bag: Bag, topic: Topic, hints: Hints) -> tuple[str, str]:
    """Return the frames that the user names, else the only ones of a robot's body.

    Raises:
        ValueError: in one line with the frames there are.
    """
    counts = Counter(_name_frames(transform) for _, transform in _read_transforms(bag, topic))
    chosen = tuple(hints.topics.get("poses", "").split(":")[1:])
    bodies = [frames for frames in counts if any(word in frames[1] for word in BODIES)]
    candidates = [frames for frames in counts if frames == chosen] if chosen else bodies
    if len(candidates) == 1:
        return candidates[0]
    known = ", ".join(":".join(frames) for frames in list(counts)[:SHOWN_FRAMES])
    example = ":".join((bodies or list(counts))[0])
    problem = f"has no {':'.join(chosen)}" if chosen else "does not tell which frame is the robot"
    raise ValueError(
        f"{bag.path}: {topic.name} {problem} among {known}; name the frames: "
        f"--topics poses={topic.name}:{example}"
    )
