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

from jaxtube.experiments.cli import main
from jaxtube.experiments.montecarlo import command
from jaxtube.experiments.montecarlo import report as montecarlo_report
from jaxtube.scenario import load
from jaxtube.statistics import histogram
from jaxtube.statistics import run as montecarlo
from jaxtube.statistics.events import EVENT_NAMES, find_row
from jaxtube.statistics.intervals import mean_interval, share_interval
from jaxtube.synthesis.design import design as designed
from sets.certificate import Certificate

BLOCK, TILE, BLOCKS = 64, 32, 10
OVERRIDES = ("reference.duration_s=3", "slip.relative_error=0.2", "noise.lateral_m=0.002")
WORDS = ("montecarlo", "--scenario", "robust", "--controller", "equal_gain", *OVERRIDES)


def small(patch, design):
    """Let the command take one known design, small blocks, and no time for figures."""
    patch.setattr(command, "make_design", lambda scenario: dataclasses.replace(design))
    for module in (montecarlo, command):
        patch.setattr(module, "BLOCK", BLOCK)
        patch.setattr(module, "TILE", TILE)
    patch.setattr("jaxtube.experiments.montecarlo.figures.draw", lambda *arguments: None)


@pytest.fixture
def quick(monkeypatch, uncertified):
    small(monkeypatch, uncertified("robust", *OVERRIDES))


def run(folder, realisations=BLOCKS * BLOCK, *words):
    return main([*WORDS, "--realisations", str(realisations), "--out", str(folder), *words])


def statistics_of(folder):
    return (folder / "statistics.npz").read_bytes()


def refused(capsys):
    """Return the one line on the standard error."""
    output = capsys.readouterr()
    lines = [line for line in output.err.splitlines() if not line.startswith("simulating")]
    assert len(lines) == 1 and not output.out
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
    laps, steps = BLOCKS * BLOCK, 30
    assert found["laps"] == statistics["laps"] == laps and found["steps_a_lap"] == steps
    # A static gain solves no QP: nothing is said of any.
    assert set(found["events"]) == set(EVENT_NAMES) - {
        "qp_infeasible",
        "qp_unsolved",
        "row_active",
        "backup",
    }
    for name in found["events"].keys() - {"outside_ultimate_bound"}:
        row = statistics["events"][find_row(name)]
        event = found["events"][name]
        assert event["laps"] == laps - row[0] and event["share_of_laps"] == (laps - row[0]) / laps
        assert event["steps"] == sum(count * times for times, count in enumerate(row))
        assert event["share_of_steps"] == pytest.approx(event["steps"] / (laps * steps), rel=1e-15)
        assert event["share_of_laps_interval"] == list(share_interval(event["laps"], laps, 0.95))
        assert event["share_of_steps_interval"] == list(mean_interval(row, steps, 0.95)[1:])
    assert found["events"]["w_outside_W"]["laps"] == laps
    peaks, degrees = (
        found["peak_error"]["p95"],
        np.rad2deg(histogram.quantile(statistics["peak"], 0.95)[2]),
    )
    assert peaks["heading_deg"] == pytest.approx(degrees, rel=1e-12)
    assert peaks["lateral_m"] == histogram.quantile(statistics["peak"], 0.95)[1]
    assert [worst["lap"] for worst in found["worst"]["error"]] == statistics[
        "worst_lap/error"
    ].tolist()
    assert found["largest_excess"]["error"] == statistics["excess/error"].tolist()
    assert found["plans"] == 0 and "reach" not in found
    assert found["law"] == (
        "equal_gain on the slipping robot, true slip (iid) uniform within +-0.2 of its nominal value, "
        "pose noise uniform within 0 m, 0.002 m, 0 deg, the scenario's start"
    )


def test_the_first_line_is_the_verdict(undisturbed, quick, tmp_path, capsys):
    """A run that is complete says the same again, but for its speed."""
    shutil.copytree(undisturbed, tmp_path / "run")
    assert run(tmp_path / "run") == 0
    first, second, *_ = capsys.readouterr().out.split("\n")
    found = json.loads((tmp_path / "run" / "metrics.json").read_text())
    share = found["events"]["w_outside_W"]["share_of_steps"]
    assert first == montecarlo_report.verdict(found)
    assert (
        first.startswith(f"w leaves W in {share:.2%} of the steps (95%: ")
        and "premise does not hold" in first
    )
    assert first.endswith(f"of {BLOCKS * BLOCK} laps left E (at most 0.00575)") and second == ""
    assert statistics_of(tmp_path / "run") == statistics_of(undisturbed)
    assert (tmp_path / "run" / "metrics.json").read_bytes() == (
        undisturbed / "metrics.json"
    ).read_bytes()


def test_a_verdict_without_violations_bounds_them():
    laps = {"laps": 0, "share_of_laps_interval": (0.0, 2.9957e-6)}
    line = montecarlo_report.verdict(
        {
            "events": {"w_outside_W": laps, "e_outside_E": laps},
            "laps": 10**6,
            "confidence": 0.95,
            "plans": 0,
        }
    )
    assert line == (
        "w stayed in W in every step (95%: in at most 3e-06 of the laps it would not); "
        "0 of 1,000,000 laps left E (at most 3e-06)"
    )


# ------------------------------------------------------------------------ interrupted and continued


def test_more_realisations_continue_a_run(undisturbed, quick, tmp_path, monkeypatch):
    """Partial last blocks are computed again, all others are kept."""
    computed = []
    original = montecarlo.Run.compute

    def watched(self, blocks):
        for block, found in original(self, blocks):
            computed.append(block)
            yield block, found

    monkeypatch.setattr(montecarlo.Run, "compute", watched)
    assert run(tmp_path, 1) == run(tmp_path, 3 * BLOCK + 7) == run(tmp_path, BLOCKS * BLOCK) == 0
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
    told = [line for line in capsys.readouterr().err.splitlines() if "is damaged" in line]
    assert len(told) == 1 and victim.name in told[0]
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
    shutil.copytree(undisturbed, tmp_path / "run")
    before = {path: path.read_bytes() for path in (tmp_path / "run").rglob("*") if path.is_file()}
    assert run(tmp_path / "run", BLOCKS * BLOCK, *words) == 2
    line = refused(capsys)
    assert line.startswith("command line: --out = ") and named in line
    assert before == {
        path: path.read_bytes() for path in (tmp_path / "run").rglob("*") if path.is_file()
    }


def test_a_full_disk_ends_with_4_and_the_same_command_goes_on(
    undisturbed, quick, tmp_path, capsys, monkeypatch
):
    calls, works = [], os.fsync

    def full(descriptor):
        calls.append(descriptor)
        if len(calls) > 7:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        works(descriptor)

    with monkeypatch.context() as patch:
        patch.setattr(os, "fsync", full)
        assert run(tmp_path) == 4
    line = refused(capsys)
    assert (
        "No space left on device" in line
        and "laps recorded there are safe; run the same command again" in line
    )
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
    random, count = np.random.default_rng(os.getpid()), 200 * BLOCK
    environment = os.environ | {
        "JAX_COMPILATION_CACHE_DIR": str(tmp_path / "cache"),
        "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS": "0",
    }
    records, killed = tmp_path / "killed" / "records", 0
    for _ in range(5):
        words = [sys.executable, __file__, str(tmp_path / "killed"), str(count)]
        child = subprocess.Popen(
            words, env=environment, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True
        )
        before = set(records.glob("blocks-*.record"))
        while child.poll() is None and set(records.glob("blocks-*.record")) == before:
            time.sleep(0.01)
        time.sleep(random.uniform(0, 0.4))
        child.send_signal(signal.SIGKILL)
        output = child.communicate()[0]
        assert child.returncode in (0, -signal.SIGKILL), output
        killed += child.returncode != 0
    assert killed >= 2
    assert run(tmp_path / "killed", count) == run(tmp_path / "once", count) == 0
    assert statistics_of(tmp_path / "killed") == statistics_of(tmp_path / "once")
    assert sorted(path.name for path in records.iterdir()) == sorted(
        path.name for path in (tmp_path / "once" / "records").iterdir()
    )


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
