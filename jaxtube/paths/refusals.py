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

STRAIGHT = 1e-6
"""Curvature in 1/m that is none."""

LEAST_TURN = np.deg2rad(30.0)
"""Turn within a track width from which it counts as one on the spot."""

REACH = 2.0
"""Track widths between a turn on the spot and where it shows."""


class Failure(NamedTuple):
    """What stands against driving a piece.

    Attributes:
        fit: the smoothest curve that was tried.
        at: arc length at which no speed keeps the wheels' limits, m; None where the curve is too
            far from a row.
        largest_deviation: of a row from the curve, m.
    """

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
    sharpest = limits.sharpest_curvature
    if failure.at is not None:
        samples = fit.curve.at(np.array([failure.at]))
        curvature = max(abs(float(samples.curvature[0])), STRAIGHT)
        change = abs(float(samples.curvature_change[0]))
        bound = "" if limits.acceleration is None else f" and below {limits.acceleration:.3g} m/s^2"
        text = (
            f"no speed keeps the wheels in their box{bound}: the radius is {1.0 / curvature:.3g} m "
            f"and the curvature changes by {change:.3g} 1/m in a metre; widen the box, raise "
            "robot.wheel_acceleration_max_mps2, or allow a larger deviation (path --deviation)"
        )
        return Note(place_of(piece.raw, _nearest_row(fit, failure.at)), text)
    row = int(np.argmax(fit.deviations))
    off = f"{fit.deviations[row]:.3g} m, more than {failure.largest_deviation:.3g} m"
    if fit.unbent.sharpest <= sharpest:
        text = (
            f"lies off the smooth path by {off}; record with less noise, or allow a larger "
            "deviation (path --deviation)"
        )
        return Note(place_of(piece.raw, row), text)
    curve = fit.unbent
    wider = f", and that wide a turn would leave the path by {off}"
    if fit.curve.sharpest > sharpest:
        curve = fit.curve
        wider = f", which smoothing within {failure.largest_deviation:.3g} m does not reach"
    curvature = curve.at(curve.lengths).curvature
    worst = int(np.argmax(np.abs(curvature)))
    radius = 1.0 / abs(curvature[worst])
    text = (
        f"turns with a radius of {radius:.3g} m; wheels {limits.track_width:.3g} m apart at "
        f"{limits.least:.3g} to {limits.greatest:.3g} m/s turn with {1.0 / sharpest:.3g} m or "
        f"more{wider}; "
        f"{_say_slower(1.0 / radius, limits)}allow a larger deviation (path --deviation), or turn "
        "less sharply"
    )
    return Note(place_of(piece.raw, _nearest_row(fit, curve.lengths[worst])), text)


def cut_at_corner(piece: Piece, failure: Failure, track_width: float) -> Halves | None:
    """Cut a piece where it fails if it turns there more sharply than around one of its own wheels;
    None where it does not."""
    fit = failure.fit
    curve = fit.unbent
    is_sharp = np.abs(curve.at(curve.lengths).curvature) > 2.0 / track_width
    if not is_sharp.any():
        return None
    parameter = fit.rows[np.argmax(fit.deviations)]
    place = failure.at
    if place is None:
        place = float(np.interp(parameter, curve.parameter, curve.lengths))
    sharp = np.flatnonzero(is_sharp)
    corner = int(sharp[np.argmin(np.abs(curve.lengths[sharp] - place))])
    around = curve.lengths[corner] + np.array([-1.0, 1.0]) * track_width
    arrival, departure = curve.at(np.clip(around, 0.0, curve.length)).headings
    turn = abs(departure - arrival)
    if turn < LEAST_TURN or abs(curve.lengths[corner] - place) > REACH * track_width:
        return None
    first = corner - int(np.argmin(np.append(is_sharp[corner::-1], False))) + 1
    last = corner + int(np.argmin(np.append(is_sharp[corner:], False))) - 1
    ends = _nearest_row(fit, curve.lengths[first])
    begins = max(_nearest_row(fit, curve.lengths[last]), ends)
    text = f"turns on the spot by {np.degrees(turn):.0f} deg"
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
