"""Laws of the command `identify`: the promise first, a complete folder, refusals in one line."""

import json
import tomllib

import numpy as np
import pytest
from pages import find_first_lines
from spoken import leave_out_waits

from jaxtube.experiments import cli
from jaxtube.experiments.cli import main
from jaxtube.experiments.identify.prediction_figure import predict
from jaxtube.experiments.options import IdentifyOptions, command_line
from jaxtube.identification.identify import Choices, identify_windows
from jaxtube.identification.simulated.drive import Truth, drive
from jaxtube.identification.simulated.log import Sensors, record, write_log
from jaxtube.recordings.window_table import read_windows
from jaxtube.scenario import load

TRUTH = Truth(effective_track=0.7, wheel_lag=0.1, lever_arm=0.08)
SENSORS = Sensors(jumps=1, lost=((60.0, 64.0),))
FIGURES = ("slip_over_time", "slip_by_speed", "ground_by_wheel", "box", "prediction")


@pytest.fixture(scope="module")
def log_file(tmp_path_factory):
    path = tmp_path_factory.mktemp("log") / "drive.csv"
    write_log(record(drive(TRUTH, 40, seed=31), SENSORS, seed=31).log, path)
    return path


@pytest.fixture(scope="module")
def window_file(tmp_path_factory):
    """A table of windows of two robots, one of which is meant."""
    path = tmp_path_factory.mktemp("windows") / "windows.csv"
    draw = np.random.default_rng(3)
    lines = ["robot,step,left_mps,right_mps,v_mps,w_radps,vy_mps,steady"]
    for step in range(60):
        right, left = draw.uniform(0.2, 0.8, 2)
        ground_right = right * (1 - draw.uniform(0.02, 0.1))
        ground_left = left * (1 - draw.uniform(0.02, 0.1))
        v = (ground_right + ground_left) / 2
        w = (ground_right - ground_left) / 0.9
        robot = "mine" if step % 2 else "other"
        lines.append(f"{robot},{step},{left:.4f},{right:.4f},{v:.4f},{w:.4f},0.001,True")
    path.write_text("\n".join(lines) + "\n")
    return path


def run(*words):
    return main(["identify", *map(str, words)])


@pytest.fixture(scope="module")
def finished(log_file, tmp_path_factory):
    folder = tmp_path_factory.mktemp("run")
    assert run(log_file, "--out", folder) == 0
    return folder


def test_a_run_leaves_a_scenario_that_loads_a_report_and_figures(finished):
    scenario = load(finished / "identified.toml")
    assert scenario.robot.effective_track_m == pytest.approx(TRUTH.effective_track, rel=0.03)
    names = {path.name for path in finished.iterdir()}
    wanted = {f"{name}.{kind}" for name in FIGURES for kind in ("png", "pdf")}
    wanted |= {"report.txt", "metrics.json", "manifest.json", "scenario.toml", "windows.npz"}
    assert wanted <= names


def test_the_promise_is_printed_before_anything_else(finished):
    lines = (finished / "report.txt").read_text().splitlines()
    metrics = json.loads((finished / "metrics.json").read_text())
    share = int(100 * metrics["promised_share"])
    promised = f"the box of slips holds for at least {share} % of new commands at 95 % confidence"
    assert lines[0].startswith(promised) and len(lines[0]) < 100
    assert find_first_lines(finished) == (lines[0], lines[0])
    assert f"95 % needs {metrics['commands_for_95_percent']}" in lines[2]


def test_the_report_names_what_was_cut_and_what_is_not_covered(finished):
    report = (finished / "report.txt").read_text()
    assert "1 stretch in which the pose was lost" in report
    assert "wheels behind" in report
    assert "Not covered by the promise:" in report
    assert "turning on the spot" in report
    metrics = json.loads((finished / "metrics.json").read_text())["log"]
    assert metrics["wheel_lag_s"] == pytest.approx(TRUTH.wheel_lag, abs=0.02)
    (lost,) = [cut for cut in metrics["cuts"] if cut["kind"] == "lost"]
    assert lost["start"] == pytest.approx(60.0, abs=0.3)


def test_windows_are_saved_with_what_they_were_used_for(finished):
    with np.load(finished / "windows.npz") as saved:
        used = saved["fits"] | saved["counts"]
        assert not (saved["fits"] & saved["counts"]).any()
        assert saved["steady"][used].all()
        assert not saved["lost"][used].any()
        assert np.isfinite(saved["slips"][used]).all()


def test_a_table_of_windows_is_selected_from(window_file, tmp_path, capsys):
    assert (
        run(window_file, "--select", "robot=mine", "--box", "alike", "--out", tmp_path / "a") == 0
    )
    told = capsys.readouterr().out
    assert "from 20 commands" in told and "95 % needs 124" in told
    text = (tmp_path / "a" / "identified.toml").read_text()
    tables = tomllib.loads(text)
    assert tables["slip"]["right"] == tables["slip"]["left"]
    assert "NOT IDENTIFIED" in text


def test_pairs_after_their_options_are_no_overrides():
    options = cli.parse(["identify", "log.csv", "--select", "robot=mine", "--columns", "left=wl"])
    assert isinstance(options, IdentifyOptions)
    assert options.select == "robot=mine"
    assert options.columns == "left=wl"
    assert options.overrides == ()


def test_the_command_line_names_the_log_by_its_place():
    options = IdentifyOptions(log="my log.csv", select="robot=mine", box="alike")
    words = command_line(options)
    assert words.endswith("identify 'my log.csv' --select robot=mine --box alike")
    assert options.folder.name == "identify-my log-mine"


def test_predictions_hold_the_motion_of_windows_that_made_the_box(window_file):
    windows = read_windows(window_file, {"robot": "mine"})
    found = identify_windows(windows, Choices())
    motion = predict(found, 2.0, 0.5)
    forward = motion.measured[:, 0]
    # Corners of the box bound forward motion and turn; sideways motion has its extremes inside.
    assert np.all(forward <= motion.greatest[:, 0] + 0.01)
    assert np.all(forward >= motion.least[:, 0] - 0.01)
    turn = motion.measured[:, 2]
    assert np.all(turn <= motion.greatest[:, 2] + 1e-6)
    assert np.all(turn >= motion.least[:, 2] - 1e-6)


@pytest.mark.parametrize(
    ("words", "what"),
    [
        (("absent.csv",), "absent.csv"),
        ((), "--log = : is missing; name the file of a log"),
        (("LOG", "--window-s", "0"), "--window-s = 0"),
        (("LOG", "--margin", "2"), "--margin = 2"),
        (("LOG", "--least-wheel-mps", "0.9"), "lower --least-wheel-mps"),
        (("LOG", "--columns", "left"), "left is no pair"),
        (("WINDOWS", "--select", "robot"), "robot is no pair"),
        (("WINDOWS", "--select", "robot=none"), "none"),
        (("LOG", "controller.horizon=3"), "is of no use here"),
    ],
)
def test_refusals_are_one_line_and_leave_no_folder(
    words, what, log_file, window_file, tmp_path, capsys
):
    files = {"LOG": log_file, "WINDOWS": window_file}
    given = [files.get(word, word) for word in words]
    assert run(*given, "--out", tmp_path / "run") == 2
    (error,) = leave_out_waits(capsys.readouterr().err)
    assert what in error
    assert not (tmp_path / "run").exists()
