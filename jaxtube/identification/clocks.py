"""The offset between the clocks of wheels and poses, and how sure it is.

    forward ~ a_r dS_r + a_l dS_l,   turn ~ b_r dS_r - b_l dS_l,   S at the times less the offset

The offset first maximises, over a grid, the sum of two correlations: of forward motion and of turn
as the poses and as the wheels have them. They are about zero, not about means: steady motion counts
as being in common. Then the offset and the gains are fitted together, robustly. A positive offset
says that a pose is stamped later than the wheels moved. It holds whatever delays poses against
wheels: clocks, the time of computing a pose, and rows that show a pose only when their own time
comes.

Source: new; correlation of yaw rates as in any alignment of odometry, e.g. Censi et al.,
Simultaneous calibration of odometry and sensor parameters for mobile robots, IEEE T-RO 2013; loss
soft L1 of scipy.optimize.least_squares.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.optimize import least_squares

from jaxtube.identification.samples import Poses, Steps, Travel, measure_steps
from jaxtube.recordings.spread import find_spread
from jaxtube.scenario.refusal import refusal

FURTHEST_S = 10.0
"""Largest offset that is searched."""

GRID_S = 0.05
"""Between two offsets that are tried first."""

SPAN_S = 0.6
"""Over which motions are compared; at least two and a half periods of the poses."""

LEAST_CORRELATION = 0.5
"""Of wheels and poses, in forward motion or in turn, at some offset of the grid; where both stay
below it at all offsets, wheels and poses are not of one drive."""

CLIPPED = 98.0
"""Percentile of motions at which they are clipped for a correlation: a jump is no motion."""

LEAST_MOTION_M = 0.5
"""That the wheels must roll in all."""


@dataclass(frozen=True)
class Clock:
    """How wheels and poses go together.

    Attributes:
        offset: by which poses come late, s.
        standard_error: of the offset, s, from the spread over eighths of the log.
        correlation: the largest one of forward motion or of turn, at any offset of the grid.
        forward_gains: forward motion by travel (right, left).
        turn_gains: rad by m of travel (right, -left).
    """

    offset: float
    standard_error: float
    correlation: float
    forward_gains: tuple[float, float]
    turn_gains: tuple[float, float]

    def predict(
        self, travel: Travel, start: Float[np.ndarray, "k"], end: Float[np.ndarray, "k"]
    ) -> Float[np.ndarray, "k 2"]:
        """Return (forward m, turn rad) that the wheels make expect between two times of poses."""
        way = travel.between(start - self.offset, end - self.offset)
        return _apply(way, np.array([*self.forward_gains, *self.turn_gains]))


def align(path: str, travel: Travel, poses: Poses) -> Clock:
    """Find the offset between wheels and poses.

    Raises:
        ScenarioError: in one line, where the wheels stand still or the two do not belong together.
    """
    rolled = float(np.abs(np.diff(travel.way, axis=0)).sum() / 2.0)
    if rolled < LEAST_MOTION_M:
        cure = "record a drive, or name the columns of the wheel speeds"
        raise refusal(path, "wheels", round(rolled, 3), "are m rolled in the whole log", cure)
    steps = measure_steps(poses, max(SPAN_S, 2.5 * poses.period))
    reach = min(FURTHEST_S, (travel.time[-1] - travel.time[0]) / 4.0)
    offsets = GRID_S * np.arange(-round(reach / GRID_S), round(reach / GRID_S) + 1)
    scores = np.array([_correlate(travel, steps, offset) for offset in offsets])
    correlation = float(scores.max())
    if correlation < LEAST_CORRELATION:
        problem = f"is all that wheels and poses have in common, at any offset within {reach:.0f} s"
        cure = "give wheels and poses of one drive with stamps of one clock, in s"
        raise refusal(path, "correlation", round(correlation, 3), problem, cure)
    best = float(offsets[np.argmax(scores.sum(axis=1))])
    scale = _find_scale(travel, steps, best)
    fitted = _refine(travel, steps, best, scale)
    parts = np.array_split(np.arange(len(steps.start)), 8)
    by_part = [_refine(travel, _take(steps, part), fitted[0], scale)[0] for part in parts]
    error = find_spread(np.array(by_part) - fitted[0]) / float(np.sqrt(len(parts)))
    offset, right, left, turn_right, turn_left = fitted.tolist()
    return Clock(offset, error, correlation, (right, left), (turn_right, turn_left))


def _correlate(travel: Travel, steps: Steps, offset: float) -> tuple[float, float]:
    """Return the correlations of forward motion, and of turn, between poses and wheels."""
    way = travel.between(steps.start - offset, steps.end - offset)
    forward = _correlation(steps.forward, way.sum(axis=1))
    return forward, _correlation(steps.turn, way[:, 0] - way[:, 1])


def _correlation(measured: Float[np.ndarray, "k"], expected: Float[np.ndarray, "k"]) -> float:
    """Return the correlation about zero of two motions, clipped; 0 where one of them is none."""
    first = _clip(measured)
    second = _clip(expected)
    size = float(np.sqrt(np.mean(first**2) * np.mean(second**2)))
    return float(np.mean(first * second)) / size if size > 0.0 else 0.0


def _clip(values: Float[np.ndarray, "k"]) -> Float[np.ndarray, "k"]:
    limit = np.percentile(np.abs(values), CLIPPED)
    return np.clip(values, -limit, limit)


def _find_scale(travel: Travel, steps: Steps, offset: float) -> Float[np.ndarray, "2"]:
    """Return the sizes of what forward motion and turn differ from the wheels' by."""
    fitted = _refine(travel, steps, offset, np.ones(2))
    missed = _miss(travel, steps, fitted)
    return np.maximum(find_spread(missed, axis=0), 1e-6)


def _refine(
    travel: Travel, steps: Steps, offset: float, scale: Float[np.ndarray, "2"]
) -> Float[np.ndarray, "5"]:
    """Fit offset, forward gains and turn gains together."""
    way = travel.between(steps.start - offset, steps.end - offset)
    forward = np.linalg.lstsq(way, steps.forward, rcond=None)[0]
    turn = np.linalg.lstsq(way * [1.0, -1.0], steps.turn, rcond=None)[0]
    start = np.concatenate([[offset], forward, turn])

    def residuals(values: Float[np.ndarray, "5"]) -> Float[np.ndarray, "2k"]:
        return (_miss(travel, steps, values) / scale).ravel()

    lowest = np.concatenate([[offset - 4 * GRID_S], np.full(4, -np.inf)])
    highest = np.concatenate([[offset + 4 * GRID_S], np.full(4, np.inf)])
    fit = least_squares(
        residuals, start, bounds=(lowest, highest), loss="soft_l1", diff_step=1e-3, x_scale=0.1
    )
    return fit.x


def _miss(travel: Travel, steps: Steps, values: Float[np.ndarray, "5"]) -> Float[np.ndarray, "k 2"]:
    """Return by how much forward motion and turn differ from what the wheels make expect."""
    way = travel.between(steps.start - values[0], steps.end - values[0])
    return np.column_stack([steps.forward, steps.turn]) - _apply(way, values[1:])


def _apply(
    way: Float[np.ndarray, "k 2"], gains: Float[np.ndarray, "4"]
) -> Float[np.ndarray, "k 2"]:
    forward = way @ gains[:2]
    turn = way @ (gains[2:] * [1.0, -1.0])
    return np.column_stack([forward, turn])


def _take(steps: Steps, rows: np.ndarray) -> Steps:
    return Steps(steps.start[rows], steps.end[rows], steps.forward[rows], steps.turn[rows])
