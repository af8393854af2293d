"""The tour of the library runs, imports nothing but the two packages, and stays short."""

import ast
import runpy
from pathlib import Path

import pytest

TOUR = Path(__file__).parents[1] / "docs" / "tour.py"
LINES = 40


def test_the_tour_imports_the_two_packages_alone_and_is_short():
    text = TOUR.read_text(encoding="utf-8")
    nodes = list(ast.walk(ast.parse(text)))
    imports = [node for node in nodes if isinstance(node, ast.Import)]
    assert {alias.name for node in imports for alias in node.names} == {"jaxtube", "sets"}
    assert not any(isinstance(node, ast.ImportFrom) for node in nodes)
    code = [line for line in text.splitlines() if line.strip() and not line.startswith("#")]
    assert len(code) < LINES


@pytest.mark.slow
def test_the_tour_runs(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    names = runpy.run_path(str(TOUR))
    assert names["certificate"].holds_for_robot
    assert names["mine"].outside == names["tube_mpc"].outside == 0
    assert names["run"].share("e_outside_E").laps == 0
    assert not names["worst"].is_violated
    assert names["tuned"].is_certified
    assert names["same"].certificate.verdict == names["certificate"].verdict
    assert "CERTIFIED" in capsys.readouterr().out
