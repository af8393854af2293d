"""The directive `commands`: every command with the text of its `--help`."""

import contextlib
import io
import os
from unittest.mock import patch

from docutils import nodes
from sphinx.application import Sphinx
from sphinx.util.docutils import SphinxDirective

from jaxtube.experiments.cli import parse
from jaxtube.experiments.options import COMMANDS

COLUMNS = 88
"""Width that the help is laid out for."""


def read_help(command: str) -> str:
    """Return what a command prints for `--help`."""
    printed = io.StringIO()
    wide = patch.dict(os.environ, COLUMNS=str(COLUMNS))
    with wide, contextlib.redirect_stdout(printed):
        parse([command, "--help"])
    return printed.getvalue().strip()


def write_reference() -> str:
    """Return the reference of all commands in MyST, a heading each."""
    parts = [f"## `{command}`\n\n```text\n{read_help(command)}\n```\n" for command in COMMANDS]
    return "\n".join(parts)


class Commands(SphinxDirective):
    """Puts the reference of all commands in its place."""

    def run(self) -> list[nodes.Node]:
        """Return the parsed reference."""
        return self.parse_text_to_nodes(write_reference(), allow_section_headings=True)


def setup(app: Sphinx) -> dict[str, bool]:
    """Add the directive."""
    app.add_directive("commands", Commands)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
