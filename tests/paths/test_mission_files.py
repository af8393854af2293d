"""Laws of `[reference] shape = "file"`: clean recordings as ever, the others cleaned and told, and
missions to the last bit."""

import warnings

import numpy as np
import pytest
from made_paths import MADE, drive, stand, text_of, there_and_back, write_made

from jaxtube.paths.driving import Drive
from jaxtube.paths.mission_file import read_mission, write_mission
from jaxtube.paths.missions import plan_path
from jaxtube.paths.places import PathWarning
from jaxtube.paths.profile import WheelLimits
from jaxtube.plant.recorded_reference import follow_recording
from jaxtube.recordings.reading import read_path
from jaxtube.scenario.reading import experiments_folder, load, replace
from jaxtube.scenario.refusal import ScenarioError
from jaxtube.synthesis.problem import make_problem

RECORDED = experiments_folder() / "untuned" / "recorded.csv"
WIDTH = 0.5
PREVIEW = 6


def along(file, base="paper", **keys):
    """Return the reference of a scenario along a file."""
    others = {f"reference.{key}": value for key, value in keys.items()}
    values = {"reference.shape": "file", "reference.file": str(file)} | others
    return make_problem(replace(load(base), values)).reference


def test_a_clean_recording_is_driven_as_ever():
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        reference = along(RECORDED, "untuned")
        shorter = along(RECORDED, "untuned", duration_s=12.0)
    expected = follow_recording(read_path(RECORDED), 0.1, PREVIEW, WIDTH)
    np.testing.assert_array_equal(reference.wheels, expected.wheels)
    np.testing.assert_array_equal(reference.poses, expected.poses)
    np.testing.assert_array_equal(shorter.wheels, expected.wheels[: 120 + PREVIEW])


@pytest.mark.parametrize("name", MADE)
def test_every_made_path_drives_or_is_refused_in_one_line(tmp_path, name):
    file = write_made(tmp_path, name)
    is_one = name not in ("reversal", "reversal_with_headings", "turned_about")
    is_one = is_one and "corner" not in name
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", PathWarning)
        if is_one:
            wheels = along(file, speed_mps=1.0).wheels
            assert wheels.min() >= 0.2 and wheels.max() <= 1.5
        else:
            with pytest.raises(ScenarioError, match=rf"{name}\.csv: .* s, \(.*\) m: ") as caught:
                along(file, speed_mps=1.0)
            assert "\n" not in str(caught.value)


def test_what_is_cleaned_is_told(tmp_path):
    file = tmp_path / "stops.csv"
    file.write_text(text_of(stand(drive(), 80, 5.0)))
    told = r"stops\.csv: driven within .* m of its rows, .*stands for 5.05 s: cut out"
    with pytest.warns(PathWarning, match=told):
        along(file)


def test_a_path_in_several_pieces_names_the_command_that_makes_missions(tmp_path):
    file = tmp_path / "back.csv"
    file.write_text(text_of(there_and_back(turning=True), ("time_s", "x_m", "y_m", "yaw_rad")))
    words = r"5\.9 s, \(5\.85, 0\.57\) m: turns on the spot by 180 deg; run `path`"
    with pytest.raises(ScenarioError, match=words):
        along(file)


def test_a_recording_too_fast_for_the_box_is_slowed_down_and_told(tmp_path):
    file = tmp_path / "fast.csv"
    file.write_text(text_of(drive(speed=2.5)))
    with pytest.warns(PathWarning, match=r"its own timing asks the wheels for 2\.\d+ to"):
        reference = along(file)
    assert reference.wheels.max() <= 1.5 * (1.0 + 1e-9)
    assert reference.steps > 1.6 * 96


def test_a_path_without_time_takes_the_speed_of_the_scenario(tmp_path):
    file = write_made(tmp_path, "no_time")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", PathWarning)
        reference = along(file, speed_mps=0.8)
        with pytest.raises(ScenarioError, match=r"takes 29\.\d s but the duration .* is 40 s"):
            along(file, speed_mps=0.8, duration_s=40.0)
    np.testing.assert_allclose(reference.wheels.mean(axis=1), 0.8, atol=1e-3)


def test_a_closed_path_is_driven_for_as_many_laps_as_asked_for(tmp_path):
    file = write_made(tmp_path, "closed")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", PathWarning)
        reference = along(file, duration_s=60.0)
    assert reference.steps == 600
    assert np.ptp(reference.poses[:, 2]) > 6.0 * np.pi
    assert np.linalg.norm(np.ptp(reference.poses[:, :2], axis=0) - 6.0) < 0.2


def make_mission(tmp_path, name="gnss"):
    limits = WheelLimits(0.2, 1.5, 1.0, WIDTH)
    asked = Drive(limits, 0.1, PREVIEW, 1.0, 0.1)
    raw = read_path(write_made(tmp_path, name))
    return plan_path(raw, asked).missions[0].reference, raw.origin


@pytest.mark.parametrize("name", ["gnss", "utm"])
def test_missions_are_read_back_to_the_last_bit(tmp_path, name):
    reference, origin = make_mission(tmp_path, name)
    file = tmp_path / "mission-1.csv"
    file.write_text(write_mission(reference, origin))
    read = read_mission(file, 0.1, PREVIEW, WIDTH, None)
    assert read is not None and read.steps == reference.steps
    np.testing.assert_allclose(read.wheels, reference.wheels, rtol=0, atol=1e-15)
    np.testing.assert_allclose(
        read.poses - np.append(origin, 0.0), reference.poses, rtol=0, atol=1e-8
    )
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        driven = along(file)
        shorter = along(file, duration_s=5.0)
    np.testing.assert_array_equal(driven.wheels, read.wheels)
    np.testing.assert_array_equal(shorter.wheels, read.wheels[: 50 + PREVIEW])


def test_a_mission_for_another_robot_or_period_is_a_path_like_any_other(tmp_path):
    reference, origin = make_mission(tmp_path)
    file = tmp_path / "mission-1.csv"
    file.write_text(write_mission(reference, origin))
    assert read_mission(file, 0.05, PREVIEW, WIDTH, None) is None
    assert read_mission(file, 0.1, PREVIEW, 0.6, None) is None
    wider = {"reference.shape": "file", "reference.file": str(file), "robot.track_width_m": 0.6}
    driven = make_problem(replace(load("paper"), wider)).reference
    np.testing.assert_allclose(driven.poses[:230, :2], reference.poses[:230, :2], atol=0.02)


def test_what_cannot_be_read_is_refused_with_file_and_cure(tmp_path):
    file = tmp_path / "empty.csv"
    file.write_text("")
    with pytest.raises(ScenarioError, match=r"empty\.csv: "):
        along(file)
    file.write_text("time_s,x_m,y_m\n" + "\n".join(f"{k},1.0,2.0" for k in range(9)))
    with pytest.raises(ScenarioError, match=r"empty\.csv: .*no stretch|different rows"):
        along(file)
