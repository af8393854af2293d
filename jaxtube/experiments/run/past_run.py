"""A run folder that an earlier command has written, read again."""

from __future__ import annotations

import json
import shlex
from pathlib import Path
from typing import NamedTuple

from jaxtube.experiments.options import PROGRAM, Options
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
        manifest = json.loads((folder / "manifest.json").read_bytes())
        words = shlex.split(manifest["command_line"])
        options = parse(words[len(PROGRAM.split()) :])
    except (OSError, ValueError, LookupError, TypeError):
        options = None
    if options is None:
        cure = "name the folder of a run, such as runs/paper-paper"
        raise refusal("command line", "RUN", name, "holds no complete run", cure)
    return PastRun(folder, options)
