"""References along a recorded path: its rows, with their times, become held wheel speeds.

Cubic splines in time go through the recorded positions. At each period the reference stands at the
pose it has really reached, sees the recording's next sample under the bearing beta from there, and
turns by the mean of two turns: 2 (beta - phi), whose arc ends at the sample's position, and the one
that ends with the sample's heading. To first order in lateral and heading error this is deadbeat:
both are gone after two periods, so that the reference does not drift off the recording. The arc is
as long as brings it abreast of the sample.

Source: the mean is new (the arc to the position alone has a heading error that alternates for ever,
the one to the heading alone lets lateral errors add up); splines as in any textbook.
"""

import numpy as np
from jaxtyping import Float
from scipy.interpolate import CubicSpline

from jaxtube.plant.reference import (
    Reference,
    count_periods,
    make_reference,
    refuse_too_many_periods,
    refuse_unless_positive,
)
from jaxtube.recordings.path import FEWEST_ROWS, RawPath

SHARPEST_TURN = np.pi / 2.0
"""Turn in rad of one period beyond which the path is taken to reverse."""

SLOWEST_RECORDING = 1e-3
"""Speed in m/s below which a recorded path has no heading."""

SHORT_TIME = 1e-6
"""Of a period, by which a recording may be short of a whole one: rounding of its times."""


def follow_recording(
    raw: RawPath, dt: float, preview: int, track_width: float, duration: float | None = None
) -> Reference:
    """Build a reference along a recorded path at its own times (module docstring).

    Args:
        raw: the path; its time increases and its robot always moves forwards.
        dt: s.
        preview: periods known beyond the run; past the end of the recording the last wheel speeds
            are held.
        track_width: m.
        duration: of the run, s, a whole number of periods; by default the whole periods of the
            recording.

    Returns:
        A reference that starts at the recorded pose, in the coordinates of the file, and keeps to
        the recording: exactly where that is made of arcs, else within about half of what a single
        arc from sample to sample misses.

    Raises:
        ValueError: in one line, for a path without time, too few rows, time that does not increase
            or is not in its unit, a stop or a reversal in the path, or a duration longer than the
            recording.
    """
    refuse_unless_positive(track_width=track_width, dt=dt)
    time = _find_time(raw)
    refuse_too_many_periods(float(time[-1]), dt)
    recorded_steps = int(np.floor(time[-1] / dt + SHORT_TIME))
    steps = recorded_steps if duration is None else count_periods(duration, dt)
    if not 0 < steps <= recorded_steps:
        raise ValueError(
            f"{raw.path}: its time covers {time[-1]:.9g} s but the duration asked for is "
            f"{steps * dt:.9g} s; choose a duration from {dt:g} s to {recorded_steps * dt:.9g} s"
        )
    known = min(steps + preview, recorded_steps)
    samples = dt * np.arange(known + 1)
    spline = CubicSpline(time, raw.positions)
    positions = spline(samples)
    headings = _find_headings(raw, samples, spline(samples, 1))
    _refuse_reversing(raw, spline(time, 1))
    turns, lengths = _follow_path(positions, headings)
    speeds = lengths / (dt * np.sinc(turns / (2.0 * np.pi)))
    held = (0, steps + preview - known)
    return make_reference(
        start=np.append(positions[0] + raw.origin, headings[0]),
        speeds=np.pad(speeds, held, "edge"),
        yaw_rates=np.pad(turns / dt, held, "edge"),
        dt=dt,
        steps=steps,
        track_width=track_width,
    )


def _find_time(raw: RawPath) -> Float[np.ndarray, "rows"]:
    """Return the times of a path's rows, s, which increase."""
    if raw.time is None:
        raise ValueError(f"{raw.path}: has no time; give a column of it, such as time_s")
    if len(raw.time) < FEWEST_ROWS:
        raise ValueError(
            f"{raw.path}: {len(raw.time)} rows are too few; record at least {FEWEST_ROWS}"
        )
    stalled = np.flatnonzero(np.diff(raw.time) <= 0.0)
    if stalled.size:
        before = raw.time[stalled[0]]
        after = raw.time[stalled[0] + 1]
        raise ValueError(
            f"{raw.path}: time does not increase at {raw.word} {raw.lines[stalled[0] + 1]}: "
            f"{before:.9g} s then {after:.9g} s after the first row; sort the rows and drop "
            "repeated times"
        )
    length = float(np.linalg.norm(np.diff(raw.positions, axis=0), axis=1).sum())
    mean_speed = length / raw.time[-1]
    if 0.0 < mean_speed < SLOWEST_RECORDING:
        raise ValueError(
            f"{raw.path}: the path moves at {mean_speed:.2g} m/s on average, so that its time is "
            "in another unit; give seconds (divide milliseconds by 1e3, microseconds by 1e6, "
            "nanoseconds by 1e9)"
        )
    return raw.time


def _find_headings(
    raw: RawPath,
    samples: Float[np.ndarray, "periods+1"],
    velocities: Float[np.ndarray, "periods+1 2"],
) -> Float[np.ndarray, "periods+1"]:
    """Return the unwrapped directions of motion of a path that neither stops nor reverses."""
    speeds = np.linalg.norm(velocities, axis=-1)
    headings = np.unwrap(np.arctan2(velocities[:, 1], velocities[:, 0]))
    stops = np.flatnonzero(speeds < SLOWEST_RECORDING)
    jumps = np.flatnonzero(np.abs(np.diff(headings)) > SHARPEST_TURN)
    if stops.size or jumps.size:
        _refuse_repeats(raw)
    if stops.size:
        raise ValueError(
            f"{raw.path}: the path moves at {speeds[stops[0]]:.2g} m/s at {samples[stops[0]]:g} s, "
            f"without a heading there; cut parts slower than {SLOWEST_RECORDING:g} m/s out"
        )
    if jumps.size:
        turn = np.degrees(headings[jumps[0] + 1] - headings[jumps[0]])
        raise ValueError(
            f"{raw.path}: the path turns by {turn:.0f} deg in the step at {samples[jumps[0]]:g} s; "
            "shorten dt, or smooth the recording"
        )
    return headings


def _refuse_repeats(raw: RawPath) -> None:
    """Refuse a position that is given twice in a row."""
    moves = np.diff(raw.positions, axis=0)
    repeats = np.flatnonzero(~moves.any(axis=1))
    if repeats.size:
        first = raw.lines[repeats[0]]
        second = raw.lines[repeats[0] + 1]
        raise ValueError(
            f"{raw.path}: {raw.word} {second} repeats the position of {raw.word} {first} and "
            "leaves the path without a heading; drop repeated positions and cut stops out"
        )


def _refuse_reversing(raw: RawPath, velocities: Float[np.ndarray, "rows 2"]) -> None:
    """Refuse a robot that moves against its own heading, where the path has headings."""
    if raw.headings is None:
        return
    forwards = np.column_stack([np.cos(raw.headings), np.sin(raw.headings)])
    against = np.flatnonzero(np.sum(forwards * velocities, axis=1) < 0.0)
    if against.size:
        raise ValueError(
            f"{raw.path}: at {raw.word} {raw.lines[against[0]]} the robot moves against its "
            "heading, and references drive forwards; cut parts in reverse out"
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
