"""Reading of recordings: logs and paths, of tables and of bags.

Source: new.
"""

from __future__ import annotations

from pathlib import Path

from jaxtube.recordings.assemble import assemble_log
from jaxtube.recordings.hints import NO_HINTS, Hints
from jaxtube.recordings.log import Log
from jaxtube.recordings.log_table import read_sources
from jaxtube.recordings.path import RawPath
from jaxtube.recordings.path_table import read_path_table


def read_log(path: str | Path, hints: Hints = NO_HINTS) -> Log:
    """Read a robot's log.

    Args:
        path: of a table (CSV and the like).
        hints: what the user says about it.

    Raises:
        ValueError: in one line with the file and the cure, for what cannot be read or understood.
    """
    return assemble_log(str(path), read_sources(str(path), hints), hints)


def read_path(path: str | Path, hints: Hints = NO_HINTS) -> RawPath:
    """Read a path, its rows as they are.

    Args:
        path: of a table (CSV, TUM poses and the like).
        hints: what the user says about it.

    Raises:
        ValueError: in one line with the file and the cure, for what cannot be read or understood.
    """
    return read_path_table(str(path), hints)
