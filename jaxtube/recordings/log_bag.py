"""A log, or a path, out of a bag.

Source: ROS message packages geometry_msgs and nav_msgs.
"""

from __future__ import annotations

import numpy as np

from jaxtube.recordings.assemble import Samples, Sources
from jaxtube.recordings.bag import Bag, Topic, open_bag
from jaxtube.recordings.hints import Hints
from jaxtube.recordings.log_table import read_pose_file
from jaxtube.recordings.path import RawPath, count_from_origin
from jaxtube.recordings.pose_messages import flatten_poses, read_poses
from jaxtube.recordings.stamps import count_nanoseconds
from jaxtube.recordings.topics import (
    COMMANDS,
    PATH,
    PATHS,
    POSES,
    TWIST_STAMPED,
    choose_topic,
    list_candidates,
    list_topics,
    shorten_type,
)
from jaxtube.recordings.wheel_messages import read_wheels


def read_bag_sources(path: str, hints: Hints) -> Sources:
    """Read what a log is made of from a bag.

    Raises:
        ValueError: in one line, for a bag that cannot be read, and topics that are not there or
            cannot be told.
    """
    with open_bag(path) as bag:
        wheels = read_wheels(bag, hints)
        if hints.pose_file is None:
            poses, pose_clauses = read_poses(bag, choose_topic(bag, POSES, hints), hints)
        else:
            poses, pose_clauses = read_pose_file(hints)
        commands, command_clauses = _read_commands(bag, hints)
    return Sources(
        wheels=wheels.samples,
        wheel_unit=wheels.unit,
        poses=poses,
        commands=commands,
        steps=None,
        guesses=(*wheels.guesses, *pose_clauses, *command_clauses),
    )


def _read_commands(bag: Bag, hints: Hints) -> tuple[Samples | None, list[str]]:
    """Return the commands of a bag, None where it has none or several topics may hold them."""
    candidates = list_candidates(bag, COMMANDS)
    if "commands" in hints.topics:
        topic = choose_topic(bag, COMMANDS, hints)
    elif len(candidates) == 1:
        topic = candidates[0]
    else:
        several = f"none read, {list_topics(candidates)} may hold them"
        return None, [f"commands: {several}"] if candidates else []
    stamps = []
    values = []
    for message in bag.read(topic):
        twist = message.content.twist if topic.type == TWIST_STAMPED else message.content
        stamps.append(message.stamp)
        values.append((twist.linear.x, twist.angular.z))
    marks = np.arange(1, len(stamps) + 1)
    samples = Samples(bag.path, count_nanoseconds(stamps), np.array(values), marks, "message")
    return samples, [f"commands = {topic.name} ({shorten_type(topic.type)})"]


def read_path_bag(path: str, hints: Hints) -> RawPath:
    """Read a path from a bag, its poses as they are.

    Raises:
        ValueError: as `read_bag_sources`.
    """
    with open_bag(path) as bag:
        topic = choose_topic(bag, PATHS, hints)
        if topic.type == PATH:
            return _read_plan(bag, topic)
        poses, clauses = read_poses(bag, topic, hints)
    return count_from_origin(
        RawPath(
            path=path,
            time=poses.stamps.since,
            positions=poses.values[:, :2],
            headings=poses.values[:, 2],
            lines=poses.marks,
            word=poses.word,
            guesses=tuple(clauses),
        )
    )


def _read_plan(bag: Bag, topic: Topic) -> RawPath:
    """Return the longest of the planned paths of a topic; plans have no time of their own."""
    plan = max((message.content.poses for message in bag.read(topic)), key=len)
    marks = np.arange(1, len(plan) + 1)
    if not plan:
        raise ValueError(f"{bag.path}: the paths of {topic.name} are empty; record a path")
    values = flatten_poses(
        bag.path,
        [each.pose.position for each in plan],
        [each.pose.orientation for each in plan],
        marks.tolist(),
    )
    is_turned = bool(np.ptp(values[:, 2]))  # planners that plan no headings leave them all zero
    clause = f"positions = the longest of {topic.count} paths of {topic.name}"
    return count_from_origin(
        RawPath(
            path=bag.path,
            time=None,
            positions=values[:, :2],
            headings=values[:, 2] if is_turned else None,
            lines=marks,
            word="pose",
            guesses=(clause,),
        )
    )
