"""Samples over time: put in order, made increasing, and held between their times.

Source: new.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

LONGEST_DISORDER = 1.0
"""Seconds that a sample may come late and still be sorted in: messages overtake each other, but a
clock that goes back further was set, or another recording begins."""

FEWEST_SAMPLES = 4
"""Samples of a log below which there is nothing to see."""


class Order(NamedTuple):
    """Which samples are kept, in which order.

    Attributes:
        rows: of the samples, in the order of their times, each time once.
        guesses: what was changed, a clause each; empty for samples that increase.
    """

    rows: Int[np.ndarray, "kept"]
    guesses: tuple[str, ...]


def order_samples(
    path: str, what: str, time: Float[np.ndarray, "n"], marks: Int[np.ndarray, "n"], word: str
) -> Order:
    """Return the order in which times increase; of samples of one time the first is kept.

    Args:
        path: the file, for messages.
        what: is sampled, for messages.
        time: of the samples, s.
        marks: where the samples stand in the file.
        word: for a mark, such as "line".

    Raises:
        ValueError: in one line, where time goes back too far.
    """
    latest = np.maximum.accumulate(time)
    late = np.flatnonzero(latest - time > LONGEST_DISORDER)
    if late.size:
        row = int(late[0])
        raise ValueError(
            f"{path}: the time of {what} goes back by {latest[row] - time[row]:.4g} s in {word} "
            f"{marks[row]}: the clock was set or another recording begins; split the file there"
        )
    rows = np.argsort(time, kind="stable")
    is_new = np.diff(time[rows], prepend=-np.inf) > 0.0
    guesses = []
    if np.any(np.diff(time) < 0.0):
        row = int(np.flatnonzero(np.diff(time) < 0.0)[0]) + 1
        guesses.append(f"{what} sorted by time, the first late one in {word} {marks[row]}")
    if not is_new.all():
        repeated = rows[~is_new]
        guesses.append(
            f"{repeated.size} {what} dropped whose time is repeated, the first in {word} "
            f"{marks[repeated[0]]}"
        )
    return Order(rows[is_new], tuple(guesses))


def hold(
    time: Float[np.ndarray, "m"], values: Float[np.ndarray, "m ..."], at: Float[np.ndarray, "n"]
) -> Float[np.ndarray, "n ..."]:
    """Return the last of some values at or before each time, 0 before the first."""
    places = np.searchsorted(time, at, side="right") - 1
    held = values[np.maximum(places, 0)]
    held[places < 0] = 0.0
    return held
