"""Laws of the command `path`: what it says, writes and exits with."""

import json

import numpy as np
import pytest
from made_paths import drive, text_of, there_and_back, write_made
from pages import find_first_lines

from jaxtube.experiments.cli import main, parse
from jaxtube.experiments.options import command_line
from jaxtube.experiments.path import figures
from jaxtube.experiments.run.table import WIDTH
from jaxtube.paths.driving import Drive
from jaxtube.paths.missions import plan_path
from jaxtube.paths.profile import WheelLimits
from jaxtube.recordings.reading import read_path
from jaxtube.scenario.reading import load
from jaxtube.simulation.simulate import simulate
from jaxtube.synthesis.design import design
from jaxtube.synthesis.problem import make_problem

POSES = ("time_s", "x_m", "y_m", "yaw_rad")


def run(tmp_path, file, *words):
    folder = tmp_path / "run"
    code = main(["path", str(file), "--out", str(folder), *words])
    return code, folder


def test_missions_are_told_written_and_drawn(tmp_path, capsys):
    file = tmp_path / "drive.csv"
    file.write_text(text_of(there_and_back(turning=True), POSES))
    code, folder = run(tmp_path, file, "--speed", "0.8")
    assert code == 0
    names = {path.name for path in folder.iterdir()}
    written = {"mission-1.csv", "mission-1.toml", "mission-2.csv", "mission-2.toml", "path.png"}
    assert written | {"report.txt", "metrics.json", "scenario.toml"} <= names
    said = capsys.readouterr().out
    assert "5.9 s, (5.85, 0.57) m: turns on the spot by 180 deg" in said
    assert "checked in all" in said and "largest deviation" in said
    assert "lie outside of any certificate" in said
    report = (folder / "report.txt").read_text()
    verdict, printed = find_first_lines(folder)
    assert verdict == printed
    assert max(map(len, report.splitlines())) <= WIDTH
    metrics = json.loads((folder / "metrics.json").read_text())
    assert [mission["ends"] for mission in metrics["missions"]] == [
        "turns on the spot by 180 deg",
        "",
    ]
    assert metrics["missions"][0]["least_wheel_mps"] > 0.7


def test_the_scenario_of_a_mission_drives_the_wheels_that_were_checked(tmp_path):
    code, folder = run(tmp_path, write_made(tmp_path, "gnss"), "reference.speed_mps=0.9")
    reference = make_problem(load(folder / "mission-1.toml")).reference
    metrics = json.loads((folder / "metrics.json").read_text())["missions"][0]
    assert code == 0
    assert reference.wheels.min() == metrics["least_wheel_mps"]
    assert reference.wheels.max() == metrics["greatest_wheel_mps"]
    np.testing.assert_allclose(reference.wheels.mean(axis=1), 0.9, atol=1e-3)


def test_a_path_without_any_mission_exits_as_bad_input(tmp_path, capsys):
    file = tmp_path / "back.csv"
    time, positions, headings = drive()
    file.write_text(text_of((time, positions, headings + np.pi), POSES))
    code, folder = run(tmp_path, file, "--speed", "1")
    assert code == 2 and (folder / "path.png").exists()
    printed = capsys.readouterr()
    assert "0.0 s, (0.00, 0.00) m: reverses for" in printed.out
    assert "no mission is left" in printed.err


@pytest.mark.parametrize(
    "words, message",
    [
        (["path"], "--file = : is missing; name the file of a path"),
        (["path", "no.csv"], "no.csv: cannot be read|no.csv.*cannot be read"),
        (["path", "no.csv", "--speed", "-1"], "--speed = -1.0: is out of range"),
    ],
)
def test_bad_words_are_refused_in_one_line(capsys, words, message):
    import re

    assert main(words) == 2
    line = capsys.readouterr().err.strip()
    assert "\n" not in line and re.search(message, line)


def test_columns_can_be_named(tmp_path):
    file = tmp_path / "odd.csv"
    file.write_text(text_of(drive()).replace("x_m,y_m", "across,along"))
    assert run(tmp_path, file)[0] == 2
    assert run(tmp_path, file, "--columns", "x=across,y=along", "--speed", "1")[0] == 0


def test_the_command_line_of_a_run_repeats_it():
    options = parse(["path", "a b.csv", "--speed", "0.5", "--through-stops"])
    assert options is not None
    words = command_line(options)
    assert words.endswith("path 'a b.csv' --speed 0.5 --through-stops")
    assert options.folder.name == "path-a b-paper"


@pytest.mark.parametrize("name", ["utm", "reversal_with_headings", "no_time"])
def test_figures_show_rows_missions_and_limits(tmp_path, name):
    raw = read_path(write_made(tmp_path, name))
    asked = Drive(WheelLimits(0.2, 1.5, None, 0.5), 0.1, 6, 1.0, 0.1)
    figure = figures.plan_figure(raw, plan_path(raw, asked), asked)
    plane, speed, _, wheels = figure.axes
    assert ("500123 m" in plane.get_xlabel()) == (name == "utm")
    labels = [text.get_text() for text in figure.legends[0].get_texts()]
    assert ("recorded speed" in labels) == (name != "no_time")
    assert ("refused" in labels) == (name == "reversal_with_headings")
    assert wheels.get_ylim()[0] <= 0.2 and wheels.get_ylim()[1] >= 1.5
    assert speed.get_ylim()[0] == 0.0


@pytest.mark.slow
@pytest.mark.parametrize("name", ["gnss", "stops", "closed", "hairpin"])
def test_missions_are_driven_in_a_lap_within_the_limits_of_errors(tmp_path, name):
    code, folder = run(tmp_path, write_made(tmp_path, name), "--speed", "1")
    assert code == 0
    made = design(load(folder / "mission-1.toml"))
    laps = simulate(made, "compensated", laps=32)
    assert laps.outside == 0
