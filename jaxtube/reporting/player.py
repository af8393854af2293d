"""Laps for the player of a page: as few bytes as keep what is seen.

Errors and wheel speeds become 16-bit integers, little-endian, time first, then laps, in units of a
step a channel that is told beside them. MISSING stands for what is no finite number.
"""

from __future__ import annotations

import base64
from collections.abc import Mapping
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from jaxtube.coordinates import COORDINATES
from jaxtube.figures.style import Line, controller_lines
from jaxtube.reporting.alternatives import plain
from jaxtube.reporting.laps import LapSet, StoredLaps

MOST_BYTES = 1_200_000
"""Of all laps in a page, as text."""
MOST_LAPS = 40
"""Of a controller."""
LEAST_LAPS = 2
"""Of a controller, however long they are."""
MOST_STEPS = 6000
"""Periods of a lap; of a longer one only every second, third, .. instant is shown."""
MISSING = -32768
LARGEST = 32767
FARTHEST = 50.0
"""Errors beyond so many limits are shown there: a loop that diverged would take all resolution."""


def make_player(stored: StoredLaps, note: str = "") -> dict[str, Any]:
    """Return the laps of a run as plain values for the player.

    Args:
        stored: laps that were kept.
        note: a sentence on what they are.
    """
    stride = -(-len(stored.reference_poses) // MOST_STEPS)
    reference = stored.reference_poses[::stride]
    lines = controller_lines(stored.laps)
    instants = len(reference)
    bytes_a_lap = instants * (3 + 2) * 2 * 4 // 3
    most = MOST_BYTES // (bytes_a_lap * max(len(stored.laps), 1))
    most = int(np.clip(most, LEAST_LAPS, MOST_LAPS))
    chosen = choose_laps(stored.laps, most)
    return {
        "period_s": stored.period_s * stride,
        "instants": instants,
        "reference": _encode(reference.astype("<f4")),
        "track_m": stored.track_m,
        "coordinates": [
            {"symbol": entry.symbol, "unit": entry.unit, "to": entry.to_display}
            for entry in COORDINATES
        ],
        "controllers": [
            _pack(name, line, stored.laps[name], stride, chosen[name])
            for name, line in lines.items()
        ],
        "note": note,
    }


def choose_laps(laps: Mapping[str, LapSet], most: int) -> dict[str, Int[np.ndarray, " chosen"]]:
    """Return which laps are shown of each controller, in ascending order: its median and its worst
    one, and the first of the others.

    Controllers on the same draws get the same laps, so that they can be compared, where there is
    room for the median and the worst one of each.
    """
    special = {name: [kept.find("worst"), kept.find("median")] for name, kept in laps.items()}
    every = list(dict.fromkeys(place for places in special.values() for place in places))
    numbers = [kept.numbers for kept in laps.values()]
    if len(every) <= most and all(np.array_equal(numbers[0], other) for other in numbers):
        special = dict.fromkeys(laps, every)
    return {
        name: np.sort(list(dict.fromkeys([*special[name], *range(len(kept.numbers))]))[:most])
        for name, kept in laps.items()
    }


def _pack(
    name: str, line: Line, kept: LapSet, stride: int, chosen: Int[np.ndarray, " chosen"]
) -> dict[str, Any]:
    """Return the laps of one controller that are shown."""
    reach = FARTHEST * kept.limits
    return {
        "name": name,
        "label": plain(line.label),
        "colour": line.colour,
        "limits": kept.limits.tolist(),
        "section": kept.section.tolist(),
        "total": int(kept.total),
        "kept": len(kept.numbers),
        "numbers": kept.numbers[chosen].tolist(),
        "outside": np.flatnonzero(kept.usage[chosen] > 1).tolist(),
        "median": int(np.flatnonzero(chosen == kept.find("median"))[0]),
        "worst": int(np.flatnonzero(chosen == kept.find("worst"))[0]),
        "errors": quantise(np.clip(kept.errors[::stride, chosen], -reach, reach)),
        "wheels": _pack_wheels(kept, stride, chosen),
    }


def _pack_wheels(kept: LapSet, stride: int, chosen: Int[np.ndarray, " laps"]) -> dict | None:
    """Return wheel speeds, None for a model without wheels."""
    wheels = kept.wheels[::stride, chosen]
    return quantise(wheels) if np.isfinite(wheels).any() else None


def quantise(values: Float[np.ndarray, "times laps channels"]) -> dict[str, Any]:
    """Return values as 16-bit integers in text, with the size of a step of each channel."""
    finite = np.where(np.isfinite(values), values, 0.0).astype(float)
    largest = np.abs(finite).max(axis=(0, 1), initial=0.0)
    step = np.where(largest > 0, largest, 1.0) / LARGEST
    whole = np.round(finite / step)
    whole[~np.isfinite(values)] = MISSING
    return {"step": step.tolist(), "data": _encode(whole.astype("<i2"))}


def _encode(array: np.ndarray) -> str:
    return base64.b64encode(np.ascontiguousarray(array).tobytes()).decode()
