"""`completion`: the script that lets a shell complete command lines of `jaxtube`."""

from jaxtube.experiments.completion.scripts import SCRIPTS
from jaxtube.experiments.options import CompletionOptions
from jaxtube.scenario.tree import Scenario


def run(scenario: Scenario | None, options: CompletionOptions) -> int:
    """Print the script of a shell; returns 0."""
    print(SCRIPTS[options.shell], end="")
    return 0
