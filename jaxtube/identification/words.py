"""The promise in words, as a report and a scenario file say it first.

Source: new.
"""

from __future__ import annotations

import math

import numpy as np

from jaxtube.identification.box import SIDES, BoxKind
from jaxtube.identification.identify import Identified
from jaxtube.identification.promise import make_promise

SHARES = (0.95, 0.99)
"""That the needed commands are told for."""

SIDES_IN_WORDS: dict[BoxKind, str] = {
    "each": "an interval of slip for each wheel, and the sideslip",
    "alike": "one interval of slip for both wheels, and the sideslip",
    "scaled": "one factor, by which the box of the fitted commands is blown up",
}


def say_promise(identified: Identified) -> str:
    """Return what the box holds for, and what more would take."""
    return "; ".join([say_holding(identified), *say_needed(identified)])


def say_holding(identified: Identified) -> str:
    """Return what the box holds for: the first line of everything."""
    promise = identified.promise
    return (
        f"holds for at least {math.floor(100 * promise.share)} % of new commands at "
        f"{100 * promise.confidence:.0f} % confidence, from {promise.commands}"
    )


def say_needed(identified: Identified) -> list[str]:
    """Return how many commands would be needed for greater shares."""
    promise = identified.promise
    return [
        f"{100 * share:.0f} % needs {promise.count_needed(share)}"
        for share in SHARES
        if share > promise.share
    ]


def say_sample(identified: Identified) -> str:
    """Return what the promise rests on, as one paragraph."""
    windows = identified.windows
    promise = identified.promise
    counted = int(identified.counts.sum())
    fitted = len(np.unique(windows.command[identified.fits]))
    sides = "1 side" if promise.sides == 1 else f"{promise.sides} sides"
    return (
        f"A box of {sides} ({SIDES_IN_WORDS[identified.choices.box]}) around {counted} windows of "
        f"{promise.commands} commands, each command counted once; track and lever arm come from "
        f"{fitted} other commands. A new command is one drawn as these were, on the same ground, "
        "that turns both wheels steadily forwards at "
        f"{identified.least_wheel:.3g} to {identified.fastest_wheel:.3g} m/s; it is inside where "
        "all of its windows are."
    )


def say_other_boxes(identified: Identified) -> str:
    """Return what boxes of fewer sides would promise; empty where there are none."""
    promise = identified.promise
    others = [
        f"{math.floor(100 * make_promise(promise.commands, sides, promise.confidence).share)} % "
        f"with --box {kind}"
        for kind, sides in SIDES.items()
        if sides < promise.sides
    ]
    if not others:
        return ""
    return (
        f"Fewer sides promise more, of a box that is no smaller: {', '.join(others)}. Choose "
        "before you look at the slips."
    )
