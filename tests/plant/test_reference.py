"""Laws of the references: their poses solve the kinematics, their shapes are the curves they are
named for."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.special import ellipkinc
from tolerances import EXACT_ARCS, ROUNDING, SPLINE

from jaxtube.plant import reference

TRACK_WIDTH = 0.5
MAKERS = {"two_circles": reference.two_circles, "lemniscate": reference.lemniscate}


def paper_eight(preview=5):
    return reference.two_circles(2.5, 1.36, 30.0, 0.1, preview, TRACK_WIDTH)


def recorded_circle(path, radius=4.0, duration=12.0):
    """Write half a turn at an uneven pace, a sample about each 0.1 s."""
    time = np.linspace(0.0, duration, 121) + 3.0
    angle = 0.25 * (time - 3.0) + 0.1 * np.sin(0.5 * (time - 3.0))
    table = np.column_stack([time, radius * np.sin(angle), radius * (1.0 - np.cos(angle))])
    np.savetxt(path, table, delimiter=",", header="time_s,x_m,y_m", comments="", fmt="%.17g")
    return path


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
    short, long = paper_eight(0), paper_eight(20)
    np.testing.assert_array_equal(long.wheels[:300], short.wheels)
    np.testing.assert_array_equal(long.poses[:301], short.poses)


def test_wheel_range_is_the_tightest_box():
    lower, upper = reference.wheel_range(paper_eight())
    np.testing.assert_allclose([lower, upper], [[1.224, 1.224], [1.496, 1.496]], atol=ROUNDING)


@pytest.mark.parametrize("radius, speed", [(2.5, 1.36), (4.0, 0.7)])
def test_lemniscate_stays_on_the_curve_of_its_radius(radius, speed):
    half_width, dt = 3 * radius, 0.1
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


@pytest.mark.parametrize("dt", [0.1, 1.0])
def test_recorded_path_is_followed_at_the_recorded_times(tmp_path, dt):
    # On a circle arcs are exact at whatever pace and step: what remains is the spline.
    path = reference.from_file(recorded_circle(tmp_path / "path.csv"), dt, 0, TRACK_WIDTH, 11.0)
    time = dt * np.arange(path.steps + 1)
    angle = 0.25 * time + 0.1 * np.sin(0.5 * time)
    exact = np.column_stack([4.0 * np.sin(angle), 4.0 * (1.0 - np.cos(angle)), angle])
    np.testing.assert_allclose(path.poses, exact, atol=SPLINE)
    assert path.steps == round(11.0 / dt)


def test_recorded_path_is_held_past_its_end(tmp_path):
    file = recorded_circle(tmp_path / "path.csv")
    path = reference.from_file(file, 0.1, 7, TRACK_WIDTH)
    assert path.steps == 120 and path.wheels.shape == (127, 2)
    np.testing.assert_array_equal(path.wheels[120:], np.broadcast_to(path.wheels[119], (7, 2)))
    np.testing.assert_array_equal(
        path.poses[:121], reference.from_file(file, 0.1, 0, TRACK_WIDTH).poses
    )
    # Within the recording the preview knows what comes, and holds nothing.
    preview = reference.from_file(file, 0.1, 7, TRACK_WIDTH, 5.0)
    np.testing.assert_array_equal(preview.wheels, path.wheels[:57])


def test_columns_may_come_in_any_order_among_others(tmp_path):
    file = recorded_circle(tmp_path / "path.csv")
    rows = [line.split(",") for line in file.read_text().splitlines()]
    shuffled = tmp_path / "shuffled.csv"
    shuffled.write_text(
        "\n".join(f"{y}, {t},note,{x}".replace(" time_s,note", " time_s,note") for t, x, y in rows)
    )
    np.testing.assert_array_equal(
        reference.from_file(shuffled, 0.1, 0, TRACK_WIDTH).poses,
        reference.from_file(file, 0.1, 0, TRACK_WIDTH).poses,
    )


GOOD = [f"{0.5 * k},{0.4 * k},{0.01 * k * k}" for k in range(9)]
HEADER = "time_s,x_m,y_m"


@pytest.mark.parametrize(
    "lines, duration, message",
    [
        (["time_s,x_m,y", *GOOD], None, "column y_m is missing.*write the header time_s,x_m,y_m"),
        ([], None, "column time_s is missing"),
        ([HEADER, *GOOD[:3]], None, "3 rows of time_s.*at least 4"),
        (
            [HEADER, *GOOD[:4], GOOD[3], *GOOD[4:]],
            None,
            "time_s does not increase in line 6: 1.5 then 1.5; sort",
        ),
        (
            [HEADER, *GOOD[:2], "1.0,nan,0.04", *GOOD[3:]],
            None,
            "column x_m, line 4: 'nan' .*mend or drop",
        ),
        (
            [HEADER, *GOOD[:2], "1.0,0.8,fast", *GOOD[3:]],
            None,
            "column y_m, line 4: 'fast' .*mend or drop",
        ),
        (
            [HEADER, *GOOD[:2], "1.0,0.8", *GOOD[3:]],
            None,
            "column y_m, line 4: None .*mend or drop",
        ),
        (
            [HEADER, *GOOD],
            4.5,
            "time_s covers 4 s but the duration asked for is 4.5 s; choose a duration from 0.1 s to 4 s",
        ),
        ([HEADER, *GOOD], 0.25, "duration = 0.25 s is no whole number of dt = 0.1 s"),
        (
            [HEADER, *[f"{k},1.0,2.0" for k in range(9)]],
            None,
            "columns x_m, y_m: .*0 m/s at 0 s.*cut",
        ),
        (
            [HEADER, *[f"{k},{np.cos(k)},0.0" for k in range(9)]],
            None,
            "columns x_m, y_m: .*turns by .*shorten dt",
        ),
    ],
)
def test_bad_recordings_are_refused_in_one_line(tmp_path, lines, duration, message):
    file = tmp_path / "bad.csv"
    file.write_text("\n".join(lines))
    with pytest.raises(ValueError, match=message) as caught:
        reference.from_file(file, 0.1, 5, TRACK_WIDTH, duration)
    assert "\n" not in str(caught.value)
    assert "bad.csv" in str(caught.value) or duration == 0.25


@pytest.mark.parametrize("maker", MAKERS.values(), ids=MAKERS)
@pytest.mark.parametrize(
    "changed, message",
    [
        ({"radius": 0.0}, "radius = 0.0"),
        ({"speed": float("nan")}, "speed = nan"),
        ({"dt": -0.1}, "dt = -0.1"),
        ({"duration": float("inf")}, "duration = inf"),
        ({"duration": 30.05}, "duration = 30.05 s is no whole number of dt"),
        ({"track_width": 0.0}, "track_width = 0.0"),
    ],
)
def test_bad_settings_are_refused(maker, changed, message):
    good = dict(radius=2.5, speed=1.36, duration=30.0, dt=0.1, preview=5, track_width=TRACK_WIDTH)
    with pytest.raises(ValueError, match=message):
        maker(**{**good, **changed})
