"""`list`: the scenarios that come with the project, each with the first comment of its file."""

from jaxtube.experiments.options import Options
from jaxtube.scenario.reading import find, load, names
from jaxtube.scenario.tree import Scenario


def run(scenario: Scenario | None, options: Options) -> int:
    """Print one line a scenario, after reading it; returns 0.

    Raises:
        ScenarioError: when one of them cannot be used.
    """
    listed = [options.scenario] if scenario else names()
    width = max(map(len, listed), default=0)
    for name in listed:
        load(name, options.overrides)
        print(f"{name:{width}}  {summary(name)}")
    return 0


def summary(name_or_path: str) -> str:
    """Read the first comment line of a scenario's file; empty when there is none."""
    lines = find(name_or_path).read_text(encoding="utf-8").splitlines()
    return next((line.lstrip("# ") for line in lines if line.startswith("#")), "")
