"""`list`: the scenarios that come with the project, each with the first sentence of its file."""

import re
import textwrap

from jaxtube.experiments.options import Options
from jaxtube.scenario.reading import find, load, names
from jaxtube.scenario.tree import Scenario

WIDTH = 100
"""Columns of a line."""


def run(scenario: Scenario | None, options: Options) -> int:
    """Print the name and the summary of each scenario, after reading it; returns 0.

    Raises:
        ScenarioError: when one of them cannot be used.
    """
    listed = [options.scenario] if scenario else names()
    width = max(map(len, listed), default=0)
    for name in listed:
        load(name, options.overrides)
        text = f"{name:{width}}  {summary(name)}"
        print(textwrap.fill(text, WIDTH, subsequent_indent=" " * (width + 2)))
    return 0


def summary(name_or_path: str) -> str:
    """Read the first sentence of the first comment in a scenario's file; empty if there is none."""
    text = find(name_or_path).read_text(encoding="utf-8-sig")
    comment = re.search(r"^#.*(\n#.*)*", text, re.MULTILINE)
    if not comment:
        return ""
    words = " ".join(line.lstrip("# ") for line in comment[0].splitlines())
    return re.split(r"(?<=\.) ", words, maxsplit=1)[0]
