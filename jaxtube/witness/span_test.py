"""One test of a scenario: its slips, sideslip and noise against the spans of one length.

Source: `jaxtube.witness.motion` and `jaxtube.witness.verdict`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from jaxtube.identification.findings import Findings
from jaxtube.scenario.refusal import ScenarioError, refusal
from jaxtube.scenario.tree import Scenario
from jaxtube.witness.motion import (
    NOISES,
    Reach,
    find_allowance,
    find_reach,
    measure_disturbance,
)
from jaxtube.witness.shares import Share, count_share
from jaxtube.witness.spans import Kind, Spans, cut_spans
from jaxtube.witness.verdict import Verdict, judge

JUDGED: tuple[Kind, ...] = ("steady", "changing")


@dataclass(frozen=True, eq=False)
class SpanTest:
    """What spans of one length say.

    Attributes:
        every: all spans of the log.
        spans: those that are judged, changing and steady.
        measured: w of them, (m, m, rad).
        reach: whatever that may be.
        verdict: on them.
    """

    every: Spans
    spans: Spans
    measured: Float[np.ndarray, "k 3"]
    reach: Reach
    verdict: Verdict

    @property
    def noise_share(self) -> Float[np.ndarray, "3"]:
        """How much of what w may be is pose noise, by coordinate, median of the spans."""
        noise = np.abs(self.reach.generators[:, :, -NOISES:]).sum(axis=2)
        return np.median(noise / self.reach.half_widths, axis=0)

    def share(self, *kinds: Kind) -> Share:
        """Return the share of spans that are explained."""
        rows = self.spans.is_kind(*kinds)
        return count_share(self.verdict.explained[rows], self.spans.command[rows])

    def inside_alone(self, *kinds: Kind) -> Float[np.ndarray, "3"]:
        """Return the shares of spans in which a coordinate alone is one that it may be."""
        inside = self.verdict.excess[self.spans.is_kind(*kinds)] == 0.0
        return np.mean(inside, axis=0) if len(inside) else np.full(3, np.nan)

    def stretches(self) -> list[Bool[np.ndarray, "k"]]:
        """Return runs of spans that are not explained, one after another, the worst first."""
        rows = np.flatnonzero(~self.verdict.explained)
        breaks = np.flatnonzero(self.spans.start[rows[1:]] > self.spans.end[rows[:-1]] + 1e-9)
        runs = [run for run in np.split(rows, breaks + 1) if len(run)]
        return sorted(runs, key=lambda run: -float(self.verdict.usage[run].max()))


def try_spans(findings: Findings, scenario: Scenario, length: float) -> SpanTest:
    """Put a scenario to the test of spans of about `length` seconds.

    Raises:
        ScenarioError: in one line, for a log that never drives as the scenario allows.
    """
    every = cut_spans(findings, scenario, length)
    spans = every.take(every.is_kind(*JUDGED))
    if not len(spans.start):
        raise _refuse_idle(findings, scenario, every)
    allowed = find_allowance(scenario)
    measured = measure_disturbance(spans, allowed)
    reach = find_reach(spans, allowed)
    return SpanTest(every, spans, measured, reach, judge(spans, allowed, reach, measured))


def _refuse_idle(findings: Findings, scenario: Scenario, spans: Spans) -> ScenarioError:
    """Return the refusal of a log that never drives as the scenario allows."""
    robot = scenario.robot
    problem = (
        f"of {len(spans.start)} have both wheels between robot.wheel_speed_min_mps = "
        f"{robot.wheel_speed_min_mps:g} and robot.wheel_speed_max_mps = "
        f"{robot.wheel_speed_max_mps:g} and a pose that holds"
    )
    return refusal(findings.log.path, "spans", 0, problem, "give a log that drives so")
