"""How far a reference is from the curve that it follows, and from the rows of its path.

Each row is compared with the drive at its own place along the path, not with whatever part of the
path comes nearest: where a path crosses itself that would hide an error.

Source: new.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from jaxtube.paths.curve import Curve
from jaxtube.paths.profile import SpeedProfile
from jaxtube.plant.reference import Reference

POINTS_PER_PERIOD = 4
"""Of the drive that are compared with the curve."""

PROJECTIONS = 3
"""Newton steps to the nearest point."""


class Deviations(NamedTuple):
    """Distances in m.

    Attributes:
        from_curve: largest one of the drive from the curve.
        from_rows: largest one from the drive to a row that the run comes to.
        rms_from_rows: root mean square of these, over the rows that the run comes to.
    """

    from_curve: float
    from_rows: float
    rms_from_rows: float


def measure_deviations(
    reference: Reference,
    curve: Curve,
    profile: SpeedProfile,
    positions: Float[np.ndarray, "n 2"],
    parameters: Float[np.ndarray, " n"],
) -> Deviations:
    """Measure how far a run of a reference is from its curve and from rows.

    Args:
        reference: the drive; its preview is left out.
        curve: that it follows.
        profile: its speed along the curve.
        positions: of the rows, m.
        parameters: of the points of the curve nearest to each.
    """
    duration = reference.dt * reference.steps
    times = np.linspace(0.0, duration, POINTS_PER_PERIOD * reference.steps + 1)
    driven = find_positions(reference, times)
    lengths = profile.lengths_at(times)
    within = lengths % curve.length if curve.closed else np.minimum(lengths, curve.length)
    nearest = curve.project(driven, np.interp(within, curve.lengths, curve.parameter))
    from_curve = np.linalg.norm(driven - curve.spline(nearest), axis=1)
    row_lengths = np.interp(parameters, curve.parameter, curve.lengths)
    passed = np.interp(row_lengths, profile.lengths, profile.times)
    # Rows that the run does not come to, as within its last unfinished period, are not compared.
    reached = passed <= duration
    from_rows = _distances(reference, positions[reached], passed[reached])
    return Deviations(
        from_curve=float(from_curve.max()),
        from_rows=float(from_rows.max()),
        rms_from_rows=float(np.sqrt(np.mean(from_rows**2))),
    )


def find_positions(
    reference: Reference, times: Float[np.ndarray, " k"]
) -> Float[np.ndarray, "k 2"]:
    """Return where a reference is at times, m, on the arcs between its poses."""
    period = np.clip((times / reference.dt).astype(int), 0, len(reference.wheels) - 1)
    since = times - reference.dt * period
    speeds = reference.wheels.mean(axis=1)[period]
    headings = reference.poses[:, 2]
    turns = (headings[period + 1] - headings[period]) * since / reference.dt
    chords = since * speeds * np.sinc(turns / (2.0 * np.pi))
    directions = headings[period] + turns / 2.0
    moves = np.stack([chords * np.cos(directions), chords * np.sin(directions)], axis=-1)
    return reference.poses[period, :2] + moves


def _distances(
    reference: Reference, positions: Float[np.ndarray, "n 2"], times: Float[np.ndarray, " n"]
) -> Float[np.ndarray, " n"]:
    """Return the distances of positions from the drive near given times, m."""
    end = reference.dt * reference.steps
    step = reference.dt / 100.0
    for _ in range(PROJECTIONS):
        start = np.clip(times, 0.0, end - step)
        here = find_positions(reference, start)
        velocity = (find_positions(reference, start + step) - here) / step
        ahead = np.sum((positions - here) * velocity, axis=1) / np.sum(velocity**2, axis=1)
        times = np.clip(start + np.clip(ahead, -end / 4.0, end / 4.0), 0.0, end)
    return np.linalg.norm(positions - find_positions(reference, times), axis=1)
