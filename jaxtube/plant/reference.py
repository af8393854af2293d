"""References: wheel speeds held over each period, and the poses they lead to, exactly.

    p_{k+1} = p_k + Rot(phi_k) chord(V_k, Om_k)        phi_{k+1} = phi_k + T Om_k

where the chord of the arc has length T V sinc(T Om / 2) and direction T Om / 2. Wheels are (right,
left) in m/s, poses (x m, y m, heading rad) in the world frame; headings are not wrapped.

Source: the eight of Gonzalez, Fiacchini, Guzman, Alamo 2009, section IV, read as two circles;
Bernoulli's lemniscate by Gauss's lemniscate functions, cl(u) = cn(sqrt(2) u | 1/2).
"""

import csv
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float
from scipy.interpolate import CubicSpline
from scipy.special import ellipj

COLUMNS = ("time_s", "x_m", "y_m")
# A cubic spline needs this many points to have no freedom left to invent.
FEWEST_ROWS = 4
# Below this speed, m/s, a recorded path has no heading.
SLOWEST_RECORDING = 1e-3


@dataclass(frozen=True, eq=False)
class Reference:
    """A reference in periods of dt, longer than the run by the preview.

    Attributes:
        wheels: speeds (right, left) held over each period, m/s.
        poses: (x m, y m, heading rad) at the periods' ends, world frame; wheels k lead from pose k
            to pose k + 1.
        dt: length of a period, s.
        steps: periods of the run, without the preview.
    """

    wheels: Float[np.ndarray, "periods 2"]
    poses: Float[np.ndarray, "periods+1 3"]
    dt: float
    steps: int


TRANSIENT_S = 10.0
"""The first seconds, in which a run forgets its start."""


def settled_step(reference: Reference) -> int:
    """Return the step from which a run has settled; of one that is shorter than the transient, its
    last."""
    return min(round(TRANSIENT_S / reference.dt), reference.steps)


def two_circles(
    radius: float, speed: float, duration: float, dt: float, preview: int, track_width: float
) -> Reference:
    """Build the eight of two tangent circles, left one first, from the origin with heading 0.

    Args:
        radius: of each circle, m.
        speed: m/s.
        duration: of the run, s, a whole number of periods.
        dt: s.
        preview: periods known beyond the run.
        track_width: m.

    Returns:
        A reference that turns left while floor(k V T / (2 pi R)) is even, right while it is odd: it
        changes circle at the first sample past the origin.

    Raises:
        ValueError: for a setting that is not positive, or a duration that is no whole number of
            periods.
    """
    _refuse_unless_positive(radius=radius, speed=speed, track_width=track_width)
    steps = _whole_steps(duration, dt)
    # Rounding must not add a step to a circle that closes at a sample.
    circles_done = np.floor(np.arange(steps + preview) * speed * dt / (2.0 * np.pi * radius) + 1e-9)
    yaw_rates = np.where(circles_done % 2 == 0, speed / radius, -speed / radius)
    return _reference(
        np.zeros(3), np.full_like(yaw_rates, speed), yaw_rates, dt, steps, track_width
    )


def lemniscate(
    radius: float, speed: float, duration: float, dt: float, preview: int, track_width: float
) -> Reference:
    """Build Bernoulli's lemniscate at constant speed, left lobe first, from its crossing at the
    origin with heading 0.

    With half-width a the heading after the arc length s is 3 (pi/4 - arctan cl(s/a)), its rate at
    most 3 V / a.

    Args:
        radius: tightest radius of curvature, m, a third of the half-width a.
        speed: m/s.
        duration: of the run, s, a whole number of periods.
        dt: s.
        preview: periods known beyond the run.
        track_width: m.

    Returns:
        A reference with the lemniscate's exact headings at the samples; its arcs leave the curve by
        less than 0.3 (V T)^2 / R in each eight, for steps V T below R / 10.

    Raises:
        ValueError: for a setting that is not positive, or a duration that is no whole number of
            periods.
    """
    _refuse_unless_positive(radius=radius, speed=speed, track_width=track_width)
    steps = _whole_steps(duration, dt)
    lengths = speed * dt * np.arange(steps + preview + 1)
    _, cosine_lemniscate, _, _ = ellipj(np.sqrt(2.0) * lengths / (3.0 * radius), 0.5)
    headings = 3.0 * (np.pi / 4.0 - np.arctan(cosine_lemniscate))
    yaw_rates = np.diff(headings) / dt
    return _reference(
        np.zeros(3), np.full_like(yaw_rates, speed), yaw_rates, dt, steps, track_width
    )


def from_file(
    path: str | Path, dt: float, preview: int, track_width: float, duration: float | None = None
) -> Reference:
    """Build a reference along a recorded path, through cubic splines in time.

    Args:
        path: CSV file with the header time_s,x_m,y_m; time increasing, the robot always moving
            forwards.
        dt: s.
        preview: periods known beyond the run; past the end of the recording the last wheel speeds
            are held.
        track_width: m.
        duration: of the run, s, a whole number of periods; by default as long as the recording.

    Returns:
        A reference that starts at the recorded pose and has the spline's headings and chord lengths
        at the samples.

    Raises:
        ValueError: in one line, for a missing column, too few rows, a bad number, time that does
            not increase, a stop or a reversal in the path, or a duration longer than the recording.
    """
    _refuse_unless_positive(track_width=track_width, dt=dt)
    time, x, y = _read_path(Path(path))
    recorded_steps = int(np.floor((time[-1] - time[0]) / dt * (1.0 + 1e-12)))
    steps = recorded_steps if duration is None else _whole_steps(duration, dt)
    if not 0 < steps <= recorded_steps:
        raise ValueError(
            f"{path}: column time_s covers {time[-1] - time[0]:g} s but the duration asked for is {steps * dt:g} s; "
            f"choose a duration from {dt:g} s to {recorded_steps * dt:g} s"
        )
    samples = time[0] + dt * np.arange(min(steps + preview, recorded_steps) + 1)
    positions = np.stack([CubicSpline(time, x)(samples), CubicSpline(time, y)(samples)], axis=-1)
    velocities = np.stack(
        [CubicSpline(time, x)(samples, 1), CubicSpline(time, y)(samples, 1)], axis=-1
    )
    headings = _path_headings(path, samples, velocities)
    turns = np.diff(headings)
    speeds = np.linalg.norm(np.diff(positions, axis=0), axis=-1) / (
        dt * np.sinc(turns / (2.0 * np.pi))
    )
    held = (0, steps + preview - len(turns))
    speeds, yaw_rates = np.pad(speeds, held, "edge"), np.pad(turns / dt, held, "edge")
    return _reference(
        np.append(positions[0], headings[0]), speeds, yaw_rates, dt, steps, track_width
    )


def from_wheels(wheels: Float[np.ndarray, "periods 2"], dt: float, track_width: float) -> Reference:
    """Build the reference of given wheel speeds (right, left), m/s, from the origin with heading 0,
    without preview."""
    yaw_rates = wheels @ np.array([1.0, -1.0]) / track_width
    return _reference(np.zeros(3), wheels.mean(axis=1), yaw_rates, dt, len(wheels), track_width)


def wheel_range(reference: Reference) -> tuple[Float[np.ndarray, "2"], Float[np.ndarray, "2"]]:
    """Give the least and the greatest reference speed of each wheel.

    Args:
        reference: any.

    Returns:
        (lower, upper), each (right, left) in m/s: the tightest box of schedules that holds the
        reference.
    """
    return reference.wheels.min(axis=0), reference.wheels.max(axis=0)


def _reference(
    start: Float[np.ndarray, "3"],
    speeds: Float[np.ndarray, "periods"],
    yaw_rates: Float[np.ndarray, "periods"],
    dt: float,
    steps: int,
    track_width: float,
) -> Reference:
    """Turn speeds and yaw rates into wheel speeds and the poses their arcs lead to."""
    difference = yaw_rates * track_width / 2.0
    wheels = np.stack([speeds + difference, speeds - difference], axis=-1)
    turns = dt * yaw_rates
    headings = start[2] + np.concatenate([[0.0], np.cumsum(turns)])
    chords = dt * speeds * np.sinc(turns / (2.0 * np.pi))
    directions = headings[:-1] + turns / 2.0
    moves = np.stack([chords * np.cos(directions), chords * np.sin(directions)], axis=-1)
    positions = start[:2] + np.concatenate([np.zeros((1, 2)), np.cumsum(moves, axis=0)])
    return Reference(wheels, np.column_stack([positions, headings]), dt, steps)


def _read_path(path: Path) -> Float[np.ndarray, "3 rows"]:
    """Read and check a recorded path."""
    with path.open(newline="", encoding="utf-8-sig") as file:
        reader = csv.DictReader(file)
        header = [name.strip() for name in reader.fieldnames or ()]
        reader.fieldnames = header
        for column in COLUMNS:
            if column not in header:
                raise ValueError(
                    f"{path}: column {column} is missing from the header {header}; write the header {','.join(COLUMNS)}"
                )
        rows = list(reader)
    if len(rows) < FEWEST_ROWS:
        raise ValueError(
            f"{path}: {len(rows)} rows of {COLUMNS[0]} are too few; record at least {FEWEST_ROWS}"
        )
    columns = np.array(
        [
            [_number(path, column, line, row) for line, row in enumerate(rows, 2)]
            for column in COLUMNS
        ]
    )
    stalled = np.flatnonzero(np.diff(columns[0]) <= 0.0)
    if stalled.size:
        k = stalled[0]
        raise ValueError(
            f"{path}: column time_s does not increase in line {k + 3}: {columns[0, k]:g} then {columns[0, k + 1]:g}; "
            "sort the rows and drop repeated times"
        )
    return columns


def _number(path: Path, column: str, line: int, row: dict[str, str]) -> float:
    """Read one finite number."""
    try:
        value = float(row[column])
    except (TypeError, ValueError):
        value = np.nan
    if not np.isfinite(value):
        raise ValueError(
            f"{path}: column {column}, line {line}: {row[column]!r} is no finite number; mend or drop the row"
        )
    return value


def _path_headings(
    path: str | Path,
    samples: Float[np.ndarray, "periods+1"],
    velocities: Float[np.ndarray, "periods+1 2"],
) -> Float[np.ndarray, "periods+1"]:
    """Give the unwrapped directions of motion of a path that neither stops nor reverses."""
    speeds = np.linalg.norm(velocities, axis=-1)
    headings = np.unwrap(np.arctan2(velocities[:, 1], velocities[:, 0]))
    stops = np.flatnonzero(speeds < SLOWEST_RECORDING)
    if stops.size:
        raise ValueError(
            f"{path}: columns x_m, y_m: the path moves at {speeds[stops[0]]:g} m/s at {samples[stops[0]]:g} s, "
            f"without a heading there; cut parts slower than {SLOWEST_RECORDING:g} m/s out"
        )
    jumps = np.flatnonzero(np.abs(np.diff(headings)) > np.pi / 2.0)
    if jumps.size:
        turn = np.degrees(headings[jumps[0] + 1] - headings[jumps[0]])
        raise ValueError(
            f"{path}: columns x_m, y_m: the path turns by {turn:.0f} deg in the step at {samples[jumps[0]]:g} s; "
            "shorten dt, or smooth the recording"
        )
    return headings


def _whole_steps(duration: float, dt: float) -> int:
    """Give the number of periods in a duration."""
    _refuse_unless_positive(duration=duration, dt=dt)
    steps = round(duration / dt)
    if steps < 1 or abs(steps * dt - duration) > 1e-9 * duration:
        raise ValueError(
            f"reference: duration = {duration:g} s is no whole number of dt = {dt:g} s; choose a multiple of dt"
        )
    return steps


def _refuse_unless_positive(**values: float) -> None:
    """Refuse a setting that is not a positive number."""
    for field, value in values.items():
        if not (np.isfinite(value) and value > 0.0):
            raise ValueError(
                f"reference: {field} = {value!r} is not usable; give a positive number"
            )
