"""Logs of a simulated robot, whose truth is known: the sensors, and the file they write.

Rows come at the rate of the wheel speeds. A pose is taken at its own rate, with noise in the world
frame, and reaches the rows some time later; between two poses rows repeat the last one. A jump
moves all later poses; where the pose is lost it walks at random and comes back.

    time_s, left_wheel_mps, right_wheel_mps, x_m, y_m, heading_rad, cmd_v_mps, cmd_w_radps, step

Source: new; the columns are those of the records of D. Baril et al., "DRIVE: data-driven robot
input vector exploration" (2024).
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float

from jaxtube.identification.simulated.drive import STEP, Drive
from jaxtube.recordings.log import Log

HEADER = "time_s,left_wheel_mps,right_wheel_mps,x_m,y_m,heading_rad,cmd_v_mps,cmd_w_radps,step"

LOST_STEP_M = 1.5
"""Standard deviation of what a lost pose moves from one pose to the next, in x and in y."""


@dataclass(frozen=True)
class Sensors:
    """What a simulated robot measures with.

    Attributes:
        wheel_rate: Hz, of the rows.
        wheel_noise: standard deviation of a wheel speed, m/s.
        pose_rate: Hz.
        pose_delay: by which a row shows a pose later than the pose was true, s, before the waiting
            for the next row.
        pose_noise: standard deviation in x and in y, m.
        heading_noise: rad.
        jumps: number of jumps of the pose, of 0.5 to 2 m.
        lost: stretches (from, to) in which the pose is lost, s.
    """

    wheel_rate: float = 50.0
    wheel_noise: float = 0.003
    pose_rate: float = 10.0
    pose_delay: float = 0.05
    pose_noise: float = 0.005
    heading_noise: float = 0.003
    jumps: int = 0
    lost: tuple[tuple[float, float], ...] = ()


@dataclass(frozen=True, eq=False)
class SimulatedLog:
    """A log and what lies behind it.

    Attributes:
        log: as read from its file.
        drive: what the robot did.
        jump_times: at which the pose jumps, s.
    """

    log: Log
    drive: Drive
    jump_times: Float[np.ndarray, "jumps"]


def record(drive: Drive, sensors: Sensors, seed: int, path: str = "simulated.csv") -> SimulatedLog:
    """Record a drive with given sensors.

    Args:
        drive: what the robot does.
        sensors: what it measures with.
        seed: of noise and jumps.
        path: that the log names in messages.
    """
    generator = np.random.default_rng([seed, 2])
    end = drive.time[-1]
    time = np.arange(0.0, end, 1.0 / sensors.wheel_rate)
    row = np.round(time / STEP).astype(int)
    wheels = drive.wheels[row] + generator.normal(0.0, sensors.wheel_noise, (len(row), 2))
    taken = np.arange(0.0, end, 1.0 / sensors.pose_rate)
    true_poses = drive.poses[np.round(taken / STEP).astype(int)]
    spread = np.array([sensors.pose_noise, sensors.pose_noise, sensors.heading_noise])
    poses = true_poses + generator.normal(0.0, 1.0, true_poses.shape) * spread
    jump_times = np.sort(generator.uniform(0.1 * end, 0.9 * end, sensors.jumps))
    poses[:, :2] += _move_by_jumps(taken, jump_times, generator)
    for start, stop in sensors.lost:
        lost = (taken >= start) & (taken < stop)
        steps = generator.normal(0.0, LOST_STEP_M, (int(lost.sum()), 2))
        poses[lost, :2] += np.cumsum(steps, axis=0)
    arrived = np.searchsorted(taken + sensors.pose_delay, time + STEP / 2, side="right") - 1
    shown = poses[np.maximum(arrived, 0)]
    commands = drive.commands.velocity[drive.command[row]]
    log = Log(path, time, wheels, time, shown, drive.command[row], commands)
    return SimulatedLog(log, drive, jump_times)


def _move_by_jumps(
    taken: Float[np.ndarray, "m"],
    jump_times: Float[np.ndarray, "jumps"],
    generator: np.random.Generator,
) -> Float[np.ndarray, "m 2"]:
    """Return by how much the jumps so far have moved each pose, m."""
    size = generator.uniform(0.5, 2.0, len(jump_times))
    bearing = generator.uniform(0.0, 2 * np.pi, len(jump_times))
    jumps = size[:, None] * np.column_stack([np.cos(bearing), np.sin(bearing)])
    has_happened = taken[:, None] >= jump_times
    return has_happened.astype(float) @ jumps


def write_log(log: Log, path: str | Path) -> None:
    """Write a log whose poses stand in the rows of its wheels, as CSV."""
    assert log.step is not None
    assert log.commands is not None
    wheels = log.wheels[:, ::-1]
    table = np.column_stack([log.time, wheels, log.poses, log.commands, log.step])
    formats = ["%.4f", "%.4f", "%.4f", "%.5f", "%.5f", "%.6f", "%.4f", "%.4f", "%d"]
    np.savetxt(path, table, formats, ",", header=HEADER, comments="", encoding="utf-8")
