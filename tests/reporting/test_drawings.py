"""Laws of what the figures of `paper` are drawn from: they come back from the run's folder, and
with them the same curves."""

import numpy as np
import pytest
from invented_laps import invent_laps

from jaxtube.experiments.paper.drawings import (
    DesignOfRun,
    Drawn,
    find_stressed,
    make_drawings,
    read_drawn,
)
from jaxtube.experiments.run.folder import RunFolder
from jaxtube.figures.stress import judge_case, stress
from jaxtube.reporting.laps import find_poses


@pytest.fixture
def drawn():
    generator = np.random.default_rng(1)
    errors = {kind: generator.normal(size=(20, 50, 3)) for kind in ("plain", "tube")}
    errors["tube"][0] = errors["plain"][0]
    case = judge_case("a case", np.full(3, 3.0), errors)
    deviations = generator.normal(size=(5, 9, 3))
    return Drawn(invent_laps(), deviations, {"a_case": case}, generator.normal(size=(6, 3)))


def test_what_figures_show_comes_back_from_the_folder(drawn, tmp_path):
    drawn.save(RunFolder(tmp_path))
    back = read_drawn(tmp_path)
    np.testing.assert_allclose(back.deviations, drawn.deviations, rtol=1e-6)
    np.testing.assert_array_equal(back.boundary, drawn.boundary)
    case = drawn.cases["a_case"]
    again = back.cases["a_case"]
    assert again.title == case.title
    np.testing.assert_allclose(again.starts, case.starts, rtol=1e-6)
    for kind, runs in case.runs.items():
        for field, value in runs._asdict().items():
            np.testing.assert_array_equal(getattr(again.runs[kind], field), value)


def test_the_figure_of_saved_runs_has_the_curves_of_the_runs(drawn, tmp_path, uncertified):
    drawn.save(RunFolder(tmp_path))
    problem = uncertified("paper").problem
    first = stress(problem, list(drawn.cases.values()), drawn.boundary)
    again = stress(problem, list(read_drawn(tmp_path).cases.values()), drawn.boundary)
    for one, other in zip(first.axes[0].lines, again.axes[0].lines, strict=True):
        np.testing.assert_array_equal(one.get_xydata(), other.get_xydata())


def test_saved_laps_are_drawn_where_they_were(drawn, tmp_path, uncertified):
    design = uncertified("paper")
    laps = invent_laps(count=2, steps=design.problem.reference.steps)
    drawn._replace(kept=laps).save(RunFolder(tmp_path))
    own = DesignOfRun("robust", design)
    drawings = make_drawings(own, find_stressed(own), "a label", read_drawn(tmp_path))
    assert "stress_terminal_set" not in drawings
    whole = drawings["trajectories"]().axes[0]
    reference = design.problem.reference.poses[: len(laps.reference_poses)]
    wanted = find_poses(laps.laps["tube_mpc"].errors, reference[:, None]).mean(axis=1)
    drawn_at = [line.get_xydata() for line in whole.lines if len(line.get_xdata()) == len(wanted)]
    distances = [np.abs(points - wanted[:, :2]).max() for points in drawn_at]
    assert min(distances) < 1e-3


def test_what_is_drawn_of_a_case_is_counted_from_its_runs():
    errors = np.zeros((4, 3, 3))
    errors[2, 1, 0] = 0.5
    errors[1, 2, 2] = np.nan
    runs = judge_case("", np.full(3, 0.4), {"plain": errors, "tube": 0 * errors[:, :2]}).runs
    assert runs["plain"].leaves.tolist() == [False, True, True]
    assert (runs["plain"].last_exit, runs["tube"].last_exit) == (2, 0)
    assert runs["plain"].tail[-1, 2] == pytest.approx(0.5 / 0.4)
