"""Laws of progress: compilation is no speed; the time left is estimated from the first units on."""

import io
import sys
import time

import pytest
from spoken import leave_out_waits

from jaxtube import progress as module
from jaxtube.progress import announce, progress, show_progress


def test_compilation_is_said_and_not_counted_in_the_time_left(monkeypatch, capsys):
    monkeypatch.setattr(module, "SECONDS_BETWEEN_LINES", 0.0)
    now = [1000.0]
    with progress(100, "simulating", "laps", done=10) as bar:
        monkeypatch.setattr(bar, "_time", lambda: now[0])
        monkeypatch.setattr(time, "time", lambda: now[0])
        assert capsys.readouterr().err == "simulating: compiling\n"
        now[0] += 60.0
        bar.update(10)
        assert capsys.readouterr().err == "simulating: 20 of 100 laps\n"
        now[0] += 2.0
        bar.update(20)
        line = capsys.readouterr().err
        assert "40 of 100 laps" in line and "10.00 laps/s" in line and "00:06 left" in line


def test_work_without_compilation_names_its_own_start(capsys):
    with progress(3, "drawing", "figures", starting="starting") as bar:
        bar.update(3)
    lines = capsys.readouterr().err.splitlines()
    assert lines[0] == "drawing: starting" and lines[-1].startswith("drawing: 3 of 3 figures")


@pytest.mark.parametrize("is_terminal", [True, False])
def test_functions_of_the_library_show_progress_in_a_terminal_alone(
    is_terminal, monkeypatch, capsys
):
    monkeypatch.setattr(sys.stderr, "isatty", lambda: is_terminal)
    with show_progress(3, "simulating", "laps") as bar:
        bar.update(2)
        bar.update(1)
        assert bar.n == (3 if is_terminal else 0)
        bar.total = bar.n
        bar.set_postfix_str("held out 1.0", refresh=False)
    shown = capsys.readouterr().err
    assert ("simulating: compiling" in shown) == is_terminal
    assert bool(shown) == is_terminal


def test_slow_work_is_told_in_seconds_each(monkeypatch, capsys):
    monkeypatch.setattr(module, "SECONDS_BETWEEN_LINES", 0.0)
    now = [1000.0]
    with progress(5, "drawing", "figures", starting="starting") as bar:
        monkeypatch.setattr(bar, "_time", lambda: now[0])
        monkeypatch.setattr(time, "time", lambda: now[0])
        bar.update()
        now[0] += 2.5
        bar.update()
    line = capsys.readouterr().err.splitlines()[-1]
    assert line == "drawing: 2 of 5 figures, 2.50 s each, 00:02 gone, 00:07 left"


def test_a_bar_in_a_terminal_tells_the_same(monkeypatch):
    stream = io.StringIO()
    monkeypatch.setattr(stream, "isatty", lambda: True)
    monkeypatch.setattr(sys, "stderr", stream)
    with progress(2, "drawing", "figures", starting="starting") as bar:
        bar.update()
        bar.start_t -= 4.0
        bar.update()
    last = stream.getvalue().rstrip().split("\r")[-1]
    assert "2 of 2 figures" in last
    assert "s each" in last or "figures/s" in last
    assert "s/ " not in last


def test_a_wait_is_told_in_one_line_on_the_standard_error(capsys):
    announce("designing")
    told = capsys.readouterr()
    assert told.out == "" and told.err == "designing ...\n"
    assert leave_out_waits(told.err + "a refusal\n") == ["a refusal"]
