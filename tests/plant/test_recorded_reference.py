"""Laws of references along recorded paths: they keep to the recording, and say what is wrong with
it."""

import numpy as np
import pytest
from scipy.interpolate import CubicSpline
from tolerances import ROUNDING

from jaxtube.plant import reference
from jaxtube.plant.recorded_reference import from_file
from jaxtube.scenario import reference_rules

SPLINE = 1e-4
"""In m and rad; cubic splines through a smooth path sampled each 0.1 s."""

TRACK_WIDTH = 0.5


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
            "column y_m, line 4: nothing .*mend or drop",
        ),
        (
            [HEADER, *GOOD],
            4.5,
            "time_s covers 4 s but .* asked for is 4.5 s; choose a duration from 0.1 s to 4 s",
        ),
        ([HEADER, *GOOD], 0.25, "duration = 0.25 s is no whole number of dt = 0.1 s"),
        (
            [HEADER, *[f"{k},1.0,2.0" for k in range(9)]],
            None,
            "columns x_m, y_m: line 3 repeats the position of line 2.*drop repeated",
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
            "columns x_m, y_m: .* m/s at 4 s, without a heading there; cut",
        ),
        (
            [HEADER, *[f"{17 * 10**17 + k * 10**8},{0.1 * k},0.0" for k in range(9)]],
            None,
            r"column time_s starts at 1.7e\+18: nanoseconds since 1970; .*divide .* by 1e9",
        ),
        (
            [HEADER, *[f"{17 * 10**11 + k * 100},{0.1 * k},0.0" for k in range(9)]],
            None,
            "milliseconds since 1970.*divide the column by 1e3",
        ),
        (
            [HEADER, *[f"{k * 10**8},{0.1 * k},0.0" for k in range(9)]],
            None,
            "time_s: the path moves at 1e-09 m/s on average; give seconds .*nanoseconds by 1e9",
        ),
        ([HEADER, "0," + "1" * 140_000 + ",0"], None, "is not CSV .*save it as CSV in UTF-8"),
        (["x" * 1000], None, "missing from the header x+\\.\\.\\.; write"),
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


@pytest.mark.parametrize("encoding", ["latin-1", "utf-16", "utf-16-le"])
def test_other_encodings_are_refused_with_file_and_cure(tmp_path, encoding):
    file = tmp_path / "saved.csv"
    text = "\n".join(["time_s,x_m,y_m,Stra\u00dfe", *[f"{row}," for row in GOOD]])
    file.write_bytes(text.encode(encoding))
    with pytest.raises(ValueError, match=r"saved\.csv: .*UTF-8") as caught:
        from_file(file, 0.1, 0, TRACK_WIDTH)
    assert "\n" not in str(caught.value)


def test_a_recording_of_too_many_periods_is_refused(tmp_path):
    file = tmp_path / "good.csv"
    file.write_text("\n".join([HEADER, *GOOD]))
    with pytest.raises(ValueError, match=r"has 4e.09 periods of dt = 1e-09 s, more than 1,000,000"):
        from_file(file, 1e-9, 0, TRACK_WIDTH)


def test_scenarios_and_references_know_the_same_most_periods():
    assert reference_rules.MOST_PERIODS == reference.MOST_PERIODS
