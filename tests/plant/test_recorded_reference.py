"""Laws of references along recorded paths: they keep to the recording, and say what is wrong with
it."""

import numpy as np
import pytest
from scipy.interpolate import CubicSpline
from tolerances import ROUNDING

from jaxtube.plant import reference
from jaxtube.plant.recorded_reference import follow_recording
from jaxtube.recordings.reading import read_path
from jaxtube.scenario import reference_rules

SPLINE = 1e-4
"""In m and rad; cubic splines through a smooth path sampled each 0.1 s."""

TRACK_WIDTH = 0.5


def from_file(file, *asked):
    """Return the reference along a file: dt, preview, track width, duration."""
    return follow_recording(read_path(file), *asked)


def recorded_circle(path, radius=4.0, duration=12.0):
    """Write half a turn at an uneven pace, a sample about each 0.1 s."""
    time = np.linspace(0.0, duration, 121) + 3.0
    angle = 0.25 * (time - 3.0) + 0.1 * np.sin(0.5 * (time - 3.0))
    table = np.column_stack([time, radius * np.sin(angle), radius * (1.0 - np.cos(angle))])
    np.savetxt(path, table, delimiter=",", header="time_s,x_m,y_m", comments="", fmt="%.17g")
    return path


def recorded_mower(path):
    """Write 90 s of lanes at 1 m/s with turns of 180 deg within 4 s, ten rows a second."""
    time = np.arange(0.0, 90.0, 1e-3)
    yaw_rate = np.zeros_like(time)
    for number, start in enumerate(np.arange(8.0, 90.0, 12.0)):
        share = np.clip((time - start) / 4.0, 0.0, 1.0)
        yaw_rate += (-1) ** number * np.pi / 2.0 * np.sin(np.pi * share) ** 2
    heading = 1e-3 * np.cumsum(yaw_rate)
    x = 1e-3 * np.cumsum(np.cos(heading))
    y = 1e-3 * np.cumsum(np.sin(heading))
    table = np.column_stack([time, x, y])[::100]
    np.savetxt(path, table, delimiter=",", header="time_s,x_m,y_m", comments="", fmt="%.6f")
    return table


@pytest.mark.parametrize("dt", [0.1, 1.0])
def test_recorded_path_is_followed_at_the_recorded_times(tmp_path, dt):
    # On a circle arcs are exact at whatever pace and step: what remains is the spline.
    path = from_file(recorded_circle(tmp_path / "path.csv"), dt, 0, TRACK_WIDTH, 11.0)
    time = dt * np.arange(path.steps + 1)
    angle = 0.25 * time + 0.1 * np.sin(0.5 * time)
    exact = np.column_stack([4.0 * np.sin(angle), 4.0 * (1.0 - np.cos(angle)), angle])
    np.testing.assert_allclose(path.poses, exact, atol=SPLINE)
    assert path.steps == round(11.0 / dt)


def test_recorded_path_is_held_past_its_end(tmp_path):
    file = recorded_circle(tmp_path / "path.csv")
    path = from_file(file, 0.1, 7, TRACK_WIDTH)
    assert path.steps == 120 and path.wheels.shape == (127, 2)
    np.testing.assert_array_equal(path.wheels[120:], np.broadcast_to(path.wheels[119], (7, 2)))
    without_preview = from_file(file, 0.1, 0, TRACK_WIDTH)
    np.testing.assert_allclose(path.poses[:121], without_preview.poses, rtol=0, atol=ROUNDING)
    # Within the recording the preview knows what comes, and holds nothing.
    preview = from_file(file, 0.1, 7, TRACK_WIDTH, 5.0)
    np.testing.assert_allclose(preview.wheels, path.wheels[:57], rtol=0, atol=ROUNDING)


def test_columns_may_come_in_any_order_among_others(tmp_path):
    file = recorded_circle(tmp_path / "path.csv")
    rows = [line.split(",") for line in file.read_text().splitlines()]
    shuffled = tmp_path / "shuffled.csv"
    shuffled.write_text(
        "\n".join(f"{y}, {t},note,{x}".replace(" time_s,note", " time_s,note") for t, x, y in rows)
    )
    np.testing.assert_array_equal(
        from_file(shuffled, 0.1, 0, TRACK_WIDTH).poses,
        from_file(file, 0.1, 0, TRACK_WIDTH).poses,
    )


GOOD = [f"{0.5 * k},{0.4 * k},{0.01 * k * k}" for k in range(9)]
HEADER = "time_s,x_m,y_m"


@pytest.mark.parametrize(
    "lines, duration, message",
    [
        (["time_s,x_m,z_m", *GOOD], None, "hold the coordinate y, among .*; name it: --columns y="),
        (["x_m,y_m", *(row.partition(",")[2] for row in GOOD)], None, "has no time; give a column"),
        ([], None, "is empty; name another file"),
        ([HEADER, *GOOD[:3]], None, "3 rows are too few; record at least 4"),
        (
            [HEADER, *GOOD[:4], GOOD[3], *GOOD[4:]],
            None,
            "time does not increase at line 6: 1.5 s then 1.5 s after the first row; sort",
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
            "line 4 has 2 cells, the header names 3; mend or drop",
        ),
        (
            [HEADER, *GOOD],
            4.5,
            "its time covers 4 s but .* asked for is 4.5 s; choose a duration from 0.1 s to 4 s",
        ),
        ([HEADER, *GOOD], 0.25, "duration = 0.25 s is no whole number of dt = 0.1 s"),
        (
            [HEADER, *[f"{k},1.0,2.0" for k in range(9)]],
            None,
            "line 3 repeats the position of line 2.*drop repeated",
        ),
        (
            [HEADER, *GOOD[:3], "", "", "1.5,1.2,0.09", "2.0,1.2,0.09", "2.5,1.2,0.09"],
            None,
            "line 8 repeats the position of line 7",
        ),
        ([HEADER, "", *GOOD[:2], "", "1.0,fast,0.04"], None, "column x_m, line 6: 'fast'"),
        (
            [HEADER, *[f"{k},{(k - 4) ** 3},0.0" for k in range(9)]],
            None,
            "the path moves at .* m/s at 4 s, without a heading there; cut",
        ),
        (
            [
                f"{HEADER},heading_rad",
                *[f"{row},{np.pi if k > 4 else 0.0}" for k, row in enumerate(GOOD)],
            ],
            None,
            "at line 7 the robot moves against its heading, .*; cut parts in reverse out",
        ),
        (
            [HEADER, *[f"{k * 10**8},{0.1 * k},0.0" for k in range(9)]],
            None,
            "the path moves at 1e-09 m/s on average, .* give seconds .*nanoseconds by 1e9",
        ),
        ([HEADER, "0," + "1" * 140_000 + ",0"], None, "is no table of numbers; give rows"),
        (["x" * 1000], None, "is no table of numbers; give rows"),
        (
            [HEADER, *[f"{k},{np.cos(k)},0.0" for k in range(9)]],
            None,
            "the path turns by .*shorten dt",
        ),
    ],
)
def test_bad_recordings_are_refused_in_one_line(tmp_path, lines, duration, message):
    file = tmp_path / "bad.csv"
    file.write_text("\n".join(lines))
    with pytest.raises(ValueError, match=message) as caught:
        from_file(file, 0.1, 5, TRACK_WIDTH, duration)
    assert "\n" not in str(caught.value)
    assert "bad.csv" in str(caught.value) or duration == 0.25


@pytest.mark.parametrize(
    "dt, reached, drifted", [(0.1, 1e-4, 0.01), (0.5, 6e-3, 0.3), (1.0, 0.045, 1.4)]
)
def test_a_reference_does_not_drift_off_its_recording(tmp_path, dt, reached, drifted):
    """Arcs with the recording's headings alone would end `drifted` m off."""
    file = tmp_path / "mower.csv"
    table = recorded_mower(file)
    path = from_file(file, dt, 0, TRACK_WIDTH)
    spline = CubicSpline(table[:, 0], table[:, 1:])
    recorded = spline(dt * np.arange(path.steps + 1))
    off = np.linalg.norm(path.poses[:, :2] - recorded, axis=1)
    assert off.max() < reached
    assert off[-1] < reached / 10
    velocity = spline(dt * np.arange(path.steps + 1), 1)
    headings = np.unwrap(np.arctan2(velocity[:, 1], velocity[:, 0]))
    turns = np.diff(headings)
    chords = np.linalg.norm(np.diff(recorded, axis=0), axis=1)
    ends = np.cumsum(chords * np.exp(1j * (headings[:-1] + turns / 2.0)))
    assert abs(ends[-1] - (recorded[-1] - recorded[0]) @ np.array([1.0, 1.0j])) > drifted


def test_stamps_since_1970_lose_no_step(tmp_path):
    """A float64 of 1.7e9 s knows 0.24 us; decimals know the recording's own digits."""
    for tenths in range(100, 200):
        file = tmp_path / "stamped.csv"
        rows = [f"{17 * 10**9 + k}e-1,{0.1 * k},0.0" for k in range(tenths + 1)]
        file.write_text("\n".join([HEADER, *rows]))
        assert from_file(file, 0.1, 0, TRACK_WIDTH, tenths / 10).steps == tenths
        assert from_file(file, 0.1, 0, TRACK_WIDTH).steps == tenths


@pytest.mark.parametrize("unit, per_second", [("ns", 10**9), ("us", 10**6), ("ms", 10**3)])
def test_stamps_since_1970_are_told_by_their_size(tmp_path, unit, per_second):
    file = tmp_path / "stamped.csv"
    rows = [f"{(17 * 10**9 + k) * per_second // 10},{0.1 * k},0.0" for k in range(9)]
    file.write_text("\n".join(["stamp,x_m,y_m", *rows]))
    reference = from_file(file, 0.1, 0, TRACK_WIDTH)
    assert reference.steps == 8
    np.testing.assert_allclose(reference.wheels, 1.0, rtol=1e-9)


@pytest.mark.parametrize("encoding", ["latin-1", "utf-16", "utf-16-le"])
def test_other_encodings_delimiters_and_tables_without_header_are_read(tmp_path, encoding):
    file = tmp_path / "saved.csv"
    text = "\n".join(["time_s;x_m;y_m;Stra\u00dfe", *[f"{row},".replace(",", ";") for row in GOOD]])
    file.write_bytes(text.encode(encoding))
    plain = tmp_path / "plain.txt"
    plain.write_text("\n".join(row.replace(",", " ") for row in GOOD))
    expected = from_file(file, 0.1, 0, TRACK_WIDTH)
    np.testing.assert_array_equal(from_file(plain, 0.1, 0, TRACK_WIDTH).poses, expected.poses)


def test_coordinates_far_from_zero_stay_those_of_the_file(tmp_path):
    file = tmp_path / "near.csv"
    file.write_text("\n".join([HEADER, *GOOD]))
    far = tmp_path / "far.csv"
    origin = np.array([500123.5, 4649776.25])
    table = np.loadtxt(file, delimiter=",", skiprows=1) + np.append(0.0, origin)
    np.savetxt(far, table, delimiter=",", header=HEADER, comments="", fmt="%.17g")
    near = from_file(file, 0.1, 0, TRACK_WIDTH)
    poses = from_file(far, 0.1, 0, TRACK_WIDTH).poses
    np.testing.assert_allclose(poses - np.append(origin, 0.0), near.poses, rtol=0, atol=1e-8)


def test_a_recording_of_too_many_periods_is_refused(tmp_path):
    file = tmp_path / "good.csv"
    file.write_text("\n".join([HEADER, *GOOD]))
    with pytest.raises(ValueError, match=r"has 4e.09 periods of dt = 1e-09 s, more than 1,000,000"):
        from_file(file, 1e-9, 0, TRACK_WIDTH)


def test_scenarios_and_references_know_the_same_most_periods():
    assert reference_rules.MOST_PERIODS == reference.MOST_PERIODS
