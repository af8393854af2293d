"""Drives along a curve: a speed profile, held wheel speeds, and the check of those.

Source: new; its parts name theirs.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from jaxtube.paths.curve import Curve
from jaxtube.paths.deviation import Deviations, measure_deviations
from jaxtube.paths.following import follow
from jaxtube.paths.pieces import Piece
from jaxtube.paths.places import Place, place_of
from jaxtube.paths.profile import NoSpeedError, SpeedProfile, WheelLimits, make_profile
from jaxtube.paths.proof import Excess, WheelUse, find_excess, find_use
from jaxtube.paths.smoothing import Fit
from jaxtube.paths.timing import recorded_speeds
from jaxtube.plant.reference import Reference, count_periods, refuse_too_many_periods

GRID_SHARE = 0.25
"""Of the step of a period: the grid of the speed profile."""

FEWEST_POINTS = 50
"""Of that grid."""

MARGINS = 6
"""Tries at a margin that keeps the held speeds in the box."""

EXTRA = 1.5
"""Times what was too much by which a margin grows."""

WHOLE = 1e-9
"""Share of a period that is rounding."""


class Drive(NamedTuple):
    """How paths are to be driven.

    Attributes:
        limits: of the wheels.
        dt: length of a period, s.
        preview: periods known beyond the end.
        speed: along the path, m/s.
        recorded_timing: keep to the speeds of the recording instead, where it has time.
        largest_deviation: of the curve from any row, m.
        through_stops: drive through stops instead of ending a mission there.
        duration: of the run, s, a whole number of periods; None for the whole path, once.
    """

    limits: WheelLimits
    dt: float
    preview: int
    speed: float
    largest_deviation: float
    recorded_timing: bool = False
    through_stops: bool = False
    duration: float | None = None


@dataclass(frozen=True, eq=False)
class Mission:
    """A piece of a path that can be driven.

    Attributes:
        piece: its rows.
        fit: the smooth curve along them.
        profile: speed along the curve.
        reference: held wheel speeds.
        use: what the wheels do, which keeps the limits.
        deviations: how far the reference is from the curve and from the rows.
    """

    piece: Piece
    fit: Fit
    profile: SpeedProfile
    reference: Reference
    use: WheelUse
    deviations: Deviations

    @property
    def start(self) -> Place:
        """Where it begins."""
        return place_of(self.piece.raw, 0)

    @property
    def least_radius(self) -> float:
        """Least radius of curvature of its curve, m, infinite where that is straight."""
        sharpest = self.fit.curve.sharpest
        return 1.0 / sharpest if sharpest > 0.0 else np.inf


def drive_curve(piece: Piece, fit: Fit, drive: Drive) -> Mission:
    """Drive a curve; held speeds that pass the limits by a little are kept off them by as much.

    Raises:
        NoSpeedError: where the curve cannot be driven.
    """
    limits = drive.limits
    margins = Excess(0.0, 0.0)
    for _ in range(MARGINS):
        profile = _make_profile(
            piece, fit, drive, limits.shrink(margins.speed, margins.acceleration)
        )
        reference = _sample(piece, fit.curve, profile, drive)
        use = find_use(reference)
        excess = find_excess(use, limits)
        if excess == (0.0, 0.0):
            deviations = measure_deviations(
                reference, fit.curve, profile, piece.raw.positions, fit.rows
            )
            return Mission(piece, fit, profile, reference, use, deviations)
        margins = Excess(
            margins.speed + EXTRA * excess.speed, margins.acceleration + EXTRA * excess.acceleration
        )
    raise NoSpeedError(_find_worst(reference, profile, limits))


def _make_profile(piece: Piece, fit: Fit, drive: Drive, limits: WheelLimits) -> SpeedProfile:
    curve = fit.curve
    points = max(FEWEST_POINTS, int(np.ceil(curve.length / (GRID_SHARE * drive.speed * drive.dt))))
    lengths = np.linspace(0.0, curve.length, points)
    samples = curve.at(lengths)
    wanted = np.full(points, drive.speed)
    if drive.recorded_timing and piece.raw.time is not None:
        wanted = recorded_speeds(curve, fit.rows, piece.raw.time, lengths)
    return make_profile(
        lengths, samples.curvature, samples.curvature_change, wanted, limits, curve.closed
    )


def _sample(piece: Piece, curve: Curve, profile: SpeedProfile, drive: Drive) -> Reference:
    """Return the reference of a profile: whole periods up to the end of an open curve, on to the
    start of a closed one or beyond, in further laps, for as long as was asked for."""
    periods = profile.duration / drive.dt
    whole = int(np.ceil(periods - WHOLE)) if curve.closed else int(np.floor(periods + WHOLE))
    steps = whole if drive.duration is None else count_periods(drive.duration, drive.dt)
    refuse_too_many_periods(steps * drive.dt, drive.dt)
    if steps < 1:
        raise ValueError(
            f"{piece.raw.path}: {curve.length:.3g} m at {drive.speed:.3g} m/s are less than a "
            f"period of {drive.dt:.3g} s; shorten controller.dt_s"
        )
    if steps > whole and not curve.closed:
        raise ValueError(
            f"{piece.raw.path}: the path takes {whole * drive.dt:.9g} s but the duration asked for "
            f"is {steps * drive.dt:.9g} s; choose a duration up to that"
        )
    known = steps + drive.preview
    if not curve.closed:
        known = min(known, whole)
    lengths = profile.lengths_at(drive.dt * np.arange(known + 1))
    held = steps + drive.preview - known
    return follow(curve, lengths, held, drive.dt, steps, drive.limits.track_width)


def _find_worst(reference: Reference, profile: SpeedProfile, limits: WheelLimits) -> float:
    """Return the arc length where held speeds pass their limits by most, m."""
    wheels = reference.wheels
    off = np.maximum(limits.least - wheels, wheels - limits.greatest).max(axis=1)
    if limits.acceleration is not None and off.max() <= 0.0:
        changes = np.abs(np.diff(wheels, axis=0)).max(axis=1) / reference.dt
        off = changes - limits.acceleration
    time = reference.dt * float(np.argmax(off))
    return float(profile.lengths_at(np.array([min(time, profile.duration)]))[0])
