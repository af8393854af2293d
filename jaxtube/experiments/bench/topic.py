"""What the topics of `bench` have in common.

Source: new.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

from jaxtube.experiments.bench.rounds import Spread
from jaxtube.experiments.options import BenchOptions
from jaxtube.experiments.run.folder import RunFolder
from jaxtube.scenario.tree import Scenario


class Told(NamedTuple):
    """What a topic found: its metrics, and its lines of the table of all topics, each a sentence
    and a number."""

    metrics: dict[str, Any]
    headlines: list[tuple[str, str]]


class Topic(NamedTuple):
    """A topic: what it does meanwhile, said before it begins, and how it is run."""

    waits: str
    run: Callable[[Scenario, BenchOptions, RunFolder], Told]


def describe(found: Spread) -> dict[str, float]:
    """Return a median and its quartiles for metrics.json."""
    return {"median": found.median, "lower_quartile": found.low, "upper_quartile": found.high}
