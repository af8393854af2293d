"""Bags of ROS 1 and ROS 2, and MCAP files: topics and their messages.

The library `rosbags` reads them without ROS. It is imported only when a bag is read.

Source: wiki.ros.org/Bags/Format/2.0; REP 149 and rosbag2 for folders; mcap.dev/spec.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

from jaxtube.recordings.table import shorten

MAGIC = (b"#ROSBAG V", b"\x89MCAP0\r\n", b"SQLite format 3\x00")
"""First bytes of bags."""

SUFFIXES = (".bag", ".mcap", ".db3")

CURE = "mend it with `rosbag reindex` or `ros2 bag reindex`, or record it again"

LONGEST_REASON = 120
"""Characters of the library's own words that a message shows."""


class Topic(NamedTuple):
    """A topic of a bag.

    Attributes:
        name: such as "/odom".
        type: of its messages, such as "nav_msgs/msg/Odometry".
        count: of its messages.
    """

    name: str
    type: str
    count: int


class Message(NamedTuple):
    """A message of a bag.

    Attributes:
        stamp: when it was sent, by its header, ns; when it was recorded where it has none.
        content: with the fields of its type.
    """

    stamp: int
    content: Any


@dataclass(frozen=True, eq=False)
class Bag:
    """An open bag.

    Attributes:
        path: the file or folder, for messages.
        reader: of the library, open.
        topics: that have messages, by name.
    """

    path: str
    reader: Any
    topics: dict[str, Topic]

    def find(self, *types: str) -> list[Topic]:
        """Return the topics of some types of messages, by name."""
        return [topic for topic in self.topics.values() if topic.type in types]

    def read(self, topic: Topic) -> Iterator[Message]:
        """Yield the messages of a topic in the order of the bag.

        Raises:
            ValueError: in one line, for messages that cannot be read.
        """
        connections = [each for each in self.reader.connections if each.topic == topic.name]
        messages = self.reader.messages(connections=connections)
        while True:
            try:
                connection, recorded, data = next(messages)
                content = self.reader.deserialize(data, connection.msgtype)
            except StopIteration:
                return
            except Exception as error:  # whatever a broken file does to a parser
                raise ValueError(
                    f"{self.path}: messages of {topic.name} cannot be read "
                    f"({_describe_error(error)}); {CURE}"
                ) from None
            yield Message(_find_stamp(content) or recorded, content)


def is_bag(path: str | Path) -> bool:
    """Say whether a path names a bag, by its first bytes or its name."""
    place = Path(path)
    if os.path.isdir(place) or place.suffix in SUFFIXES:
        return True
    try:
        with place.open("rb") as file:
            return file.read(16).startswith(MAGIC)
    except OSError:
        return False


@contextmanager
def open_bag(path: str) -> Iterator[Bag]:
    """Open a bag for as long as a context lasts.

    Raises:
        ValueError: in one line, where the library is not installed or cannot read the bag.
    """
    reader = _open_reader(path)
    try:
        topics = [_describe_topic(name, about) for name, about in sorted(reader.topics.items())]
        yield Bag(path, reader, {topic.name: topic for topic in topics if topic.count})
    finally:
        reader.close()


def _open_reader(path: str) -> Any:
    """Return the library's reader of a bag, open."""
    try:
        from rosbags.highlevel import AnyReader
        from rosbags.typesys import Stores, get_typestore
    except ImportError:
        raise ValueError(
            f"{path}: to read bags the library rosbags is needed; pip install 'jaxtube[rosbag]'"
        ) from None
    if not os.path.exists(path):
        raise ValueError(f"{path}: there is no such file; name a bag")
    try:
        # Bags of ROS 2 before Iron do not describe their messages; those used here never changed.
        types = get_typestore(Stores.ROS2_HUMBLE)
        reader = AnyReader([Path(path)], default_typestore=types)
        reader.open()
    except Exception as error:  # whatever a broken file does to a parser
        raise ValueError(
            f"{path}: cannot be read as a bag ({_describe_error(error)}); {CURE}"
        ) from None
    return reader


def _describe_topic(name: str, about: Any) -> Topic:
    """Return a topic as the library describes it, without type where it has several."""
    return Topic(name, about.msgtype or "several types", about.msgcount)


def _describe_error(error: Exception) -> str:
    """Return what an error says, in a few words of one line."""
    text = " ".join(str(error).split()) or type(error).__name__
    return shorten(text, LONGEST_REASON)


def _find_stamp(content: Any) -> int:
    """Return the time in ns that a message gives itself, 0 where it gives none."""
    header = getattr(content, "header", None)
    return find_stamp(header) if header is not None else 0


def find_stamp(header: Any) -> int:
    """Return the time of a header, ns; 0 where nobody set it."""
    return int(header.stamp.sec) * 10**9 + int(header.stamp.nanosec)
