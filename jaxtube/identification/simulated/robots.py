"""The three robots whose simulated logs come with the project, in the folders of their scenarios.

What is true of them is a guess at robots of these kinds on firm ground with good localisation; no
record of a real robot went into it.

Source: new; sizes and speeds of a Clearpath Husky A200 (track 0.555 m between the middles of its
tyres, here between their inner thirds; 1 m/s), of a tracked robot of its size and of a small indoor
robot (track 0.16 m, 0.22 m/s) such as the TurtleBot3 Burger.
"""

from __future__ import annotations

from typing import NamedTuple

from jaxtube.identification.simulated.drive import Truth, drive
from jaxtube.identification.simulated.log import Sensors, SimulatedLog, record

COMMANDS = 64
HOLD_S = (4.0, 5.0)
SEED = 7
FILE = "drive.csv"
SECOND_COMMANDS = 24
SECOND_SEED = 8
SECOND_FILE = "second_drive.csv"
"""A shorter log of the husky, which nothing was identified from."""


class Example(NamedTuple):
    """A robot and what measures it."""

    truth: Truth
    sensors: Sensors


EXAMPLES = {
    "husky": Example(
        Truth(
            track_width=0.5385,
            effective_track=0.93,
            lever_arm=-0.03,
            wheel_lag=0.02,
            slip=((-0.01, 0.06), (-0.01, 0.06)),
            slip_wander=0.004,
            sideslip=0.02,
            fastest_wheel=1.0,
            slowest_share=0.1,
        ),
        Sensors(
            wheel_rate=20.0,
            pose_rate=20.0,
            pose_delay=0.05,
            pose_noise=0.0005,
            heading_noise=0.0005,
            jumps=1,
        ),
    ),
    "tracked": Example(
        Truth(
            track_width=0.52,
            effective_track=0.6,
            lever_arm=0.02,
            wheel_lag=0.02,
            slip=((0.03, 0.09), (0.03, 0.09)),
            slip_wander=0.004,
            sideslip=0.02,
            fastest_wheel=0.8,
            slowest_share=0.06,
        ),
        Sensors(
            wheel_rate=20.0,
            pose_rate=20.0,
            pose_delay=0.1,
            pose_noise=0.0003,
            heading_noise=0.0004,
            lost=((200.0, 206.0),),
        ),
    ),
    "indoor": Example(
        Truth(
            track_width=0.16,
            effective_track=0.17,
            wheel_lag=0.02,
            slip=((0.0, 0.04), (0.0, 0.04)),
            slip_wander=0.002,
            sideslip=0.01,
            fastest_wheel=0.22,
            slowest_share=0.05,
        ),
        Sensors(
            wheel_rate=20.0,
            wheel_noise=0.0005,
            pose_rate=20.0,
            pose_delay=0.05,
            pose_noise=0.0002,
            heading_noise=0.0003,
        ),
    ),
}
"""By the name of their scenario."""


def record_example(name: str, seed: int = SEED, count: int = COMMANDS) -> SimulatedLog:
    """Drive a robot through random commands and record it: the defaults make `FILE`."""
    example = EXAMPLES[name]
    return record(drive(example.truth, count, seed, HOLD_S), example.sensors, seed, FILE)


def record_second(name: str) -> SimulatedLog:
    """Drive the same robot through other commands: what `SECOND_FILE` holds, to be replayed."""
    return record_example(name, SECOND_SEED, SECOND_COMMANDS)
