"""Laws of `bench devices`: a missing library is told before anything is measured; speeds are set
against those of one."""

import sys

import pytest

from jaxtube.experiments.bench import devices
from jaxtube.experiments.cli import main


def test_a_missing_dask_is_told_before_anything_is_measured(monkeypatch, tmp_path, capsys):
    monkeypatch.setitem(sys.modules, "distributed", None)
    monkeypatch.setattr(devices, "design", lambda scenario: pytest.fail("it designs"))
    assert main(["bench", "--out", str(tmp_path / "run")]) == 2
    output = capsys.readouterr()
    assert output.err.count("\n") == 1 and "pip install 'jaxtube[cluster]'" in output.err
    assert not (tmp_path / "run").exists()


def test_speeds_are_set_against_one():
    speeds = {("devices", 1): 1000.0, ("devices", 2): 1900.0, ("workers", 1): 800.0}
    lines = devices.speed_table(speeds, "devices").splitlines()
    assert lines[2].split() == ["devices:", "1", "1,000", "1.00x"]
    assert lines[3].split() == ["devices:", "2", "1,900", "1.90x"]
    assert len(lines) == 4
