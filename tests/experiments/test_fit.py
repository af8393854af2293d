"""Laws of the command `fit`: the border is written as a scenario that loads, an interrupted run
goes on, what is found and what is not is said and drawn."""

import json
import math

import numpy as np
import pytest
from figure_checks import assert_presentable, legend_texts
from pages import find_first_lines
from spoken import leave_out_waits

from jaxtube.experiments.cli import main, parse
from jaxtube.experiments.fit import attempts as module
from jaxtube.experiments.fit import command, figures
from jaxtube.experiments.fit.attempts import Fit, fit
from jaxtube.experiments.fit.report import report
from jaxtube.experiments.options import FitOptions, command_line
from jaxtube.experiments.run.value_log import ValueLog
from jaxtube.scenario import load
from jaxtube.scenario.tree import to_toml
from jaxtube.synthesis.attempt import Attempt
from jaxtube.synthesis.border import Border
from jaxtube.synthesis.levers import FITTED, SLIP, SPEED
from jaxtube.synthesis.starts import caps_and_gains, without_caps

CAPS = (0.01, 0.02, 1.0, 0.2915, 0.4754, 1.095, 0.1419, 1.235, 9.99, 9.302, 9.302)
IDENTITY = {"scenario": "certified"}


def invent(scenario, lever, factor, near) -> Attempt:
    """Return an attempt whose ratio is 1 where the speed times twice the slip error is 0.5, and
    limits are 0.2 m; limits break above 6 m/s."""
    scaled = lever.scale(scenario, factor)
    speed = scaled.reference.speed_mps
    width = scaled.constraints.lateral_m
    level = math.log(4 * speed * scaled.slip.relative_error * 0.2 / width)
    if speed > 6:
        return Attempt(factor, lever.measure(scaled), None, 5.0, "initial.y_m", CAPS, False, "far")
    held = level < 0
    row = "coupling" if speed < 1 else "constraints.lateral_m"
    ratio = math.exp(level)
    reason = "" if held else "the tube fills too much"
    return Attempt(factor, lever.measure(scaled), ratio, level, row, CAPS, held, reason)


@pytest.fixture
def asked(monkeypatch):
    """Replace searches and designs by what is invented; return the questions asked."""
    questions = []

    def note(name):
        def ask(scenario, lever, factor, near):
            questions.append((name, factor))
            return invent(scenario, lever, factor, near)

        return ask

    monkeypatch.setattr(module, "METHODS", {name: note(name) for name in ("design", "search")})
    return questions


@pytest.fixture
def scenario():
    return without_caps(load("certified"))


def value_of(attempt: Attempt | None) -> float:
    assert attempt is not None and attempt.value is not None
    return attempt.value


def run(tmp_path, *words) -> int:
    return main(["fit", *words, "--out", str(tmp_path / "run")])


@pytest.mark.parametrize("quantity", FITTED)
def test_the_fitted_scenario_loads_and_is_the_border(quantity, asked, tmp_path, capsys):
    assert run(tmp_path, quantity, "--scenario", "certified") == 0
    fitted = load(tmp_path / "run" / "fitted.toml")
    metrics = json.loads((tmp_path / "run" / "metrics.json").read_text())
    best = metrics["best"]
    assert best["is_certified"] and 0.98 < best["ratio"] <= 1
    assert metrics["beyond"]["ratio"] > 1
    lever = FITTED[quantity]
    assert lever.measure(fitted) == pytest.approx(best["value"])
    assert caps_and_gains(fitted) == CAPS
    first = (tmp_path / "run" / "fitted.toml").read_text().splitlines()[0]
    assert first.startswith("# Fitted from certified. The ")
    for name in ("frontier.png", "frontier.pdf", "report.txt", "scenario.toml", "manifest.json"):
        assert (tmp_path / "run" / name).exists()
    verdict, printed = find_first_lines(tmp_path / "run")
    assert verdict == printed
    told = capsys.readouterr().out
    assert "does not prove that there is" in told
    assert f"design --scenario {tmp_path / 'run' / 'fitted.toml'}" in told


def test_an_interrupted_run_goes_on_and_ends_alike(asked, scenario, tmp_path):
    with ValueLog(tmp_path / "log", IDENTITY) as log:
        whole = fit(scenario, SPEED, log, CAPS)
    entries = sorted((tmp_path / "log").glob("*.record"))
    assert len(entries) == len(asked) > 10
    for path in entries[7:]:
        path.unlink()
    asked.clear()
    with ValueLog(tmp_path / "log", IDENTITY) as log:
        assert fit(scenario, SPEED, log, CAPS) == whole
    assert len(asked) == len(entries) - 7


def test_the_frontier_follows_the_second_quantity(asked, scenario, tmp_path):
    with ValueLog(tmp_path / "log", IDENTITY) as log:
        found = fit(scenario, SPEED, log)
    assert found.second is SLIP
    assert [point.factor for point in found.frontier] == [0.5, 0.75, 1.0, 1.25, 1.5]
    for point in found.frontier:
        # 4 v r 0.2 / 0.3 = 1
        border = min(0.375 / point.value, 6.0)
        assert border * 0.95 <= value_of(point.attempt) <= border * 1.001
    assert value_of(found.border.attempts[0]) < 0.7 * value_of(found.border.best)


def test_the_figure_shows_what_is_certified_what_binds_and_the_scenario(asked, scenario, tmp_path):
    with ValueLog(tmp_path / "log", IDENTITY) as log:
        found = fit(scenario, SPEED, log)
    figure = figures.frontier(scenario, found)
    assert_presentable(figure)
    texts = legend_texts(figure)
    assert {"certified", "not certified", "the scenario"} <= set(texts)
    assert any(text.endswith(" binds") for text in texts)


def test_a_quantity_without_a_border_is_told_and_drawn(asked, scenario, monkeypatch, tmp_path):
    def deny(scenario, lever, factor, near):
        value = lever.measure(lever.scale(scenario, factor))
        return Attempt(factor, value, 1.4, math.log(1.4), "coupling", CAPS, False, "too wide")

    monkeypatch.setattr(module, "METHODS", {"design": deny, "search": deny})
    monkeypatch.setattr(command, "say_nearest", lambda *arguments: ["nearest: another slip"])
    assert run(tmp_path, "speed", "--require-certificate") == 3
    assert not (tmp_path / "run" / "fitted.toml").exists()
    text = (tmp_path / "run" / "report.txt").read_text()
    assert text.startswith("NOT CERTIFIED at any speed tried\n")
    assert "Closest at reference." in text
    assert "nearest: another slip" in text
    with ValueLog(tmp_path / "log", IDENTITY) as log:
        found = fit(scenario, SPEED, log)
    assert found.border.best is None and found.frontier == ()
    assert_presentable(figures.frontier(scenario, found))
    assert "too wide" in report(scenario, found)


@pytest.mark.parametrize("least", [0.4, 1.4, 7.0])
def test_the_figure_shows_every_attempt_however_much_its_tube_fills(scenario, least):
    attempts = tuple(
        Attempt(factor, SPEED.measure(SPEED.scale(scenario, factor)), ratio, 1.0, "coupling", CAPS)
        for factor, ratio in ((0.5, least), (1.0, 3 * least), (1.5, None))
    )
    figure = figures.frontier(scenario, Fit(SPEED, Border(attempts, None, attempts[0]), None, ()))
    assert_presentable(figure)
    axes = figure.axes[0]
    marks = [line for line in axes.lines if line.get_marker() == "o"]
    heights = [np.asarray(line.get_ydata()).item() for line in marks]
    top = axes.get_ylim()[1]
    assert len(marks) == 4 and max(heights) <= top
    assert heights[0] == least < top


def test_where_no_attempt_has_a_tube_nothing_is_drawn_and_that_is_said(
    asked, monkeypatch, tmp_path
):
    def deny(scenario, lever, factor, near):
        return Attempt(factor, reason="controller: no tube is bounded; wider caps")

    monkeypatch.setattr(module, "METHODS", {"design": deny, "search": deny})
    monkeypatch.setattr(command, "say_nearest", lambda *arguments: ["nearest: another slip"])
    assert run(tmp_path, "speed") == 0
    assert not list((tmp_path / "run").glob("frontier.*"))
    text = (tmp_path / "run" / "report.txt").read_text()
    assert text.startswith("NOT CERTIFIED at any") and "No figure" in text


@pytest.mark.parametrize(
    ("words", "fragments"),
    [
        (["speed", "--scenario", "paper"], ["fit: model, input_map", "exact_jacobian"]),
        (["speed", "--scenario", "certified_wide"], ["operating.bands", "leave them out"]),
        (["width"], ["width", "speed"]),
        (["slip", "slip.relative_error=0"], ["has none of it"]),
    ],
)
def test_what_has_no_border_is_refused_in_one_line(words, fragments, asked, tmp_path, capsys):
    assert run(tmp_path, *words) == 2
    (line,) = leave_out_waits(capsys.readouterr().err)
    assert all(fragment in line for fragment in fragments)
    assert asked == []


def test_the_quantity_is_given_by_its_place_and_names_the_folder():
    options = parse(["fit", "limits", "--scenario", "mine.toml"])
    assert isinstance(options, FitOptions)
    assert str(options.folder) == "runs/fit-mine-limits"
    assert command_line(options).endswith("fit --scenario mine.toml limits")
    again = parse(command_line(options).split()[3:])
    assert again == options


@pytest.mark.slow
def test_the_fitted_speed_is_certified_by_design(tmp_path):
    slow = without_caps(load("certified", ["initial.x_m=0", "initial.y_m=0"]))
    path = tmp_path / "mine.toml"
    path.write_text(to_toml(slow))
    assert run(tmp_path, "speed", "--scenario", str(path)) == 0
    fitted = str(tmp_path / "run" / "fitted.toml")
    words = ["design", "--scenario", fitted, "--require-certificate", "--out", str(tmp_path / "d")]
    assert main(words) == 0
