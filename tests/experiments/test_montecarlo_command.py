"""Laws of the command `montecarlo`: the verdict comes first, nothing is lost, and what fails costs
one line."""

import dataclasses
import errno
import json
import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import jax
import numpy as np
import pytest
from pages import find_first_lines
from spoken import leave_out_waits

from jaxtube import qp
from jaxtube.experiments.cli import main
from jaxtube.experiments.montecarlo import command
from jaxtube.experiments.montecarlo import report as montecarlo_report
from jaxtube.experiments.run import blocks
from jaxtube.scenario import load
from jaxtube.statistics import histogram
from jaxtube.statistics import run as montecarlo
from jaxtube.statistics.events import EVENT_NAMES, EVENTS, find_row
from jaxtube.statistics.intervals import mean_interval, share_interval
from jaxtube.synthesis.design import design as designed
from sets.certificate import Certificate

BLOCK = 64
TILE = 32
BLOCKS = 10
OVERRIDES = ("reference.duration_s=3", "slip.relative_error=0.2", "noise.lateral_m=0.002")
WORDS = ("montecarlo", "--scenario", "robust", "--controller", "equal_gain", *OVERRIDES)


def small(patch, design):
    """Let the command take one known design, small blocks, and no time for figures."""
    patch.setattr(command, "make_design", lambda scenario, options: dataclasses.replace(design))
    for module in (montecarlo, command):
        patch.setattr(module, "BLOCK", BLOCK)
    for module in (montecarlo, blocks):
        patch.setattr(module, "TILE", TILE)
    patch.setattr("jaxtube.experiments.montecarlo.figures.draw", lambda *arguments: None)


@pytest.fixture
def quick(monkeypatch, uncertified):
    small(monkeypatch, uncertified("robust", *OVERRIDES))


def run(folder, realisations=BLOCKS * BLOCK, *words):
    return main([*WORDS, "--realisations", str(realisations), "--out", str(folder), *words])


def read_files(folder):
    """Return the bytes of all files below a folder."""
    return {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def statistics_of(folder):
    return (folder / "statistics.npz").read_bytes()


def refused(capsys):
    """Return the one line on the standard error."""
    output = capsys.readouterr()
    lines = leave_out_waits(output.err)
    assert len(lines) == 1
    assert not output.out
    return lines[0]


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory, uncertified):
    """The folder of a run that nothing disturbed."""
    folder = tmp_path_factory.mktemp("undisturbed")
    with pytest.MonkeyPatch.context() as patch:
        small(patch, uncertified("robust", *OVERRIDES))
        assert run(folder) == 0
    return folder


# --------------------------------------------------------------------------------- what is reported


def test_the_metrics_are_those_of_the_statistics(undisturbed):
    found = json.loads((undisturbed / "metrics.json").read_text())
    with np.load(undisturbed / "statistics.npz") as arrays:
        statistics = dict(arrays)
    laps = BLOCKS * BLOCK
    steps = 30
    assert found["laps"] == statistics["laps"] == laps
    assert found["steps_a_lap"] == steps
    # A static gain solves no QP: nothing is said of any.
    of_qps = {"qp_infeasible", "qp_unsolved", "row_active", "backup"}
    of_others = {"acceleration_exceeded", "slip_outside_interval"}
    assert set(found["events"]) == set(EVENT_NAMES) - of_qps - of_others
    for name in found["events"].keys() - {"outside_ultimate_bound"}:
        row = statistics["events"][find_row(name)]
        event = found["events"][name]
        assert event["laps"] == laps - row[0]
        assert event["share_of_laps"] == (laps - row[0]) / laps
        assert event["steps"] == sum(count * times for times, count in enumerate(row))
        assert event["share_of_steps"] == pytest.approx(event["steps"] / (laps * steps), rel=1e-15)
        assert event["share_of_laps_interval"] == list(share_interval(event["laps"], laps, 0.95))
        assert event["share_of_steps_interval"] == list(mean_interval(row, steps, 0.95)[1:])
    assert found["events"]["w_outside_W"]["laps"] == laps
    told = found["peak_error"]["p95"]
    _, lateral, heading = histogram.quantile(statistics["peak"], 0.95)
    assert told["lateral_m"] == lateral
    assert told["heading_deg"] == pytest.approx(np.rad2deg(heading), rel=1e-12)
    worst = [entry["lap"] for entry in found["worst"]["error"]]
    assert worst == statistics["worst_lap/error"].tolist()
    assert found["largest_excess"]["error"] == statistics["excess/error"].tolist()
    assert found["plans"] == 0
    assert "reach" not in found
    assert found["law"] == (
        "equal_gain on the slipping robot, true slip (iid) uniform within +-0.2 of its nominal "
        "value, pose noise uniform within 0 m, 0.002 m, 0 deg, the scenario's start"
    )


def test_the_first_line_is_the_verdict(undisturbed, quick, tmp_path, capsys):
    """A run that is complete says the same again, but for its speed."""
    folder = tmp_path / "run"
    shutil.copytree(undisturbed, folder)
    assert run(folder) == 0
    report = capsys.readouterr().out
    first, second, *_ = report.split("\n")
    found = json.loads((folder / "metrics.json").read_text())
    share = found["events"]["w_outside_W"]["share_of_steps"]
    laps = BLOCKS * BLOCK
    assert first == f"w left W, so the tube's premise does not hold here; 0 of {laps} laps left E"
    assert second == ""
    assert find_first_lines(folder) == (first, first)
    assert f"w outside W in {share:.2%} of the steps (" in report
    assert "share of the laps that leave E: at most 0.00575\n" in report
    assert statistics_of(folder) == statistics_of(undisturbed)
    assert (folder / "metrics.json").read_bytes() == (undisturbed / "metrics.json").read_bytes()


def test_a_verdict_without_violations_is_short_and_what_follows_bounds_them():
    event = {"laps": 0, "share_of_laps_interval": (0.0, 2.9957e-6)}
    summary = {
        "events": {"w_outside_W": event, "e_outside_E": event},
        "laps": 10**6,
        "confidence": 0.95,
        "plans": 0,
    }
    line = montecarlo_report.say_verdict(summary)
    event["steps"] = 0
    summary["events"] |= {"qp_infeasible": event, "qp_unsolved": event}
    assert line == "w stayed in W in every step; 0 of 1,000,000 laps left E"
    assert montecarlo_report.findings(summary).split("\n  ") == [
        "at 95% confidence:",
        "share of the laps in which w leaves W: at most 3e-06",
        "share of the laps that leave E: at most 3e-06",
    ]
    summary["events"]["qp_infeasible"] = {"steps": 1234}
    assert montecarlo_report.findings(summary).split("\n  ")[3:] == [
        f"1,234 QPs {qp.describe(qp.INFEASIBLE)}"
    ]


def test_the_report_explains_every_event_and_says_which_limits_it_means(
    undisturbed, quick, tmp_path, capsys
):
    shutil.copytree(undisturbed, tmp_path / "run")
    assert run(tmp_path / "run") == 0
    report = capsys.readouterr().out
    found = json.loads((tmp_path / "run" / "metrics.json").read_text())
    for event in EVENTS:
        is_explained = f"{event.words}: {event.meaning}" in report
        assert is_explained == (event.name in found["events"] and not event.part)
    assert "E, limits of the true error: |e_x| 0.3 m, |e_y| 0.3 m, |e_th| 20 deg\n" in report


# ------------------------------------------------------------------------ interrupted and continued


def test_more_realisations_continue_a_run(undisturbed, quick, tmp_path, monkeypatch):
    """Partial last blocks are computed again, all others are kept."""
    computed = []
    original = montecarlo.Run.compute

    def watched(self, blocks):
        for block, statistics in original(self, blocks):
            computed.append(block)
            yield block, statistics

    monkeypatch.setattr(montecarlo.Run, "compute", watched)
    for realisations in (1, 3 * BLOCK + 7, BLOCKS * BLOCK):
        assert run(tmp_path, realisations) == 0
    assert computed == [0, 0, 1, 2, 3, *range(3, BLOCKS)]
    assert statistics_of(tmp_path) == statistics_of(undisturbed)
    assert (tmp_path / "metrics.json").read_bytes() == (undisturbed / "metrics.json").read_bytes()


def test_fewer_realisations_than_recorded_are_refused(undisturbed, quick, tmp_path, capsys):
    shutil.copytree(undisturbed, tmp_path / "run")
    assert run(tmp_path / "run", 5) == 2
    assert "command line: --realisations = 5" in refused(capsys)


def test_a_damaged_record_is_told_in_one_line_and_computed_again(
    undisturbed, quick, tmp_path, capsys
):
    shutil.copytree(undisturbed, tmp_path / "run")
    victim = sorted((tmp_path / "run" / "records").glob("blocks-*.record"))[4]
    content = bytearray(victim.read_bytes())
    content[len(content) // 2] ^= 1
    victim.write_bytes(content)
    assert run(tmp_path / "run") == 0
    (told,) = [line for line in capsys.readouterr().err.splitlines() if "is damaged" in line]
    assert victim.name in told
    assert statistics_of(tmp_path / "run") == statistics_of(undisturbed)


@pytest.mark.parametrize(
    ("words", "named"),
    [
        (("--seed", "1"), "seed = 0 there, 1 here"),
        (("--starts", "feasible"), "starts = "),
        (("slip.process=walk",), "scenario.slip.process = "),
    ],
)
def test_another_run_is_refused_and_leaves_the_folder_alone(
    undisturbed, quick, tmp_path, capsys, words, named
):
    folder = tmp_path / "run"
    shutil.copytree(undisturbed, folder)
    before = read_files(folder)
    assert run(folder, BLOCKS * BLOCK, *words) == 2
    line = refused(capsys)
    assert line.startswith("command line: --out = ")
    assert named in line
    assert read_files(folder) == before


def test_a_full_disk_ends_with_4_and_the_same_command_goes_on(
    undisturbed, quick, tmp_path, capsys, monkeypatch
):
    calls = []
    works = os.fsync

    def full(descriptor):
        calls.append(descriptor)
        if len(calls) > 7:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        works(descriptor)

    with monkeypatch.context() as patch:
        patch.setattr(os, "fsync", full)
        assert run(tmp_path) == 4
    line = refused(capsys)
    assert "No space left on device" in line
    assert "laps recorded there are safe; run the same command again" in line
    assert 0 < len(list((tmp_path / "records").glob("blocks-*.record"))) < BLOCKS
    assert run(tmp_path) == 0
    assert statistics_of(tmp_path) == statistics_of(undisturbed)


@pytest.mark.parametrize("written", ["scenario.toml", "statistics.npz", "metrics.json"])
def test_a_disk_that_is_full_elsewhere_costs_one_line_too(
    undisturbed, quick, tmp_path, capsys, monkeypatch, written
):
    """Whatever file it is, the records stay and the run goes on."""
    shutil.copytree(undisturbed, tmp_path / "run")
    works = os.replace

    def full(source, target):
        if Path(target).name == written:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        works(source, target)

    with monkeypatch.context() as patch:
        patch.setattr(os, "replace", full)
        assert run(tmp_path / "run") in (2, 4)
    assert "No space left on device" in refused(capsys)
    assert run(tmp_path / "run") == 0
    assert statistics_of(tmp_path / "run") == statistics_of(undisturbed)


@pytest.mark.slow
def test_a_run_that_is_killed_again_and_again_ends_with_the_same_bytes(
    tmp_path, quick, uncertified
):
    random = np.random.default_rng(os.getpid())
    count = 200 * BLOCK
    environment = os.environ | {
        "JAX_COMPILATION_CACHE_DIR": str(tmp_path / "cache"),
        "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS": "0",
    }
    records = tmp_path / "killed" / "records"
    words = [sys.executable, __file__, str(tmp_path / "killed"), str(count)]
    killed = 0
    for _ in range(5):
        child = subprocess.Popen(
            words, env=environment, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True
        )
        before = set(records.glob("blocks-*.record"))
        while child.poll() is None and set(records.glob("blocks-*.record")) == before:
            time.sleep(0.01)
        time.sleep(random.uniform(0, 0.4))
        child.send_signal(signal.SIGKILL)
        output, _ = child.communicate()
        assert child.returncode in (0, -signal.SIGKILL), output
        killed += child.returncode != 0
    assert killed >= 2
    once = tmp_path / "once"
    assert run(tmp_path / "killed", count) == run(once, count) == 0
    assert statistics_of(tmp_path / "killed") == statistics_of(once)
    names = {path.name for path in records.iterdir()}
    assert names == {path.name for path in (once / "records").iterdir()}


# ---------------------------------------------------------------------------------------- bad words


@pytest.mark.parametrize(
    ("words", "named"),
    [
        (("--realisations", "0.5"), "--realisations = 0.5"),
        (("--realisations", "0"), "--realisations = 0"),
        (("--realisations", "nan"), "--realisations = nan"),
        (("--realisations", "many"), "many"),
        (("--chunk", "0"), "--chunk = 0"),
        (("--devices", "-1"), "--devices = -1"),
        (("--devices", "1000"), "--devices = 1000: this machine has "),
        (("--seed", "-1"), "--seed = -1"),
        (("--controller", "none"), "none"),
        (("initial.lateral=1",), "initial.lateral"),
    ],
)
def test_bad_words_cost_one_line(quick, tmp_path, capsys, words, named):
    assert main([*WORDS, "--out", str(tmp_path / "run"), *words]) == 2
    assert named in refused(capsys)
    assert not (tmp_path / "run").exists()


if __name__ == "__main__":
    # The process that is killed.
    jax.config.update("jax_enable_x64", True)
    jax.config.update("jax_numpy_dtype_promotion", "strict")
    with pytest.MonkeyPatch.context() as context:
        context.setattr("jaxtube.synthesis.design.certify", lambda *sets: Certificate())
        small(context, designed(load("robust", OVERRIDES)))
        sys.exit(run(*sys.argv[1:]))
