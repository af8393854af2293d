"""What every command takes: a scenario, the folder of its run, a seed, and overrides of single
keys."""

import shlex
import textwrap
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Annotated, ClassVar

from tyro.conf import Suppress, arg

from jaxtube.experiments.options.rules import FOLDER, SEED, Rule

PROGRAM = "python -m jaxtube.experiments"
MOST_SHOWN = 40
"""Characters of overrides in the title of a figure."""


@dataclass(frozen=True)
class Options:
    """What every command takes."""

    command: ClassVar[str]
    module: ClassVar[str]
    positional: ClassVar[tuple[str, ...]] = ()
    """Options that are given by their place, without their name."""

    scenario: Annotated[str, arg(metavar="NAME|FILE.toml|DIR")] = "paper"
    """a scenario that `list` prints, a file, or the folder of a saved result or a run"""
    out: Annotated[
        str, arg(metavar="DIR", help_behavior_hint="(default: runs/COMMAND-SCENARIO)"), FOLDER
    ] = ""
    """folder of the run"""
    seed: Annotated[int, arg(metavar="INT"), SEED] = 0
    """seed of every random draw"""
    # Not tuple[str, ...]: to check that default, the parser would load a library that takes a third
    # of the help's time.
    overrides: Suppress[tuple] = ()

    @property
    def folder(self) -> Path:
        """The folder of the run."""
        return Path(self.out or f"runs/{self.command}-{title(self.scenario)}")

    @property
    def scenario_overrides(self) -> tuple[str, ...]:
        """The overrides with which the scenario is read."""
        return self.overrides

    @property
    def label(self) -> str:
        """The scenario of the run in the titles of figures, overrides included."""
        overrides = textwrap.shorten(" ".join(self.overrides), MOST_SHOWN, placeholder=" ...")
        return f"{title(self.scenario)} with {overrides}" if overrides else title(self.scenario)

    @property
    def scenario_files(self) -> list[Path]:
        """The files that scenarios are read from, those that come with the project left out."""
        names = [self.scenario, getattr(self, "against", "")]
        return [Path(name) for name in names if Path(name).suffix == ".toml"]

    def find_broken_rule(self) -> str:
        """Say in one line which option has a value that breaks its rule; empty where none does."""
        for field in fields(self):
            value = getattr(self, field.name)
            for rule in getattr(field.type, "__metadata__", ()):
                if isinstance(rule, Rule) and not rule.is_kept(value):
                    return f"{flag(field.name)} = {value}: {rule.words}"
        return ""


def title(scenario: str) -> str:
    """Name a scenario in a folder's name: its own name, or that of its file, or of the folder of a
    scenario.toml; a design that was saved in the folder of a run has the name of that run."""
    path = Path(scenario)
    if path.suffix == ".toml" and path.stem != "scenario":
        return path.stem
    if path.suffix != ".toml" and path.name == scenario:
        return scenario
    folder = path.resolve().parent if path.suffix == ".toml" else path.resolve()
    return folder.parent.name if folder.name == "design" else folder.name


def flag(name: str) -> str:
    """Return an option as it is written on the command line."""
    return f"--{name.replace('_', '-')}"


def command_line(options: Options) -> str:
    """Return the command that has these options, for a shell; options at their default are left
    out."""
    words = [*PROGRAM.split(), options.command]
    for field in fields(options):
        value = getattr(options, field.name)
        if isinstance(value, tuple):
            words += value
        elif field.name in options.positional:
            words.append(str(value))
        elif value != field.default:
            words.append(flag(field.name))
            words += [] if value is True else [str(value)]
    return shlex.join(words)
