"""What lag and delay add to the disturbance of a robot that steers its committed pose.

The committed pose q_k is where the commands given before the instant k T take the robot: from its
pose p_k the wheels first run out, by tau s_k with the lag tau and their speeds s_k, as if the body
drove straight ahead and then turned on the spot; then the commands of the last delay D are driven,
along arcs; all by nominal values,

    q_k = p_k + M_k,    M_k = (tau v_s ahead, then a turn by tau w_s) + (arcs of the last commands)

+ joining motions of the plane. The error e between reference and q_k is what the controller keeps
small: a command moves q_k at once, by its whole arc, so that lag and delay do not delay the loop,
and no command has to overshoot. The robot itself runs tau + D behind.

In the plane of the wheels' travels (x_r, x_l) the way of a body is the integral of the form
e^{i (x_r - x_l) / b} (dx_r + dx_l) / 2, and an arc is a straight line. Two curves with the same
ends lead to places that differ by (Green)

    (i / b) double integral of e^{i (x_r - x_l) / b} over the area between them,

sideways of the robot, up to its turn. Of nominal wheels these areas nearly cancel
(`sets.robot.late_ways`).

What the ground takes and what lag and delay were not known to do happens now, on the way to q_k,
and not along the arc that the command adds to it. Let delta_j(t) be what wheel j has lost until t
and ell_j = delta_j(T) / T. Against an arc at the speeds c_j - ell_j, the kick kappa = T (ell_r -
ell_l) / b turns the robot while M is still ahead of it: it moves q_k sideways by kappa |M| more, at
the middle speed V by

    kappa lever,    lever = (tau + D) V.

The rest is bounded by following both ways as delta grows from 0 to its size: a loss d delta at a
place moves the end by d delta along the heading there, and by d delta_theta times the lever between
that place and the end.

Source: new. Predicting where the commands take the plant goes back to Smith 1957 (dead time) and to
Artstein 1982 ("Linear systems with delayed controls: a reduction").
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from sets.robot.actuation import Actuation, step_travel
from sets.robot.late_ways import Driving, Ground, Lost, Ways, bound_unevenness
from sets.robot.unknown_travel import OUTWARDS, UnknownTravel, bound_unknown_travel


class Commitment(NamedTuple):
    """Error of the committed pose after a period: that after an arc at the commands less what is
    lost, plus kick (0, lever, 0), plus a rest in two boxes.

    Attributes:
        loss: least and greatest mean speed that slip takes from a wheel (right, left), m/s.
        unknown: greatest mean of what unknown lag and delay take from the body's (speed m/s, yaw
            rate rad/s).
        kick: greatest yaw kick, rad; less than all of these together would give.
        lever: m.
        box: half widths (m, m) of what lag and delay do.
        slide: half widths (m, m) of what sideslip and lever arm do.
    """

    loss: Float[np.ndarray, "2 2"]
    unknown: Float[np.ndarray, "2"]
    kick: float
    lever: float
    box: Float[np.ndarray, "2"]
    slide: Float[np.ndarray, "2"]


def bound_commitment(
    actuation: Actuation,
    dt: float,
    track_width: float,
    driving: Driving,
    ground: Ground,
    middle_speed: float,
) -> Commitment:
    """Bound what lag and delay do to the committed pose in a period.

    Args:
        actuation: lag and delay, the same for both wheels.
        dt: period, s.
        track_width: m.
        driving: what the wheels are asked for.
        ground: what it does, the same throughout a period.
        middle_speed: of the body, m/s, to which the lever belongs.

    Raises:
        ValueError: where the wheels may lose so much in a period, or the robot turn so far within
            the latency, that nothing is bounded.
    """
    nominal = actuation.nominal(dt)
    of_body = np.array([0.5, 1 / track_width])
    share = _find_fresh_share(actuation, dt)
    slipped = dt * _bound_slip(driving, ground, share, track_width) * of_body
    uneven = bound_unevenness(nominal, dt) * _span_of_losses(driving, ground)
    unknown = bound_unknown(actuation, dt, track_width, driving, ground)
    lost = Lost(
        total=slipped + unknown.total,
        variation=slipped + unknown.variation,
        unevenness=uneven[0] * of_body + unknown.unevenness,
        mean_unevenness=uneven[1] * of_body + unknown.unevenness,
    )
    ways = Ways(nominal, dt, track_width, driving, lost)
    return Commitment(
        loss=_bound_loss(driving, ground, share),
        unknown=OUTWARDS * unknown.total / dt,
        kick=OUTWARDS * float(lost.total[1]),
        lever=nominal.latency * middle_speed,
        box=OUTWARDS * ways.bound_rest(middle_speed),
        slide=OUTWARDS * ways.bound_slide(ground),
    )


def bound_unknown(
    actuation: Actuation, dt: float, track_width: float, driving: Driving, ground: Ground
) -> UnknownTravel:
    """Return what lag and delay that were not known do within a period to (way m, turn rad), over
    ground.

    Slip changes of that as much as its share: of each wheel, or of the losses d c of all commands.
    """
    span = np.array([np.ptp(driving.speed), np.ptp(driving.yaw_rate)])
    of_body = bound_unknown_travel(actuation, dt, span, driving.change)
    widths = driving.wheels[1] - driving.wheels[0]
    if ground.stale_errors is None:
        shares = np.abs(ground.wheel_errors).max(axis=0)
        of_slip = bound_unknown_travel(actuation, dt, widths, driving.wheel_change)
    else:
        shares = np.ones(2)
        widths = np.ptp(_multiply_ends(ground.stale_errors, driving.wheels), axis=0)
        of_slip = bound_unknown_travel(actuation, dt, widths, widths)
    slipped = [float(shares @ part) * np.array([0.5, 1 / track_width]) for part in of_slip]
    return UnknownTravel(*(np.add(*parts) for parts in zip(of_body, slipped, strict=True)))


def _find_fresh_share(actuation: Actuation, dt: float) -> float:
    """Return the least share of a period's travel that is under the command of the period."""
    left = np.array(max(dt - actuation.delay[1], 0.0))
    return float(step_travel(left, actuation.lag[1])) / dt


def _mix(share: float, fresh, stale):
    """Return what is lost under the command of the period and under those before it, each at its
    own worst."""
    return share * fresh + (1 - share) * stale


def _bound_slip(driving: Driving, ground: Ground, share: float, track_width: float) -> float:
    """Return how much speed slip takes from both wheels together, m/s: |g_r| + |g_l| is 2 |v| or
    b |w|, whichever is more."""
    stale = ground.wheel_errors if ground.stale_errors is None else ground.stale_errors
    fresh_most = np.abs(ground.wheel_errors).max(axis=0)
    stale_most = np.abs(stale).max(axis=0)
    by_wheel = _mix(share, fresh_most, stale_most) @ np.abs(driving.wheels).max(axis=0)
    of_body = max(2 * np.abs(driving.speed).max(), track_width * np.abs(driving.yaw_rate).max())
    return float(min(by_wheel, _mix(share, fresh_most.max(), stale_most.max()) * of_body))


def _bound_loss(driving: Driving, ground: Ground, share: float) -> Float[np.ndarray, "2 2"]:
    """Return the least and the greatest speed that slip takes from each wheel, m/s."""
    stale = ground.wheel_errors if ground.stale_errors is None else ground.stale_errors
    fresh_products = _multiply_ends(ground.wheel_errors, driving.wheels)
    stale_products = _multiply_ends(stale, driving.wheels)
    least = _mix(share, fresh_products.min(axis=0), stale_products.min(axis=0))
    most = _mix(share, fresh_products.max(axis=0), stale_products.max(axis=0))
    rounding = (OUTWARDS - 1) * np.maximum(np.abs(least), np.abs(most))
    return np.stack([least - rounding, most + rounding])


def _span_of_losses(driving: Driving, ground: Ground) -> float:
    """Return the widths of the ranges of d c over the commands c that meet in a period, of both
    wheels together, m/s."""
    if ground.stale_errors is None:
        largest = np.abs(ground.wheel_errors).max(axis=0)
        return float(largest @ (driving.wheels[1] - driving.wheels[0]))
    return float(np.ptp(_multiply_ends(ground.stale_errors, driving.wheels), axis=0).sum())


def _multiply_ends(errors: Float[np.ndarray, "2 2"], speeds: Float[np.ndarray, "2 2"]):
    """Return the products of ends of two ranges of each wheel."""
    return np.array([error * speed for error in errors for speed in speeds])
