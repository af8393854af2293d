"""Laws of missions: made and real paths are driven with the wheels in their box, or refused with
time and place."""

import functools
import os
from pathlib import Path

import numpy as np
import pytest
from made_paths import MADE, add_noise, drive, stand, write_made
from scipy.spatial import KDTree
from test_cleaning import raw_of

from jaxtube.paths.driving import Drive
from jaxtube.paths.missions import plan_path
from jaxtube.paths.profile import WheelLimits
from jaxtube.recordings.reading import read_path

SHARED = Path(os.environ.get("JAXTUBE_DATA", Path(__file__).parents[2].parent / "shared" / "data"))
LIMITS = WheelLimits(least=0.2, greatest=1.5, acceleration=1.0, track_width=0.5)
DRIVE = Drive(LIMITS, dt=0.1, preview=6, speed=1.0, largest_deviation=0.1)

CUTS = {
    "stops": (2, "8.0 s, (7.19, 1.90) m: stands for 5.05 s"),
    "duplicates": (1, "repeated rows left out"),
    "unordered": (1, "time falls back 9 times"),
    "no_time": (1, ""),
    "semicolons": (1, ""),
    "byte_order_mark": (1, ""),
    "carriage_returns": (1, ""),
    "no_header": (1, ""),
    "utm": (1, ""),
    "closed": (1, "meets its start"),
    "figure_eight": (1, "meets its start"),
    "hairpin": (1, ""),
    "gnss": (1, ""),
    "slow_gnss": (1, ""),
    "reversal": (2, "5.9 s, (5.85, 0.57) m: turns back by 180 deg (reverses or turns on the spot"),
    "reversal_with_headings": (1, "5.9 s, (5.85, 0.57) m: reverses for 5.90 m"),
    "turned_about": (2, "5.9 s, (5.85, 0.57) m: turns on the spot by 180 deg"),
    "corner": (2, "5.0 s, (5.00, 0.00) m: turns on the spot by 90 deg"),
    "noisy_corner": (2, "turns on the spot by 89 deg"),
}
"""Missions of each made path, and what is said of it."""


def assert_drives(mission, limits):
    """Recompute what a mission claims from its held wheel speeds and its rows alone."""
    reference = mission.reference
    wheels = reference.wheels
    rounding = 1e-9 * limits.greatest
    assert limits.least - rounding <= wheels.min() and wheels.max() <= limits.greatest + rounding
    if limits.acceleration is not None:
        changes = np.abs(np.diff(wheels, axis=0)) / reference.dt
        assert changes.max() <= limits.acceleration * (1.0 + 1e-9)
    driven = integrate(reference, limits.track_width)
    np.testing.assert_allclose(driven[::STEPS_PER_PERIOD][-1], reference.poses[-1], atol=1e-6)
    run = driven[: STEPS_PER_PERIOD * reference.steps + 1, :2]
    off, _ = KDTree(run).query(mission.piece.raw.positions)
    last = STEP_LENGTH * limits.greatest * reference.dt
    # Rows beyond the last whole period are not driven to.
    ahead = mission.piece.raw.positions - run[-1]
    is_passed = ahead @ [np.cos(driven[-1, 2]), np.sin(driven[-1, 2])] <= 0.0
    near = np.linalg.norm(ahead, axis=1) < 2.0 * limits.greatest * reference.dt
    assert off[is_passed | ~near].max() <= mission.deviations.from_rows + last
    assert mission.deviations.from_rows <= DRIVE.largest_deviation * 1.05


STEPS_PER_PERIOD = 50
STEP_LENGTH = 1.0 / STEPS_PER_PERIOD


def integrate(reference, track_width):
    """Integrate held wheel speeds by the midpoint rule."""
    wheels = np.repeat(reference.wheels, STEPS_PER_PERIOD, axis=0)
    step = reference.dt / STEPS_PER_PERIOD
    turns = step * (wheels[:, 0] - wheels[:, 1]) / track_width
    headings = reference.poses[0, 2] + np.append(0.0, np.cumsum(turns))
    middle = headings[:-1] + turns / 2.0
    moves = step * wheels.mean(axis=1)[:, None] * np.column_stack([np.cos(middle), np.sin(middle)])
    positions = reference.poses[0, :2] + np.vstack([np.zeros(2), np.cumsum(moves, axis=0)])
    return np.column_stack([positions, headings])


@pytest.fixture(scope="module")
def plan_made(tmp_path_factory):
    """Plan a made path, once."""
    folder = tmp_path_factory.mktemp("made")
    return functools.cache(lambda name: plan_path(read_path(write_made(folder, name)), DRIVE))


@pytest.mark.parametrize("name", MADE)
def test_made_paths_drive_or_are_refused_with_time_and_place(plan_made, name):
    plan = plan_made(name)
    count, words = CUTS[name]
    assert len(plan.missions) == count
    said = [str(note) for note in (*plan.notes, *(refused.note for refused in plan.refused))]
    assert any(words in text for text in said) if words else said == []
    for mission in plan.missions:
        assert_drives(mission, LIMITS)


def test_every_made_path_is_expected():
    assert set(CUTS) == set(MADE)


def test_formats_of_one_drive_give_one_mission(plan_made):
    names = ("no_time", "semicolons", "byte_order_mark", "carriage_returns", "no_header", "utm")
    wheels = [plan_made(name).missions[0].reference.wheels for name in names]
    for other in wheels[1:]:
        np.testing.assert_allclose(other, wheels[0], atol=1e-5)


@pytest.mark.parametrize("noise", [0.01, 0.02])
def test_a_noisy_drive_is_driven_nearer_to_the_true_one_than_its_rows_are(noise):
    made = drive()
    plan = plan_path(raw_of(add_noise(made, noise)), DRIVE)
    driven = integrate(plan.missions[0].reference, LIMITS.track_width)
    off, _ = KDTree(driven[:, :2]).query(made[1][2:-2])
    assert off.max() < 1.5 * noise
    assert plan.missions[0].deviations.from_rows > 2.0 * noise


def test_a_closed_path_ends_where_it_began_in_the_same_direction(plan_made):
    mission = plan_made("closed").missions[0]
    reference = mission.reference
    assert mission.fit.curve.closed
    lap = mission.profile.duration
    ends = reference.dt * reference.steps
    assert lap <= ends < lap + reference.dt
    # The preview is the beginning of the next lap.
    beyond = reference.poses[reference.steps] - reference.poses[0]
    along = (ends - lap) * reference.wheels[0].mean()
    assert np.linalg.norm(beyond[:2]) == pytest.approx(along, abs=1e-3)
    assert beyond[2] == pytest.approx(2.0 * np.pi + along / 3.0, abs=0.02)


def test_a_path_keeps_its_recorded_speeds_where_its_wheels_can():
    time, positions, headings = drive(speed=0.6)
    half = len(time) // 2
    # The second half in half the time.
    time = np.concatenate([time[:half], time[half] + 0.5 * (time[half:] - time[half])])
    recorded = DRIVE._replace(recorded_timing=True)
    plan = plan_path(raw_of((time, positions, headings)), recorded)
    mission = plan.missions[0]
    speeds = mission.reference.wheels.mean(axis=1)
    np.testing.assert_allclose(speeds[20:120], 0.6, atol=0.01)
    np.testing.assert_allclose(speeds[-40:], 1.2, atol=0.02)
    assert_drives(mission, LIMITS)


def test_a_stop_can_be_driven_through_at_speed():
    made = stand(drive(), 80, 5.0)
    plan = plan_path(raw_of(made), DRIVE._replace(through_stops=True, recorded_timing=True))
    (mission,) = plan.missions
    assert mission.reference.steps == pytest.approx(239, abs=8)
    assert mission.reference.wheels.mean(axis=1).min() > 0.6


def test_a_turn_too_sharp_for_the_box_is_refused_with_its_radius_and_a_cure():
    narrow = DRIVE._replace(limits=LIMITS._replace(least=0.9), largest_deviation=0.03)
    plan = plan_path(raw_of(drive(((4, 0, 0), (1, 0, 1.6), (2, 1.6, 1.6), (4, 0, 0)))), narrow)
    assert plan.missions == []
    note = plan.refused[0].note
    radius = float(note.text.split("radius of ")[1].split()[0])
    assert radius == pytest.approx(1.0 / 1.6, rel=0.2)
    least = 2.4 / 0.6 * LIMITS.track_width / 2.0
    assert f"turn with {least:.3g} m or more" in note.text
    assert "lower reference.wheel_speed_min_mps to" in note.text
    assert note.place.time == pytest.approx(6.0, abs=1.5)


def test_the_speed_that_a_refusal_names_lets_the_path_drive():
    made = raw_of(drive(((4, 0, 0), (1, 0, 0.6), (2, 0.6, 0.6), (1, 0.6, 0), (4, 0, 0))))
    narrow = DRIVE._replace(
        limits=LIMITS._replace(least=1.3, acceleration=None), largest_deviation=0.01
    )
    text = plan_path(made, narrow).refused[0].note.text
    named = float(text.split("wheel_speed_min_mps to ")[1].split(",")[0])
    lower = narrow._replace(limits=narrow.limits._replace(least=0.98 * named))
    assert len(plan_path(made, lower).missions) == 1


def test_slow_wheels_that_cannot_change_fast_are_refused_by_name():
    slow = DRIVE._replace(limits=LIMITS._replace(least=0.9, acceleration=0.02))
    plan = plan_path(raw_of(drive(((4, 0, 0), (0.3, 0, 0.8), (2, 0.8, 0.8), (4, 0, 0)))), slow)
    text = plan.refused[0].note.text
    assert "no speed keeps the wheels" in text and "wheel_acceleration_max_mps2" in text


@pytest.mark.parametrize(
    "seed", [*range(6), *(pytest.param(seed, marks=pytest.mark.slow) for seed in range(6, 12))]
)
def test_random_paths_drive_within_random_limits_or_are_refused(seed):
    random = np.random.default_rng(seed)
    lengths = random.uniform(1.0, 4.0, 8)
    ends = random.uniform(-0.8, 0.8, 9)
    bends = tuple(zip(lengths, ends[:-1], ends[1:], strict=True))
    made = add_noise(drive(bends), random.choice([0.0, 0.003, 0.015]), seed)
    limits = WheelLimits(
        least=random.uniform(0.05, 0.8),
        greatest=random.uniform(1.1, 2.0),
        acceleration=random.choice([None, 0.3, 1.0]),
        track_width=0.5,
    )
    plan = plan_path(raw_of(made), DRIVE._replace(limits=limits))
    assert plan.outcomes
    for mission in plan.missions:
        assert_drives(mission, limits)
    for refused in plan.refused:
        assert refused.note.place is not None and ";" in refused.note.text


@pytest.mark.skipif(not SHARED.exists(), reason="needs the data of real robots")
@pytest.mark.parametrize(
    "name, limits, speed, missions",
    [
        ("warthog_grass2_path", WheelLimits(0.3, 1.5, 1.0, 1.08), 1.0, 16),
        ("maxxii_planned", WheelLimits(0.03, 0.22, 0.2, 0.16), 0.1, 1),
    ],
)
def test_real_paths_drive(name, limits, speed, missions):
    off = 0.2 * limits.track_width
    asked = DRIVE._replace(limits=limits, speed=speed, largest_deviation=off)
    plan = plan_path(read_path(SHARED / "paths" / f"{name}.csv"), asked)
    assert len(plan.missions) == missions and plan.refused == []
    for mission in plan.missions:
        wheels = mission.reference.wheels
        assert limits.least <= wheels.min() and wheels.max() <= limits.greatest
        changes = np.abs(np.diff(wheels, axis=0)) / mission.reference.dt
        assert changes.max() <= limits.acceleration
        driven = integrate(mission.reference, limits.track_width)
        distances, _ = KDTree(driven[:, :2]).query(mission.piece.raw.positions)
        assert distances.max() < 0.06 * limits.track_width


def test_noise_along_the_path_does_not_look_like_speed():
    made = add_noise(drive(speed=0.3), 0.02)
    plan = plan_path(raw_of(made), DRIVE._replace(recorded_timing=True))
    speeds = plan.missions[0].reference.wheels.mean(axis=1)
    assert speeds.mean() == pytest.approx(0.3, rel=0.02)
    np.testing.assert_allclose(speeds[15:-15], 0.3, atol=0.05)


def test_stamps_in_whole_seconds_are_time_enough_and_one_stamp_for_all_is_none():
    time, positions, headings = drive(speed=0.6)
    recorded = DRIVE._replace(recorded_timing=True)
    plan = plan_path(raw_of((np.floor(time), positions, headings)), recorded)
    speeds = plan.missions[0].reference.wheels.mean(axis=1)
    assert speeds.mean() == pytest.approx(0.6, rel=0.05)
    assert "share the stamp of the row before" in str(plan.notes[0])
    plan = plan_path(raw_of((0.0 * time, positions, headings)), recorded)
    np.testing.assert_allclose(plan.missions[0].reference.wheels.mean(axis=1), 1.0, atol=1e-3)
    assert "all rows have the same time" in str(plan.notes[0])
