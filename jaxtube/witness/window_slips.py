"""Slips of the windows of a log, beside the intervals of a scenario: what an identification
promises, kept or not.

A promise is about new commands, and about the mean slips of windows of some seconds. A command is
inside where all of its windows are that settled and drive both wheels forwards; commands count
once, so that their number inside is binomial where they are independent.

Source: new; slips by effective track as in `jaxtube.identification.geometry`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from jaxtube.identification.box import Box
from jaxtube.identification.findings import Findings
from jaxtube.identification.geometry import find_sideslip, find_slips
from jaxtube.identification.identify import SLOWEST_SHARE
from jaxtube.identification.windows import find_fastest
from jaxtube.plant.slip_bounds import slip_bounds
from jaxtube.scenario.tree import Scenario
from jaxtube.witness.shares import Share, count_share


@dataclass(frozen=True, eq=False)
class WindowSlips:
    """Slips of windows that drive both wheels forwards, under the track of a scenario.

    Attributes:
        length: of a window, s.
        start: s on the clock of the wheels.
        command: number of the command.
        wheels: mean speeds (right, left), m/s.
        slips: (right, left).
        sideslips: signed, left positive.
        steady: the wheels had settled; the others say nothing of a promise.
        inside: what the scenario allows.
        box: that it allows.
        least_wheel: speed that both wheels reach, m/s.
    """

    length: float
    start: Float[np.ndarray, "k"]
    command: Int[np.ndarray, "k"]
    wheels: Float[np.ndarray, "k 2"]
    slips: Float[np.ndarray, "k 2"]
    sideslips: Float[np.ndarray, "k"]
    steady: Bool[np.ndarray, "k"]
    inside: Bool[np.ndarray, "k"]
    box: Box
    least_wheel: float

    @property
    def share(self) -> Share:
        """Steady windows inside, and the commands that have all of theirs inside."""
        steady = self.steady
        return count_share(self.inside[steady], self.command[steady])

    def recorded(self) -> tuple[Float[np.ndarray, "n"], Float[np.ndarray, "n 3"]]:
        """Return times and (right slip, left slip, sideslip) of windows that can be replayed."""
        values = np.column_stack([self.slips, self.sideslips])
        usable = np.all(np.abs(values) < 1.0, axis=1)
        return self.start[usable], values[usable]


def find_window_slips(findings: Findings, scenario: Scenario) -> WindowSlips:
    """Return the slips of the windows that the scenario's wheel limits allow, forwards."""
    windows = findings.windows.windows
    robot = scenario.robot
    least = robot.wheel_speed_min_mps
    if least <= 0.0:
        least = SLOWEST_SHARE * find_fastest(windows.wheels[windows.steady & ~windows.lost])
    slowest = windows.wheels.min(axis=1)
    fastest = windows.wheels.max(axis=1)
    used = ~windows.lost & (slowest >= least) & (fastest <= robot.wheel_speed_max_mps) & (least > 0)
    wheels = windows.wheels[used]
    velocity = windows.velocity[used]
    slips = find_slips(wheels, velocity, robot.turning_track_m)
    sideslips = find_sideslip(velocity, robot.lever_arm_m)
    box = allowed_box(scenario)
    return WindowSlips(
        length=findings.windows.length,
        start=findings.windows.start[used],
        command=windows.command[used],
        wheels=wheels,
        slips=slips,
        sideslips=sideslips,
        steady=windows.steady[used],
        inside=box.holds(slips, sideslips),
        box=box,
        least_wheel=least,
    )


def allowed_box(scenario: Scenario) -> Box:
    """Return the slips that a scenario allows."""
    bounds = slip_bounds(scenario.slip)
    low = np.asarray(bounds.middle - bounds.half_width).tolist()
    high = np.asarray(bounds.middle + bounds.half_width).tolist()
    return Box((low[0], high[0]), (low[1], high[1]), scenario.slip.sideslip)
