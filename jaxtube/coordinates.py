"""The three coordinates of a tracking error: names, symbols, units of display; names of the inputs.

    e = (e_x, e_y, e_theta)     in the frame of the robot, m, m and rad; displayed in m, m and deg

Results files, tables and axes take what they call a coordinate from here.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Float


class Coordinate(NamedTuple):
    """One coordinate."""

    name: str
    letter: str  # index of its symbol, LaTeX
    plain: str  # index of its symbol, plain text
    unit: str  # of display
    to_display: float  # from SI units with rad

    @property
    def key(self) -> str:
        """Name with unit, as in metrics.json."""
        return f"{self.name}_{self.unit}"

    @property
    def symbol(self) -> str:
        """Symbol of the tracking error, plain text."""
        return f"e_{self.plain}"

    @property
    def error(self) -> str:
        """Symbol of the tracking error, LaTeX without dollars."""
        return f"e_{self.letter}"

    @property
    def disturbance(self) -> str:
        """Symbol of the disturbance, LaTeX without dollars."""
        return f"w_{self.letter}"

    def say(self, size: float) -> str:
        """Return a size, from m or rad, with its unit of display."""
        return f"{self.to_display * size:.3g} {self.unit}"


COORDINATES = (
    Coordinate("longitudinal", "x", "x", "m", 1.0),
    Coordinate("lateral", "y", "y", "m", 1.0),
    Coordinate("heading", "\\theta", "th", "deg", float(np.rad2deg(1.0))),
)
NAMES = tuple(coordinate.name for coordinate in COORDINATES)
KEYS = tuple(coordinate.key for coordinate in COORDINATES)
TO_DISPLAY = np.array([coordinate.to_display for coordinate in COORDINATES])
"""Factors from (m, m, rad) to (m, m, deg)."""
SI_UNITS = ("m", "m", "rad")
ERROR_NAMES = tuple(f"{name} error" for name in NAMES)
INPUT_NAMES = ("speed deficit", "yaw rate deficit")
"""The virtual inputs, m/s and rad/s."""

PLANES = ((0, 1), (0, 2), (1, 2))
"""Pairs of coordinates that a projection shows, abscissa first."""


def describe_half_widths(half_widths: Float[np.ndarray, "3"]) -> str:
    """Return limits in (m, m, rad) as words, in the units of display."""
    words = [
        f"|{coordinate.symbol}| {limit * coordinate.to_display:.3g} {coordinate.unit}"
        for coordinate, limit in zip(COORDINATES, half_widths, strict=True)
    ]
    return ", ".join(words)


def describe_excursion(excursion: Float[np.ndarray, "3"]) -> str:
    """Return how far positions, (m, m, rad), leave their limits, in words; headings left out."""
    words = [coordinate.say(size) for coordinate, size in zip(COORDINATES, excursion, strict=True)]
    return f"by at most {words[0]} lengthwise and {words[1]} sideways"
