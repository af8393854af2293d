"""Laws of completion: what may come next is offered, nothing else, and each shell takes it."""

import os
import re
import shutil
import subprocess
import sys

import pytest

from jaxtube.experiments.cli import main, parse
from jaxtube.experiments.completion.scripts import SCRIPTS
from jaxtube.experiments.completion.words import complete
from jaxtube.experiments.options import COMMANDS
from jaxtube.scenario import load, names
from jaxtube.scenario.validation import find_choices, known_keys


def test_every_command_scenario_and_key_is_offered():
    assert set(COMMANDS) <= set(complete("jaxtube "))
    assert complete("jaxtube design --scenario ") == names()
    assert {f"{key}=" for key in known_keys()} == {
        word
        for section in complete("jaxtube design ")
        for word in complete(f"jaxtube design {section}")
    }


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ("jaxtube desi", ["design"]),
        ("jaxtube design controller.hor", ["controller.horizon="]),
        (
            "jaxtube design controller.terminal=T-",
            ["controller.terminal=T-A", "controller.terminal=T-B"],
        ),
        ("jaxtube design controller.restart=t", ["controller.restart=true"]),
        ("jaxtube montecarlo --controller plain", ["plain_mpc"]),
        ("jaxtube design --require-certificate contr", ["controller."]),
        ("jaxtube --real", ["--realisations"]),
        ("jaxtube fit sp", ["speed"]),
        ("jaxtube check certified_2", ["certified_20"]),
        ("jaxtube 'des", []),
        ("jaxtube design controller.horizon=", []),
        ("jaxtube design no.such", []),
        ("jaxtube design --out ", []),
        ("jaxtube doctor contr", []),
        ("jaxtube doctor --s", []),
    ],
)
def test_what_goes_on_from_the_typed_word_is_offered(line, words):
    assert complete(line) == words


@pytest.mark.parametrize("name", COMMANDS)
def test_the_options_offered_are_those_that_help_shows(name, capsys):
    assert parse([name, "--help"]) is None
    shown = set(re.findall(r"(?m)^\W+ (?:-h, )?(--[\w-]+)", capsys.readouterr().out))
    assert set(complete(f"jaxtube {name} --")) == shown


def test_every_choice_of_a_key_is_taken_by_the_scenario_reader():
    refused = []
    for key in known_keys():
        for choice in find_choices(key):
            try:
                load("paper", [f"{key}={choice}"])
            except ValueError as error:
                refused += [str(error)] if "unknown choice" in str(error) else []
    assert refused == []


# ------------------------------------------------------------------------------------------- shells

ASK = {
    "bash": 'COMP_LINE="{line}"; COMP_POINT=${{#COMP_LINE}}; COMP_WORDBREAKS=" ="; '
    '_jaxtube jaxtube 2>/dev/null; printf "%s\\n" "${{COMPREPLY[@]}}"',
    "zsh": "words=({line}); CURRENT=${{#words}}; _jaxtube | sort",
    "fish": 'complete -C "{line}"',
}
STAND_INS = {
    "bash": "",
    "zsh": "compdef() {}; _files() {}\n"
    'compadd() { while [[ $1 != -- ]]; do shift; done; shift; print -l -- "$@"; }\n',
    "fish": "",
}
"""What zsh has in its completion system alone."""


@pytest.fixture
def program(tmp_path):
    """A folder with the program `jaxtube`, as an installation has it."""
    path = tmp_path / "jaxtube"
    path.write_text(f'#!/bin/sh\nexec "{sys.executable}" -m jaxtube.experiments "$@"\n')
    path.chmod(0o755)
    return tmp_path


@pytest.mark.parametrize("shell", SCRIPTS)
@pytest.mark.parametrize(
    ("line", "words"),
    [
        ("jaxtube desi", ["design"]),
        ("jaxtube design controller.tube=su", ["controller.tube=summed"]),
    ],
)
def test_a_shell_completes_with_its_script(shell, line, words, program, capsys):
    if not shutil.which(shell):
        pytest.skip(f"{shell} is not installed")
    assert main(["completion", shell]) == 0
    script = STAND_INS[shell] + capsys.readouterr().out + ASK[shell].format(line=line)
    environment = os.environ | {"PATH": f"{program}:{os.environ['PATH']}"}
    told = subprocess.run(
        [shell, "-c", script], env=environment, capture_output=True, text=True, timeout=50
    )
    if shell == "bash":  # it completes what follows "="
        words = [word.rpartition("=")[2] for word in words]
    assert [word.strip() for word in told.stdout.split("\n") if word.strip()] == words
