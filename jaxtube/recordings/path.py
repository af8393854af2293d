"""A path as it was recorded: not sorted, not cleaned.

Source: new.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from jaxtyping import Float, Int

from jaxtube.recordings.poses import describe_headings, describe_origin, find_origin

FEWEST_ROWS = 4
"""A path of fewer rows leaves a curve through them free to invent."""


@dataclass(frozen=True, eq=False)
class RawPath:
    """A recorded or planned path, its rows in the order of the file.

    Attributes:
        path: the file, for messages.
        time: since the first row, s, as recorded: repeated and unordered where the file is; None
            where it has none.
        positions: (x, y) from `origin`, m, world frame.
        headings: rad, world frame, as recorded; None where the file has none.
        lines: where the rows stand in the file.
        word: for one of `lines`: "line" of a text, "message" of a bag.
        origin: (x, y), m: the first point where coordinates are large, as those of UTM, else zero.
        guesses: what the reader took for what, a clause each.
    """

    path: str
    time: Float[np.ndarray, "n"] | None
    positions: Float[np.ndarray, "n 2"]
    headings: Float[np.ndarray, "n"] | None
    lines: Int[np.ndarray, "n"]
    word: str
    origin: Float[np.ndarray, "2"] = field(default_factory=lambda: np.zeros(2))
    guesses: tuple[str, ...] = ()


def count_from_origin(raw: RawPath) -> RawPath:
    """Return a path counted from its first point where its coordinates are large, with a warning
    where its headings do not lie along it."""
    origin = find_origin(raw.positions)
    warnings = () if raw.headings is None else describe_headings(raw.positions, raw.headings)
    return replace(
        raw,
        positions=raw.positions - origin,
        origin=origin,
        guesses=(*raw.guesses, *describe_origin(origin), *warnings),
    )
