"""Scenarios that nobody chose: the one of a number is drawn by that number alone.

Robots of 0.2 to 1.2 m of track, periods of 0.05 to 0.2 s, circles of 0.8 to 12 m, slips of up to
35 % known to 25 % of themselves, uneven from wheel to wheel, limits of unlike proportions, noise of
up to 5 mm. Some can be certified and some cannot.
"""

from __future__ import annotations

from functools import cache

import numpy as np

from jaxtube.scenario import load, replace
from jaxtube.scenario.tree import Scenario
from jaxtube.synthesis.starts import without_caps

COUNT = 40
SEED = 20_261
PERIODS = (0.05, 0.1, 0.15, 0.2)
DURATION_S = 30.0
DIGITS = 3


def draw_scenario(index: int) -> Scenario:
    """Return the unseen scenario of a number, without caps and gains."""
    random = np.random.default_rng([SEED, index])

    def between(low: float, high: float) -> float:
        return _shorten(random.uniform(low, high))

    def about(low: float, high: float) -> float:
        return _shorten(np.exp(random.uniform(np.log(low), np.log(high))))

    track = about(0.2, 1.2)
    dt = float(random.choice(PERIODS))
    radius = about(0.8, 12.0)
    # The slower of two wheels goes on forwards: half a track is less than the radius.
    lean = track / 2 / radius
    speed = about(0.15, 1.6)
    width = between(1.0, 1.15)
    slowest = _shorten(speed * (1 - lean) / width)
    fastest = _shorten(speed * (1 + lean) * width)
    slips = [between(0.0, 0.35) for _ in range(2)]
    errors = [between(0.0, 0.25) for _ in range(2)]
    intervals = [
        [round(slip * (1 - error), 4), round(slip * (1 + error), 4)]
        for slip, error in zip(slips, errors, strict=True)
    ]
    strongest = max(high for _, high in intervals)
    spare = between(1.3, 2.5)
    lateral = about(0.1, 0.6)
    noise = between(0.0, 0.005)
    return replace(
        _load_common(),
        {
            "robot.track_width_m": track,
            "robot.wheel_speed_max_mps": _shorten(spare * fastest / (1 - strongest)),
            "robot.wheel_speed_min_mps": -_shorten(between(0.0, 1.0) * fastest),
            "controller.dt_s": dt,
            "reference.radius_m": radius,
            "reference.speed_mps": speed,
            "reference.duration_s": DURATION_S,
            "reference.wheel_speed_min_mps": slowest,
            "reference.wheel_speed_max_mps": fastest,
            "slip.right": intervals[0],
            "slip.left": intervals[1],
            "slip.nominal_right": slips[0],
            "slip.nominal_left": slips[1],
            "constraints.longitudinal_m": _shorten(lateral * between(0.4, 1.5)),
            "constraints.lateral_m": lateral,
            "constraints.heading_deg": between(8.0, 35.0),
            "noise.longitudinal_m": noise,
            "noise.lateral_m": _shorten(noise * between(0.5, 1.0)),
            "noise.heading_deg": between(0.0, 0.3),
            "initial.x_m": 0.0,
            "initial.y_m": 0.0,
        },
    )


@cache
def _load_common() -> Scenario:
    """Return what all unseen scenarios have in common."""
    return without_caps(load("certified"))


def _shorten(value: float) -> float:
    """Return a number as one would write it."""
    return float(f"{value:.{DIGITS}g}")
