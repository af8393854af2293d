"""Which topic of a bag holds what: as the user says, else by the types of messages.

Source: ROS message packages nav_msgs, geometry_msgs, sensor_msgs and tf2_msgs.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

from jaxtube.recordings.bag import Bag, Topic
from jaxtube.recordings.hints import Hints
from jaxtube.recordings.samples import FEWEST_SAMPLES

JOINT_STATE = "sensor_msgs/msg/JointState"
POSE = "geometry_msgs/msg/PoseStamped"
POSE_WITH_COVARIANCE = "geometry_msgs/msg/PoseWithCovarianceStamped"
TRANSFORM = "geometry_msgs/msg/TransformStamped"
ODOMETRY = "nav_msgs/msg/Odometry"
TREE = "tf2_msgs/msg/TFMessage"
OLD_TREE = "tf/msg/tfMessage"
PATH = "nav_msgs/msg/Path"
TWIST = "geometry_msgs/msg/Twist"
TWIST_STAMPED = "geometry_msgs/msg/TwistStamped"

WISHES = ("goal", "initialpose", "setpoint", "target", "command", "cmd")
"""Parts of the names of topics whose poses are wished, not measured."""

SHOWN_TOPICS = 8
"""Topics that a message lists."""


class Sought(NamedTuple):
    """What is sought among the topics.

    Attributes:
        name: as `--topics` says it.
        words: for messages.
        ranks: types of messages, the likeliest first; those of one rank are as likely.
    """

    name: str
    words: str
    ranks: tuple[tuple[str, ...], ...]


WHEELS = Sought("wheels", "wheel speeds", ((JOINT_STATE,),))
POSES = Sought(
    "poses",
    "poses",
    ((POSE, POSE_WITH_COVARIANCE, TRANSFORM), (ODOMETRY,), (TREE, OLD_TREE)),
)
PATHS = Sought("poses", "a path", (*POSES.ranks, (PATH,)))
COMMANDS = Sought("commands", "commands", ((TWIST, TWIST_STAMPED),))


def choose_topic(bag: Bag, sought: Sought, hints: Hints) -> Topic:
    """Return the topic that holds what is sought.

    Raises:
        ValueError: in one line with the topics there are, where the user names none of them, or
            none or several may hold it.
    """
    chosen = hints.topics.get(sought.name)
    types = [name for rank in sought.ranks for name in rank]
    if chosen:
        return require_topic(bag, sought.name, chosen, types)
    candidates = list_candidates(bag, sought)
    if len(candidates) == 1:
        return candidates[0]
    if candidates:
        raise ValueError(
            f"{bag.path}: {len(candidates)} topics may hold {sought.words}: "
            f"{list_topics(candidates)}; name one: --topics {sought.name}={candidates[0].name}"
        )
    raise ValueError(
        f"{bag.path}: no topic holds {sought.words} ({' or '.join(map(shorten_type, types))}), "
        f"among {list_topics(list(bag.topics.values()))}; record one, or name it: "
        f"--topics {sought.name}=NAME"
    )


def list_candidates(bag: Bag, sought: Sought) -> list[Topic]:
    """Return the topics of the likeliest type of messages that the bag has."""
    for rank in sought.ranks:
        candidates = [topic for topic in bag.find(*rank) if _is_recording(topic, sought)]
        if candidates:
            return candidates
    return []


def _is_recording(topic: Topic, sought: Sought) -> bool:
    """Say whether a topic tells what happened rather than what was wished for."""
    if sought is COMMANDS:
        return "cmd" in topic.name or "command" in topic.name
    is_wish = any(word in topic.name for word in WISHES)
    return topic.type == PATH or (topic.count >= FEWEST_SAMPLES and not is_wish)


def require_topic(bag: Bag, role: str, chosen: str, types: Sequence[str]) -> Topic:
    """Return the topic that the user names.

    Args:
        bag: to search.
        role: what it is to hold, as `--topics` says it.
        chosen: its name.
        types: of messages that can be read for it; empty for any.

    Raises:
        ValueError: in one line, where there is none or its messages are of another type.
    """
    name = chosen.split(":")[0]  # what follows are frames, or a field
    topic = bag.topics.get(name) or bag.topics.get(f"/{name}")
    if topic is None:
        raise ValueError(
            f"{bag.path}: --topics {role}={chosen}: there is no such topic with messages; name one "
            f"of {list_topics(list(bag.topics.values()))}"
        )
    if types and topic.type not in types:
        raise ValueError(
            f"{bag.path}: --topics {role}={chosen}: is of {shorten_type(topic.type)}; name one of "
            f"{' or '.join(map(shorten_type, types))}"
        )
    return topic


def list_topics(topics: Sequence[Topic]) -> str:
    """Return topics with their types, for a message."""
    shown = ", ".join(f"{each.name} ({shorten_type(each.type)})" for each in topics[:SHOWN_TOPICS])
    more = len(topics) - SHOWN_TOPICS
    return f"{shown} and {more} more" if more > 0 else shown


def shorten_type(name: str) -> str:
    """Return a type of messages as people call it, such as Odometry."""
    return name.rsplit("/", 1)[-1]
