"""Laws of the log of a tuning run: resumed runs end at the same bits; what does not fit is refused
or redone."""

import errno
import os
import re
import signal
import subprocess
import sys
import time
from typing import NamedTuple

import numpy as np
import pytest

from jaxtube.experiments.run.store import StoreError
from jaxtube.experiments.tune.log import TuningLog
from jaxtube.scenario import ScenarioError
from jaxtube.tuning.descent import adam, lbfgs
from jaxtube.tuning.search import nelder_mead, random_search

IDENTITY = {"seed": 3, "scenario": {"controller": {"horizon": 5, "weights": [1.0, 2.0]}}}
START = np.array([-1.2, 1.0, 0.3])
NAMES = ("a", "b", "c")


class Killed(BaseException):
    """What ends a run between two entries."""


class Inspected(NamedTuple):
    held_out: float
    certified: bool


class Objective:
    """A rugged, noisy objective with its log; counts what is computed and is killed at a call."""

    def __init__(self, log, killed_at=-1, seconds=0.0):
        self.log = log
        self.killed_at = killed_at
        self.seconds = seconds
        self.computed = 0

    def counted(self, answer):
        if self.computed == self.killed_at:
            raise Killed
        self.computed += 1
        time.sleep(self.seconds)
        return answer

    def evaluate(self, point, draws=0):
        def compute():
            noise = 0.1 * np.random.default_rng((5, draws)).standard_normal(3)
            value = 3 + np.sum(np.sin(3 * point) + point**2) / 3 + noise @ point
            return self.counted(
                {"value": value, "gradient": np.cos(3 * point) + 2 / 3 * point + noise}
            )

        answer = self.log.remember("evaluate", {"point": point, "draws": draws}, compute)
        return float(answer["value"]), answer["gradient"]

    def inspect(self, iteration, point):
        def compute():
            return self.counted(
                {"held_out": np.sum(np.sin(3 * point) + point**2), "certified": point[0] < 0.1}
            )

        answer = self.log.remember("inspect", {"point": point}, compute)
        return Inspected(float(answer["held_out"]), bool(answer["certified"]))

    def value(self, point):
        return self.evaluate(point)[0]


METHODS = {
    "adam": lambda f: adam(
        f.evaluate, f.inspect, START, NAMES, budget=9, patience=9, learning_rate=0.1
    ),
    "lbfgs": lambda f: lbfgs(f.evaluate, f.inspect, START, NAMES, budget=12, patience=9),
    "random": lambda f: random_search(f.value, START, np.ones(3), 12, seed=2),
    "simplex": lambda f: nelder_mead(f.value, START, 12, size=0.5),
}


def bits(outcome):
    """Return all numbers of an outcome, to the last bit."""
    if hasattr(outcome, "__dataclass_fields__"):
        return {name: bits(getattr(outcome, name)) for name in outcome.__dataclass_fields__}
    return outcome.tobytes() if isinstance(outcome, np.ndarray) else repr(outcome)


def finished(method, folder):
    """Run to the end; return the outcome and the number of answers computed."""
    with TuningLog(folder, IDENTITY) as log:
        objective = Objective(log)
        return bits(METHODS[method](objective)), objective.computed


def filled(folder, count=4):
    with TuningLog(folder, IDENTITY) as log:
        for number in range(count):
            ask(log, number)


def ask(log, number, value=None):
    """Ask for the square of a number; the given value, if any, is what is computed."""
    return log.remember(
        "adam", {"x": float(number)}, lambda: {"y": number**2 if value is None else value}
    )["y"]


def files(folder):
    return {path.name: path.read_bytes() for path in folder.iterdir() if path.name != "lock"}


@pytest.fixture
def quick(monkeypatch):
    """Do not wait for the disk."""
    monkeypatch.setattr(os, "fsync", lambda descriptor: None)


# ------------------------------------------------------------------------------------ the same bits


@pytest.mark.parametrize("method", METHODS)
def test_a_run_killed_after_any_number_of_answers_ends_at_the_same_bits(tmp_path, quick, method):
    undisturbed, count = finished(method, tmp_path / "once")
    for killed_at in range(count):
        folder = tmp_path / f"killed-{killed_at}"
        with pytest.raises(Killed), TuningLog(folder, IDENTITY) as log:
            METHODS[method](Objective(log, killed_at))
        assert finished(method, folder) == (undisturbed, count - killed_at)
        assert files(folder) == files(tmp_path / "once")
    assert finished(method, tmp_path / "once") == (undisturbed, 0)


def test_a_killed_process_loses_nothing_that_was_logged(tmp_path):
    """SIGKILL, while another answer is computed or written."""
    script = (
        "import sys; from pathlib import Path; import jax\n"
        "jax.config.update('jax_enable_x64', True)\n"
        "sys.path.insert(0, sys.argv[1]); from test_tune_log import *\n"
        "with TuningLog(Path(sys.argv[2]), IDENTITY) as log:\n"
        "    METHODS['adam'](Objective(log, seconds=0.05))\n"
    )
    folder = tmp_path / "killed"
    process = subprocess.Popen(
        [sys.executable, "-c", script, os.path.dirname(__file__), str(folder)]
    )
    deadline = time.monotonic() + 60
    while len(list(folder.glob("*.record"))) < 7 and time.monotonic() < deadline:
        assert process.poll() is None
        time.sleep(0.01)
    with pytest.raises(ScenarioError, match="another process is writing there; wait for it"):
        TuningLog(folder, IDENTITY)
    process.send_signal(signal.SIGKILL)
    assert process.wait() == -signal.SIGKILL
    undisturbed, count = finished("adam", tmp_path / "once")
    resumed, computed = finished("adam", folder)
    assert resumed == undisturbed and computed <= count - 7


def test_answers_come_back_with_the_same_bits_types_and_layout(tmp_path, quick):
    answer = {
        "numbers": np.array([0.1, -0.0, np.nan, np.inf, 5e-324, 1 / 3]),
        "signalling": np.array([0x7FF0000000000001], np.uint64).view(np.float64),
        "fortran": np.asfortranarray(np.arange(6.0).reshape(2, 3)),
        "strided": np.arange(12.0).reshape(3, 4)[:, ::2],
        "half": np.arange(3, dtype=np.float32),
        "counts": np.arange(3),
        "flag": True,
        "number": 0.1,
    }
    seen = []
    for _ in range(2):
        with TuningLog(tmp_path, IDENTITY) as log:
            arrays = log.remember("adam", {"x": 1.0}, lambda: answer)
        seen.append(
            {name: (a.dtype, a.shape, a.strides, a.tobytes()) for name, a in arrays.items()}
        )
    assert seen[0] == seen[1] and list(seen[0]) == sorted(answer)
    for name, array in answer.items():
        assert (
            seen[0][name][0] == np.asarray(array).dtype
            and seen[0][name][3] == np.asarray(array).tobytes()
        )


def test_streams_are_counted_apart(tmp_path, quick):
    for order in (("adam", "adam-2", "adam", "random"), ("random", "adam", "adam", "adam-2")):
        with TuningLog(tmp_path, IDENTITY) as log:
            for name in order:
                log.remember(name, {"stream": len(name)}, lambda: {"y": 1.0})
            assert log.entries == 4
    names = [
        "adam-000000.record",
        "adam-000001.record",
        "adam-2-000000.record",
        "random-000000.record",
    ]
    assert sorted(files(tmp_path)) == names


def test_what_is_computed_may_fail_and_be_asked_again(tmp_path, quick):
    with TuningLog(tmp_path, IDENTITY) as log:
        with pytest.raises(ZeroDivisionError):
            log.remember("adam", {"x": 0.0}, lambda: {"y": 1 / 0})
        assert log.entries == 0 and ask(log, 0, value=7.0) == 7.0


# ------------------------------------------------------------------------------------------ refused


def test_another_identity_is_refused_and_nothing_touched(tmp_path, quick):
    filled(tmp_path / "log")
    before = files(tmp_path / "log")
    other = IDENTITY | {"scenario": {"controller": {"horizon": 6, "weights": [1.0, 2.0]}}}
    with pytest.raises(ScenarioError) as refused:
        TuningLog(tmp_path / "log", other)
    assert re.match(
        "command line: --out = .*log holds another run: scenario.controller.horizon",
        str(refused.value),
    )
    assert "5 there, 6 here; name another --out, or delete that folder" in str(refused.value)
    assert "\n" not in str(refused.value) and files(tmp_path / "log") == before
    TuningLog(tmp_path / "log", IDENTITY).close()


@pytest.mark.parametrize(
    "given, named",
    [
        ({"x": np.nextafter(2.0, 3.0)}, "x"),
        ({"x": np.float32(2.0)}, "x"),
        ({"x": [2.0]}, "x"),
        ({"x": 2.0, "draws": 1}, "draws"),
        ({"draws": 1}, "draws"),
    ],
)
def test_another_question_is_refused(tmp_path, quick, given, named):
    filled(tmp_path / "log")
    before = files(tmp_path / "log")
    with TuningLog(tmp_path / "log", IDENTITY) as log:
        assert (ask(log, 0), ask(log, 1)) == (0, 1)
        with pytest.raises(ScenarioError) as refused:
            log.remember("adam", given, lambda: {"y": 4.0})
        told = f"adam-000002.record answers another {named}, so other code or settings wrote it"
        assert f"{told}; name another --out" in str(
            refused.value
        ) and f"or delete {tmp_path / 'log'}" in str(refused.value)
        assert "\n" not in str(refused.value)
    assert files(tmp_path / "log") == before


def test_a_minus_zero_is_another_question(tmp_path, quick):
    filled(tmp_path)
    with (
        TuningLog(tmp_path, IDENTITY) as log,
        pytest.raises(ScenarioError, match="answers another x"),
    ):
        log.remember("adam", {"x": -0.0}, lambda: {"y": 0})


def test_an_open_log_is_refused_to_others_until_it_is_closed(tmp_path):
    with (
        TuningLog(tmp_path, IDENTITY),
        pytest.raises(ScenarioError, match="another process is writing there"),
    ):
        TuningLog(tmp_path, IDENTITY)
    TuningLog(tmp_path, IDENTITY).close()


@pytest.mark.parametrize("stream", ["", "Adam", "a/b", "../a", "2adam"])
def test_names_that_cannot_be_files_are_refused(tmp_path, stream):
    with TuningLog(tmp_path, IDENTITY) as log, pytest.raises(ValueError, match="stream = "):
        log.remember(stream, {}, lambda: {})


def test_answers_that_are_no_numbers_are_refused(tmp_path):
    with (
        TuningLog(tmp_path, IDENTITY) as log,
        pytest.raises(ValueError, match="neither integers nor floats"),
    ):
        log.remember("adam", {}, lambda: {"y": np.array("text")})


# ------------------------------------------------------------------------------ damage and the disk


@pytest.mark.parametrize("number", [1, 3])
@pytest.mark.parametrize("damage", ["flipped", "cut", "empty", "renamed"])
def test_a_damaged_entry_is_computed_again(tmp_path, quick, number, damage):
    filled(tmp_path)
    path = tmp_path / f"adam-{number:06d}.record"
    record = path.read_bytes()
    other = (tmp_path / "adam-000000.record").read_bytes()
    flipped = record[:200] + bytes([record[200] ^ 1]) + record[201:]
    path.write_bytes(
        {"flipped": flipped, "cut": record[:-9], "empty": b"", "renamed": other}[damage]
    )
    with TuningLog(tmp_path, IDENTITY) as log:
        assert (
            log.damaged == [f"{path}: is damaged; it is removed and computed again"]
            and not path.exists()
        )
        assert [ask(log, each, value=each**2 if each == number else -1) for each in range(5)] == [
            0,
            1,
            4,
            9,
            -1,
        ]
    assert path.read_bytes() == record


def test_entries_after_a_damaged_one_are_refused_unless_the_questions_are_the_same(tmp_path, quick):
    filled(tmp_path)
    (tmp_path / "adam-000001.record").unlink()
    with TuningLog(tmp_path, IDENTITY) as log:
        assert [ask(log, 0), ask(log, 1, value=1.5)] == [0, 1.5]
        with pytest.raises(ScenarioError, match=r"adam-000002\.record answers another x"):
            ask(log, 2.5)


def test_what_a_killed_process_left_half_written_is_cleared(tmp_path, quick):
    filled(tmp_path)
    (tmp_path / ".adam-000004.record.1234").write_bytes(b"half")
    with TuningLog(tmp_path, IDENTITY) as log:
        assert log.damaged == [] and log.entries == 4
    assert sorted(files(tmp_path)) == [f"adam-{number:06d}.record" for number in range(4)]


def test_a_full_disk_is_told_in_one_line(tmp_path, quick, monkeypatch):
    filled(tmp_path)

    def full(descriptor):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    with TuningLog(tmp_path, IDENTITY) as log:
        assert [ask(log, number) for number in range(4)] == [0, 1, 4, 9]
        monkeypatch.setattr(os, "fsync", full)
        with pytest.raises(StoreError) as told:
            ask(log, 4)
    failed = "logging adam-000004.record failed (No space left on device)"
    safe = "the 4 evaluations logged there are safe"
    assert (
        str(told.value) == f"{tmp_path}: {failed}; {safe}; run the same command again to continue"
    )
    monkeypatch.undo()
    with TuningLog(tmp_path, IDENTITY) as log:
        assert [ask(log, number) for number in range(5)] == [0, 1, 4, 9, 16]
