"""A robot's log: wheel speeds and poses over one clock.

Source: new; the signs are those of the unicycle with x forward, y left, heading counter-clockwise.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int


@dataclass(frozen=True, eq=False)
class Log:
    """What a robot recorded of its wheels and of its pose.

    Wheels and poses are samples of their own times, both counted from the same instant. Rows that
    repeat a pose that was held are kept: which poses are new is for the user of a log to find.

    Attributes:
        path: the file, for messages.
        time: of the wheel samples, s, increasing, from the first sample on.
        wheels: ground speeds of the rolling wheels or tracks, (right, left), m/s.
        pose_time: of the poses, s, increasing, on the clock of `time`.
        poses: (x m, y m, heading rad), world frame, the heading unwrapped.
        step: number of the command that was held at each wheel sample, None where not recorded.
        commands: commanded (speed m/s, yaw rate rad/s) at each wheel sample, None where not
            recorded.
        guesses: what the reader took for what, a clause each, such as "time = time_s in s".
    """

    path: str
    time: Float[np.ndarray, "n"]
    wheels: Float[np.ndarray, "n 2"]
    pose_time: Float[np.ndarray, "m"]
    poses: Float[np.ndarray, "m 3"]
    step: Int[np.ndarray, "n"] | None
    commands: Float[np.ndarray, "n 2"] | None
    guesses: tuple[str, ...] = ()
