"""What the wheels of a reference do, read off its held speeds themselves: speeds in every period,
changes from each to the next.

Source: new.
"""

from typing import NamedTuple

import numpy as np

from jaxtube.paths.profile import WheelLimits
from jaxtube.plant.reference import Reference

ROUNDING = 1e-9
"""Share of a limit by which rounding may pass it."""


class WheelUse(NamedTuple):
    """Least and greatest wheel speed of a reference, m/s, and its greatest change of one from a
    period to the next over dt, m/s^2; preview included."""

    least: float
    greatest: float
    acceleration: float


class Excess(NamedTuple):
    """By how much wheels pass their speeds (m/s) and accelerations (m/s^2); 0 within."""

    speed: float
    acceleration: float


def find_use(reference: Reference) -> WheelUse:
    """Return what the wheels of a reference do."""
    wheels = reference.wheels
    changes = np.abs(np.diff(wheels, axis=0)) / reference.dt
    return WheelUse(
        float(wheels.min()), float(wheels.max()), float(changes.max()) if changes.size else 0.0
    )


def find_excess(use: WheelUse, limits: WheelLimits) -> Excess:
    """Return by how much wheels pass their limits, up to rounding; NaN passes them."""
    rounding = ROUNDING * max(abs(limits.least), abs(limits.greatest))
    speed = max(limits.least - use.least, use.greatest - limits.greatest)
    acceleration = 0.0
    if limits.acceleration is not None:
        acceleration = use.acceleration - limits.acceleration * (1.0 + ROUNDING)
    return Excess(0.0 if speed <= rounding else speed, 0.0 if acceleration <= 0.0 else acceleration)
