"""Reading of recordings: logs, windows of logs, and paths.

Source: new.
"""

from __future__ import annotations

from pathlib import Path

from jaxtube.recordings.assemble import assemble_log
from jaxtube.recordings.hints import NO_HINTS, Hints
from jaxtube.recordings.log import Log
from jaxtube.recordings.log_table import read_sources


def read_log(path: str | Path, hints: Hints = NO_HINTS) -> Log:
    """Read a robot's log.

    Args:
        path: of a table (CSV and the like).
        hints: what the user says about it.

    Raises:
        ValueError: in one line with the file and the cure, for what cannot be read or understood.
    """
    return assemble_log(str(path), read_sources(str(path), hints), hints)
