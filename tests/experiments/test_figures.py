"""Figures of the paper's comparison: drawn without a warning, holding the data they are given."""

import dataclasses
import types

import matplotlib
import numpy as np
import pytest
from figure_checks import assert_presentable, extent, legend_texts, save
from tolerances import DRAWN

from jaxtube.coordinates import COORDINATES, KEYS, TO_DISPLAY
from jaxtube.figures import laps, sets
from jaxtube.figures.paths import trajectories
from jaxtube.figures.realisations import realisations_in_tube
from jaxtube.figures.stress import judge_case, stress
from jaxtube.figures.style import CONTROLLERS, INSIDE, MILLIMETRES, OUTSIDE
from jaxtube.figures.tightened import tightened_sets
from sets.certificate import escape_excess
from sets.invariant import Escape, MaximalRpi

RUNS = 7


@pytest.fixture(scope="module")
def design(uncertified):
    return uncertified("paper")


@pytest.fixture(scope="module")
def problem(design):
    return design.problem


@pytest.fixture(scope="module")
def runs(problem):
    """Invented runs: one controller leaves E in four runs of seven, two controllers coincide."""
    generator = np.random.default_rng(3)
    steps = problem.reference.steps

    def make_run(spread):
        shares = generator.uniform(-spread, spread, (steps + 1, RUNS, 1))
        errors = shares * problem.error_set.offsets[:3]
        return types.SimpleNamespace(
            errors=errors, wheels=generator.uniform(1.0, 2.0, (steps, RUNS, 2))
        )

    invented = {
        "uncompensated": make_run(0.9),
        "compensated": make_run(0.5),
        "plain_mpc": make_run(0.2),
    }
    invented["uncompensated"].errors[150, :4, 0] = 0.31
    return {**invented, "tube_mpc": invented["plain_mpc"]}


@pytest.fixture(scope="module")
def deviations(design):
    """Three deviations inside every section, and one outside."""
    inside = np.stack([0.99 * section.vertices()[:3] for section in design.tube[1:]])
    return np.concatenate([inside, 1.5 * inside[:, :1]], axis=1)


@pytest.fixture(scope="module")
def cases(problem, runs):
    """Runs under stress from random starts."""
    errors = {"plain": runs["uncompensated"].errors, "tube": runs["compensated"].errors}
    return [judge_case("invented", problem.error_set.offsets[:3], errors)]


BOUNDARY = np.random.default_rng(5).normal(size=(60, 3))
DRAWINGS = {
    "trajectories": lambda design, runs, *_: trajectories(design.problem, runs),
    "errors": lambda design, runs, *_: laps.errors(design.problem, runs),
    "wheel speeds": lambda design, runs, *_: laps.wheel_speeds(design.problem, runs),
    "margins": lambda design, runs, *_: laps.margins(design.problem, runs),
    "tube sections": lambda design, *_: sets.tube_sections(design, "paper"),
    "terminal set": lambda design, *_: sets.terminal_set(design, "paper"),
    "sets": lambda design, *_: sets.design_sets(design, "paper"),
    "tightened sets": lambda design, *_: tightened_sets(design, "paper"),
    "realisations": lambda design, _, deviations, __: realisations_in_tube(design, deviations),
    "stress": lambda design, _, __, cases: stress(design.problem, cases, BOUNDARY),
}


@pytest.mark.parametrize("name", DRAWINGS)
def test_a_figure_is_drawn_without_a_warning_and_its_axes_tell_units(
    name, design, runs, deviations, cases
):
    assert_presentable(DRAWINGS[name](design, runs, deviations, cases))


def test_the_three_coordinates_are_those_of_the_results_files():
    keys = " ".join(KEYS)
    assert keys == "longitudinal_m lateral_m heading_deg"
    assert [coordinate.error for coordinate in COORDINATES] == ["e_x", "e_y", "e_\\theta"]
    factors = [float(factor) for factor in TO_DISPLAY]
    assert factors == pytest.approx([1.0, 1.0, 180 / np.pi], rel=1e-15)


def test_errors_are_drawn_with_the_limits_of_e_and_the_share_outside(problem, runs):
    figure = laps.errors(problem, runs)
    for coordinate, limit in enumerate((0.3, 0.3, 20.0)):
        axes = np.reshape(figure.axes, (3, 2))[coordinate, 0]
        (median,) = [
            line
            for line in axes.lines
            if str(line.get_label()).startswith(CONTROLLERS["compensated"].label)
        ]
        values = runs["compensated"].errors[..., coordinate] * TO_DISPLAY[coordinate]
        assert median.get_ydata() == pytest.approx(np.median(values, axis=1), abs=DRAWN)
        levels = {float(line.get_ydata()[0]) for line in axes.lines if len(line.get_ydata()) == 2}
        assert sorted(levels) == pytest.approx([-limit, limit])
    texts = legend_texts(figure)
    assert any(text.startswith("No slip compensation (57 %") for text in texts)
    assert "Tube MPC = MPC without tube" in texts, "runs that coincide are drawn once"


def test_paths_are_the_reference_where_errors_vanish(problem):
    steps = problem.reference.steps
    poses = problem.reference.poses[: steps + 1]
    still = types.SimpleNamespace(
        errors=np.zeros((steps + 1, RUNS, 3)), wheels=np.zeros((steps, RUNS, 2))
    )
    whole = trajectories(problem, {"tube_mpc": still}).axes[0]
    assert whole.lines[0].get_xydata() == pytest.approx(poses[:, :2], abs=DRAWN)


def test_a_run_that_is_not_finite_counts_as_outside_and_is_drawn(problem, runs, cases):
    errors = runs["compensated"].errors.copy()
    errors[20:, 2] = np.nan
    lost = {"compensated": types.SimpleNamespace(errors=errors, wheels=runs["compensated"].wheels)}
    figure = save(laps.errors(problem, lost))
    assert any("14 % leave" in text for text in legend_texts(figure))
    for draw in (trajectories, laps.wheel_speeds, laps.margins):
        save(draw(problem, lost))
    both = {"plain": runs["uncompensated"].errors, "tube": errors}
    lost_case = judge_case("lost", problem.error_set.offsets[:3], both)
    assert lost_case.runs["tube"].leaves.sum() == 1
    save(stress(problem, [lost_case], BOUNDARY))


def test_stress_counts_the_runs_outside(problem, cases):
    title = stress(problem, cases, BOUNDARY).axes[0].get_title()
    assert "of 7 runs" in title and "4 without tube, 0 with" in title


def test_tube_polygons_reach_as_far_as_the_sections(design):
    axes = sets.tube_sections(design, "paper").axes[2]
    names = ("paper", "summed", "hull", "sequence")
    sections = [section for name in names for section in design.tubes[name][1:]]
    for patch, section in zip(axes.patches, sections, strict=True):
        reach = section.support(np.eye(3)[1:]) * MILLIMETRES.factors[1:]
        assert extent(patch)[1] == pytest.approx(reach)


def test_a_design_without_terminal_set_shows_how_it_escapes(design):
    escape = Escape(np.array([0.0, 1.0, 0.0]), 0.05, (0, 3, 1, 2, 0, 0, 3, 3, 1, 2))
    terminal = dataclasses.replace(
        design.terminal, maximal=MaximalRpi(None, escape, 10), invariant=None
    )
    without = dataclasses.replace(design, terminal=terminal)
    figure = sets.terminal_set(without, "paper")
    assert_presentable(figure)
    W = [section.vertices() for section in terminal.disturbances]
    excess, _ = escape_excess(terminal.loops, W, escape.normal, escape.offset, escape.loops)
    reach = figure.axes[0].lines[0].get_ydata()
    assert reach[-1] == pytest.approx(escape.offset + excess)
    assert_presentable(sets.design_sets(without, "paper"))


def test_deviations_have_the_colour_of_the_projection_they_are_seen_in(design, deviations):
    axes = realisations_in_tube(design, deviations).axes
    horizon = design.problem.horizon
    assert "25.0 % outside" in axes[0].get_title()
    for panel in axes[: 2 * horizon]:
        inside, outside = panel.lines
        assert (inside.get_color(), outside.get_color()) == (INSIDE, OUTSIDE)
        (least, greatest) = extent(panel.patches[0])
        shown = inside.get_xydata()
        assert np.all(shown >= least - DRAWN) and np.all(shown <= greatest + DRAWN)
        assert len(shown) + len(outside.get_xdata()) == deviations.shape[1]


def test_the_look_is_independent_of_the_callers_settings(problem, runs):
    before = dict(matplotlib.rcParams)
    with matplotlib.rc_context({"font.size": 30, "axes.grid": False}):
        figure = laps.margins(problem, runs)
    assert figure.axes[0].xaxis.label.get_size() == 9
    assert dict(matplotlib.rcParams) == before
