"""Laws of logs out of tables: one robot reads alike under any names and units, nothing is dropped
or assumed without a word, and what cannot be told is refused with the option that tells it."""

import os
from pathlib import Path

import numpy as np
import pytest
from tolerances import ROUNDING

from jaxtube.recordings.hints import Hints
from jaxtube.recordings.reading import read_log

SHARED = Path(os.environ.get("JAXTUBE_DATA", Path(__file__).parents[2].parent / "shared" / "data"))
needs_data = pytest.mark.skipif(not SHARED.is_dir(), reason="records of real robots are not here")

RADIUS = 0.165
TICKS = 2048.0
SECOND_BY_SECOND = np.arange(6.0)


def drive(turn=0.3):
    """Return time, (right, left) and poses of a robot on an arc, its heading beyond pi."""
    heading = 3.0 + turn * SECOND_BY_SECOND
    wheels = np.column_stack([1.1 + 0.1 * SECOND_BY_SECOND, 0.9 - 0.05 * SECOND_BY_SECOND])
    poses = np.column_stack([np.sin(heading), -np.cos(heading), heading])
    return SECOND_BY_SECOND, wheels, poses


def write(path, names, columns, delimiter=","):
    rows = np.column_stack(columns)
    lines = [delimiter.join(repr(float(cell)) for cell in row) for row in rows]
    path.write_text("\n".join(([delimiter.join(names)] if names else []) + lines) + "\n")
    return path


def write_usual(path, time_name="time", left="left_vel", right="right_vel", scale=1.0):
    time, wheels, poses = drive()
    names = [time_name, left, right, "x", "y", "yaw"]
    return write(path, names, [time, wheels[:, 1] / scale, wheels[:, 0] / scale, poses])


def assert_drive(log, tolerance=ROUNDING):
    time, wheels, poses = drive()
    np.testing.assert_allclose(log.time, time, rtol=0, atol=tolerance)
    np.testing.assert_allclose(log.wheels, wheels, rtol=0, atol=tolerance)
    np.testing.assert_allclose(log.pose_time, time, rtol=0, atol=tolerance)
    np.testing.assert_allclose(log.poses, poses, rtol=0, atol=tolerance)


@pytest.mark.parametrize(
    "names",
    [
        "time_s left_wheel_mps right_wheel_mps x_m y_m heading_rad",
        "t v_l v_r x y theta",
        "Timestamp leftWheelSpeed rightWheelSpeed posX posY yaw",
        "stamp wheel_left wheel_right pose.position.x pose.position.y heading",
        "%time vel_left vel_right field.pose.pose.position.x field.pose.pose.position.y yaw_rad",
        "time left_velocity[m/s] right_velocity[m/s] easting_m northing_m psi",
        "header.stamp /base/left_wheel_speed /base/right_wheel_speed tx ty pose.theta",
    ],
)
def test_a_log_reads_alike_under_any_usual_names(tmp_path, names):
    time, wheels, poses = drive()
    path = write(tmp_path / "log.csv", names.split(), [time, wheels[:, 1], wheels[:, 0], poses])
    log = read_log(path)
    assert_drive(log)
    assert log.step is None and log.commands is None
    assert {clause.split(" = ")[1].split(" in ")[0] for clause in log.guesses} == set(names.split())


@pytest.mark.parametrize(
    ("left", "right", "unit", "scale"),
    [
        ("left_wheel_rad_s", "right_wheel_rad_s", None, RADIUS),
        ("omega_l", "omega_r", None, RADIUS),
        ("left_rpm", "right_rpm", None, RADIUS * 2.0 * np.pi / 60.0),
        ("left_vel", "right_vel", "rad/s", RADIUS),
    ],
)
def test_turn_rates_of_wheels_become_ground_speeds(tmp_path, left, right, unit, scale):
    path = write_usual(tmp_path / "log.csv", left=left, right=right, scale=scale)
    units = {} if unit is None else {"left": unit, "right": unit}
    assert_drive(read_log(path, Hints(units=units, wheel_radius_m=RADIUS)))
    with pytest.raises(ValueError, match=r"the wheel radius in m is needed; give --wheel-radius"):
        read_log(path, Hints(units=units))


@pytest.mark.parametrize("wrap", [None, 2**16])
def test_ticks_become_mean_speeds_at_the_middles_of_their_intervals(tmp_path, wrap):
    time = np.array([0.0, 0.1, 0.25, 0.3, 0.45])
    counts = np.array(
        [[65000.0, 400.0], [65500.0, 200], [66000.0, 100], [66400.0, 0], [67000, -50]]
    )
    recorded = counts if wrap is None else counts % wrap
    poses = np.column_stack([time, time, 0.0 * time])
    names = ["time", "right_ticks", "left_ticks", "step", "x", "y", "heading"]
    path = write(tmp_path / "log.csv", names, [time, recorded, np.arange(5.0), poses])
    log = read_log(path, Hints(wheel_radius_m=RADIUS, ticks_per_revolution=TICKS))
    middles = np.array([0.05, 0.175, 0.275, 0.375])
    speeds = np.diff(counts, axis=0) / np.diff(time)[:, None] * 2.0 * np.pi * RADIUS / TICKS
    np.testing.assert_allclose(log.time, middles - 0.05, atol=ROUNDING)
    np.testing.assert_allclose(log.pose_time, time - 0.05, atol=ROUNDING)
    np.testing.assert_allclose(log.wheels, speeds, rtol=0, atol=1e-10)
    assert log.step.tolist() == [0, 1, 2, 3]
    assert any("start again after 65536" in clause for clause in log.guesses) == (wrap is not None)
    with pytest.raises(ValueError, match=r"ticks per revolution is needed; give --ticks"):
        read_log(path, Hints(wheel_radius_m=RADIUS))


@pytest.mark.parametrize("parts", [("qz", "qw"), ("qx", "qy", "qz", "qw")])
def test_headings_come_from_quaternions(tmp_path, parts):
    time, wheels, poses = drive()
    half = poses[:, 2] / 2.0
    quaternions = np.column_stack([0.0 * half, 0.0 * half, np.sin(half), np.cos(half)])
    names = ["time", "left", "right", "x", "y", *parts]
    columns = [time, wheels[:, ::-1], poses[:, :2], quaternions[:, -len(parts) :]]
    assert_drive(read_log(write(tmp_path / "log.csv", names, columns)), tolerance=1e-12)
    columns[-1] = 3.0 * columns[-1]
    with pytest.raises(ValueError, match=r"line 2: the quaternion in qx?.* has norm 3, not 1"):
        read_log(write(tmp_path / "log.csv", names, columns))


def test_a_tilted_body_heads_where_its_axis_x_points(tmp_path):
    # Yaw 1 rad, then pitch 0.5, then roll 0.3: the axis x, turned, lies at the yaw in the plane.
    half_roll, half_pitch, half_yaw = np.array([0.3, 0.5, 1.0]) / 2.0
    roll = np.array([np.sin(half_roll), 0.0, 0.0, np.cos(half_roll)])
    pitch = np.array([0.0, np.sin(half_pitch), 0.0, np.cos(half_pitch)])
    yaw = np.array([0.0, 0.0, np.sin(half_yaw), np.cos(half_yaw)])

    def multiply(p, q):
        vector = p[3] * q[:3] + q[3] * p[:3] + np.cross(p[:3], q[:3])
        return np.array([*vector, p[3] * q[3] - p[:3] @ q[:3]])

    time, wheels, _ = drive()
    quaternion = np.tile(multiply(yaw, multiply(pitch, roll)), (6, 1))
    names = ["time", "left", "right", "x", "y", "qx", "qy", "qz", "qw"]
    path = write(tmp_path / "log.csv", names, [time, wheels, time, time, quaternion])
    np.testing.assert_allclose(read_log(path).poses[:, 2], 1.0, atol=1e-12)


@pytest.mark.parametrize("name", ["heading", "heading_deg"])
def test_headings_in_degrees_are_told_by_name_or_by_the_way(tmp_path, name):
    time, wheels, poses = drive()
    degrees = np.rad2deg(poses[:, 2]) % 360.0
    names = ["time", "left", "right", "x", "y", name]
    log = read_log(
        write(tmp_path / "log.csv", names, [time, wheels[:, ::-1], poses[:, :2], degrees])
    )
    assert_drive(log, tolerance=1e-12)
    assert any(f"heading = {name} in deg" in clause for clause in log.guesses)


def test_headings_from_another_axis_are_warned_of(tmp_path):
    time, wheels, poses = drive()
    names = ["time", "left", "right", "x", "y", "heading_rad"]
    compass = np.pi / 2.0 - poses[:, 2]
    path = write(tmp_path / "log.csv", names, [time, wheels, poses[:, :2], compass])
    assert any("headings do not lie along the way" in clause for clause in read_log(path).guesses)
    assert not any("along the way" in clause for clause in read_log(write_usual(path)).guesses)


def test_columns_are_taken_as_the_user_says(tmp_path):
    time, wheels, poses = drive()
    names = ["time", "front", "rear", "wr", "x", "x2", "y", "a b"]
    left = wheels[:, 1]
    columns = [time, left - 0.1, left + 0.1, wheels[:, 0], 0.0 * time, poses]
    path = write(tmp_path / "log.csv", names, columns)
    said = {"left": "front+rear", "right": "WR", "x": "6", "heading": "a b"}
    log = read_log(path, Hints(columns=said))
    assert_drive(log)
    assert "left = front+rear in m/s (assumed)" in log.guesses
    with pytest.raises(
        ValueError, match=r"--columns left=wl: there is no column wl; name one of ti"
    ):
        read_log(path, Hints(columns={**said, "left": "wl"}))
    with pytest.raises(ValueError, match=r"--units left=knots: is no unit of it; give one of m/s"):
        read_log(path, Hints(columns=said, units={"left": "knots"}))


def test_columns_without_names_are_taken_by_number_and_unit(tmp_path):
    time, wheels, poses = drive()
    path = write(tmp_path / "log.csv", [], [time, wheels, poses])
    numbers = {"time": "1", "right": "2", "left": "3", "x": "4", "y": "5", "heading": "6"}
    assert_drive(read_log(path, Hints(columns=numbers, units={"left": "m/s"})))
    with pytest.raises(
        ValueError, match=r"no names that tell the unit .* --units left=m/s,right=m/s"
    ):
        read_log(path, Hints(columns=numbers))
    with pytest.raises(ValueError, match=r"no header .* --columns time=NUMBER,left=NUMBER"):
        read_log(path)


@pytest.mark.parametrize(
    ("names", "words"),
    [
        ("time lft right x y yaw", "the speed of the left wheels, among time, lft, .*left=NAME"),
        ("time left right x y z", "hold the heading, among .* --columns heading=NAME"),
        ("time left right x x yaw", "2 columns may hold the coordinate x"),
        ("time left right_rpm x y yaw", "in two units, left = left in m/s"),
    ],
)
def test_what_cannot_be_told_is_refused_with_the_option_that_tells_it(tmp_path, names, words):
    path = write(tmp_path / "log.csv", names.split(), [*drive()])
    with pytest.raises(ValueError, match=words) as error:
        read_log(path)
    assert str(error.value).startswith(str(path)) and "\n" not in str(error.value)


MERGED = """time,left,right,x,y,yaw,cmd_v,cmd_w,step
0.0,1,1,,,,,,
0.1,,,5,6,0.5,,,
0.2,1,2,,,,0.5,0.1,3
0.3,,,5.5,6,0.5,,,
0.4,1,3,,,,,,
0.5,,,6,6,0.5,,,
0.6,1,4,6.5,6,0.5,0.7,0.2,4
"""


def test_rows_of_other_sensors_are_left_out_and_counted(tmp_path):
    path = tmp_path / "log.csv"
    path.write_text(MERGED)
    log = read_log(path)
    np.testing.assert_allclose(log.time, [0.0, 0.2, 0.4, 0.6], atol=ROUNDING)
    np.testing.assert_allclose(log.pose_time, [0.1, 0.3, 0.5, 0.6], atol=ROUNDING)
    np.testing.assert_array_equal(log.wheels[:, 0], [1.0, 2.0, 3.0, 4.0])
    np.testing.assert_array_equal(log.poses[:, 0], [5.0, 5.5, 6.0, 6.5])
    np.testing.assert_array_equal(log.commands[:, 0], [0.0, 0.5, 0.5, 0.7])
    np.testing.assert_array_equal(log.step, [0, 3, 3, 4])
    assert "wheel speeds in 4 of 7 rows" in log.guesses and "poses in 4 of 7 rows" in log.guesses
    path.write_text(MERGED.replace("0.2,1,2", "0.2,1,"))
    with pytest.raises(ValueError, match=r"column right, line 4: nothing is no finite number"):
        read_log(path)


def test_measured_twists_and_words_are_no_commands(tmp_path):
    time, wheels, poses = drive()
    names = "time left right x y yaw odom.twist.linear.x odom.twist.angular.z command"
    path = write(tmp_path / "log.csv", names.split(), [time, wheels[:, ::-1], poses, poses])
    path.write_text(path.read_text().replace("\n0.0,", "\n0,").replace("3.0\n", "turn\n", 1))
    log = read_log(path)
    assert log.commands is None and log.step is None
    assert "steps: none read, command holds words such as turn" in log.guesses


def test_samples_are_put_in_order_with_a_word(tmp_path):
    rows = ["0,1,1,0,0,0", "0.2,3,3,2,0,0", "0.1,2,2,1,0,0", "0.2,9,9,9,0,0", "0.3,4,4,3,0,0"]
    path = tmp_path / "log.csv"
    path.write_text("\n".join(["time,left,right,x,y,yaw", *rows, ""]))
    log = read_log(path)
    np.testing.assert_array_equal(log.time, [0.0, 0.1, 0.2, 0.3])
    np.testing.assert_array_equal(log.wheels[:, 0], [1.0, 2.0, 3.0, 4.0])
    np.testing.assert_array_equal(log.poses[:, 0], [0.0, 1.0, 2.0, 3.0])
    assert "wheel samples sorted by time, the first late one in line 4" in log.guesses
    assert any(
        "1 poses dropped whose time is repeated, the first in line 5" in x for x in log.guesses
    )
    path.write_text("\n".join(["time,left,right,x,y,yaw", *rows, "-1,1,1,0,0,0", ""]))
    with pytest.raises(ValueError, match=r"goes back by 1.3 s in line 7: .*; split the file there"):
        read_log(path)
    path.write_text("\n".join(["time,left,right,x,y,yaw", *rows[:4], ""]))
    with pytest.raises(ValueError, match=r"3 wheel samples of different times are too few"):
        read_log(path)


def write_pose_file(path, start, poses):
    half = poses[:, 2] / 2.0
    lines = [
        f"{start + k}.500000001 {x} {y} 0.1 0 0 {np.sin(h)} {np.cos(h)}"
        for k, ((x, y, _), h) in enumerate(zip(poses.tolist(), half.tolist(), strict=True))
    ]
    path.write_text("# timestamp tx ty tz qx qy qz qw of a total station\n" + "\n".join(lines))
    return path


def test_poses_come_from_a_pose_file_beside_the_log(tmp_path):
    time, wheels, poses = drive()
    lines = [
        f"{1700000000 + second}000000000,{left!r},{right!r}"
        for second, (right, left) in enumerate(wheels.tolist())
    ]
    path = tmp_path / "log.csv"
    path.write_text("stamp,left,right\n" + "\n".join(lines))
    pose_file = write_pose_file(tmp_path / "poses.txt", 1700000000, poses)
    log = read_log(path, Hints(pose_file=pose_file))
    np.testing.assert_array_equal(log.time, time)
    np.testing.assert_array_equal(log.pose_time, time + 0.500000001)
    np.testing.assert_array_equal(log.wheels, wheels)
    np.testing.assert_allclose(log.poses, poses, atol=1e-12)
    assert any(clause.startswith("TUM pose file") for clause in log.guesses)
    other = write_pose_file(tmp_path / "poses.txt", 1600000000, poses)
    with pytest.raises(ValueError, match=r"do not overlap; give wheels and poses of one recording"):
        read_log(path, Hints(pose_file=other))


def test_positions_far_from_zero_are_counted_from_the_first(tmp_path):
    time, wheels, poses = drive()
    far = poses + np.array([444444.123456, 5123456.654321, 0.0])
    names = ["time", "left", "right", "easting", "northing", "yaw"]
    log = read_log(write(tmp_path / "log.csv", names, [time, wheels[:, ::-1], far]))
    np.testing.assert_allclose(log.poses[:, :2], poses[:, :2] - poses[0, :2], rtol=0, atol=2e-9)
    assert any(clause.startswith("positions from (444444.") for clause in log.guesses)


@needs_data
@pytest.mark.parametrize(
    ("name", "rows", "duration", "steps"),
    [
        ("warthog_asphalt", 3299, 164.8999, 11),
        ("warthog_grass", 7259, 362.8994, 6),
        ("husky_wetgrass", 12920, 645.9718, 41),
    ],
)
def test_logs_of_real_robots_are_read(name, rows, duration, steps):
    log = read_log(SHARED / "logs" / f"{name}.csv")
    assert log.time.shape == log.pose_time.shape == (rows,)
    assert log.time[-1] == pytest.approx(duration, abs=1e-9)
    assert np.unique(log.step).size == steps
    table = np.genfromtxt(
        SHARED / "logs" / f"{name}.csv", delimiter=",", names=True, usecols=range(8)
    )
    np.testing.assert_array_equal(log.wheels[:, 0], table["right_wheel_mps"])
    np.testing.assert_array_equal(log.wheels[:, 1], table["left_wheel_mps"])
    np.testing.assert_array_equal(log.poses[:, 1], table["y_m"])
    np.testing.assert_array_equal(log.commands[:, 1], table["cmd_w_radps"])
    turns = (log.poses[:, 2] - table["heading_rad"]) / (2.0 * np.pi)
    np.testing.assert_allclose(turns, np.rint(turns), atol=1e-9)


@needs_data
def test_a_log_of_unknown_units_is_refused():
    with pytest.raises(ValueError, match=r"no header .* 5 columns .*--units left=m/s,right=m/s"):
        read_log(SHARED / "logs" / "maxxii_slip.csv")
