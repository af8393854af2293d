"""Laws of the command `beyond`: levels are bracketed, violations named, and the ideal robot is the
one known."""

import json

import jax.numpy as jnp
import numpy as np
import pytest
from pages import find_first_lines
from tolerances import CLOSED_LOOP

from jaxtube import qp
from jaxtube.control.mpc import Diagnostics
from jaxtube.experiments.beyond import command as beyond
from jaxtube.experiments.beyond import figures as beyond_figures
from jaxtube.experiments.beyond import laps as beyond_laps
from jaxtube.experiments.beyond.laps import ImperfectLaps, LapUsage, lap_usage
from jaxtube.experiments.beyond.search import HALVINGS, IMPERFECTIONS, most_tried, search
from jaxtube.experiments.cli import main, parse
from jaxtube.experiments.options import BeyondOptions
from jaxtube.experiments.run.table import WIDTH
from jaxtube.plant.imperfect import Imperfections
from jaxtube.plant.slip_processes import TEST_PROCESSES
from jaxtube.simulation import batches, components
from jaxtube.simulation.rollout import Trajectory

COUNT = len(TEST_PROCESSES)
LEVELS = [0.5**halved for halved in range(8, -1, -1)]


def usage(error=0.0, disturbance=0.0, wheels=0.0, without_plan=0.0):
    """What laps used, the same under every slip process."""
    return LapUsage(
        error=np.tile([0.1, error, 0.2], (COUNT, 1)),
        disturbance=np.full(COUNT, disturbance),
        wheels=np.full(COUNT, wheels),
        without_plan=np.full(COUNT, without_plan),
    )


def proportional(violation, disturbance):
    """Usage that grows with the level and reaches 1 at given ones."""
    return lambda level: usage(error=level / violation, disturbance=level / disturbance)


# ------------------------------------------------------------------------------------------- search


@pytest.mark.parametrize(("violation", "disturbance"), [(0.7, 0.01), (0.3, 0.9), (0.11, 0.111)])
def test_first_levels_are_bracketed(violation, disturbance):
    function = proportional(violation, disturbance)
    found = search(function, LEVELS, whole=False)
    for level, first in ((found.violation, violation), (found.disturbance, disturbance)):
        assert level is not None and first < level <= first * (1 + 2.0**-HALVINGS)
        below = max(tried for tried in found.usages if tried < level)
        assert below <= first
    assert len(found.usages) <= most_tried(LEVELS, whole=False)
    assert list(found.usages) == sorted(found.usages)


def test_whole_levels_are_tried_one_by_one_and_nothing_between():
    found = search(proportional(2.5, 1.5), [1.0, 2.0, 3.0, 4.0, 5.0], whole=True)
    assert (found.disturbance, found.violation) == (2.0, 3.0)
    assert list(found.usages) == [0.0, 1.0, 2.0, 3.0]


def test_what_no_level_does_is_none_and_what_the_ideal_robot_does_is_zero():
    found = search(proportional(np.inf, np.inf), LEVELS, whole=False)
    assert found.violation is found.disturbance is None
    assert len(found.usages) == 1 + len(LEVELS)
    found = search(lambda level: usage(error=2.0, disturbance=2.0), LEVELS, whole=False)
    assert found.violation == found.disturbance == 0.0
    assert list(found.usages) == [0.0]


def test_violations_are_named_with_the_slips_under_which_they_occur():
    assert usage(error=1.0, disturbance=5.0, wheels=1.0).violations == []
    mixed = usage(wheels=1.1, without_plan=0.0)
    mixed.error[1, 1] = 1.01
    mixed.error[3, 1] = np.nan
    mixed.without_plan[2] = 4.0
    assert mixed.violations == [
        "lateral error (vertex, adversarial)",
        "wheel speed (iid, vertex, constant, adversarial)",
        "no plan (constant)",
    ]
    assert usage(disturbance=np.nan).leaves_disturbance_set
    assert not usage(disturbance=1.0).leaves_disturbance_set


# ------------------------------------------------------------------------------------ usage of sets


def test_the_usage_of_laps_is_that_of_their_worst_period(paper_design):
    generator = np.random.default_rng(2)
    problem = paper_design.problem
    steps = problem.reference.steps
    runs = 5
    errors, measured = generator.normal(0.0, 0.1, (2, steps + 1, runs, 3))
    inputs, demanded = generator.normal(0.0, 0.5, (2, steps, runs, 2))
    status = generator.integers(0, 3, (steps, runs))
    none = jnp.zeros((steps, runs), bool)
    diagnostics = Diagnostics(jnp.asarray(status), jnp.zeros((steps, runs)), none, none)
    laps = Trajectory(
        errors=jnp.asarray(errors),
        measured=jnp.asarray(measured),
        inputs=jnp.asarray(inputs),
        wheels=jnp.asarray(demanded),
        demanded=jnp.asarray(demanded),
        diagnostics=diagnostics,
    )
    error, disturbance, wheels, without_plan = lap_usage(paper_design, laps)
    limits = problem.error_set.offsets[:3]
    np.testing.assert_allclose(error, np.abs(errors).max(axis=(0, 1)) / limits)
    w = batches.model_disturbances(paper_design, laps).reshape(-1, 3)
    W = problem.disturbance_set
    for share, is_inside in ((disturbance * 1.001, True), (disturbance * 0.999, False)):
        assert np.all(W.normals @ w.T <= share * W.offsets[:, None]) == is_inside
    assert wheels == pytest.approx(np.abs(demanded).max() / problem.robot.wheel_speed_max)
    assert without_plan == np.sum(status != qp.SOLVED)


@pytest.mark.slow
def test_laps_of_the_ideal_robot_are_those_known_and_imperfection_uses_more(
    paper_design, monkeypatch
):
    monkeypatch.setattr(beyond_laps, "TEST_PROCESSES", ("iid",))
    laps = ImperfectLaps(paper_design, 16, 0)
    starts = np.tile(paper_design.problem.initial_error, (16, 1))
    plant = components.slipping_robot(paper_design, "iid")
    known = batches.run_realisations(laps.controller, plant, starts, 0)
    found = laps.usage(Imperfections())
    expected = lap_usage(paper_design, known)
    for by_process, other in zip(found, expected, strict=True):
        np.testing.assert_allclose(by_process[0], other, atol=CLOSED_LOOP)
    for name, level in (("lag", 0.1), ("delay", 1.0), ("sluggishness", 1.0), ("sideslip", 0.3)):
        assert laps.at(name)(level).disturbance > 1.5 * found.disturbance
    np.testing.assert_array_equal(laps.at("preview")(0.0).error, found.error)


# ------------------------------------------------------------------------------------------ command


@pytest.fixture
def known_usage(monkeypatch, paper_design):
    """Let the laps of the command use what is known: of E the level, of W ten times as much."""

    class KnownLaps(ImperfectLaps):
        def usage(self, imperfections, shift=0):
            return proportional(1.0 if shift else 0.07, 0.01)(max(*imperfections, abs(shift) / 2))

    monkeypatch.setattr(beyond, "make_design", lambda scenario, options: paper_design)
    monkeypatch.setattr(beyond, "ImperfectLaps", KnownLaps)


def test_the_command_writes_levels_with_units_and_prints_a_table(tmp_path, capsys, known_usage):
    assert main(["beyond", "--realisations", "16", "--out", str(tmp_path)]) == 0
    found = json.loads((tmp_path / "metrics.json").read_text())
    assert found["laps_at_a_level"] == 16 * COUNT
    for name, imperfection in IMPERFECTIONS.items():
        violation = found[name][f"first_violation_{imperfection.key}"]
        assert violation == 3 if name == "preview" else 0.07 < violation < 0.0725
        assert found[name]["violated"] == ["lateral error (iid, vertex, constant, adversarial)"]
        levels = [entry[imperfection.key] for entry in found[name]["levels"]]
        assert levels[0] == 0
        assert levels == sorted(levels)
    verdict, _, table = capsys.readouterr().out.partition("\n\n")
    assert len(verdict) < WIDTH and "imperfections" in verdict
    assert find_first_lines(tmp_path) == (verdict, verdict)
    assert max(map(len, table.splitlines())) <= WIDTH
    words = set(table.split())
    for imperfection in IMPERFECTIONS.values():
        assert set(imperfection.title.split()) <= words
    names = {"beyond.png", "beyond.pdf", "metrics.json", "manifest.json", "scenario.toml"}
    names |= {"report.txt", "report.html"}
    assert {path.name for path in tmp_path.iterdir()} == names


def test_the_options_of_the_command_are_those_of_its_module():
    options = parse(["beyond"])
    assert isinstance(options, BeyondOptions)
    assert options.realisations == 1024
    assert str(options.folder) == "runs/beyond-paper"


def test_the_figure_marks_first_violations_and_has_a_panel_an_imperfection():
    searches = {name: search(proportional(0.3, 0.1), LEVELS, whole=False) for name in IMPERFECTIONS}
    searches["delay"] = search(proportional(np.inf, np.inf), LEVELS, whole=False)
    panels = beyond_figures.usages(beyond.panels(searches)).axes
    titles = [imperfection.title for imperfection in IMPERFECTIONS.values()]
    assert [axes.get_title() for axes in panels] == titles
    marks = [[line for line in axes.lines if line.get_marker() == "x"] for axes in panels]
    for name, crosses in zip(searches, marks, strict=True):
        first = searches[name].violation
        assert [np.asarray(line.get_xdata())[0] for line in crosses] == (
            [] if first is None else [first]
        )
