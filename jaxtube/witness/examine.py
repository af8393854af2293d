"""A log as the witness of a scenario.

    1. clocks, cuts, commands and windows, as an identification finds them; nothing else is fitted
    2. what slip, sideslip and noise may make of every period (spans, motion, verdict), and of
       longer spans, in which noise hides less
    3. w of every period beside W and the part of it that a log can witness (model_sets)
    4. slips of windows beside the intervals, which is what was promised (window_slips)

Source: new.
"""

from __future__ import annotations

from dataclasses import dataclass

from jaxtube.identification.findings import Findings
from jaxtube.scenario.refusal import refusal
from jaxtube.scenario.tree import Scenario
from jaxtube.witness.model_sets import ModelSets, find_model_sets
from jaxtube.witness.motion import find_allowance
from jaxtube.witness.span_test import SpanTest, try_spans
from jaxtube.witness.window_slips import WindowSlips, find_window_slips

LONGER = 1.5
"""Times a period, at least, of spans that are longer."""

PERIODS = 40
"""Of the controller in a longer span at most: beyond, nearly anything is explained."""


@dataclass(frozen=True, eq=False)
class Witness:
    """What a log says of a scenario.

    Attributes:
        scenario: that is put to the test.
        findings: of the log.
        period: the test of every period.
        longer: that of longer spans; None without.
        sets: W, or in words why there is nothing to compare.
        windows: slips of windows.
    """

    scenario: Scenario
    findings: Findings
    period: SpanTest
    longer: SpanTest | None
    sets: ModelSets | str
    windows: WindowSlips


def examine(findings: Findings, scenario: Scenario, longer: float) -> Witness:
    """Put a scenario to the test of a log.

    Args:
        findings: of the log.
        scenario: its robot, slip, noise and period. Where poses come later than a period, spans are
            from one pose to the next.
        longer: length of the longer spans, s; left out where hardly longer than a period.

    Raises:
        ScenarioError: in one line, for a scenario without noise, a length out of range, and a log
            that never drives as the scenario allows.
    """
    dt = scenario.controller.dt_s
    if not find_allowance(scenario).noise.any():
        problem = "is 0 as all of [noise] is, but poses of a log have noise"
        raise refusal("scenario", "noise.longitudinal_m", 0.0, problem, "give the bounds of theirs")
    if longer > PERIODS * dt:
        problem = f"is more than {PERIODS} periods of controller.dt_s = {dt:g}"
        raise refusal(
            "command line", "--longer-s", longer, problem, f"give at most {PERIODS * dt:g}"
        )
    period = try_spans(findings, scenario, dt)
    is_longer = longer >= LONGER * max(dt, findings.pose_period)
    return Witness(
        scenario=scenario,
        findings=findings,
        period=period,
        longer=try_spans(findings, scenario, longer) if is_longer else None,
        sets=find_model_sets(scenario, period.spans),
        windows=find_window_slips(findings, scenario),
    )
