"""Between the pose of a robot and its committed pose: noise on the way there, errors on the way
back.

With the motion M that is still to come and the reference's motion R over the same latency theta,
the error e of the pose at an instant, against where the reference was theta ago, and the error e~
of the committed pose, against where the reference is now, obey as motions of the plane

    e~ = M^-1 + e + R.

so that at the instant e = M + e~ + R^-1: the error of the pose is that of the committed pose turned
by the way still to turn, and how far the two motions differ, the reference's seen in the heading
error.

Noise n of the measured pose becomes, in e~, itself turned by the way that is still to turn, and
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

from sets.robot.actuation import FORGOTTEN, Actuation, Nominal, step_travel
from sets.robot.committed import bound_unknown
from sets.robot.late_ways import Driving, Ground

OUTWARDS = 1 + 1e-12
"""Factor that covers the rounding of sums of a few terms."""
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
    plane = np.array([longitudinal + turned * lateral, lateral + turned * longitudinal]) + swing
    return np.append(OUTWARDS * plane, heading)


def bound_late_pose_errors(
    committed: Float[np.ndarray, "3"],
    actuation: Actuation,
    dt: float,
    track_width: float,
    driving: Driving,
    ground: Ground,
    schedules: Float[np.ndarray, "boxes 2 2"],
) -> Float[np.ndarray, "3"]:
    """Bound the errors of the pose itself, at an instant and a latency after it.

    Args:
        committed: half widths of the errors of the committed pose at the instant (m, m, rad).
        actuation: lag and delay.
        dt: period, s.
        track_width: m.
        driving: what the wheels are asked for.
        ground: what it does.
        schedules: boxes of reference wheel speeds (right, left), m/s, lower ends first.

    Returns:
        Half widths (m, m, rad), each against where the reference was a latency before.
    """
    nominal = actuation.nominal(dt)
    now = bound_present_errors(committed, nominal, dt, track_width, driving, schedules)
    later = bound_later_errors(committed, actuation, dt, track_width, driving, ground)
    return np.maximum(now, later)


def bound_present_errors(
    committed: Float[np.ndarray, "3"],
    nominal: Nominal,
    dt: float,
    track_width: float,
    driving: Driving,
    schedules: Float[np.ndarray, "boxes 2 2"],
) -> Float[np.ndarray, "3"]:
    """Bound the errors of the pose itself at an instant; see `bound_late_pose_errors`."""
    slow, fast = np.moveaxis(schedules, 1, 0)
    speed = np.array([slow.mean(axis=1).min(), fast.mean(axis=1).max()])
    rates = [(slow[:, 0] - fast[:, 1]).min(), (fast[:, 0] - slow[:, 1]).max()]
    turning = np.array(rates) / track_width
    latency = nominal.latency
    turn = latency * np.abs(driving.yaw_rate).max()
    of_reference = latency * np.abs(turning).max()
    # Yaw rates are commanded as those of the reference less a deficit.
    deficit = np.abs(driving.yaw_rate - turning).max()
    apart = latency * deficit + np.ptp(turning) * _share_other_periods(nominal, dt)
    x, y, heading = committed
    tilted = heading + apart
    way = _products(latency * driving.speed, _cosines(turn))
    behind = _products(latency * speed, _cosines(of_reference))
    seen = _products(behind, _cosines(tilted))
    # Of the way to the committed pose, wheels that run out go straight on before they turn.
    across = nominal.delay * np.abs(driving.speed).max() * _sine(turn)
    aside = latency * np.abs(speed).max() * _sine(of_reference / 2)
    difference = max(way[1] - seen[0], seen[1] - way[0])
    lateral = _sine(tilted) * np.abs(behind).max() + aside + across
    return OUTWARDS * np.array(
        [
            x + _sine(turn) * y + difference + _sine(tilted) * aside,
            y + _sine(turn) * x + lateral,
            tilted,
        ]
    )


def _share_other_periods(nominal: Nominal, dt: float) -> float:
    """Return how much of the motion still to come, s, is of other periods than the reference's
    motion over the latency before: both last the latency in all."""
    count = int(np.ceil((FORGOTTEN * nominal.lag + nominal.delay) / dt)) + 2
    ages = dt * np.arange(count + 1)
    ahead = np.diff(ages - step_travel(ages - nominal.delay, nominal.lag))
    behind = np.diff(np.minimum(ages, nominal.latency))
    return float(np.abs(ahead - behind).sum() / 2)


def _sine(angle: float) -> float:
    """Return the greatest sine of angles up to one that is not negative."""
    return float(np.sin(min(angle, np.pi / 2)))


def _cosines(angle: float) -> Float[np.ndarray, "2"]:
    """Return the least and the greatest cosine of angles up to one."""
    return np.array([np.cos(min(angle, np.pi)), 1.0])


def _products(
    first: Float[np.ndarray, "2"], second: Float[np.ndarray, "2"]
) -> Float[np.ndarray, "2"]:
    """Return the least and the greatest product of two ranges."""
    products = np.outer(first, second)
    return np.array([products.min(), products.max()])


def bound_later_errors(
    committed: Float[np.ndarray, "3"],
    actuation: Actuation,
    dt: float,
    track_width: float,
    driving: Driving,
    ground: Ground,
) -> Float[np.ndarray, "3"]:
    """Bound the errors of the pose itself a latency after an instant; see
    `bound_late_pose_errors`."""
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
