"""Laws of moving pictures: as many as were asked for, from the first to the last instant, and where
they cannot be made, one line that says so."""

import itertools
import json
import shutil
import subprocess

import numpy as np
import pytest
from invented_laps import invent_laps
from PIL import Image

from jaxtube.experiments.cli import main
from jaxtube.reporting import animation
from jaxtube.reporting.animation import choose_instants
from jaxtube.reporting.moving_pictures import save_animation

FRAMES = 6


@pytest.fixture(scope="module")
def stored():
    return invent_laps()


@pytest.fixture
def run_folder(tmp_path, stored):
    np.savez(tmp_path / "laps.npz", allow_pickle=False, **stored.arrays())
    return tmp_path


def test_a_gif_has_as_many_pictures_as_were_asked_for(stored, tmp_path):
    save_animation(stored, {"uncompensated": 4, "tube_mpc": 4}, FRAMES, tmp_path / "lap.gif")
    with Image.open(tmp_path / "lap.gif") as gif:
        assert gif.n_frames == FRAMES
        assert gif.info["loop"] == 0
        pictures = []
        for number in range(FRAMES):
            gif.seek(number)
            pictures.append(np.asarray(gif.convert("RGB"), int))
    assert all(picture.shape == (360, 720, 3) for picture in pictures)
    for before, after in itertools.pairwise(pictures):
        assert np.abs(before - after).max() > 100


@pytest.mark.skipif(shutil.which("ffprobe") is None, reason="ffmpeg is not installed")
def test_an_mp4_has_as_many_pictures_as_were_asked_for(stored, tmp_path):
    save_animation(stored, {"tube_mpc": 0}, FRAMES, tmp_path / "lap.mp4")
    probe = ["ffprobe", "-v", "error", "-count_frames", "-show_entries", "stream=nb_read_frames"]
    told = subprocess.run(
        [*probe, "-of", "json", tmp_path / "lap.mp4"], capture_output=True, text=True, check=True
    )
    assert json.loads(told.stdout)["streams"] == [{"nb_read_frames": str(FRAMES)}]


@pytest.mark.parametrize("frames", [2, 7, 41, 100])
def test_pictures_reach_from_the_first_to_the_last_instant(frames):
    instants = choose_instants(40, frames)
    assert len(instants) == frames
    assert instants[0] == 0 and instants[-1] == 40
    assert np.ptp(np.diff(instants)) <= 1


def test_the_robot_is_drawn_where_it_is(stored):
    """The dot of a robot lies at the pose of the lap, in the frame of the world."""
    drawn = []
    move = animation._move

    def record(robots, box, stored, instant):
        move(robots, box, stored, instant)
        drawn.append((instant, [robot.centre.get_xydata()[0] for robot in robots]))

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(animation, "_move", record)
        list(animation.draw_frames(stored, {"tube_mpc": 3}, 3))
    poses = stored.poses("tube_mpc")
    for instant, (place,) in drawn:
        np.testing.assert_allclose(place, poses[instant, 3, :2], atol=1e-12)


def test_the_command_draws_the_same_lap_of_several_controllers(run_folder, capsys):
    target = run_folder / "both.gif"
    words = ["--controller", "uncompensated,tube_mpc", "--lap", "worst", "--frames", "2"]
    assert main(["animate", str(run_folder), *words, "--to", str(target)]) == 0
    assert "lap 14 of uncompensated, tube_mpc; 2 pictures" in capsys.readouterr().out
    with Image.open(target) as gif:
        assert gif.n_frames == 2


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (["--controller", "best"], "give one of uncompensated, tube_mpc"),
        (["--lap", "3"], "give one of 10, 11, 12, 13, 14, median or worst"),
        (["--to", "lap.avi"], "end it in .gif or .mp4"),
        (["--frames", "1"], "--frames = 1: is out of range; give a whole number from 2"),
        (["controller.horizon=7"], "is of no use here; leave it out"),
    ],
)
def test_what_cannot_be_drawn_is_refused_in_one_line(run_folder, capsys, words, told):
    assert main(["animate", str(run_folder), *words]) == 2
    output = capsys.readouterr()
    assert output.out == "" and output.err.count("\n") == 1
    assert told in output.err


def test_a_folder_without_laps_is_refused_in_one_line(tmp_path, capsys):
    for name in (str(tmp_path), "", str(tmp_path / "missing")):
        assert main(["animate", *([name] if name else [])]) == 2
        assert capsys.readouterr().err.count("\n") == 1


@pytest.mark.parametrize(
    "content", [b'{"command_line": 5}', b'{"command_line": null}', b"[" * 100_000, b"no JSON"]
)
def test_a_run_whose_manifest_is_damaged_is_refused_in_one_line(run_folder, capsys, content):
    (run_folder / "manifest.json").write_bytes(content)
    assert main(["figures", str(run_folder), "--style", "ggplot"]) == 2
    assert capsys.readouterr().err.count("\n") == 1


def test_damaged_laps_are_refused_in_one_line(run_folder, capsys):
    content = (run_folder / "laps.npz").read_bytes()
    for damaged in (content[: len(content) // 2], b"PK\x03\x04 no archive", b""):
        (run_folder / "laps.npz").write_bytes(damaged)
        assert main(["animate", str(run_folder)]) == 2
        assert capsys.readouterr().err.count("\n") == 1


def test_an_unknown_style_leaves_nothing_behind(run_folder, capsys):
    manifest = {"command_line": "python -m jaxtube.experiments design"}
    (run_folder / "manifest.json").write_text(json.dumps(manifest))
    before = sorted(run_folder.iterdir())
    assert main(["figures", str(run_folder), "--style", "nosuchstyle"]) == 2
    assert "is no style of matplotlib" in capsys.readouterr().err
    assert sorted(run_folder.iterdir()) == before


def test_an_ffmpeg_that_fails_is_told_as_that(run_folder, capsys, monkeypatch, tmp_path):
    failing = tmp_path / "bin" / "ffmpeg"
    failing.parent.mkdir()
    failing.write_text("#!/bin/sh\nexit 1\n")
    failing.chmod(0o755)
    monkeypatch.setenv("PATH", str(failing.parent), prepend=":")
    assert main(["animate", str(run_folder), "--to", str(tmp_path / "lap.mp4")]) == 2
    assert "could not be written by ffmpeg" in capsys.readouterr().err


def test_mp4_without_ffmpeg_is_refused_with_the_cure(run_folder, capsys, monkeypatch):
    monkeypatch.setattr(shutil, "which", lambda name: None)
    assert main(["animate", str(run_folder), "--to", str(run_folder / "lap.mp4")]) == 2
    assert "needs ffmpeg, which is not installed; install it, or end" in capsys.readouterr().err
