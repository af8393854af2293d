"""Laws of the report of `design`: the verdict first, lines that fit, cures that fit the failure,
margins with what they mean."""

import dataclasses

import numpy as np
import pytest

from jaxtube.experiments.run.design_report import report
from jaxtube.experiments.run.table import WIDTH
from jaxtube.scenario import load
from jaxtube.synthesis.design import design
from sets.certificate import Certificate, Condition


@pytest.fixture(scope="module")
def texts(certified_paper_design, robust_design):
    """Reports by scenario."""
    certified = design(load("certified"))
    return {
        "paper": report(certified_paper_design),
        "robust": report(robust_design),
        "certified": report(certified, {"x": 0.01, "y": 0.02, "heading": 3.0}),
        "assumed": report(dataclasses.replace(certified, certificate=Certificate())),
    }


def test_the_verdict_is_the_first_line(texts):
    assert texts["certified"].startswith(
        "CERTIFIED: every required condition holds; the tube fills at most "
    )
    assert texts["paper"].startswith("NOT CERTIFIED: plan_stays_feasible, disturbance_bound_proved")
    assert texts["robust"].startswith("CERTIFIED for the linear model with w in W alone; NOT ")


def test_lines_fit(texts):
    for text in texts.values():
        assert max(map(len, text.splitlines())) <= WIDTH


def test_a_w_that_is_assumed_is_mended_by_one_that_is_computed(texts):
    for name in ("paper", "robust"):
        head = " ".join(texts[name].split("weight Q")[0].split())
        assert 'set disturbance.bound = "computed"' in head
        assert "experiments/certified/scenario.toml" in head
    assert "what helps" not in texts["certified"]


def test_the_report_says_what_its_tables_mean(texts):
    certified = " ".join(texts["certified"].split())
    for words in (
        "By cause: bilinear,",
        "one alone may come out wider than W",
        "E, limits of the true error: |e_x| 0.151 m, |e_y| 0.243 m, |e_th| 16.5 deg",
        "paper: none, eq. (27)",
        "margin: by how much a condition holds",
    ):
        assert words in certified
    assert "paper: none" not in texts["paper"]
    assert "measured exactly" in texts["paper"]
    for text in texts.values():
        assert "-0" not in text.split("half widths")[0].replace("-0.9", "")
        assert "e-06" not in text


@pytest.mark.parametrize(
    ("name", "margin", "shown"),
    [
        ("reach", 1e-12, "tight"),
        ("reach", -1e-12, "-1e-12"),
        ("reach", -np.inf, "-"),
        ("reach", 0.25, "0.25"),
        ("wheel_limits", 0.25, "0.25 m/s"),
        ("widest_tube_fits", -0.5, "-0.5 of a cap"),
    ],
)
def test_a_margin_is_shown_with_its_unit_and_not_where_it_is_rounding(name, margin, shown):
    line = Certificate((Condition(name, margin, "A sentence."),)).table().splitlines()[0]
    assert line.split("margin")[1].strip() == shown
