"""What a promise does not cover, as far as the windows show it: turning on the spot, reversing, and
changing speed.

Source: new.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from jaxtube.identification.identify import Identified

MIDDLE = (10.0, 50.0, 90.0)
"""Percentiles of the track of a robot that turns on the spot."""


class Uncovered(NamedTuple):
    """Windows outside of what is promised."""

    on_the_spot: int  # commands that turn the wheels against each other
    spot_track: tuple[float, float, float]  # their effective track, `MIDDLE`, m; NaN without them
    reversing: int  # commands
    changing: int  # windows that drive forwards, not steadily
    changing_inside: int  # of these, windows inside the box


def find_uncovered(identified: Identified) -> Uncovered:
    """Look at the windows that no promise is made for."""
    windows = identified.windows
    wheels = windows.wheels
    usable = windows.steady & ~windows.lost
    least = identified.least_wheel
    spot = usable & (wheels.prod(axis=1) < 0.0) & (np.abs(wheels).min(axis=1) >= least)
    tracks = (wheels[spot, 0] - wheels[spot, 1]) / windows.velocity[spot, 1]
    low, middle, high = np.percentile(tracks, MIDDLE).tolist() if len(tracks) else [np.nan] * 3
    reversing = usable & (wheels.max(axis=1) <= -least)
    changing = ~windows.steady & ~windows.lost & (wheels.min(axis=1) >= least)
    box = identified.box
    inside = box.holds(identified.slips[changing], identified.sideslips[changing])
    return Uncovered(
        on_the_spot=len(np.unique(windows.command[spot])),
        spot_track=(low, middle, high),
        reversing=len(np.unique(windows.command[reversing])),
        changing=int(changing.sum()),
        changing_inside=int(inside.sum()),
    )
