"""Laws of raw paths: the rows as they are, whatever names, header and order they have."""

import os
from pathlib import Path

import numpy as np
import pytest

from jaxtube.recordings.hints import Hints
from jaxtube.recordings.reading import read_path

SHARED = Path(os.environ.get("JAXTUBE_DATA", Path(__file__).parents[2].parent / "shared" / "data"))
needs_data = pytest.mark.skipif(not SHARED.is_dir(), reason="records of real robots are not here")

ANGLE = np.linspace(0.2, 3.0, 15)
POSITIONS = 4.0 * np.column_stack([np.sin(ANGLE), 1.0 - np.cos(ANGLE)])


def write(path, header, *columns, delimiter=","):
    lines = [delimiter.join(repr(float(x)) for x in row) for row in np.column_stack(columns)]
    path.write_text("\n".join([header, *lines]) + "\n" if header else "\n".join(lines))
    return path


@pytest.mark.parametrize("header", ["x_m,y_m", "# x_m,y_m", ""])
def test_a_path_needs_neither_time_nor_header(tmp_path, header):
    path = read_path(write(tmp_path / "path.csv", header, POSITIONS))
    assert path.time is None and path.headings is None and path.word == "line"
    np.testing.assert_array_equal(path.positions, POSITIONS)
    np.testing.assert_array_equal(path.lines, np.arange(15) + 1 + bool(header))


@pytest.mark.parametrize("degrees", [False, True])
def test_columns_without_header_are_told_by_their_numbers(tmp_path, degrees):
    headings = np.rad2deg(ANGLE) if degrees else ANGLE
    alone = read_path(write(tmp_path / "path.csv", "", POSITIONS, headings))
    assert alone.time is None
    np.testing.assert_allclose(alone.headings, ANGLE, atol=1e-12)
    timed = read_path(write(tmp_path / "path.csv", "", ANGLE, POSITIONS))
    np.testing.assert_array_equal(timed.time, ANGLE - ANGLE[0])
    np.testing.assert_array_equal(timed.positions, POSITIONS)
    both = read_path(write(tmp_path / "path.csv", "", ANGLE, POSITIONS, headings, delimiter=" "))
    np.testing.assert_allclose(both.headings, ANGLE, atol=1e-12)
    np.testing.assert_array_equal(both.positions, POSITIONS)
    assert "time = 1 in s (assumed)" in both.guesses


def test_columns_that_their_numbers_do_not_tell_are_asked_for(tmp_path):
    path = write(tmp_path / "path.csv", "", POSITIONS, np.ones(15), np.ones(15))
    with pytest.raises(ValueError, match=r"its 4 columns .* --columns x=NUMBER,y=NUMBER"):
        read_path(path)
    named = read_path(path, Hints(columns={"x": "2", "y": "1"}))
    np.testing.assert_array_equal(named.positions, POSITIONS[:, ::-1])


def test_stamps_are_returned_as_they_are(tmp_path):
    stamps = [0.0, 0.1, 0.1, 0.3, 0.2]
    text = "\n".join(f"170000000{stamp:.1f},{k},0" for k, stamp in enumerate(stamps))
    (tmp_path / "path.csv").write_text("t,x,y\n\n" + text)
    path = read_path(tmp_path / "path.csv")
    assert path.time.tolist() == stamps
    assert path.lines.tolist() == [3, 4, 5, 6, 7]


def test_pose_files_have_time_and_headings(tmp_path):
    quaternions = np.column_stack([0 * ANGLE, 0 * ANGLE, np.sin(ANGLE / 2), np.cos(ANGLE / 2)])
    columns = (100.0 + ANGLE, POSITIONS, 0 * ANGLE, quaternions)
    path = read_path(write(tmp_path / "poses.tum", "", *columns, delimiter=" "))
    np.testing.assert_allclose(path.headings, ANGLE, atol=1e-12)
    np.testing.assert_allclose(path.time, ANGLE - ANGLE[0], atol=1e-12)


def test_large_coordinates_are_counted_from_the_first_point(tmp_path):
    far = np.array([444444.125, 5123456.25])
    path = read_path(write(tmp_path / "path.csv", "easting,northing", far + POSITIONS))
    np.testing.assert_array_equal(path.origin, far + POSITIONS[0])
    np.testing.assert_allclose(path.positions, POSITIONS - POSITIONS[0], rtol=0, atol=2e-9)
    assert not read_path(write(tmp_path / "path.csv", "x,y", POSITIONS)).origin.any()


def test_race_lines_with_headings_from_north_are_warned_of(tmp_path):
    header = "# s_m; x_m; y_m; psi_rad; kappa_radpm; vx_mps; ax_mps2"
    rest = np.ones((15, 3))
    columns = (4.0 * ANGLE, POSITIONS, ANGLE - np.pi / 2.0, rest)
    path = read_path(write(tmp_path / "line.csv", header, *columns, delimiter="; "))
    assert path.time is None
    np.testing.assert_array_equal(path.positions, POSITIONS)
    assert any("headings do not lie along the way" in clause for clause in path.guesses)


def test_a_path_on_the_globe_is_refused(tmp_path):
    path = write(tmp_path / "path.csv", "time,latitude,longitude", ANGLE, POSITIONS)
    with pytest.raises(ValueError, match=r"latitude is in degrees on the globe; project the path"):
        read_path(path)


@needs_data
@pytest.mark.parametrize(
    ("name", "rows", "end"),
    [
        ("warthog_grass2_path", 1694, [-6.20135, -6.83957]),
        ("maxxii_planned", 9258, [-0.461904589090108, -1.11075294807565]),
    ],
)
def test_real_paths_are_read(name, rows, end):
    path = read_path(SHARED / "paths" / f"{name}.csv")
    assert path.time.shape == (rows,) and path.lines[-1] == rows + 1
    assert path.positions[-1].tolist() == end
