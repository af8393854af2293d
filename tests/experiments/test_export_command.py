"""Laws of the command `export`: its page begins as its report does, says of every precision what is
proved, and is good news only where steps come out as recorded."""

import html

import pytest
from pages import find_first_lines

from jaxtube.experiments.cli import main
from jaxtube.experiments.export import command
from jaxtube.experiments.export.page import UNPROVED, make_page
from jaxtube.experiments.run.exit_codes import ExitCode
from jaxtube.exporting.proof import list_margins
from jaxtube.exporting.write import export
from jaxtube.scenario import load
from jaxtube.synthesis.design import design

WORDS = ["reference.duration_s=4"]


@pytest.fixture(scope="module")
def made():
    return design(load("certified", WORDS))


@pytest.fixture(scope="module")
def exported(made, tmp_path_factory):
    return export(made, tmp_path_factory.mktemp("exported") / "controller", "certified")


@pytest.fixture
def known(monkeypatch, made, exported):
    """Let the command hand out what was designed and exported before."""
    monkeypatch.setattr(command, "make_design", lambda scenario, options: made)
    monkeypatch.setattr(command, "export", lambda *anything: exported)


def test_the_page_begins_as_the_report_and_tells_what_is_proved(known, made, exported, tmp_path):
    assert main(["export", "certified", *WORDS, "--out", str(tmp_path)]) == 0
    line = "exported and certified again as written, in float64 and float32"
    assert find_first_lines(tmp_path) == (line, line)
    told = html.unescape((tmp_path / "report.html").read_text(encoding="utf-8"))
    told_of = [condition.sentence for condition in made.certificate.checked]
    told_of += [*list_margins(exported.proofs), *UNPROVED, *made.certificate.assumptions]
    assert [words for words in told_of if words not in told] == []


def test_steps_that_come_out_otherwise_are_bad_news_and_end_with_1(
    known, made, exported, tmp_path, monkeypatch
):
    replay = command.replay_in_numpy(exported.folder)
    assert make_page(made, exported, replay, None).tone == "good"
    wrong = replay._replace(wrong=1)
    assert make_page(made, exported, wrong, None).tone == "bad"
    monkeypatch.setattr(command, "replay_in_numpy", lambda folder: wrong)
    assert main(["export", "certified", *WORDS, "--out", str(tmp_path)]) == ExitCode.METRIC_OFF
    told = (tmp_path / "report.html").read_text(encoding="utf-8")
    assert "1 of them come out differently" in told
