"""Laws of windows out of tables: right first, units as named, robots and grounds not mixed."""

import os
from pathlib import Path

import numpy as np
import pytest

from jaxtube.recordings.hints import Hints
from jaxtube.recordings.window_table import is_window_table, read_windows

SHARED = Path(os.environ.get("JAXTUBE_DATA", Path(__file__).parents[2].parent / "shared" / "data"))
needs_data = pytest.mark.skipif(not SHARED.is_dir(), reason="records of real robots are not here")

TABLE = """robot,terrain,step,left_mps,right_mps,v_mps,w_radps,vy_mps,largest_pose_step_m,steady
a,"grass, wet",0,1.0,2.0,1.4,0.5,0.1,0.2,True
a,"grass, wet",1,1.5,2.5,1.9,0.5,0.1,0.6,False
b,sand,0,3.0,4.0,3.4,0.5,0.1,,true
"""


@pytest.fixture
def table(tmp_path):
    path = tmp_path / "windows.csv"
    path.write_text(TABLE)
    return path


def test_windows_of_one_robot_are_read(table):
    windows = read_windows(table, {"robot": "a", "terrain": "grass, wet"})
    assert windows.command.tolist() == [0, 1]
    np.testing.assert_array_equal(windows.wheels, [[2.0, 1.0], [2.5, 1.5]])
    np.testing.assert_array_equal(windows.velocity, [[1.4, 0.5, 0.1], [1.9, 0.5, 0.1]])
    assert windows.steady.tolist() == [True, False] and windows.lost.tolist() == [False, True]
    assert "only robot = a" in windows.guesses


def test_a_window_whose_pose_step_is_missing_is_lost(table):
    text = TABLE.replace("0.1,0.2,True", "0.1,,True")
    table.write_text(text)
    assert read_windows(table, {"robot": "a"}).lost.tolist() == [True, True]


def test_a_table_without_flags_takes_all_windows_for_good(tmp_path):
    path = tmp_path / "windows.csv"
    path.write_text("step;omega_l;omega_r;v;w_deg_s;vy\n0;1,5;2;0,4;90;0\n1;1;2;0,4;90;0\n")
    windows = read_windows(path, hints=Hints(wheel_radius_m=0.2))
    np.testing.assert_allclose(windows.wheels, [[0.4, 0.3], [0.4, 0.2]])
    np.testing.assert_allclose(windows.velocity[:, 1], np.pi / 2.0)
    assert windows.steady.all() and not windows.lost.any()
    assert "every window taken for steady" in windows.guesses


@pytest.mark.parametrize(
    ("select", "words"),
    [
        ({}, r"windows of 2 values of robot would be mixed: a, b; .* --select \"robot=a\""),
        ({"robot": "c"}, "no row has robot = c; select one of a, b"),
        ({"robt": "a"}, "--select: there is no column robt; name one of robot, terrain"),
    ],
)
def test_mixtures_and_unknown_values_are_refused(table, select, words):
    with pytest.raises(ValueError, match=words) as error:
        read_windows(table, select)
    assert "\n" not in str(error.value)


def test_flags_that_are_neither_true_nor_false_are_refused(table):
    table.write_text(TABLE.replace("False", "maybe"))
    with pytest.raises(
        ValueError, match=r"column steady, line 3: 'maybe' is neither true nor fals"
    ):
        read_windows(table, {"robot": "a"})
    table.write_text(TABLE.replace("left_mps,right_mps", "left_ticks,right_ticks"))
    with pytest.raises(ValueError, match="of which means are no speeds"):
        read_windows(table, {"robot": "a"})


def test_windows_are_told_from_logs(table, tmp_path):
    log = tmp_path / "log.csv"
    log.write_text("time,left,right,x,y,yaw\n0,1,1,0,0,0\n1,1,1,0,0,0\n")
    assert is_window_table(table) and not is_window_table(log)


@needs_data
@pytest.mark.parametrize(
    ("select", "windows", "commands", "steady"),
    [
        ({"robot": "husky"}, 600, 200, 400),
        ({"robot": "marmotte"}, 618, 206, 412),
        ({"robot": "warthog", "terrain": "ice"}, 300, 100, 200),
    ],
)
def test_windows_of_real_robots_are_read(select, windows, commands, steady):
    found = read_windows(SHARED / "slip_windows.csv", select)
    assert found.wheels.shape == (windows, 2) and found.velocity.shape == (windows, 3)
    assert np.unique(found.command).size == commands and found.steady.sum() == steady


@needs_data
def test_real_robots_are_not_mixed():
    with pytest.raises(ValueError, match="marmotte, husky, warthog"):
        read_windows(SHARED / "slip_windows.csv")
    with pytest.raises(ValueError, match="asphalt, gravel, sand, ice"):
        read_windows(SHARED / "slip_windows.csv", {"robot": "warthog"})
