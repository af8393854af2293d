"""Windows of a log: means of wheel speeds and of the body's velocity over a stretch of one command.

Source: D. Baril et al., "DRIVE: data-driven robot input vector exploration" (2024), whose
calibration holds each command for several windows; the columns are those of its records.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int


@dataclass(frozen=True, eq=False)
class Windows:
    """Windows of one robot on one terrain, a row each.

    Attributes:
        path: the file, for messages.
        command: number of the command of each window; windows of one command are not independent.
        wheels: mean ground speeds of the rolling wheels or tracks, (right, left), m/s.
        velocity: mean (v m/s forward, omega rad/s counter-clockwise, v_y m/s to the left) of the
            body, in its own frame.
        steady: wheels and body had settled.
        lost: the pose was lost within the window, its velocity means nothing.
        guesses: what the reader took for what, a clause each.
    """

    path: str
    command: Int[np.ndarray, "k"]
    wheels: Float[np.ndarray, "k 2"]
    velocity: Float[np.ndarray, "k 3"]
    steady: Bool[np.ndarray, "k"]
    lost: Bool[np.ndarray, "k"]
    guesses: tuple[str, ...] = ()
