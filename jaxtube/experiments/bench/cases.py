"""What a topic measures: scenarios that come with the project, or the one that is asked for.

Source: new.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

from jaxtube.experiments.options import BenchOptions
from jaxtube.scenario.reading import load
from jaxtube.scenario.tree import Scenario


class Usual(NamedTuple):
    """What is measured where no scenario is asked for: its name, where its laps start, and keys of
    it that are set."""

    name: str
    starts: str
    overrides: tuple[str, ...] = ()

    @property
    def label(self) -> str:
        """The name, with the overrides."""
        return " ".join([self.name, *self.overrides])


LOOPS = (
    Usual("paper", "scenario"),
    Usual("robust", "feasible"),
    Usual("certified", "feasible"),
    Usual("tuned", "scenario"),
    Usual("certified", "edge"),
)
"""Closed loops from no active row to many."""
FAMILIES = (
    Usual("certified_30", "feasible"),
    Usual("robust", "edge", ("controller.terminal_facets=62",)),
    Usual("tuned", "scenario"),
)
"""Closed loops whose programs with active rows are solved: 52, 81 and 68 rows."""


class Case(NamedTuple):
    """A scenario and where its laps start: "scenario", "feasible" or "edge"."""

    name: str
    starts: str
    scenario: Scenario

    @property
    def words(self) -> str:
        """As in tables."""
        return self.name if self.starts == "scenario" else f"{self.name}, {self.starts} starts"


def choose_cases(scenario: Scenario, options: BenchOptions, usual: Sequence[Usual]) -> list[Case]:
    """Return the usual cases; those of the scenario that was asked for, where one was."""
    if not is_asked_for(options):
        return [Case(each.label, each.starts, load(each.name, each.overrides)) for each in usual]
    starts = sorted({each.starts for each in usual}, reverse=True)
    return [Case(options.label, each, scenario) for each in starts]


def name_scenarios(
    scenario: Scenario, options: BenchOptions, usual: Sequence[str]
) -> list[tuple[str, Scenario]]:
    """Return the usual scenarios with their names; the one that was asked for, where one was."""
    if not is_asked_for(options):
        return [(name, load(name, ())) for name in usual]
    return [(options.label, scenario)]


def is_asked_for(options: BenchOptions) -> bool:
    """Return whether the command names a scenario, or a key of one."""
    return options.scenario != BenchOptions.scenario or bool(options.overrides)
