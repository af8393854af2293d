"""References: wheel speeds held over each period, and the poses they lead to, exactly.

    p_{k+1} = p_k + Rot(phi_k) chord(V_k, Om_k)        phi_{k+1} = phi_k + T Om_k

where the chord of the arc has length T V sinc(T Om / 2) and direction T Om / 2. Wheels are (right,
left) in m/s, poses (x m, y m, heading rad) in the world frame; headings are not wrapped.

Source: the eight of Gonzalez, Fiacchini, Guzman, Alamo 2009, section IV, read as two circles;
Bernoulli's lemniscate by Gauss's lemniscate functions, cl(u) = cn(sqrt(2) u | 1/2).
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.special import ellipj

MOST_PERIODS = 1_000_000
"""Most periods of a run: a day at 10 Hz has fewer, and one lap still fits into 1 GB."""

LONGEST_STRETCH = 10
"""Periods that a pair of wheel speeds lasts at most in a reference that jumps."""

TRANSIENT_S = 10.0
"""The first seconds, in which a run forgets its start."""


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


def settled_step(reference: Reference) -> int:
    """Return the step from which a run has settled; its last step where it is shorter than the
    transient."""
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
    refuse_unless_positive(radius=radius, speed=speed, track_width=track_width)
    steps = count_periods(duration, dt)
    # Rounding must not add a step to a circle that closes at a sample.
    circles_done = np.floor(np.arange(steps + preview) * speed * dt / (2.0 * np.pi * radius) + 1e-9)
    yaw_rates = np.where(circles_done % 2 == 0, speed / radius, -speed / radius)
    return make_reference(
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
    refuse_unless_positive(radius=radius, speed=speed, track_width=track_width)
    steps = count_periods(duration, dt)
    lengths = speed * dt * np.arange(steps + preview + 1)
    _, cosine_lemniscate, _, _ = ellipj(np.sqrt(2.0) * lengths / (3.0 * radius), 0.5)
    headings = 3.0 * (np.pi / 4.0 - np.arctan(cosine_lemniscate))
    yaw_rates = np.diff(headings) / dt
    return make_reference(
        np.zeros(3), np.full_like(yaw_rates, speed), yaw_rates, dt, steps, track_width
    )


def jumps(
    slowest: float,
    fastest: float,
    duration: float,
    dt: float,
    preview: int,
    track_width: float,
    seed: int,
) -> Reference:
    """Build a reference whose wheel speeds jump anywhere in a box, from the origin with heading 0.

    A pair of speeds lasts a period in half of the cases, else up to LONGEST_STRETCH of them; in
    half of the cases it is a corner of the box, else uniform in it. A longer run, or one of which
    more is known ahead, begins with the same speeds.

    Args:
        slowest, fastest: least and greatest speed of each wheel, m/s.
        duration: of the run, s, a whole number of periods.
        dt: s.
        preview: periods known beyond the run.
        track_width: m.
        seed: of the draws.

    Raises:
        ValueError: for a duration that is no whole number of periods.
    """
    steps = count_periods(duration, dt)
    periods = steps + preview
    random = np.random.default_rng(seed)
    # Row by row, so that what comes later changes nothing before.
    lasting, length, is_corner, *places = random.random((periods, 7)).T
    lengths = np.where(lasting < 0.5, 1, 1 + (LONGEST_STRETCH * length).astype(int))
    inside = np.stack(places[:2], axis=1)
    corners = np.stack(places[2:], axis=1) < 0.5
    shares = np.where(is_corner[:, None] < 0.5, corners, inside)
    wheels = np.repeat(slowest + shares * (fastest - slowest), lengths, axis=0)[:periods]
    made = from_wheels(wheels, dt, track_width)
    return Reference(made.wheels, made.poses, dt, steps)


def from_wheels(wheels: Float[np.ndarray, "periods 2"], dt: float, track_width: float) -> Reference:
    """Build the reference of given wheel speeds (right, left), m/s, from the origin with heading 0,
    without preview."""
    yaw_rates = wheels @ np.array([1.0, -1.0]) / track_width
    return make_reference(np.zeros(3), wheels.mean(axis=1), yaw_rates, dt, len(wheels), track_width)


def make_reference(
    start: Float[np.ndarray, "3"],
    speeds: Float[np.ndarray, "periods"],
    yaw_rates: Float[np.ndarray, "periods"],
    dt: float,
    steps: int,
    track_width: float,
) -> Reference:
    """Make a reference of the speeds (m/s) and yaw rates (rad/s) of every period from a start pose.

    The wheel speeds follow from them, and the poses are those that the arcs lead to.
    """
    difference = yaw_rates * track_width / 2.0
    wheels = np.stack([speeds + difference, speeds - difference], axis=-1)
    turns = dt * yaw_rates
    headings = start[2] + np.concatenate([[0.0], np.cumsum(turns)])
    chords = dt * speeds * np.sinc(turns / (2.0 * np.pi))
    directions = headings[:-1] + turns / 2.0
    moves = np.stack([chords * np.cos(directions), chords * np.sin(directions)], axis=-1)
    positions = start[:2] + np.concatenate([np.zeros((1, 2)), np.cumsum(moves, axis=0)])
    poses = np.column_stack([positions, headings])
    return Reference(wheels, poses, dt, steps)


def drive(
    poses: Float[np.ndarray, "... 3"],
    wheels: Float[np.ndarray, "... 2"],
    dt: float,
    track_width: float,
) -> Float[np.ndarray, "... 3"]:
    """Return poses one period later, with wheel speeds (right, left) held, m/s: the exact arc."""
    speed = wheels.mean(axis=-1)
    turn = dt * (wheels @ np.array([1.0, -1.0])) / track_width
    chord = dt * speed * np.sinc(turn / (2.0 * np.pi))
    direction = poses[..., 2] + turn / 2.0
    move = np.stack([chord * np.cos(direction), chord * np.sin(direction), turn], axis=-1)
    return poses + move


def count_periods(duration: float, dt: float) -> int:
    """Return the number of periods in a duration; refuse one that is not a whole number of them."""
    refuse_unless_positive(duration=duration, dt=dt)
    refuse_too_many_periods(duration, dt)
    steps = round(duration / dt)
    if steps < 1 or abs(steps * dt - duration) > 1e-9 * duration:
        raise ValueError(
            f"reference: duration = {duration:g} s is no whole number of dt = {dt:g} s; "
            "choose a multiple of dt"
        )
    return steps


def refuse_too_many_periods(duration: float, dt: float) -> None:
    """Refuse a run that would ask for more memory than machines have."""
    if duration > MOST_PERIODS * dt:
        raise ValueError(
            f"reference: duration = {duration:g} s has {duration / dt:.3g} periods of dt = {dt:g} "
            f"s, more than {MOST_PERIODS:,}; shorten the run or lengthen dt"
        )


def refuse_unless_positive(**values: float) -> None:
    """Refuse a setting that is not a positive number."""
    for field, value in values.items():
        if not (np.isfinite(value) and value > 0.0):
            raise ValueError(
                f"reference: {field} = {value!r} is not usable; give a positive number"
            )
