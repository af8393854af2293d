"""What may be asked of a robot at the extremes of its errors, inputs and reference.

Source: new.
"""

from __future__ import annotations

import itertools
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from jaxtube.synthesis.certificate.period import (
    find_extreme_speeds,
    map_inputs,
    pair_errors_and_inputs,
)
from jaxtube.synthesis.certificate.period_cases import PeriodCases
from jaxtube.synthesis.problem import Problem

DIRECTIONS = np.array([way for way in itertools.product((-1, 0, 1), repeat=2) if any(way)])
"""In the plane of speed and yaw rate, both by the widths of their ranges."""


class Demands(NamedTuple):
    """Extreme demands.

    Attributes:
        wheels: corners of the certified wheel speeds of the reference (right, left), m/s.
        asked: along each of them, wheel speeds (right, left) over ground under the slip that is
            compensated, m/s.
    """

    wheels: Float[np.ndarray, "corners 2"]
    asked: Float[np.ndarray, "corners demands 2"]


def find_demands(problem: Problem) -> Demands:
    """Return what the input map asks for, furthest along each of DIRECTIONS."""
    wheels = find_extreme_speeds(problem)
    bodies = np.array([_ask(problem, corner) for corner in wheels])
    widths = np.maximum(np.ptp(bodies, axis=(0, 1)), np.finfo(float).tiny)
    furthest = np.argmax((bodies / widths) @ DIRECTIONS.T, axis=1)
    speed, turn = np.moveaxis(np.take_along_axis(bodies, furthest[..., None], axis=1), -1, 0)
    aside = problem.model.track_width / 2 * turn
    return Demands(wheels, np.stack([speed + aside, speed - aside], axis=-1))


def _ask(problem: Problem, wheels: Float[np.ndarray, "2"]) -> Float[np.ndarray, "n 2"]:
    """Return the (speed m/s, yaw rate rad/s) asked for along a reference's wheel speeds."""
    errors, inputs = pair_errors_and_inputs(problem)
    none = np.zeros_like(errors)
    cases = PeriodCases(
        errors=errors,
        inputs=inputs,
        wheels=np.tile(wheels, (len(errors), 1)),
        slip=none[:, :2],
        measured_slip=none[:, :2],
        sideslip=none[:, 0],
        noise=none,
    )
    return np.stack(map_inputs(problem, cases), axis=1)
