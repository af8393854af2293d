"""What the topics of `bench` have in common.

Source: new.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

from jaxtube.experiments.bench.rounds import Spread
from jaxtube.experiments.options import BenchOptions
from jaxtube.experiments.run.folder import RunFolder
from jaxtube.experiments.run.verdict import fit_line
from jaxtube.scenario.tree import Scenario


class Headline(NamedTuple):
    """A line of the table of all topics.

    Attributes:
        what: the topic, and on what it was measured.
        ours, peer: what was measured of this project and of what stands beside it, with units.
        ratio: of the two; what it is of is told by the topic's own table.
        residual: largest of ours, of the optimality conditions; empty where no program is solved.
    """

    what: str
    ours: str
    peer: str
    ratio: str
    residual: str = ""


class Told(NamedTuple):
    """What a topic found: its metrics, and its lines of the table of all topics."""

    metrics: dict[str, Any]
    headlines: list[Headline]


class Topic(NamedTuple):
    """A topic: what it does meanwhile, said before it begins, and how it is run."""

    waits: str
    run: Callable[[Scenario, BenchOptions, RunFolder], Told]


def say_verdict(headlines: Sequence[Headline]) -> str:
    """Return the first of some headlines in one line: what was measured, and what stands beside
    it."""
    if not headlines:
        return "nothing was measured that stands beside anything"
    first = headlines[0]
    parts = [f"{first.what}: {first.ours}", first.peer, first.ratio and f"ratio {first.ratio}"]
    return fit_line("; ".join(filter(None, parts)))


def describe(found: Spread) -> dict[str, float]:
    """Return a median and its quartiles for metrics.json."""
    return {"median": found.median, "lower_quartile": found.low, "upper_quartile": found.high}
