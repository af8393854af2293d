"""What a log says of its sensors and its actuators, before any slip: clocks, rates, noise, cuts.

Source: new.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from jaxtube.identification.clocks import Clock, align
from jaxtube.identification.cuts import Cuts, find_cuts
from jaxtube.identification.response import Response, find_response
from jaxtube.identification.samples import drop_held_poses, measure_travel
from jaxtube.identification.windows import LogWindows, cut_windows
from jaxtube.recordings.log import Log

NOISE_PERCENTILE = 99.5
"""Of what poses miss of parabolas through seven neighbours, in size: the bound of the noise."""

DEVIATION_PERCENTILE = 68.27
"""The same for the standard deviation, as of a normal law."""


SETTLING_LAGS = 4.0
"""After which wheels have all but 2 % of a new command."""
SETTLING_S = 0.3
"""The time counted with for wheels whose lag is not known."""
LONGEST_SETTLING_S = 1.0


@dataclass(frozen=True)
class Noise:
    """What poses miss of parabolas through seven neighbours.

    Attributes:
        poses: looked at.
        deviation: spread (m in x and in y, rad), robust.
        bound: that all but one of 200 poses keep (m, rad).
    """

    poses: int
    deviation: tuple[float, float]
    bound: tuple[float, float]


@dataclass(frozen=True, eq=False)
class Findings:
    """What was found in a log, slips apart.

    Attributes:
        log: the log.
        wheel_period: median time between two samples of the wheels, s.
        pose_period: between two poses that differ, s.
        held_share: share of poses that repeated the one before.
        clock: of wheels and poses.
        cuts: where the pose is not trusted.
        response: of the wheels to commands, None without commands.
        standing: noise of the standing robot, None where it never stood still.
        moving: noise while it drives steadily, None where it never does.
        windows: of the log.
    """

    log: Log
    wheel_period: float
    pose_period: float
    held_share: float
    clock: Clock
    cuts: Cuts
    response: Response | None
    standing: Noise | None
    moving: Noise | None
    windows: LogWindows

    @property
    def noise(self) -> Noise | None:
        """The noise to count with: that of the driving robot, where known."""
        return self.moving or self.standing


def inspect_log(log: Log, length: float) -> Findings:
    """Look at a log in windows of `length` seconds.

    Raises:
        ScenarioError: in one line, where wheels and poses do not belong together.
    """
    poses = drop_held_poses(log)
    travel = measure_travel(log)
    clock = align(log.path, travel, poses)
    cuts = find_cuts(travel, poses, clock)
    row = float(np.median(np.diff(log.time)))
    response = find_response(log)
    settle = _find_settling(response, row)
    windows = cut_windows(log, travel, poses, clock, cuts, length, settle)
    return Findings(
        log,
        row,
        poses.period,
        poses.held_share,
        clock,
        cuts,
        response,
        _measure_noise(windows.standing),
        _measure_noise(windows.missed),
        windows,
    )


def _find_settling(response: Response | None, row: float) -> float:
    """Return how long after a new command wheels follow it, s."""
    if response is None:
        return SETTLING_S
    late = max(response.delay, 0.0) + 2 * row
    return min(late + SETTLING_LAGS * response.lag, LONGEST_SETTLING_S)


def _measure_noise(missed: Float[np.ndarray, "poses 3"]) -> Noise | None:
    """Return the noise that poses show; None for hardly any."""
    if len(missed) < 20:
        return None
    size = np.abs(missed)
    place = size[:, :2].ravel()
    turn = size[:, 2]
    deviation = _percentiles(place, turn, DEVIATION_PERCENTILE)
    return Noise(len(missed), deviation, _percentiles(place, turn, NOISE_PERCENTILE))


def _percentiles(
    place: Float[np.ndarray, "2k"], turn: Float[np.ndarray, "k"], percent: float
) -> tuple[float, float]:
    return float(np.percentile(place, percent)), float(np.percentile(turn, percent))
