"""Laws of the first line of a report: below 100 characters, and no failure is left out of its
count."""

from types import SimpleNamespace

import pytest

from jaxtube.experiments.beyond import command as beyond
from jaxtube.experiments.paper.report import say_verdict as say_paper
from jaxtube.experiments.run.design_report import say_verdict as say_design
from jaxtube.experiments.run.verdict import LONGEST, fit_line, list_names

NAMES = [f"condition_with_a_name_{number}" for number in range(20)]


def make_design(failing, holds_for_model=False, conditions=None):
    certificate = SimpleNamespace(
        failing=failing,
        holds_for_model=holds_for_model or not failing,
        holds_for_robot=not failing,
        conditions=conditions or {},
    )
    return SimpleNamespace(certificate=certificate)


def test_a_line_that_is_too_long_is_cut_at_a_word():
    words = " ".join(NAMES)
    assert len(fit_line(words)) <= LONGEST
    assert set(fit_line(words).split()) <= {*NAMES, "..."}
    assert fit_line("as it is") == "as it is"


@pytest.mark.parametrize("room", [10, 25, 31, 60, 1000])
@pytest.mark.parametrize("count", [1, 2, 20])
def test_names_that_do_not_fit_are_counted(room, count):
    text = list_names(NAMES[:count], room)
    shown = [name for name in text.replace(" and", ",").split(", ") if name in NAMES]
    left_out = count - len(shown)
    assert len(text) <= room or not shown
    assert text.endswith(f"{left_out} more") or text == f"{count} conditions" or not left_out


@pytest.mark.parametrize("holds_for_model", [True, False])
@pytest.mark.parametrize("failing", [NAMES[:1], NAMES])
def test_the_verdict_of_a_design_that_fails_is_short_and_names_what_fails(failing, holds_for_model):
    line = say_design(make_design(failing, holds_for_model))
    assert len(line) < 100
    assert NAMES[0] in line or f": {len(failing)} conditions" in line
    assert ("NOT for the robot" in line) == holds_for_model


def test_a_certified_design_says_how_much_of_a_cap_its_tube_fills():
    widest = {"widest_tube_fits": SimpleNamespace(holds=True, margin=0.55)}
    assert say_design(make_design([], conditions=widest)).endswith("fills at most 45.0% of a cap")
    assert say_design(make_design([])) == "CERTIFIED: every required condition holds"


def test_the_verdict_of_the_paper_counts_every_claim():
    verdicts = ["reproduced", "in part", "in part", "not reproduced"]
    rows = [SimpleNamespace(verdict=verdict) for verdict in verdicts]
    line = say_paper(rows, make_design(NAMES))
    assert line == (
        "1 of the paper's 4 claims are reproduced, 2 in part, 1 not; the design is NOT CERTIFIED"
    )


def test_a_level_at_which_nothing_failed_is_none_of_the_violations():
    found = {
        "lag": SimpleNamespace(violation=0.1, disturbance=0.0),
        "delay": SimpleNamespace(violation=None, disturbance=0.0),
    }
    assert beyond.say_verdict(found).startswith("of 2 imperfections 1 violate a limit")
