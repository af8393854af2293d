"""What lag and delay add to the disturbance of a robot that steers its committed pose.

The committed pose q_k is where the commands given before the instant k T take the robot: from its
pose p_k the wheels first run out, by tau s_k with the lag tau and their speeds s_k, then the
commands of the last delay D are driven; all by nominal values, along arcs,

    q_k = p_k + M_k,    M_k = (arc of tau s_k) + (arcs of the commands on their way)

+ joining motions of the plane. The error e between reference and q_k is what the controller keeps
small: a command moves q_k at once, by its whole arc, so that lag and delay do not delay the loop,
and no command has to overshoot. A pose that follows a circle in the steady state runs
tau + D behind.

In the plane of the wheels' travels (x_r, x_l) the way of a body is the integral of the form
e^{i (x_r - x_l) / b} (dx_r + dx_l) / 2, and an arc is a straight line. Two curves with the same
ends lead to places that differ by (Green)

    (i / b) double integral of e^{i (x_r - x_l) / b} over the area between them,

sideways of the robot, up to its turn. Of nominal wheels the period, run out, and run out, the
period, enclose the area |s_r c_l - s_l c_r| tau^2 (1 - e^{-T / tau}) / 2: `_bound_order`.

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

from itertools import product
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from sets.robot.actuation import (
    OUTWARDS,
    Actuation,
    Nominal,
    UnknownTravel,
    bound_unknown_travel,
    closed_share,
    held_back,
    step_travel,
)

MOST_KICK = 0.25
"""Yaw kick of a period, rad, beyond which nothing is bounded."""


class Driving(NamedTuple):
    """What the wheels are asked for at any time, as speeds over ground under the compensated slip.

    Attributes:
        wheels: least and greatest speeds (right, left), m/s.
        speed: least and greatest speed of the body, m/s.
        yaw_rate: least and greatest, rad/s.
        change: greatest changes of (speed m/s, yaw rate rad/s) from one period to the next.
    """

    wheels: Float[np.ndarray, "2 2"]
    speed: Float[np.ndarray, "2"]
    yaw_rate: Float[np.ndarray, "2"]
    change: Float[np.ndarray, "2"]


class Ground(NamedTuple):
    """What the ground does to the motion.

    Attributes:
        wheel_errors: least and greatest d (right, left), the share of its speed that a wheel loses
            under the command of the period.
        stale_errors: the same under commands given before, for which other slips were compensated;
            None where one slip is compensated in all.
        sideslip: greatest lateral speed, by the forward speed.
        lever_arm: m.
    """

    wheel_errors: Float[np.ndarray, "2 2"]
    stale_errors: Float[np.ndarray, "2 2"] | None = None
    sideslip: float = 0.0
    lever_arm: float = 0.0


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
    errors = _mix_errors(actuation, dt, ground)
    slipped = dt * _bound_slip(driving, errors, track_width) * of_body
    uneven = _bound_unevenness(nominal, dt) * _span_of_losses(driving, ground)
    unknown = bound_unknown(actuation, dt, track_width, driving, ground)
    lost = _Lost(
        total=slipped + unknown.total,
        variation=slipped + unknown.variation,
        unevenness=uneven[0] * of_body + unknown.unevenness,
        mean_unevenness=uneven[1] * of_body + unknown.unevenness,
    )
    frame = _Frame(nominal, dt, track_width, driving, lost)
    return Commitment(
        loss=_bound_loss(errors, driving),
        unknown=OUTWARDS * unknown.total / dt,
        kick=OUTWARDS * float(lost.total[1]),
        lever=nominal.latency * middle_speed,
        box=OUTWARDS * frame.bound_rest(middle_speed),
        slide=OUTWARDS * frame.bound_slide(ground),
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
        change = np.full(2, driving.change @ [1.0, track_width / 2])
        of_slip = bound_unknown_travel(actuation, dt, widths, change)
    else:
        shares = np.ones(2)
        widths = np.ptp(_multiply_ends(ground.stale_errors, driving.wheels), axis=0)
        of_slip = bound_unknown_travel(actuation, dt, widths, widths)
    slipped = [float(shares @ part) * np.array([0.5, 1 / track_width]) for part in of_slip]
    return UnknownTravel(*(np.add(*parts) for parts in zip(of_body, slipped, strict=True)))


def _mix_errors(actuation: Actuation, dt: float, ground: Ground) -> Float[np.ndarray, "2 2"]:
    """Return the least and the greatest share that the wheels lose of what all commands that meet
    in a period have them travel."""
    if ground.stale_errors is None:
        return ground.wheel_errors
    left = np.array(max(dt - actuation.delay[1], 0.0))
    fresh = float(step_travel(left, actuation.lag[1])) / dt
    return fresh * ground.wheel_errors + (1 - fresh) * ground.stale_errors


def _bound_slip(driving: Driving, errors: Float[np.ndarray, "2 2"], track_width: float) -> float:
    """Return how much speed slip takes from both wheels together, m/s: |g_r| + |g_l| is 2 |v| or
    b |w|, whichever is more."""
    largest = np.abs(errors).max(axis=0)
    by_wheel = largest @ np.abs(driving.wheels).max(axis=0)
    of_body = max(2 * np.abs(driving.speed).max(), track_width * np.abs(driving.yaw_rate).max())
    return float(min(by_wheel, largest.max() * of_body))


def _bound_loss(errors: Float[np.ndarray, "2 2"], driving: Driving) -> Float[np.ndarray, "2 2"]:
    """Return the least and the greatest speed that slip takes from each wheel, m/s."""
    products = _multiply_ends(errors, driving.wheels)
    rounding = (OUTWARDS - 1) * np.abs(products).max(axis=0)
    return np.stack([products.min(axis=0) - rounding, products.max(axis=0) + rounding])


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


class _Lost(NamedTuple):
    """Bounds of what is lost of (way m, turn rad) within a period: in all, up and down, and at most
    and in the mean beside a loss at constant speed."""

    total: Float[np.ndarray, "2"]
    variation: Float[np.ndarray, "2"]
    unevenness: Float[np.ndarray, "2"]
    mean_unevenness: Float[np.ndarray, "2"]


def _bound_unevenness(nominal: Nominal, dt: float) -> Float[np.ndarray, "2"]:
    """Return how far, at most and in the mean over a period, a nominal wheel's travel strays from
    that at constant speed, per width of the range of commands, s.

    At the start the wheel follows the command before; within the period the next one may arrive.
    The travel of either is convex or concave with slopes from 0 to 1 and m in the mean: within
    T m (1 - m) of its chord, on one side of it.
    """
    held = held_back(nominal.lag, dt)
    most = dt * held * (1 - held)
    mean = abs(held * dt / 2 - nominal.lag * (1 - held))
    late = nominal.delay % dt
    if late > 0:
        left = dt - late
        travel = float(step_travel(np.array(left), nominal.lag))
        share = travel / dt
        area = left**2 / 2 - nominal.lag * travel
        most += dt * share * (1 - share)
        mean += abs(area / dt - travel / 2)
    return np.array([most, mean])


def _bound_order(nominal: Nominal, dt: float, track_width: float, driving: Driving) -> float:
    """Return how far, m, it may lead apart that nominal wheels run out before the period instead of
    after it."""
    of_body = _greatest_cross(driving.speed, driving.yaw_rate)
    of_wheels = _greatest_cross(*driving.wheels.T) / track_width
    # s x c = s x (c - s), and steps of at most `change` leave so much between s and c.
    closed = closed_share(nominal.lag, dt)
    span = np.array([np.ptp(driving.speed), np.ptp(driving.yaw_rate)])
    of_speed, of_yaw_rate = np.minimum(driving.change, span) / closed
    greatest_speed = np.abs(driving.speed).max()
    of_change = greatest_speed * of_yaw_rate + np.abs(driving.yaw_rate).max() * of_speed
    late = nominal.delay % dt
    if late > 0:
        closed = closed_share(nominal.lag, late) + closed_share(nominal.lag, dt - late)
    return float(min(of_body, of_wheels, of_change)) * nominal.lag**2 * closed / 2


def _greatest_cross(first: Float[np.ndarray, "2"], second: Float[np.ndarray, "2"]) -> float:
    """Return the greatest |a q - b p| for a, b in one range and p, q in another."""
    return max(float(abs(a * q - b * p)) for a, b, p, q in product(first, first, second, second))


class _Frame:
    """Bounds of lengths and angles within a period and the latency, seen from the end."""

    def __init__(self, nominal: Nominal, dt, track_width, driving: Driving, lost: _Lost):
        self.dt = dt
        self.latency = nominal.latency
        self.lost = lost
        self.order = _bound_order(nominal, dt, track_width, driving)
        self.yaw_rate = float(np.abs(driving.yaw_rate).max())
        self.speed = float(np.abs(driving.speed).max())
        self.speeds = driving.speed
        self.slowing, self.kick = lost.total * [1 / dt, 1]
        self.turn = (dt + self.latency) * self.yaw_rate + self.kick + lost.unevenness[1]
        if lost.variation[1] > MOST_KICK:
            raise ValueError(
                f"what the wheels lose may turn the robot by {lost.variation[1]:.3g} rad within a "
                f"period of {dt:g} s; narrow slip, lag or delay"
            )
        if self.turn > np.pi / 2:
            raise ValueError(
                f"the robot may turn by {self.turn:.3g} rad within a period and its latency of "
                f"{self.latency:.3g} s; shrink inputs, lag or delay"
            )

    def bound_rest(self, middle_speed: float) -> Float[np.ndarray, "2"]:
        """Return the half widths of what lag and delay do (m, m)."""
        swing = self.lost.variation[1]
        tilt = np.sin(self.turn)
        across = self._along_headings() + self._uneven_kicks()
        stray, swerve = self.lost.unevenness
        strays = stray + self.dt * self._speed_of_arc * swerve
        ahead = self.latency * self.speed
        # How far the two ways lead apart: `order` at first, and no more than at last.
        last = (self.order + across + swing * (ahead + strays)) / (1 - 2 * swing)
        mean = (self.order + last) / 2
        mean_along = tilt * (self.order + across + swing * ahead) + swing * (strays + 2 * mean)
        off_lever = self._miss_lever(middle_speed) + stray + tilt * strays + 2 * mean_along
        y = self.order + across + swing * off_lever
        x = tilt * (self.order + across + swing * ahead) + swing * (strays + 2 * mean)
        return np.array([x, y])

    def bound_slide(self, ground: Ground) -> Float[np.ndarray, "2"]:
        """Return the half widths of what sideslip and lever arm do (m, m)."""
        turn = self.dt * self.yaw_rate + self.kick
        way = self.dt * self._speed_of_arc
        slide = abs(ground.lever_arm) * turn + ground.sideslip * way
        return slide * np.array([np.sin(self.turn), 1.0])

    def _miss_lever(self, middle_speed: float) -> float:
        """Bound how far levers of kicks differ from the one at the middle speed."""
        levers = self.latency * self.speeds
        levers = np.append(levers, levers * np.cos(self.turn))
        return float(np.abs(levers - self.latency * middle_speed).max())

    @property
    def _speed_of_arc(self) -> float:
        return self.speed + self.slowing

    def _along_headings(self) -> float:
        """Bound what a loss of way does at another heading, and unevenly."""
        turned = self.latency * self.yaw_rate + self.lost.unevenness[1]
        yaw_rate = self.yaw_rate + self.kick / self.dt
        uneven = self.dt * yaw_rate * self.lost.mean_unevenness[0]
        return float(turned * self.lost.variation[0] + uneven)

    def _uneven_kicks(self) -> float:
        """Bound what a loss of heading does that comes unevenly."""
        return float(self.dt * self._speed_of_arc * self.lost.mean_unevenness[1])
