"""How far apart two ways lead: that of a robot whose wheels lag, to its committed pose, and the arc
that it is commanded.

`sets.robot.committed` has the notation and the argument; here are the bounds that it sums up.

Source: new.
"""

from __future__ import annotations

from itertools import product
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from sets.robot.actuation import Nominal, closed_share, held_back, step_travel

MOST_KICK = 0.25
"""Yaw kick of a period, rad, beyond which nothing is bounded."""


class Driving(NamedTuple):
    """What the wheels are asked for at any time, as speeds over ground under the compensated slip.

    Attributes:
        wheels: least and greatest speeds (right, left), m/s.
        speed: least and greatest speed of the body, m/s.
        yaw_rate: least and greatest, rad/s.
        change: greatest changes of (speed m/s, yaw rate rad/s) from one period to the next.
        wheel_change: those of the wheels (right, left), m/s.
    """

    wheels: Float[np.ndarray, "2 2"]
    speed: Float[np.ndarray, "2"]
    yaw_rate: Float[np.ndarray, "2"]
    change: Float[np.ndarray, "2"]
    wheel_change: Float[np.ndarray, "2"]


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


class Lost(NamedTuple):
    """Bounds of what is lost of (way m, turn rad) within a period: in all, up and down, and at most
    and in the mean beside a loss at constant speed."""

    total: Float[np.ndarray, "2"]
    variation: Float[np.ndarray, "2"]
    unevenness: Float[np.ndarray, "2"]
    mean_unevenness: Float[np.ndarray, "2"]


def bound_unevenness(nominal: Nominal, dt: float) -> Float[np.ndarray, "2"]:
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


class Order(NamedTuple):
    """What it does to nominal wheels that they run out before the period instead of after it.

    Attributes:
        sideways: how far it leads them apart, m, were all areas met at one heading.
        sizes: of these areas in all, over the track width, m.
        spread: by which the headings there differ from one in between, rad.
    """

    sideways: float
    sizes: float
    spread: float


def _bound_order(nominal: Nominal, dt: float, track_width: float, driving: Driving) -> Order:
    """Bound what the order of motions does.

    The body drives tau v_s and then turns by tau w_s. Before a period at the command c and after
    it, at the speeds s and s', the areas sum up to b tau^2 / 2 (v' - v_s) (w_s + w'): to nothing
    where the body's speed is constant.
    """
    late = nominal.delay % dt
    pieces = (dt,) if late == 0 else (late, dt - late)
    closed = sum(closed_share(nominal.lag, piece) for piece in pieces)
    of_body = _greatest_cross(driving.speed, driving.yaw_rate)
    of_wheels = _greatest_cross(*driving.wheels.T) / track_width
    speed = np.abs(driving.speed).max()
    yaw_rate = np.abs(driving.yaw_rate).max()
    # Between s and c there is so much where steps are bounded.
    apart = min(np.ptp(driving.speed), driving.change[0] / closed_share(nominal.lag, dt))
    return Order(
        sideways=float(nominal.lag**2 * closed * apart * yaw_rate),
        sizes=float(nominal.lag**2 * (closed * min(of_body, of_wheels) / 2 + speed * yaw_rate)),
        spread=float(min((dt + nominal.lag) * yaw_rate / 2, np.pi / 2)),
    )


def _greatest_cross(first: Float[np.ndarray, "2"], second: Float[np.ndarray, "2"]) -> float:
    """Return the greatest |a q - b p| for a, b in one range and p, q in another."""
    return max(float(abs(a * q - b * p)) for a, b, p, q in product(first, first, second, second))


class Ways:
    """Bounds of lengths and angles on both ways, seen from their end."""

    def __init__(self, nominal: Nominal, dt, track_width, driving: Driving, lost: Lost):
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
        sideways, sizes, spread = self.order
        # How far the two ways lead apart, at first and at last.
        first = sideways + 2 * sizes * np.sin(spread / 2)
        last = (first + across + swing * (ahead + strays)) / (1 - 2 * swing)
        mean = (first + last) / 2
        spread_along = sizes * np.sin(spread)
        along = tilt * (sideways + across + swing * ahead)
        along += spread_along + swing * (strays + 2 * mean)
        off_lever = self._miss_lever(middle_speed) + stray + tilt * strays + 2 * along
        y = sideways + sizes * (1 - np.cos(spread)) + tilt * spread_along + across
        return np.array([along, y + swing * off_lever])

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
