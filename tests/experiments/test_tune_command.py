"""Laws of the command `tune`: what it returns is certified, nothing is lost, and what fails costs
one line."""

import json
import os
import shutil
import signal
import subprocess
import sys
import time

import numpy as np
import pytest
import stand_ins
from pages import find_first_lines
from spoken import leave_out_waits

from jaxtube.experiments.cli import main
from jaxtube.experiments.run.exit_codes import ExitCode
from jaxtube.experiments.tune import report as tune_report
from jaxtube.experiments.tune import result as tune_result
from jaxtube.scenario import load

GAINS = "controller.tracking_gains=[3.0,6.5,6.5]"
UNCERTIFIED = "controller.tracking_gains=[0.951249,0.936687,1.305797]"
WORDS = (
    "tune",
    "reference.duration_s=3",
    GAINS,
    "--laps",
    "4",
    "--held-out",
    "4",
    "--evaluations",
    "3",
    "--method",
    "adam",
)


def small(patch):
    """Few laps to compare, no time for figures."""
    patch.setattr(tune_result, "COMPARED_LAPS", 4)
    patch.setattr(tune_report, "draw", lambda *arguments: None)


def run(folder, *words):
    return main([*WORDS, "--out", str(folder), *words])


def files(folder):
    return {
        name: (folder / name).read_bytes()
        for name in ("tuned.toml", "metrics.json", "iterates.npz")
    }


@pytest.fixture(scope="module", params=["stand-ins", pytest.param("true", marks=pytest.mark.slow)])
def laps(request):
    """Give what makes laps those asked for: true ones take a minute to compile."""
    return (lambda patch: None) if request.param == "true" else stand_ins.patch_tuner


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory, laps):
    """The folder of a run that nothing disturbed."""
    folder = tmp_path_factory.mktemp("undisturbed")
    with pytest.MonkeyPatch.context() as patch:
        small(patch)
        laps(patch)
        assert run(folder) == 0
    return folder


@pytest.fixture
def quick(monkeypatch):
    small(monkeypatch)


def test_the_page_begins_as_the_report_does(undisturbed):
    verdict, printed = find_first_lines(undisturbed)
    assert verdict == printed


def test_the_file_holds_the_best_certified_iterate(undisturbed):
    with np.load(undisturbed / "iterates.npz") as iterates:
        held_out = iterates["held_out"]
        certified = iterates["certified"]
        gains = iterates["gains"]
    best = int(np.argmin(np.where(certified, held_out, np.inf)))
    scenario = load(undisturbed / "tuned.toml")
    assert certified.any()
    np.testing.assert_array_equal(scenario.controller.tracking_gains, gains[best])


@pytest.mark.slow
@pytest.mark.parametrize("laps", ["true"], indirect=True)
def test_the_objective_falls(undisturbed):
    with np.load(undisturbed / "iterates.npz") as iterates:
        held_out = iterates["held_out"]
    assert len(held_out) == 4
    assert held_out[-1] < held_out[0]


def test_the_same_command_again_computes_nothing_and_says_the_same(
    undisturbed, laps, tmp_path, quick, monkeypatch
):
    laps(monkeypatch)
    shutil.copytree(undisturbed, tmp_path / "run")
    monkeypatch.setattr("jaxtube.tuning.tuner.Tuner.evaluate", None)
    monkeypatch.setattr("jaxtube.tuning.tuner.Tuner.inspect", None)
    assert run(tmp_path / "run") == 0
    assert files(tmp_path / "run") == files(undisturbed)


@pytest.mark.slow
@pytest.mark.parametrize("kept", [1, 4])
def test_an_interrupted_run_ends_at_the_same_bits(
    undisturbed, laps, tmp_path, quick, monkeypatch, kept
):
    laps(monkeypatch)
    folder = tmp_path / "run"
    shutil.copytree(undisturbed / "log", folder / "log")
    entries = sorted((folder / "log").glob("*.record"), key=lambda path: path.stat().st_mtime_ns)
    for entry in entries[kept:]:
        entry.unlink()
    assert run(folder) == 0
    assert files(folder) == files(undisturbed)


@pytest.mark.slow
@pytest.mark.parametrize("method", ["adam", "lbfgs"])
def test_a_killed_run_ends_at_the_same_bits(tmp_path, method):
    whole = tmp_path / "whole"
    killed = tmp_path / "killed"
    command = [sys.executable, "-m", "jaxtube.experiments", *WORDS, "--method", method, "--out"]
    subprocess.run([*command, str(whole)], check=True, capture_output=True)
    for kept in (1, 3):
        process = subprocess.Popen(
            [*command, str(killed)], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
        )
        while process.poll() is None and len(list((killed / "log").glob("*.record"))) < kept:
            time.sleep(0.02)
        os.kill(process.pid, signal.SIGKILL)
        process.wait()
    subprocess.run([*command, str(killed)], check=True, capture_output=True)
    assert files(killed) == files(whole)


def refused(capsys):
    """Return the one line on the standard error."""
    lines = leave_out_waits(capsys.readouterr().err)
    assert len(lines) == 1
    return lines[0]


@pytest.mark.parametrize(
    "words, told",
    [
        (["--scenario", "paper"], "no gains to tune; start from a copy of the scenario `untuned`"),
        (["controller.tracking_gains=[0.01,0.01,0.01]"], "tuning cannot start"),
        (["--laps", "0"], "--laps = 0: is out of range"),
        (["tuning.margin=0"], "tuning.margin = 0"),
    ],
)
def test_a_start_that_cannot_be_tuned_costs_one_line(tmp_path, capsys, words, told):
    assert main(["tune", "--out", str(tmp_path / "run"), *words]) == 2
    assert told in refused(capsys)


@pytest.mark.slow
def test_numbers_that_are_none_end_in_one_line_with_the_best_certified_iterate_on_disk(
    tmp_path, quick, capsys
):
    assert run(tmp_path, "--learning-rate", "300", "--evaluations", "9") == 2
    line = refused(capsys)
    assert "lower the learning rate" in line and "best certified iterate is kept" in line
    assert load(tmp_path / "tuned.toml").controller.tracking_gains == pytest.approx((3.0, 6.5, 6.5))


@pytest.mark.slow
def test_a_run_without_certified_iterates_says_what_they_lack(tmp_path, quick, capsys):
    assert run(tmp_path, UNCERTIFIED, "--evaluations", "1") == ExitCode.NO_GUARANTEE
    assert "no iterate is certified: the best one fails terminal_set_invariant" in refused(capsys)
    assert not (tmp_path / "tuned.toml").exists()


@pytest.mark.slow
def test_an_uncertified_iterate_is_returned_only_when_asked_for_and_labelled(
    tmp_path, quick, capsys
):
    assert run(tmp_path, UNCERTIFIED, "--evaluations", "1", "--accept-uncertified") == 0
    assert "NOT CERTIFIED: terminal_set_invariant" in capsys.readouterr().out
    assert (tmp_path / "tuned.toml").read_text().startswith("# Tuned from untuned; NOT CERTIFIED")


def test_metrics_hold_start_and_result(undisturbed):
    metrics = json.loads((undisturbed / "metrics.json").read_text())
    assert metrics["tuned"]["certified"] and metrics["gradients"] == 3
    reduction = metrics["lateral_reduction"]
    assert reduction["low"] <= reduction["share"] <= reduction["high"]


def test_what_does_not_certify_when_read_back_is_not_returned(tmp_path, quick, monkeypatch, capsys):
    stand_ins.patch_tuner(monkeypatch)
    monkeypatch.setattr(
        "jaxtube.tuning.tune.failing_conditions", lambda design: ("some_condition",)
    )
    assert run(tmp_path, "--evaluations", "1") == ExitCode.NO_GUARANTEE
    assert "does not certify when read back: some_condition" in refused(capsys)
    assert not (tmp_path / "tuned.toml").exists()


def test_the_result_of_an_earlier_run_does_not_outlive_a_run_without_one(
    tmp_path, quick, monkeypatch
):
    stand_ins.patch_tuner(monkeypatch)
    (tmp_path / "tuned.toml").write_text("# of an earlier run\n")
    assert run(tmp_path, UNCERTIFIED, "--evaluations", "1") == ExitCode.NO_GUARANTEE
    assert not (tmp_path / "tuned.toml").exists()
