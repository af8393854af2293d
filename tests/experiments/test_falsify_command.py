"""The command `falsify`: what it refuses, saves and plays again."""

import numpy as np
from pages import find_first_lines
from tolerances import FALSIFY_REPLAY

from jaxtube.experiments.cli import main
from jaxtube.experiments.falsify import command


def test_bad_words_and_files_cost_one_line(capsys, tmp_path):
    (tmp_path / "text.npz").write_text("no archive")
    np.savez(tmp_path / "other.npz", a=1)
    for words, fragment in (
        (["--seconds", "0"], "--seconds = 0.0"),
        (["--target", "tube", "--controller", "local_gain"], "choose --controller tube_mpc"),
        (["--replay", str(tmp_path / "none.npz")], "No such file"),
        (["--replay", str(tmp_path / "text.npz")], "no archive"),
        (["--replay", str(tmp_path / "other.npz")], "no worst case"),
    ):
        assert main(["falsify", *words]) == 2
        line = capsys.readouterr().err
        assert fragment in line and line.count("\n") == 1


def test_the_command_saves_worst_cases_that_replay_to_the_same_margin(
    capsys, tmp_path, monkeypatch, uncertified
):
    monkeypatch.setattr(
        command, "make_design", lambda scenario, options: uncertified("paper", *words)
    )
    words = ["reference.duration_s=3", "controller.tube=summed", "noise.lateral_m=0.001"]
    options = [
        "--controller",
        "local_gain",
        "--target",
        "error",
        "--seconds",
        "1",
        "--out",
        str(tmp_path),
    ]
    assert main(["falsify", *options, *words]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[0].startswith("no violation found; smallest margin")
    assert find_first_lines(tmp_path) == (lines[0], lines[0])
    for name in ("metrics.json", "scenario.toml", "worst_error.npz", "worst_error.png"):
        assert (tmp_path / name).stat().st_size > 0
    assert main(["falsify", "--replay", str(tmp_path / "worst_error.npz"), *words]) == 0
    said = capsys.readouterr().out
    differences = [
        float(word.rstrip(",")) for word in said.splitlines()[1].split() if word[0].isdigit()
    ]
    assert len(differences) == 2 and max(differences) <= FALSIFY_REPLAY
    assert (tmp_path / "replay_error.png").stat().st_size > 0
    assert main(["falsify", "--replay", str(tmp_path / "worst_error.npz")]) == 2
    assert "another scenario" in capsys.readouterr().err
