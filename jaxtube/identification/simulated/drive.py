"""A robot of known slip driven through random commands: the truth behind a simulated log.

    tau w' = u - w                           each wheel follows its command u = v +- b omega / 2
    v = (g_r + g_l) / 2,   omega = (g_r - g_l) / B,   v_y = s v - L omega,   g = w (1 - i)
    x' = v cos phi - v_y sin phi,   y' = v sin phi + v_y cos phi,   phi' = omega

Notation: b track width, B effective track, L lever arm, i slip of a wheel, s sideslip, tau lag. A
command is held for some seconds; its slips and its sideslip are drawn anew within their intervals,
and each slip wanders a little while the command lasts. Wheels are solved exactly on a grid of
2 ms, poses by the midpoint rule on it.

Source: new; slips as in Gonzalez, Fiacchini, Guzman, Alamo 2009, eqs. (1)-(2); an effective track
as in Mandow et al., Experimental kinematics for wheeled skid-steer mobile robots, IROS 2007.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int
from scipy.signal import lfilter

STEP = 0.002
"""Of the grid, s; commands change on it."""

STANDING_S = 4.0
"""Before the first command and after the last one."""

WANDER_S = 3.0
"""Period in which a slip wanders about its value of this command."""


@dataclass(frozen=True)
class Truth:
    """What is true of a simulated robot.

    Attributes:
        track_width: with which its commands become wheel speeds, m.
        effective_track: with which its wheels turn it, m.
        lever_arm: L in v_y = -L omega, m.
        wheel_lag: time constant of the wheels, s; 0 for none.
        slip: (right, left) by (least, greatest).
        slip_wander: amplitude of a slip about its value of a command; stays inside the interval.
        sideslip: greatest lateral speed by forward speed.
        fastest_wheel: m/s; commands turn the wheels up to it.
        slowest_share: of `fastest_wheel`, the slowest that a wheel turns while driving.
    """

    track_width: float = 0.5
    effective_track: float = 0.7
    lever_arm: float = 0.0
    wheel_lag: float = 0.1
    slip: tuple[tuple[float, float], tuple[float, float]] = ((0.02, 0.1), (0.02, 0.1))
    slip_wander: float = 0.005
    sideslip: float = 0.03
    fastest_wheel: float = 1.0
    slowest_share: float = 0.25

    def __post_init__(self) -> None:
        """Refuse a slip whose interval is narrower than it wanders."""
        narrowest = min(greatest - least for least, greatest in self.slip)
        if narrowest < 2 * self.slip_wander:
            raise ValueError(
                f"slip_wander = {self.slip_wander}: is wider than an interval of slip; "
                f"give at most {narrowest / 2:.4g}"
            )


class Commands(NamedTuple):
    """Commands in the order they are held; those of the standing robot are 0."""

    duration: Float[np.ndarray, "k"]  # s, whole steps of the grid
    velocity: Float[np.ndarray, "k 2"]  # commanded (speed m/s, yaw rate rad/s)
    slip: Float[np.ndarray, "k 2"]  # (right, left), about which the slip wanders
    sideslip: Float[np.ndarray, "k"]


@dataclass(frozen=True, eq=False)
class Drive:
    """What a simulated robot did, on the grid.

    Attributes:
        time: s, from 0.
        wheels: (right, left), m/s.
        slips: (right, left).
        velocity: of the body (v m/s, omega rad/s, v_y m/s).
        poses: (x m, y m, heading rad), from 0.
        command: number of the command held, 0 while standing at either end.
        commands: the commands.
    """

    time: Float[np.ndarray, "n"]
    wheels: Float[np.ndarray, "n 2"]
    slips: Float[np.ndarray, "n 2"]
    velocity: Float[np.ndarray, "n 3"]
    poses: Float[np.ndarray, "n 3"]
    command: Int[np.ndarray, "n"]
    commands: Commands


def drive(truth: Truth, count: int, seed: int, hold_s: tuple[float, float] = (4.0, 6.0)) -> Drive:
    """Drive a robot through random commands.

    Args:
        truth: the robot.
        count: commands; one of ten turns on the spot, one of ten reverses.
        seed: of all that is drawn.
        hold_s: shortest and longest time a command is held.
    """
    commands = draw_commands(truth, count, np.random.default_rng(seed), hold_s)
    held = np.repeat(
        np.arange(len(commands.duration)), np.round(commands.duration / STEP).astype(int)
    )
    time = STEP * np.arange(len(held))
    wheels = follow(command_wheels(commands.velocity, truth.track_width)[held], truth.wheel_lag)
    phases = np.random.default_rng([seed, 1]).uniform(0, 2 * np.pi, (len(commands.duration), 2))
    wander = np.sin(2 * np.pi * time[:, None] / WANDER_S + phases[held])
    slips = commands.slip[held] + truth.slip_wander * wander
    velocity = move_body(truth, wheels * (1.0 - slips), commands.sideslip[held])
    last = len(commands.duration) - 1
    number = np.where(held == last, 0, held)
    return Drive(time, wheels, slips, velocity, integrate(velocity), number, commands)


def draw_commands(
    truth: Truth, count: int, generator: np.random.Generator, hold_s: tuple[float, float]
) -> Commands:
    """Draw commands between a stop before and a stop after."""
    wheels = generator.uniform(truth.slowest_share, 1.0, (count, 2)) * truth.fastest_wheel
    kind = generator.permutation(count) % 10
    wheels[kind == 8] *= [1.0, -1.0]
    wheels[kind == 9] *= -1.0
    speed = wheels.mean(axis=1)
    yaw_rate = (wheels[:, 0] - wheels[:, 1]) / truth.track_width
    velocity = np.column_stack([speed, yaw_rate])
    duration = generator.uniform(*hold_s, count)
    slip = draw_slips(truth, count, generator)
    sideslip = generator.uniform(-truth.sideslip, truth.sideslip, count)
    return Commands(
        STEP * np.round(np.concatenate([[STANDING_S], duration, [STANDING_S]]) / STEP),
        np.pad(velocity, ((1, 1), (0, 0))),
        np.pad(slip, ((1, 1), (0, 0))),
        np.pad(sideslip, 1),
    )


def draw_slips(
    truth: Truth, count: int, generator: np.random.Generator
) -> Float[np.ndarray, "count 2"]:
    """Draw the slips (right, left) of commands, uniform where their wandering stays inside."""
    slip = np.array(truth.slip)
    least = slip[:, 0] + truth.slip_wander
    greatest = slip[:, 1] - truth.slip_wander
    return generator.uniform(least, greatest, (count, 2))


def command_wheels(
    velocity: Float[np.ndarray, "... 2"], track_width: float
) -> Float[np.ndarray, "... 2"]:
    """Return the wheel speeds (right, left) that the robot's own driver makes of (v, omega)."""
    turning = velocity[..., 1] * track_width / 2.0
    return np.stack([velocity[..., 0] + turning, velocity[..., 0] - turning], axis=-1)


def follow(commanded: Float[np.ndarray, "n k"], lag: float) -> Float[np.ndarray, "n k"]:
    """Return what follows commands, held over each step of the grid, with a first-order lag; from
    rest, exact."""
    if lag == 0.0:
        return commanded
    kept = np.exp(-STEP / lag)
    return np.asarray(lfilter([0.0, 1.0 - kept], [1.0, -kept], commanded, axis=0))


def move_body(
    truth: Truth, ground: Float[np.ndarray, "n 2"], sideslip: Float[np.ndarray, "n"]
) -> Float[np.ndarray, "n 3"]:
    """Return (v, omega, v_y) of the body from the ground speeds of its wheels."""
    speed = ground.mean(axis=1)
    yaw_rate = (ground[:, 0] - ground[:, 1]) / truth.effective_track
    lateral = sideslip * speed - truth.lever_arm * yaw_rate
    return np.column_stack([speed, yaw_rate, lateral])


def integrate(velocity: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3"]:
    """Return the poses (x, y, heading) of a body that starts at 0, by the midpoint rule."""
    middle = (velocity[1:] + velocity[:-1]) / 2.0
    turned = STEP * middle[:, 1]
    heading = np.concatenate([[0.0], np.cumsum(turned)])
    towards = heading[:-1] + turned / 2.0
    x_rate = middle[:, 0] * np.cos(towards) - middle[:, 2] * np.sin(towards)
    y_rate = middle[:, 0] * np.sin(towards) + middle[:, 2] * np.cos(towards)
    moved = STEP * np.cumsum(np.column_stack([x_rate, y_rate]), axis=0)
    return np.column_stack([np.pad(moved, ((1, 0), (0, 0))), heading])
