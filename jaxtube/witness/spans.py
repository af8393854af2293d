"""Spans of a log: from one pose to another about a period later, with the wheels in between.

A span is what one period of a controller would be. It starts where the one before ended, so that
every pose ends one span and starts the next. What the poses and their clock are worth was found by
`jaxtube.identification.findings`; every span is of one kind:

    lost       the pose is not trusted, or the wheels are not known
    standing   no wheel turns
    beyond     a wheel turns slower or faster than the scenario allows
    changing   the wheels had not settled
    steady     they had: the only spans that the promise of an identification is about

Source: new.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, NamedTuple, get_args

import numpy as np
from jaxtyping import Bool, Float, Int

from jaxtube.identification.findings import Findings
from jaxtube.identification.samples import Poses, drop_held_poses, measure_travel
from jaxtube.identification.windows import MOVING_MPS
from jaxtube.scenario.refusal import refusal
from jaxtube.scenario.tree import Scenario

Kind = Literal["lost", "standing", "beyond", "changing", "steady"]
KINDS: tuple[Kind, ...] = get_args(Kind)

EARLY = 0.5
"""Of the time between two poses, by which a span may end before its length is over."""

WHEEL_GAP_S = 0.5
"""Between two samples of the wheels, in which nothing is known of them."""

SAME_S = 1e-6
"""Between two instants that are one."""

LONGEST = 1.5
"""Times its length, beyond which a span has a gap."""

STEP_S = 0.05
"""Of time at most, over which wheels are taken as constant: at a yaw acceleration of 4 rad/s^2 and
1 m/s that moves the end of a step by 0.04 mm."""


@dataclass(frozen=True, eq=False)
class Spans:
    """Spans of one log, in order of time.

    Attributes:
        length: that was asked for, s.
        start: first pose, s on the clock of the poses.
        end: last pose, s on the same.
        first: pose at the start (x m, y m, heading rad unwrapped), as measured.
        last: pose at the end, as measured.
        ways: of the wheels (right, left) in equal steps of time over the span, m.
        pieces: equal parts over each of which a slip is constant; a whole number of steps each.
        kind: as its place in KINDS.
        command: number of the command at the start.
    """

    length: float
    start: Float[np.ndarray, "k"]
    end: Float[np.ndarray, "k"]
    first: Float[np.ndarray, "k 3"]
    last: Float[np.ndarray, "k 3"]
    ways: Float[np.ndarray, "k steps 2"]
    pieces: int
    kind: Int[np.ndarray, "k"]
    command: Int[np.ndarray, "k"]

    @property
    def duration(self) -> Float[np.ndarray, "k"]:
        """Time from the first pose to the last, s."""
        return self.end - self.start

    def is_kind(self, *kinds: Kind) -> Bool[np.ndarray, "k"]:
        """Tell which spans are of some kinds."""
        return np.isin(self.kind, [KINDS.index(kind) for kind in kinds])

    def take(self, rows: Bool[np.ndarray, "k"]) -> Spans:
        """Return some of the spans."""
        return Spans(
            self.length,
            self.start[rows],
            self.end[rows],
            self.first[rows],
            self.last[rows],
            self.ways[rows],
            self.pieces,
            self.kind[rows],
            self.command[rows],
        )


class _Ends(NamedTuple):
    """Poses between which spans lie."""

    first: Int[np.ndarray, "k"]
    last: Int[np.ndarray, "k"]


def cut_spans(findings: Findings, scenario: Scenario, length: float) -> Spans:
    """Cut a log into spans of about `length` seconds, or one pose where these come later.

    Slips are constant over a controller's period, so over as many equal pieces as a span has
    periods; at least over one.

    Raises:
        ScenarioError: in one line, where no two poses follow each other closely enough.
    """
    log = findings.log
    poses = drop_held_poses(log)
    ends = _chain(poses, length)
    if not len(ends.first):
        problem = f"is the time between poses, of which none are about {length:.3g} s apart"
        cure = "give a log with a pose at least every second"
        raise refusal(log.path, "poses", round(poses.period, 3), problem, cure)
    start = poses.time[ends.first]
    end = poses.time[ends.last]
    typical = float(np.median(end - start))
    pieces = max(1, round(typical / scenario.controller.dt_s))
    steps = pieces * int(np.ceil(typical / pieces / STEP_S - 1e-6))
    shares = np.linspace(0.0, 1.0, steps + 1)
    times = start[:, None] + shares * (end - start)[:, None] - findings.clock.offset
    travel = measure_travel(log)
    ways = travel.between(times[:, :-1].ravel(), times[:, 1:].ravel()).reshape(-1, steps, 2)
    return Spans(
        length=length,
        start=start,
        end=end,
        first=poses.pose[ends.first],
        last=poses.pose[ends.last],
        ways=ways,
        pieces=pieces,
        kind=_find_kinds(findings, scenario, start, end, ways),
        command=_find_commands(findings, start),
    )


def _chain(poses: Poses, length: float) -> _Ends:
    """Return poses that follow each other after about `length` seconds."""
    spans = []
    row = 0
    early = EARLY * min(poses.period, length)
    while row < len(poses.time) - 1:
        end = poses.time[row] + length - early
        later = max(int(np.searchsorted(poses.time, end)), row + 1)
        if later == len(poses.time):
            break
        if poses.time[later] - poses.time[row] <= LONGEST * max(length, poses.period):
            spans.append((row, later))
        row = later
    first, last = np.array(spans, dtype=int).reshape(-1, 2).T
    return _Ends(first, last)


def _find_kinds(
    findings: Findings,
    scenario: Scenario,
    start: Float[np.ndarray, "k"],
    end: Float[np.ndarray, "k"],
    ways: Float[np.ndarray, "k steps 2"],
) -> Int[np.ndarray, "k"]:
    """Return the kinds of spans; the first in the order of KINDS that holds."""
    speeds = ways * ways.shape[1] / (end - start)[:, None, None]
    robot = scenario.robot
    is_slow = np.min(speeds, axis=(1, 2)) < robot.wheel_speed_min_mps
    is_fast = np.max(speeds, axis=(1, 2)) > robot.wheel_speed_max_mps
    holds = {
        "lost": findings.cuts.touch(start, end) | _lacks_wheels(findings, start, end),
        "standing": np.max(np.abs(speeds), axis=(1, 2)) < MOVING_MPS,
        "beyond": is_slow | is_fast,
        "changing": ~_is_steady(findings, start, end),
    }
    return np.select(list(holds.values()), [KINDS.index(kind) for kind in holds], len(holds))


def _lacks_wheels(
    findings: Findings, start: Float[np.ndarray, "k"], end: Float[np.ndarray, "k"]
) -> Bool[np.ndarray, "k"]:
    """Tell which spans touch a gap of the wheels, or lie outside of them."""
    time = findings.log.time + findings.clock.offset
    lacks = (start < time[0]) | (end > time[-1])
    for gap in np.flatnonzero(np.diff(time) > WHEEL_GAP_S):
        lacks |= (end > time[gap]) & (start < time[gap + 1])
    return lacks


def _is_steady(
    findings: Findings, start: Float[np.ndarray, "k"], end: Float[np.ndarray, "k"]
) -> Bool[np.ndarray, "k"]:
    """Tell which spans lie within a run of steady windows of one command."""
    windows = findings.windows
    used = windows.windows.steady & ~windows.windows.lost
    begins = windows.start[used] + findings.clock.offset
    command = windows.windows.command[used]
    is_new = np.diff(begins, prepend=-np.inf) > windows.length + findings.pose_period
    is_new |= np.diff(command, prepend=-1) != 0
    run = np.cumsum(is_new) - 1
    of_run = np.flatnonzero(is_new)
    steady = np.zeros(len(start), dtype=bool)
    for number, first in enumerate(of_run):
        until = begins[run == number][-1] + windows.length
        steady |= (start >= begins[first] - SAME_S) & (end <= until + SAME_S)
    return steady


def _find_commands(findings: Findings, start: Float[np.ndarray, "k"]) -> Int[np.ndarray, "k"]:
    """Return the number of the command that each span begins under: that of the window that began
    last."""
    windows = findings.windows
    if not len(windows.start):
        return np.zeros(len(start), dtype=int)
    begun = np.searchsorted(windows.start + findings.clock.offset, start, side="right") - 1
    return windows.windows.command[np.maximum(begun, 0)]
