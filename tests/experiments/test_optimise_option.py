"""What the command `design` does with the result of `--optimise`, and says where nothing holds."""

import dataclasses
import tomllib

import msgspec
import pytest

from jaxtube.experiments.design import command
from jaxtube.experiments.design import nearest as nearest_lines
from jaxtube.experiments.options import DesignOptions
from jaxtube.scenario import ScenarioError, load, replace
from jaxtube.synthesis.descent import ROWS
from jaxtube.synthesis.levers import NOISE, RANGE, SPEED
from jaxtube.synthesis.optimise import UnboundedTubeError
from jaxtube.synthesis.optimum import Optimum

NONE: dict[str, float] = {row: 0.0 for row in ROWS}
OPTIONS = DesignOptions(scenario="mine.toml", overrides=("noise.lateral_m=0.003",))


@pytest.fixture
def outgrown() -> Optimum:
    pressures = NONE | {"lateral error": 0.7, "heading error": 0.3, "constraints.lateral_m": 0.4}
    return Optimum(load("certified"), 1.17, 1.0, NONE, pressures)


def test_the_lines_to_copy_are_toml_that_gives_the_scenario_back(outgrown):
    scenario = load("certified")
    text = command.scenario_lines(dataclasses.replace(outgrown, ratio=0.45))
    sections = tomllib.loads(text)
    assert sections["controller"]["tracking_gains"] == list(scenario.controller.tracking_gains)
    caps = msgspec.structs.asdict(scenario.operating)
    assert sections["operating"] == {
        name: cap for name, cap in caps.items() if isinstance(cap, float)
    }


def test_a_tube_that_outgrows_every_choice_ends_in_one_line_with_what_is_nearest(
    monkeypatch, capsys, outgrown
):
    slower = SPEED.scale(load("certified"), 0.5)
    monkeypatch.setattr(command, "optimise", lambda *arguments: outgrown)
    monkeypatch.setattr(
        nearest_lines, "find_nearest", lambda found, bar: {SPEED: slower, NOISE: None}
    )
    with pytest.raises(ScenarioError) as refused:
        command.find_caps_and_gains(load("certified"), OPTIONS)
    line = str(refused.value)
    assert "\n" not in line
    for words in (
        "fills 117.0% of its caps, above all of the lateral error",
        "constraints.lateral_m holds the caps down",
        "certified for starts on the path: reference.speed_mps = 0.68",
        "nothing certified was found by another noise alone",
        "fit speed --scenario mine.toml noise.lateral_m=0.003`",
    ):
        assert words in line
    assert "[operating]" not in capsys.readouterr().out


def test_where_no_gains_bound_a_tube_the_nearest_reference_is_told(monkeypatch):
    def find_none(*arguments, **options):
        raise UnboundedTubeError("optimise: no gains bound a tube")

    narrower = replace(load("certified"), {"reference.wheel_speed_min_mps": 1.223})
    for module in (command, nearest_lines):
        monkeypatch.setattr(module, "optimise", find_none)
    monkeypatch.setattr(
        nearest_lines, "find_nearest_bounded", lambda scenario, bar: {RANGE: narrower, SPEED: None}
    )
    with pytest.raises(ScenarioError) as refused:
        command.find_caps_and_gains(load("certified"), OPTIONS)
    words = (
        "no gains bound a tube",
        "nearest found, certified for starts on the path: reference.wheel_speed_min_mps = 1.223",
        "nothing certified was found by another speed alone",
    )
    for told in (
        str(refused.value),
        "; ".join(nearest_lines.say_nearest(load("certified"), OPTIONS)),
    ):
        assert "\n" not in told
        assert all(each in told for each in words)


def test_a_design_that_fails_is_told_of_caps_and_gains_that_hold(monkeypatch, outgrown):
    held = dataclasses.replace(outgrown, ratio=0.8)
    monkeypatch.setattr(nearest_lines, "optimise", lambda *arguments, **options: held)
    (line,) = nearest_lines.say_nearest(load("certified"), OPTIONS)
    assert "the tube fills 80.0%" in line
    assert "design --optimise --scenario mine.toml noise.lateral_m=0.003`" in line
    assert nearest_lines.say_nearest(load("paper"), OPTIONS) == []
