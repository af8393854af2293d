"""Why a piece of a path cannot be driven: where, and what would help.

Source: new; for the least radius see `WheelLimits.sharpest_curvature`.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from jaxtube.paths.pieces import Piece, is_long_enough
from jaxtube.paths.places import Note, place_of
from jaxtube.paths.profile import WheelLimits
from jaxtube.paths.rows import take_rows
from jaxtube.paths.smoothing import Fit

TABLE_STEPS = 2000
"""Points of a curve among which its sharp turns are looked for."""


class Failure(NamedTuple):
    """What stands against driving a piece: at arc length `at` (m) of the smoothest curve no speed
    keeps the wheels' limits; None where even the first curve is too far from the rows."""

    fit: Fit
    at: float | None
    largest_deviation: float


class Halves(NamedTuple):
    """A piece cut where it turns on the spot."""

    pieces: list[Piece]
    note: Note


def explain(piece: Piece, failure: Failure, limits: WheelLimits) -> Note:
    """Say where a piece cannot be driven, why, and what helps."""
    fit = failure.fit
    allowed = f"{failure.largest_deviation:.3g} m"
    if failure.at is None:
        row = int(np.argmax(fit.deviations))
        text = (
            f"lies {fit.deviations[row]:.3g} m off the smooth path, more than {allowed}; record "
            "with less noise, or allow more (path --deviation)"
        )
        return Note(place_of(piece.raw, row), text)
    samples = fit.curve.at(np.array([failure.at]))
    curvature = abs(float(samples.curvature[0]))
    place = place_of(piece.raw, _nearest_row(fit, failure.at))
    if curvature > limits.sharpest_curvature:
        text = (
            f"turns with a radius of {1.0 / curvature:.3g} m, smoothed within {allowed}; wheels "
            f"{limits.track_width:.3g} m apart at {limits.least:.3g} to {limits.greatest:.3g} m/s "
            f"turn with {1.0 / limits.sharpest_curvature:.3g} m or more; "
            f"{_say_slower(curvature, limits)}allow more (path --deviation), or turn less sharply"
        )
        return Note(place, text)
    text = (
        f"no speed keeps the wheels in their box and below {limits.acceleration:.3g} m/s^2 where "
        f"the curvature changes by {abs(samples.curvature_change[0]):.3g} 1/m in a metre; raise "
        "robot.wheel_acceleration_max_mps2, widen the box, or allow more (path --deviation)"
    )
    return Note(place, text)


def cut_at_corner(piece: Piece, failure: Failure, track_width: float) -> Halves | None:
    """Cut a piece where, smoothed as much as may be, it still turns more sharply than around one of
    its wheels; None where it does not."""
    if failure.at is None:
        return None
    lengths = np.linspace(0.0, failure.fit.curve.length, TABLE_STEPS)
    samples = failure.fit.curve.at(lengths)
    is_sharp = np.abs(samples.curvature) > 2.0 / track_width
    if not is_sharp.any():
        return None
    sharpest = int(np.argmax(np.abs(samples.curvature)))
    first = sharpest - int(np.argmin(np.append(is_sharp[sharpest::-1], False))) + 1
    last = sharpest + int(np.argmin(np.append(is_sharp[sharpest:], False))) - 1
    ends = _nearest_row(failure.fit, lengths[first])
    begins = max(_nearest_row(failure.fit, lengths[last]), ends)
    around = np.array([lengths[first] - track_width / 2.0, lengths[last] + track_width / 2.0])
    arrival, departure = failure.fit.curve.at(np.clip(around, 0.0, lengths[-1])).headings
    turn = np.degrees(abs(departure - arrival))
    text = f"turns on the spot by {turn:.0f} deg"
    before = take_rows(piece.raw, slice(ends + 1))
    after = take_rows(piece.raw, slice(begins, None))
    halves = [piece._replace(raw=before, ends=text), piece._replace(raw=after, begins=text)]
    kept = [half for half in halves if is_long_enough(half, track_width)]
    return Halves(kept, Note(place_of(piece.raw, ends), text))


def _nearest_row(fit: Fit, length: float) -> int:
    """Return the row nearest to an arc length of the curve."""
    parameter = np.interp(length, fit.curve.lengths, fit.curve.parameter)
    return int(np.argmin(np.abs(fit.rows - parameter)))


def _say_slower(curvature: float, limits: WheelLimits) -> str:
    """Say how slow the inner wheel would have to run."""
    share = curvature * limits.track_width / 2.0
    if share >= 1.0:
        return "the inner wheel would stand or run backwards; "
    least = limits.greatest * (1.0 - share) / (1.0 + share)
    return f"lower reference.wheel_speed_min_mps to {least:.3g}, "
