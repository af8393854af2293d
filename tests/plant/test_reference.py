"""Laws of the references: their poses solve the kinematics, their shapes are the curves they are
named for."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.special import ellipkinc
from tolerances import EXACT_ARCS, ROUNDING

from jaxtube.plant import reference

TRACK_WIDTH = 0.5
MAKERS = {"two_circles": reference.two_circles, "lemniscate": reference.lemniscate}


def paper_eight(preview=5):
    return reference.two_circles(2.5, 1.36, 30.0, 0.1, preview, TRACK_WIDTH)


@pytest.mark.parametrize("maker", MAKERS.values(), ids=MAKERS)
def test_poses_solve_the_kinematics_of_the_held_wheels(maker):
    path = maker(2.5, 1.36, 20.0, 0.1, 3, TRACK_WIDTH)
    assert path.wheels.shape == (203, 2) and path.poses.shape == (204, 3) and path.steps == 200

    def rates(_, pose, right, left):
        speed = (right + left) / 2
        return speed * np.cos(pose[2]), speed * np.sin(pose[2]), (right - left) / TRACK_WIDTH

    pose = np.zeros(3)
    for wheels, end in zip(path.wheels, path.poses[1:], strict=True):
        pose = solve_ivp(
            rates, (0.0, path.dt), pose, "DOP853", args=tuple(wheels), rtol=1e-12, atol=1e-13
        ).y[:, -1]
        np.testing.assert_allclose(end, pose, atol=EXACT_ARCS)


@pytest.mark.parametrize("circle_steps", [115, 116, 120, 135])
def test_a_circle_that_closes_at_a_sample_returns_to_the_origin_and_changes_side(circle_steps):
    # Where rounding makes 116 or 135 steps a shade less than a circle, the side must change all the
    # same.
    speed = 2 * np.pi * 2.5 / (circle_steps * 0.1)
    eight = reference.two_circles(2.5, speed, 2 * circle_steps * 0.1, 0.1, 0, TRACK_WIDTH)
    np.testing.assert_allclose(
        eight.poses[circle_steps], [0.0, 0.0, 2 * np.pi], atol=1e2 * ROUNDING
    )
    np.testing.assert_allclose(eight.poses[-1], [0.0, 0.0, 0.0], atol=1e2 * ROUNDING)
    np.testing.assert_allclose(np.max(eight.poses[:, 1]), 5.0, atol=2e-3)
    np.testing.assert_allclose(np.min(eight.poses[:, 1]), -5.0, atol=2e-3)
    assert np.all(eight.wheels[:circle_steps, 0] > eight.wheels[:circle_steps, 1])
    assert np.all(eight.wheels[circle_steps:, 0] < eight.wheels[circle_steps:, 1])


def test_the_papers_eight_has_two_wheel_speeds_and_its_window():
    eight = paper_eight()
    np.testing.assert_allclose(np.unique(eight.wheels.round(12)), [1.224, 1.496])
    # Three circles are begun in 30 s, and each next one starts at the first sample past 2 pi R / V
    # = 11.55 s.
    changes = np.flatnonzero(np.diff(np.sign(eight.wheels[:, 0] - eight.wheels[:, 1]))) + 1
    np.testing.assert_array_equal(changes, [116, 231])
    # A change up to one step, 0.136 m, late tilts and shifts the next circle.
    np.testing.assert_allclose(eight.poses[:, :2].min(axis=0), [-2.5, -5.0], atol=0.15)
    np.testing.assert_allclose(eight.poses[:, :2].max(axis=0), [2.5, 5.0], atol=0.15)


def test_preview_prolongs_the_same_run():
    short = paper_eight(0)
    long = paper_eight(20)
    # Arrays of another length may be computed by other instructions.
    np.testing.assert_allclose(long.wheels[:300], short.wheels, rtol=0, atol=ROUNDING)
    np.testing.assert_allclose(long.poses[:301], short.poses, rtol=0, atol=ROUNDING)


@pytest.mark.parametrize("radius, speed", [(2.5, 1.36), (4.0, 0.7)])
def test_lemniscate_stays_on_the_curve_of_its_radius(radius, speed):
    half_width = 3 * radius
    dt = 0.1
    # The textbook curve from its crossing, turned by 45 degrees, with its arc length by the
    # elliptic integral.
    t = np.linspace(-np.pi / 2, 3 * np.pi / 2, 50_001)
    lengths = half_width * (ellipkinc(t, -1.0) - ellipkinc(t[0], -1.0))
    curve = (
        half_width
        * np.cos(t)
        * (1.0 + 1.0j * np.sin(t))
        / (1.0 + np.sin(t) ** 2)
        * np.exp(0.25j * np.pi)
    )
    steps = int(lengths[-1] / (speed * dt))
    path = reference.lemniscate(radius, speed, steps * dt, dt, 0, TRACK_WIDTH)
    exact = np.interp(speed * dt * np.arange(steps + 1), lengths, curve)
    distance = np.abs(path.poses[:, :2] @ np.array([1.0, 1.0j]) - exact)
    assert np.max(distance) < 0.3 * (speed * dt) ** 2 / radius


def test_lemniscate_has_constant_speed_and_bounded_curvature():
    path = reference.lemniscate(2.5, 1.36, 30.0, 0.1, 0, TRACK_WIDTH)
    curvature = (path.wheels[:, 0] - path.wheels[:, 1]) / TRACK_WIDTH / 1.36
    np.testing.assert_allclose(path.wheels.mean(axis=1), 1.36, atol=ROUNDING)
    assert 0.99 / 2.5 < np.max(np.abs(curvature)) <= 1.0 / 2.5
    assert curvature[0] > 0.0 and np.min(curvature) < -0.99 / 2.5


def test_lemniscates_curvature_is_three_times_the_distance_over_the_half_width_squared():
    path = reference.lemniscate(2.5, 1.36, 30.0, 0.01, 0, TRACK_WIDTH)
    curvature = (path.wheels[:, 0] - path.wheels[:, 1]) / TRACK_WIDTH / 1.36
    distance = np.linalg.norm((path.poses[1:, :2] + path.poses[:-1, :2]) / 2, axis=1)
    np.testing.assert_allclose(np.abs(curvature), 3 * distance / 7.5**2, atol=1e-3)


@pytest.mark.parametrize("maker", MAKERS.values(), ids=MAKERS)
@pytest.mark.parametrize(
    "changed, message",
    [
        ({"radius": 0.0}, "radius = 0.0"),
        ({"speed": float("nan")}, "speed = nan"),
        ({"dt": -0.1}, "dt = -0.1"),
        ({"duration": float("inf")}, "duration = inf"),
        (
            {"duration": 1e9},
            "duration = 1e.09 s has 1e.10 periods of dt = 0.1 s, more than 1,000,000",
        ),
        ({"duration": 30.05}, "duration = 30.05 s is no whole number of dt"),
        ({"track_width": 0.0}, "track_width = 0.0"),
    ],
)
def test_bad_settings_are_refused(maker, changed, message):
    good = dict(radius=2.5, speed=1.36, duration=30.0, dt=0.1, preview=5, track_width=TRACK_WIDTH)
    with pytest.raises(ValueError, match=message):
        maker(**{**good, **changed})
