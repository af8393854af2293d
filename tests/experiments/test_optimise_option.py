"""What the command `design` does with the result of `--optimise`."""

import tomllib

import msgspec
import pytest

from jaxtube.experiments.design import command
from jaxtube.scenario import ScenarioError, load
from jaxtube.synthesis.optimise import Optimum


def test_the_lines_to_copy_are_toml_that_gives_the_scenario_back():
    scenario = load("certified")
    text = command.scenario_lines(Optimum(scenario, 0.45))
    sections = tomllib.loads(text)
    assert sections["controller"]["tracking_gains"] == list(scenario.controller.tracking_gains)
    caps = msgspec.structs.asdict(scenario.operating)
    assert sections["operating"] == {
        name: cap for name, cap in caps.items() if isinstance(cap, float)
    }


def test_a_tube_that_outgrows_every_choice_ends_in_one_line_with_its_cause(monkeypatch, capsys):
    scenario = load("certified", ["noise.lateral_m=0.003"])
    monkeypatch.setattr(command, "optimise", lambda *arguments: Optimum(scenario, 1.17))
    with pytest.raises(ScenarioError, match=r"fills 117\.0% of a cap at best") as refused:
        command.find_caps_and_gains(scenario)
    assert "\n" not in str(refused.value)
    assert "noise" in str(refused.value)
    assert "[operating]" not in capsys.readouterr().out
