"""Speeds along a path as they were recorded.

Source: new.
"""

import numpy as np
from jaxtyping import Float

from jaxtube.paths.curve import Curve

WINDOW_S = 1.0
"""Time on either side over which a recorded speed is taken, at least: stamps jitter."""

WINDOW_STEPS = 3.0
"""The same, in steps of time such as one in twenty is longer than."""

GAP = 5.0
"""Usual times between rows beyond which the robot may have stood: a stop that was cut out takes no
longer than the way over it at the usual speed."""


def recorded_speeds(
    curve: Curve,
    parameters: Float[np.ndarray, " n"],
    time: Float[np.ndarray, " n"],
    lengths: Float[np.ndarray, " k"],
) -> Float[np.ndarray, " k"]:
    """Return the recorded speeds at arc lengths of a curve, m/s.

    Args:
        curve: along the recording.
        parameters: of the curve at each row.
        time: of each row, s.
        lengths: where speeds are asked for, m.
    """
    if curve.closed:
        lap = curve.parameter[-1]
        parameters = np.unwrap(parameters, period=lap)
        # The first row may lie a little before the start, at the end of the lap before.
        parameters = parameters - lap * np.round(parameters[0] / lap)
    reached = np.maximum.accumulate(np.interp(parameters, curve.parameter, curve.lengths))
    way = np.diff(reached)
    took = np.diff(time)
    is_gap = took > GAP * np.median(took[took > 0.0])
    usual = way[~is_gap].sum() / took[~is_gap].sum()
    moving = np.append(0.0, np.cumsum(np.where(is_gap, np.minimum(took, way / usual), took)))
    clock = np.interp(lengths, reached, moving)
    window = max(WINDOW_S, WINDOW_STEPS * float(np.percentile(np.diff(moving), 95.0)))
    before = np.maximum(clock - window, 0.0)
    after = np.minimum(clock + window, moving[-1])
    gained = np.interp(after, moving, reached) - np.interp(before, moving, reached)
    return gained / (after - before)
