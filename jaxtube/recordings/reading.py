"""Reading of recordings: logs and paths, of tables and of bags.

Source: new.
"""

from __future__ import annotations

from pathlib import Path

from jaxtube.recordings.assemble import assemble_log
from jaxtube.recordings.bag import is_bag
from jaxtube.recordings.hints import NO_HINTS, Hints
from jaxtube.recordings.log import Log
from jaxtube.recordings.log_bag import read_bag_sources, read_path_bag
from jaxtube.recordings.log_table import read_sources
from jaxtube.recordings.path import RawPath
from jaxtube.recordings.path_table import read_path_table


def read_log(path: str | Path, hints: Hints = NO_HINTS) -> Log:
    """Read a robot's log.

    Args:
        path: of a table (CSV and the like), a bag of ROS 1 or ROS 2, or an MCAP file.
        hints: what the user says about it.

    Raises:
        ValueError: in one line with the file and the cure, for what cannot be read or understood.
    """
    name = str(path)
    sources = read_bag_sources(name, hints) if is_bag(path) else read_sources(name, hints)
    return assemble_log(name, sources, hints)


def read_path(path: str | Path, hints: Hints = NO_HINTS) -> RawPath:
    """Read a path, its rows as they are.

    Args:
        path: of a table (CSV, TUM poses and the like), a bag of ROS 1 or ROS 2, or an MCAP file.
        hints: what the user says about it.

    Raises:
        ValueError: in one line with the file and the cure, for what cannot be read or understood.
    """
    read = read_path_bag if is_bag(path) else read_path_table
    return read(str(path), hints)
