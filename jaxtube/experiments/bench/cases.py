"""What a topic measures: scenarios that come with the project, or the one that is asked for.

Source: new.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

from jaxtube.experiments.options import BenchOptions
from jaxtube.scenario.reading import load
from jaxtube.scenario.tree import Scenario

LOOPS = (
    ("paper", "scenario"),
    ("robust", "feasible"),
    ("certified", "feasible"),
    ("tuned", "scenario"),
    ("certified", "edge"),
)
"""Closed loops from no active row to many: scenario, and where its laps start."""
FAMILIES = (("certified_30", "feasible"), ("robust", "edge"), ("tuned", "scenario"))
"""Closed loops whose programs with active rows are solved."""


class Case(NamedTuple):
    """A scenario and where its laps start: "scenario", "feasible" or "edge"."""

    name: str
    starts: str
    scenario: Scenario

    @property
    def words(self) -> str:
        """As in tables."""
        return self.name if self.starts == "scenario" else f"{self.name}, {self.starts} starts"


def choose_cases(
    scenario: Scenario, options: BenchOptions, usual: Sequence[tuple[str, str]]
) -> list[Case]:
    """Return the usual cases; those of the scenario that was asked for, where one was."""
    if not is_asked_for(options):
        return [Case(name, starts, load(name, ())) for name, starts in usual]
    starts = sorted({starts for _, starts in usual}, reverse=True)
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
