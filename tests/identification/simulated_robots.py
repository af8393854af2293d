"""Robots of known truth whose logs the tests identify, and what of new commands a box holds."""

import numpy as np

from jaxtube.identification.box import Box
from jaxtube.identification.simulated.drive import Truth, draw_slips, move_body
from jaxtube.identification.simulated.log import Sensors
from jaxtube.recordings.windows import Windows

WINDOWS = 2
"""Of a new command."""

WANDER_OF_MEAN = 0.41
"""Of the wander of a slip, what is left at most in its mean over a window of 2 s: sinc(2 / 3)."""


def draw_robot(index: int) -> tuple[Truth, Sensors]:
    """Draw a robot of the ranges that are promised, and its sensors."""
    draw = np.random.default_rng([12, index])
    effective = draw.uniform(0.2, 1.2)
    half = draw.uniform(0.01, 0.04, 2)
    middle = draw.uniform(-0.05 + half, 0.4 - half)
    truth = Truth(
        track_width=effective / draw.uniform(1.0, 1.8),
        effective_track=effective,
        lever_arm=draw.uniform(-0.2, 0.2) * effective,
        wheel_lag=draw.uniform(0.0, 0.2),
        slip=(
            (float(middle[0] - half[0]), float(middle[0] + half[0])),
            (float(middle[1] - half[1]), float(middle[1] + half[1])),
        ),
        slip_wander=0.15 * float(half.min()),
        sideslip=draw.uniform(0.0, 0.08),
        fastest_wheel=min(1.5, 0.3 + 1.2 * effective),
    )
    sensors = Sensors(
        wheel_rate=draw.choice([20.0, 50.0]),
        pose_rate=draw.uniform(5.0, 20.0),
        pose_delay=draw.uniform(0.0, 0.15),
        pose_noise=draw.uniform(0.0, 0.02),
        heading_noise=draw.uniform(0.0, 0.01),
        jumps=3,
    )
    return truth, sensors


def share_inside(truth: Truth, box: Box, commands: int, seed: int) -> float:
    """Return the share of new commands whose true slips lie in a box in all of their windows."""
    draw = np.random.default_rng([13, seed])
    slips = draw_slips(truth, commands, draw)
    sideslips = draw.uniform(-truth.sideslip, truth.sideslip, commands)
    inside = np.ones(commands, dtype=bool)
    for _ in range(WINDOWS):
        phase = draw.uniform(0.0, 2 * np.pi, slips.shape)
        wander = WANDER_OF_MEAN * truth.slip_wander * np.sin(phase)
        inside &= box.holds(slips + wander, sideslips)
    return float(np.mean(inside))


def draw_windows(
    truth: Truth, commands: int, seed: int, noise: tuple[float, float, float] = (0.0, 0.0, 0.0)
) -> Windows:
    """Draw windows of commands that drive forwards, as a log without sensors would give them.

    Args:
        truth: the robot.
        commands: each has `WINDOWS` windows.
        seed: of all that is drawn.
        noise: standard deviations of (v, omega, v_y).
    """
    draw = np.random.default_rng([14, seed])
    wheels = draw.uniform(truth.slowest_share, 1.0, (commands, 2)) * truth.fastest_wheel
    slips = draw_slips(truth, commands, draw)
    sideslip = draw.uniform(-truth.sideslip, truth.sideslip, commands)
    command = np.repeat(np.arange(commands), WINDOWS)
    phase = draw.uniform(0.0, 2 * np.pi, (len(command), 2))
    wander = WANDER_OF_MEAN * truth.slip_wander * np.sin(phase)
    ground = wheels[command] * (1.0 - slips[command] - wander)
    velocity = move_body(truth, ground, sideslip[command])
    velocity = velocity + draw.normal(size=velocity.shape) * noise
    yes = np.ones(len(command), dtype=bool)
    return Windows("simulated windows", command, wheels[command], velocity, yes, ~yes)
