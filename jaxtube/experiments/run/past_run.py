"""A run folder that an earlier command has written, read again."""

from __future__ import annotations

import shlex
from pathlib import Path
from typing import NamedTuple

from jaxtube.experiments.options import PROGRAM, Options
from jaxtube.experiments.run.json_file import read_table
from jaxtube.scenario.folders import MANIFEST
from jaxtube.scenario.refusal import refusal


class PastRun(NamedTuple):
    """A run: its folder, and the options that it had."""

    folder: Path
    options: Options


def read_run(name: str) -> PastRun:
    """Return the run of a folder.

    Raises:
        ScenarioError: one line, where the folder holds none.
    """
    from jaxtube.experiments.cli import parse

    folder = Path(name)
    try:
        line = read_table(folder / MANIFEST).get("command_line")
        words = shlex.split(line) if isinstance(line, str) else []
        options = parse(words[len(PROGRAM.split()) :]) if words else None
    except ValueError:
        options = None
    if options is None:
        cure = "name the folder of a run, such as runs/paper-paper"
        raise refusal("command line", "RUN", name, "holds no complete run", cure)
    return PastRun(folder, options)
