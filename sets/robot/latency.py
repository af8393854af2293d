"""Between the pose of a robot and its committed pose: noise on the way there, errors on the way
back.

With the motion M that is still to come and the reference's motion R over the same latency theta,
the error e of the pose at an instant, against where the reference was theta ago, and the error e~
of the committed pose, against where the reference is now, obey as motions of the plane

    e~ = M^-1 + e + R.

So noise n of the measured pose becomes, in e~, itself turned by the way that is still to turn, and
the reference's way turned by the noise of the heading.

A latency later the robot is all but where it was committed to be. Its wheels have by then travelled
what they would have with a nominal lag and delay, but for the ground and what is not known of the
two; and nominal wheels would have travelled tau (mean of c over the last tau - s) more than M, both
averages of the same commands, that differ by 1 / e of their range at most. On the way they differ
by tau times that range at most, or by the turn tau w_s, which M has last.

`sets.robot.committed` says what a committed pose is. Source: new.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from sets.robot.actuation import Actuation
from sets.robot.committed import bound_unknown
from sets.robot.late_ways import Driving, Ground

LATE_SHARE = float(np.exp(-1.0))
"""Greatest difference between a mean over the last lag and one that forgets at its pace, by the
range of what is averaged."""


def bound_committed_noise(
    noise: Float[np.ndarray, "3"], latency: float, fastest: float, yaw_rate: float
) -> Float[np.ndarray, "3"]:
    """Bound what noise of the measured pose makes of the error of the committed pose.

    Args:
        noise: half widths in the robot's frame (m, m, rad).
        latency: s.
        fastest: greatest speed of the reference, m/s.
        yaw_rate: greatest one commanded, rad/s.
    """
    longitudinal, lateral, heading = noise
    turned = np.sin(min(latency * yaw_rate, np.pi / 2))
    swing = latency * fastest * heading
    return np.array(
        [longitudinal + turned * lateral + swing, lateral + turned * longitudinal + swing, heading]
    )


def bound_later_errors(
    committed: Float[np.ndarray, "3"],
    actuation: Actuation,
    dt: float,
    track_width: float,
    driving: Driving,
    ground: Ground,
) -> Float[np.ndarray, "3"]:
    """Bound the errors of the pose itself a latency after an instant.

    Args:
        committed: half widths of the errors of the committed pose at the instant (m, m, rad).
        actuation: lag and delay.
        dt: period, s.
        track_width: m.
        driving: what the wheels are asked for.
        ground: what it does.

    Returns:
        Half widths (m, m, rad), against where the reference is at the instant.
    """
    nominal = actuation.nominal(dt)
    latency = nominal.latency
    unknown = bound_unknown(actuation, dt, track_width, driving, ground).total
    worst = ground.wheel_errors if ground.stale_errors is None else ground.stale_errors
    slipped = latency * float(np.abs(worst).max(axis=0) @ np.abs(driving.wheels).max(axis=0))
    losses = slipped * np.array([0.5, 1 / track_width]) + np.ceil(latency / dt) * unknown
    spans = nominal.lag * np.array([np.ptp(driving.speed), np.ptp(driving.yaw_rate)])
    short, turned = LATE_SHARE * spans + losses
    # On the way to the committed pose the turn of wheels that run out comes last.
    widest = np.maximum(spans, [0.0, nominal.lag * np.abs(driving.yaw_rate).max()])
    strayed, swerved = widest + losses
    way = latency * float(np.abs(driving.speed).max()) + losses[0]
    turn = latency * float(np.abs(driving.yaw_rate).max()) + losses[1]
    slide = ground.sideslip * way + abs(ground.lever_arm) * turn
    across = strayed * turn + swerved * way + slide
    tilt = np.sin(min(turn + turned, np.pi / 2))
    x, y, heading = committed
    swing = np.sin(min(turned, np.pi / 2))
    return np.array(
        [
            x + swing * y + short + tilt * across,
            y + swing * x + across + tilt * short,
            heading + turned,
        ]
    )
