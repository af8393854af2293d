"""How far a robot strays between the ends of a period.

While wheels, slips and reference are constant over a period T, the true error obeys

    e_x' = w e_y + V cos e_th - v        e_y' = -w e_x + V sin e_th - s        e_th' = Om - w

with constant V, Om, body speed v, yaw rate w and sideways speed s. A function whose second
derivative is at most c differs from the chord between its ends by at most T^2 c / 8, and the chord
between two errors of a convex set lies in it. Hence the error stays in the box that holds it at the
ends of periods, widened by T^2 / 8 times the largest

    e_x'' = w e_y' - V e_th' sin e_th        e_y'' = -w e_x' + V e_th' cos e_th        e_th'' = 0

over the errors passed through. These are at first within T max |e'| of the box, and then, widening
by widening, within the last bound.

Source: new; the remainder of linear interpolation is classical (Davis 1975, Interpolation and
Approximation, theorem 3.1.1).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from sets.interval import Interval, cos, sin
from sets.robot.driving import find_driving
from sets.robot.operation import Operation
from sets.robot.plant import Kinematics

ENCLOSURES = 4
"""Boxes of errors passed through, each from the one before; more change the bound by less than a
thousandth."""
MOST_GROWTHS = 60
GROWTH = 1.5
"""A guess of how far the error moves in a period grows by this factor until it holds."""


class Motion(NamedTuple):
    """What is constant over a period, each an interval of one number: the reference's speed m/s,
    the body's speed m/s, yaw rate rad/s and sideways speed m/s, and the rate of the heading error
    rad/s."""

    reference: Interval
    speed: Interval
    yaw_rate: Interval
    sideways: Interval
    turning: Interval


def bound_excursion(
    operation: Operation, kinematics: Kinematics, errors: Float[np.ndarray, "3"]
) -> Float[np.ndarray, "3"]:
    """Return how far (m, m, rad) true errors leave the box |e| <= `errors` within a period that
    begins and ends in it.

    Args:
        operation: where the robot works; its wheels obey at once.
        kinematics: the input map.
        errors: half widths (m, m, rad) of the true errors at the ends of periods.

    Raises:
        ValueError: where wheels lag, or an angle may leave a quarter turn.
    """
    if not operation.actuation.is_ideal:
        raise ValueError("actuation: wheels lag, so that their speeds are not constant in a period")
    motion = _find_motion(operation, kinematics)
    excursion = _find_first_enclosure(motion, operation.dt, errors)
    for _ in range(ENCLOSURES):
        excursion = _leave_chord(motion, operation.dt, errors, excursion)
    return excursion


def _find_motion(operation: Operation, kinematics: Kinematics) -> Motion:
    """Return the motions of body and reference that the operation allows."""
    driving = find_driving(operation, kinematics)
    half_track = operation.track_width / 2
    lost = np.abs(driving.wheels).max(axis=0) * np.abs(operation.wheel_errors).max(axis=0)
    lost_speed = _symmetric(lost.sum() / 2)
    lost_turn = _symmetric(lost.sum() / (2 * half_track))
    slowest = operation.schedules[:, 0].mean(axis=1).min()
    fastest = operation.schedules[:, 1].mean(axis=1).max()
    speed = _one(*driving.speed) + lost_speed
    yaw_rate = _one(*driving.yaw_rate) + lost_turn
    sliding = operation.sideslip * np.abs([speed.lower, speed.upper]).max()
    swinging = abs(operation.lever_arm) * np.abs([yaw_rate.lower, yaw_rate.upper]).max()
    return Motion(
        reference=_one(slowest, fastest),
        speed=speed,
        yaw_rate=yaw_rate,
        sideways=_symmetric(sliding + swinging),
        turning=_one(*operation.inputs[:, 1]) + lost_turn,
    )


def _find_first_enclosure(
    motion: Motion, dt: float, errors: Float[np.ndarray, "3"]
) -> Float[np.ndarray, "3"]:
    """Return how far errors move away from where the period began, at most: a guess that holds once
    what moves within it moves no further (Picard)."""
    guess = dt * _largest(_compute_rates(motion, errors))
    for _ in range(MOST_GROWTHS):
        moved = dt * _largest(_compute_rates(motion, errors + guess)) * (1 + 1e-12)
        if np.all(moved <= guess):
            return moved
        guess = GROWTH * np.maximum(guess, moved)
    raise ValueError("period: errors have no bound within it; shorten controller.dt_s")


def _leave_chord(
    motion: Motion,
    dt: float,
    errors: Float[np.ndarray, "3"],
    excursion: Float[np.ndarray, "3"],
) -> Float[np.ndarray, "3"]:
    """Return how far errors leave the chord where they leave the box by no more than is known; the
    heading error runs along it."""
    reach = errors + excursion
    heading = _symmetric(reach[2])
    x_rate, y_rate, turning = _compute_rates(motion, reach)
    of_x = motion.yaw_rate * y_rate - motion.reference * turning * sin(heading)
    of_y = motion.reference * turning * cos(heading) - motion.yaw_rate * x_rate
    share = dt * dt / 8 * (1 + 1e-12)
    return np.append(share * _largest((of_x, of_y)), 0.0)


def _compute_rates(motion: Motion, reach: Float[np.ndarray, "3"]) -> tuple[Interval, ...]:
    """Return e' over the box |e| <= reach."""
    x = _symmetric(reach[0])
    y = _symmetric(reach[1])
    heading = _symmetric(reach[2])
    x_rate = motion.yaw_rate * y + motion.reference * cos(heading) - motion.speed
    y_rate = motion.reference * sin(heading) - motion.yaw_rate * x - motion.sideways
    return x_rate, y_rate, motion.turning


def _largest(intervals: tuple[Interval, ...]) -> Float[np.ndarray, " k"]:
    return np.array([each.magnitudes[1] for each in intervals])


def _symmetric(width: float) -> Interval:
    return _one(-width, width)


def _one(low: float, high: float) -> Interval:
    """Return the interval of two numbers that were rounded, outwards."""
    ends = np.array([low, high])
    return Interval(ends[0], ends[1]) + Interval(*(np.array([-1e-14, 1e-14]) * np.abs(ends).max()))
