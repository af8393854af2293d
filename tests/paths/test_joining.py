"""Laws of paths onto a reference: they begin and end where they must, keep both wheels in their
box, are soon there, and late by what they say."""

import numpy as np
import pytest
from scipy.optimize import approx_fprime

from jaxtube.paths import dubins, joining
from jaxtube.paths.profile import WheelLimits
from jaxtube.plant.reference import drive, make_reference, two_circles

DT = 0.1
TRACK = 0.5
LIMITS = WheelLimits(1.224, 1.496, None, TRACK)
MET = 1e-9


def make_path(duration=30.0):
    return two_circles(2.5, 1.36, duration, DT, 6, TRACK)


def draw_poses(count, spread, seed=0):
    generator = np.random.default_rng(seed)
    places = generator.uniform(-spread, spread, (count, 2))
    return np.column_stack([places, generator.uniform(-np.pi, np.pi, count)])


def follow_pieces(start, pieces, sides, radius):
    """Where a path of arcs and lines ends."""
    pose = np.asarray(start, float)
    for length, side in zip(pieces, sides, strict=True):
        turn = side * length / radius
        chord = length * np.sinc(turn / (2 * np.pi))
        direction = pose[2] + turn / 2
        pose = pose + np.array([chord * np.cos(direction), chord * np.sin(direction), turn])
    return pose


def find_gap(pose, end):
    gap = np.asarray(end) - pose
    gap[2] = np.angle(np.exp(1j * gap[2]))
    return np.abs(gap).max()


def test_every_path_of_dubins_ends_in_its_pose():
    start = np.array([0.3, -0.2, 0.7])
    ends = draw_poses(200, 6.0)
    lengths = dubins.find_paths(start, ends, 1.7)
    assert np.isfinite(lengths[:, :2]).all()  # LSL and RSR always exist
    for end, of_end in zip(ends, lengths, strict=True):
        for pieces, sides in zip(of_end, dubins.SIDES, strict=True):
            if np.isfinite(pieces).all():
                assert np.all(pieces >= 0)
                assert find_gap(follow_pieces(start, pieces, sides, 1.7), end) < MET


def test_the_shortest_path_straight_ahead_is_the_straight_line():
    lengths = dubins.find_paths(np.zeros(3), np.array([[3.0, 0.0, 0.0]]), 1.0).sum(axis=2)
    assert lengths.min() == pytest.approx(3.0, abs=MET)


@pytest.mark.parametrize("spread", [0.02, 0.5, 5.0])
def test_a_joining_path_leads_from_the_pose_onto_the_reference_within_the_box(spread):
    path = make_path()
    for start in draw_poses(20, spread, seed=1):
        asked = joining.extend(path, start, LIMITS)
        found = joining.find_joining(start, asked, LIMITS)
        assert found is not None
        assert np.all((found.wheels >= LIMITS.least) & (found.wheels <= LIMITS.greatest))
        pose = start
        for wheels in found.wheels:
            pose = drive(pose, wheels, DT, TRACK)
        assert find_gap(pose, asked.poses[found.joins]) < MET
        assert found.late == len(found.wheels) - found.joins >= 0


def test_a_pose_on_the_reference_needs_no_path():
    path = make_path()
    found = joining.find_joining(path.poses[0], path, LIMITS)
    assert found is not None
    assert (len(found.wheels), found.joins) == (0, 0)


@pytest.mark.parametrize("radius", [4.0, 1e6])
@pytest.mark.parametrize("aside", [-0.02, 0.02])
def test_a_pose_a_little_aside_of_a_path_with_room_is_on_time(radius, aside):
    path = two_circles(radius, 1.36, 30.0, DT, 6, TRACK)
    found = joining.find_joining(np.array([0.0, aside, 0.0]), path, LIMITS)
    assert found is not None
    assert found.late == 0
    assert len(found.wheels) <= 16


@pytest.mark.parametrize("aside", [-0.02, 0.02])
def test_the_sharpest_turn_in_the_box_is_joined_after_a_detour(aside):
    """From beside it a path that bends no more than the turn cannot come back to it at once."""
    found = joining.find_joining(np.array([0.0, aside, 0.0]), make_path(), LIMITS)
    assert found is not None
    assert len(found.wheels) > 60


def test_wheels_of_one_speed_alone_join_nothing():
    limits = WheelLimits(1.36, 1.36, None, TRACK)
    path = make_path()
    assert joining.find_joining(np.array([0.0, 0.5, 1.0]), path, limits) is None


def test_what_the_last_pose_owes_to_each_wheel_speed_is_its_derivative():
    generator = np.random.default_rng(2)
    wheels = generator.uniform(LIMITS.least, LIMITS.greatest, (6, 2))
    wheels[2] = 1.3  # a straight period
    start = np.array([0.1, 0.2, 0.3])

    def end(speeds):
        return joining.along(start, speeds.reshape(-1, 2), DT, TRACK).poses[-1]

    slope = joining._differentiate(joining.along(start, wheels, DT, TRACK), TRACK)
    expected = approx_fprime(wheels.ravel(), end, 1e-7)
    np.testing.assert_allclose(slope, expected, atol=1e-6)


def test_a_pose_is_driven_where_references_have_it():
    generator = np.random.default_rng(3)
    wheels = generator.uniform(-1.0, 2.0, (30, 2))
    yaw_rates = (wheels[:, 0] - wheels[:, 1]) / TRACK
    start = np.array([1.0, -2.0, 0.4])
    reference = make_reference(start, wheels.mean(axis=1), yaw_rates, DT, 30, TRACK)
    pose = start
    for period, now in enumerate(wheels):
        pose = drive(pose, now, DT, TRACK)
        np.testing.assert_allclose(pose, reference.poses[period + 1], atol=1e-12)
