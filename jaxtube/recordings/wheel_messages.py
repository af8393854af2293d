"""Wheel speeds out of the messages of a bag.

Source: ROS message package sensor_msgs; REP 103: joints turn in rad and rad/s.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from jaxtube.recordings.assemble import Samples
from jaxtube.recordings.bag import Bag, Topic
from jaxtube.recordings.hints import Hints
from jaxtube.recordings.samples import order_samples
from jaxtube.recordings.spelling import normalise
from jaxtube.recordings.stamps import count_nanoseconds
from jaxtube.recordings.topics import WHEELS, choose_topic, require_topic
from jaxtube.recordings.usual_names import UNIT_SUFFIXES

WHEEL_WORDS = ("wheel", "track", "drive", "sprocket", "tread")
"""Parts of the names of joints that move a robot over the ground."""

SIDES = {
    "left": ("left", "l", "fl", "rl", "bl", "ml"),
    "right": ("right", "r", "fr", "rr", "br", "mr"),
}
"""Words in the names of joints by side; front, rear, back and middle wheels among them."""

SHOWN_JOINTS = 12
"""Joints that a message lists."""


class Wheels(NamedTuple):
    """Wheels of a bag.

    Attributes:
        samples: (right, left) as measured, marked by the numbers of the messages from 1 on.
        unit: of them.
        guesses: what was taken for what, a clause each.
    """

    samples: Samples
    unit: str
    guesses: list[str]


def read_wheels(bag: Bag, hints: Hints) -> Wheels:
    """Read the wheels of a bag: two topics of numbers if the user names them, else joints.

    Raises:
        ValueError: in one line, for topics and joints that are not there or cannot be told.
    """
    if "left" in hints.topics or "right" in hints.topics:
        return _read_sides(bag, hints)
    topic = choose_topic(bag, WHEELS, hints)
    return _read_joints(bag, topic, hints)


def _read_joints(bag: Bag, topic: Topic, hints: Hints) -> Wheels:
    """Read wheels that are joints; messages of other joints are left out."""
    joints = _find_joints(bag, topic, hints)
    wanted = {*joints["right"], *joints["left"]}
    numbers = []
    stamps = []
    turned = []
    speeds = []
    for number, message in enumerate(bag.read(topic), 1):
        names = list(message.content.name)
        if not wanted.issubset(names):
            continue
        places = [[names.index(name) for name in joints[side]] for side in ("right", "left")]
        numbers.append(number)
        stamps.append(message.stamp)
        speeds.append([_average(message.content.velocity, side) for side in places])
        turned.append([_average(message.content.position, side) for side in places])
    has_speeds = np.isfinite(speeds).all() and np.any(speeds)
    unit = hints.find_unit("left") or ("rad/s" if has_speeds else "rad")
    values = np.array(speeds if has_speeds else turned)
    clauses = [f"{side} = {'+'.join(joints[side])} of {topic.name} in {unit}" for side in SIDES]
    samples = Samples(bag.path, count_nanoseconds(stamps), values, np.array(numbers), "message")
    return Wheels(samples, _check_unit(unit), clauses)


def _average(values: Sequence[float], places: Sequence[int]) -> float:
    """Return the mean of some values, NaN where the message has none."""
    if len(values) <= max(places):
        return float("nan")
    return sum(float(values[place]) for place in places) / len(places)


def _find_joints(bag: Bag, topic: Topic, hints: Hints) -> dict[str, list[str]]:
    """Return the joints of each side: those that the user names, else by their names.

    Raises:
        ValueError: in one line with the joints there are, where it cannot be told.
    """
    known = list(dict.fromkeys(name for each in bag.read(topic) for name in each.content.name))
    joints = {}
    for side in SIDES:
        chosen = hints.columns.get(side)
        joints[side] = chosen.split("+") if chosen else _guess_joints(known, side)
        if not joints[side] or not set(joints[side]).issubset(known):
            problem = f"no joint {chosen}" if chosen else f"no {side} wheel"
            raise ValueError(
                f"{bag.path}: {topic.name} has {problem} among {', '.join(known[:SHOWN_JOINTS])}; "
                "name the joints: --columns left=NAME,right=NAME (NAME+NAME for the mean of two)"
            )
    return joints


def _guess_joints(known: Sequence[str], side: str) -> list[str]:
    """Return the joints whose names say that they are wheels of a side; where no name says so,
    those that say the side only."""
    sided = [name for name in known if set(normalise(name).split("_")) & set(SIDES[side])]
    wheels = [name for name in sided if any(word in name.lower() for word in WHEEL_WORDS)]
    return wheels or sided


def _read_sides(bag: Bag, hints: Hints) -> Wheels:
    """Read wheels from a topic of numbers for each side; the right one is interpolated at the times
    of the left one."""
    unit = hints.find_unit("left")
    if unit is None or unit != hints.find_unit("right"):
        raise ValueError(
            f"{bag.path}: numbers in topics have no unit; give one for both wheels, such as "
            "--units left=m/s,right=m/s"
        )
    sides = {side: _read_numbers(bag, side, hints) for side in SIDES}
    left = sides["left"]
    right = sides["right"]
    gap = float(left.stamps.first - right.stamps.first)
    moved = np.interp(left.stamps.since + gap, right.stamps.since, right.values)
    inside = (left.stamps.since + gap >= 0.0) & (left.stamps.since + gap <= right.stamps.since[-1])
    if not inside.any():
        raise ValueError(
            f"{bag.path}: the left and the right wheels were not recorded at the same time; name "
            "two topics of one recording"
        )
    samples = Samples(
        bag.path,
        left.stamps._replace(since=left.stamps.since[inside]),
        np.column_stack([moved, left.values])[inside],
        left.marks[inside],
        left.word,
    )
    return Wheels(samples, _check_unit(unit), [f"{side} = {hints.topics[side]}" for side in SIDES])


def _read_numbers(bag: Bag, side: str, hints: Hints) -> Samples:
    """Read a number from each message of a topic, in the order of time.

    Raises:
        ValueError: in one line, for a topic or a field that is not there.
    """
    chosen = hints.topics.get(side, "")
    topic = require_topic(bag, side, chosen, ())
    fields = (chosen.partition(":")[2] or "data").split(".")
    stamps = []
    numbers = []
    for message in bag.read(topic):
        number = message.content
        for name in fields:
            number = getattr(number, name, None)
        if not isinstance(number, int | float):
            raise ValueError(
                f"{bag.path}: messages of {topic.name} have no number {'.'.join(fields)}; name the "
                f"field: --topics {side}={topic.name}:FIELD.FIELD"
            )
        stamps.append(message.stamp)
        numbers.append(float(number))
    marks = np.arange(1, len(stamps) + 1)
    stamped = count_nanoseconds(stamps)
    order = order_samples(bag.path, f"{side} wheels", stamped.since, marks, "message")
    since = stamped.since[order.rows]
    values = np.array(numbers)[order.rows]
    return Samples(bag.path, stamped._replace(since=since), values, marks[order.rows], "message")


def _check_unit(unit: str) -> str:
    """Return a unit of wheels.

    Raises:
        ValueError: in one line, for another unit.
    """
    known = UNIT_SUFFIXES["wheel"]
    if unit not in known:
        raise ValueError(f"--units left={unit}: is no unit of it; give one of {', '.join(known)}")
    return unit
