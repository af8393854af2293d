"""References along a recorded path: a CSV file of positions becomes held wheel speeds.

Cubic splines in time go through the recorded positions. At each period the reference stands at the
pose it has really reached, sees the recording's next sample under the bearing beta from there, and
turns by the mean of two turns: 2 (beta - phi), whose arc ends at the sample's position, and the one
that ends with the sample's heading. To first order in lateral and heading error this is deadbeat:
both are gone after two periods, so that the reference does not drift off the recording. The arc is
as long as brings it abreast of the sample.

Source: the mean is new (the arc to the position alone has a heading error that alternates for ever,
the one to the heading alone lets lateral errors add up); splines as in any textbook.
"""

from pathlib import Path

import numpy as np
from jaxtyping import Float
from scipy.interpolate import CubicSpline

from jaxtube.plant.recording import SLOWEST_RECORDING, Recording, read_recording
from jaxtube.plant.reference import (
    Reference,
    count_periods,
    make_reference,
    refuse_too_many_periods,
    refuse_unless_positive,
)

SHARPEST_TURN = np.pi / 2.0
"""Turn in rad of one period beyond which the path is taken to reverse."""


def from_file(
    path: str | Path, dt: float, preview: int, track_width: float, duration: float | None = None
) -> Reference:
    """Build a reference along a recorded path (module docstring).

    Args:
        path: CSV file with the header time_s,x_m,y_m; time increasing, the robot always moving
            forwards.
        dt: s.
        preview: periods known beyond the run; past the end of the recording the last wheel speeds
            are held.
        track_width: m.
        duration: of the run, s, a whole number of periods; by default the whole periods of the
            recording.

    Returns:
        A reference that starts at the recorded pose and keeps to the recording: exactly where that
        is made of arcs, else within about half of what a single arc from sample to sample misses.

    Raises:
        ValueError: in one line, for a file that is not UTF-8 CSV, a missing column, too few rows, a
            bad number, time that does not increase or is not in seconds, a stop or a reversal in
            the path, or a duration longer than the recording.
    """
    refuse_unless_positive(track_width=track_width, dt=dt)
    recording = read_recording(path)
    refuse_too_many_periods(recording.duration, dt)
    recorded_steps = int(np.floor(recording.duration / dt * (1.0 + 1e-12)))
    steps = recorded_steps if duration is None else count_periods(duration, dt)
    if not 0 < steps <= recorded_steps:
        raise ValueError(
            f"{path}: column time_s covers {recording.duration:.9g} s but the duration asked for "
            f"is {steps * dt:.9g} s; choose a duration from {dt:g} s to {recorded_steps * dt:.9g} s"
        )
    known = min(steps + preview, recorded_steps)
    samples = dt * np.arange(known + 1)
    spline = CubicSpline(recording.time, recording.positions)
    positions = spline(samples)
    headings = _find_headings(recording, samples, spline(samples, 1))
    turns, lengths = _follow_path(positions, headings)
    speeds = lengths / (dt * np.sinc(turns / (2.0 * np.pi)))
    held = (0, steps + preview - known)
    return make_reference(
        start=np.append(positions[0], headings[0]),
        speeds=np.pad(speeds, held, "edge"),
        yaw_rates=np.pad(turns / dt, held, "edge"),
        dt=dt,
        steps=steps,
        track_width=track_width,
    )


def _find_headings(
    recording: Recording,
    samples: Float[np.ndarray, "periods+1"],
    velocities: Float[np.ndarray, "periods+1 2"],
) -> Float[np.ndarray, "periods+1"]:
    """Return the unwrapped directions of motion of a path that neither stops nor reverses."""
    speeds = np.linalg.norm(velocities, axis=-1)
    headings = np.unwrap(np.arctan2(velocities[:, 1], velocities[:, 0]))
    stops = np.flatnonzero(speeds < SLOWEST_RECORDING)
    jumps = np.flatnonzero(np.abs(np.diff(headings)) > SHARPEST_TURN)
    if stops.size or jumps.size:
        _refuse_repeats(recording)
    if stops.size:
        raise ValueError(
            f"{recording.path}: columns x_m, y_m: the path moves at {speeds[stops[0]]:.2g} m/s at "
            f"{samples[stops[0]]:g} s, without a heading there; cut parts slower than "
            f"{SLOWEST_RECORDING:g} m/s out"
        )
    if jumps.size:
        turn = np.degrees(headings[jumps[0] + 1] - headings[jumps[0]])
        raise ValueError(
            f"{recording.path}: columns x_m, y_m: the path turns by {turn:.0f} deg in the step at "
            f"{samples[jumps[0]]:g} s; shorten dt, or smooth the recording"
        )
    return headings


def _refuse_repeats(recording: Recording) -> None:
    """Refuse a position that is given twice in a row."""
    moves = np.diff(recording.positions, axis=0)
    repeats = np.flatnonzero(~moves.any(axis=1))
    if repeats.size:
        first = recording.lines[repeats[0]]
        second = recording.lines[repeats[0] + 1]
        raise ValueError(
            f"{recording.path}: columns x_m, y_m: line {second} repeats the position of line "
            f"{first} and leaves the path without a heading; drop repeated positions and cut stops "
            "out"
        )


def _follow_path(
    positions: Float[np.ndarray, "periods+1 2"], headings: Float[np.ndarray, "periods+1"]
) -> tuple[Float[np.ndarray, "periods"], Float[np.ndarray, "periods"]]:
    """Return (turns rad, chord lengths m) of arcs that keep to a path (module docstring)."""
    points = positions @ np.array([1.0, 1.0j])  # the plane as complex numbers
    position = points[0]
    heading = headings[0]
    turns = []
    lengths = []
    for target, target_heading in zip(points[1:], headings[1:], strict=True):
        gap = (target - position) * np.exp(-1j * heading)  # in the frame of the pose reached
        turn_to_position = 2.0 * np.angle(gap)
        turn_to_heading = target_heading - heading
        turn = (turn_to_position + turn_to_heading) / 2.0
        length = (gap * np.exp(-0.5j * turn)).real
        position += length * np.exp(1j * (heading + turn / 2.0))
        heading += turn
        turns.append(turn)
        lengths.append(length)
    return np.array(turns), np.array(lengths)
