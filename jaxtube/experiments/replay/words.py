"""Words and units that the tables of a replay share: lengths in millimetres, angles in degrees."""

from __future__ import annotations

from jaxtube.coordinates import COORDINATES, TO_DISPLAY

MILLIMETRES = TO_DISPLAY * [1e3, 1e3, 1.0]
UNITS = ("mm", "mm", "deg")
SYMBOLS = tuple(f"w_{coordinate.plain}" for coordinate in COORDINATES)


def say_percent(share: float) -> str:
    """Return a share in per cent; one that is not all does not look so."""
    rounded = f"{100 * share:.3g} %"
    return "> 99.9 %" if rounded == "100 %" and share < 1.0 else rounded
