"""Figures hold the data they claim to show: what is drawn is read back from the axes and compared
with its source."""

import dataclasses
import types

import matplotlib
import numpy as np
import pytest
from matplotlib.collections import FillBetweenPolyCollection
from scipy.optimize import linprog
from tolerances import DRAWN, LINEAR_PROGRAM

from jaxtube.experiments.figures import laps as figures
from jaxtube.experiments.figures import sets as set_figures
from jaxtube.experiments.figures.style import CONTROLLERS
from jaxtube.scenario import load
from jaxtube.synthesis.design import design
from sets.certificate import escape_excess
from sets.invariant import Escape, MaximalRpi

DEGREES = np.array([1.0, 1.0, np.rad2deg(1.0)])
RUNS = 7


@pytest.fixture(scope="module")
def found():
    return design(load("paper"))


@pytest.fixture(scope="module")
def runs(found):
    """Invented runs: one controller leaves E in four runs of seven, and two controllers coincide."""
    generator = np.random.default_rng(3)
    steps = found.problem.reference.steps

    def run(spread):
        errors = (
            generator.uniform(-spread, spread, (steps + 1, RUNS, 1))
            * found.problem.error_set.offsets[:3]
        )
        return types.SimpleNamespace(
            errors=errors, wheels=generator.uniform(1.0, 2.0, (steps, RUNS, 2))
        )

    invented = {"uncompensated": run(0.9), "compensated": run(0.5), "plain_mpc": run(0.2)}
    invented["uncompensated"].errors[150, :4, 0] = 0.31
    return {**invented, "tube_mpc": invented["plain_mpc"]}


def line_of(axes, name):
    """Return the ordinates of a controller's labelled line, its median."""
    (line,) = [
        line for line in axes.lines if str(line.get_label()).startswith(CONTROLLERS[name].label)
    ]
    return np.asarray(line.get_ydata())


def levels(axes):
    """Return the ordinates of the horizontal lines."""
    return {float(line.get_ydata()[0]) for line in axes.lines if len(line.get_ydata()) == 2}


def patches_extent(axes, index):
    """Return the least and the greatest coordinates of a polygon."""
    corners = axes.patches[index].get_xy()
    return np.stack([corners.min(axis=0), corners.max(axis=0)])


def legend_texts(figure):
    return [text.get_text() for text in figure.legends[0].get_texts()]


def test_errors_are_drawn_with_the_limits_of_e_medians_inside_bands(found, runs):
    figure = figures.errors(found.problem, runs)
    panels = np.reshape(figure.axes, (3, 2))
    for coordinate, (axes, limit) in enumerate(zip(panels[:, 0], (0.3, 0.3, 20.0), strict=True)):
        assert {round(level, 9) for level in levels(axes)} == {-limit, limit}
        bands = [band for band in axes.collections if isinstance(band, FillBetweenPolyCollection)]
        assert len(bands) == 6
        for name, band in zip(
            ("uncompensated", "compensated", "tube_mpc"), bands[1::2], strict=True
        ):
            values = runs[name].errors[..., coordinate] * DEGREES[coordinate]
            median = line_of(axes, name)
            assert median == pytest.approx(np.median(values, axis=1), abs=DRAWN)
            low, high = np.quantile(values, (0.05, 0.95), axis=1)
            ordinates = band.get_paths()[0].vertices[:, 1]
            assert set(np.round(ordinates, 9)) == set(np.round(np.concatenate([low, high]), 9))
            assert np.all((low <= median) & (median <= high))


def test_the_share_of_runs_outside_is_named_and_only_the_others_are_magnified(found, runs):
    figure = figures.errors(found.problem, runs)
    texts = legend_texts(figure)
    assert any(text.startswith("No slip compensation (57 %") for text in texts)
    assert not any(text.startswith("Slip compensation (") for text in texts)
    magnified = np.reshape(figure.axes, (3, 2))[0, 1]
    assert not any(str(line.get_label()).startswith("No slip") for line in magnified.lines)


def test_controllers_that_coincide_are_drawn_once_under_both_names(found, runs):
    assert "Tube MPC = MPC without tube" in legend_texts(figures.errors(found.problem, runs))
    apart = {**runs, "plain_mpc": runs["compensated"]}
    assert "Tube MPC" in legend_texts(figures.errors(found.problem, apart))


def test_paths_are_the_reference_where_errors_vanish(found):
    steps = found.problem.reference.steps
    poses = found.problem.reference.poses[: steps + 1]
    still = types.SimpleNamespace(
        errors=np.zeros((steps + 1, RUNS, 3)), wheels=np.zeros((steps, RUNS, 2))
    )
    ahead = types.SimpleNamespace(
        errors=still.errors - np.array([0.2, 0.0, 0.0]), wheels=still.wheels
    )
    whole = figures.trajectories(found.problem, {"uncompensated": ahead, "tube_mpc": still}).axes[0]
    forward = np.column_stack([np.cos(poses[:, 2]), np.sin(poses[:, 2])])
    assert whole.lines[0].get_xydata() == pytest.approx(poses[:, :2] + 0.2 * forward, abs=DRAWN)
    assert whole.lines[1].get_xydata() == pytest.approx(poses[:, :2], abs=DRAWN)


def test_wheel_speeds_are_drawn_with_those_of_the_reference(found, runs):
    panels = np.reshape(figures.wheel_speeds(found.problem, runs).axes, (2, 2))
    steps = found.problem.reference.steps
    for wheel, axes in enumerate(panels[:, 0]):
        expected = np.median(runs["compensated"].wheels[..., wheel], axis=1)
        assert line_of(axes, "compensated") == pytest.approx(expected, abs=DRAWN)
        assert axes.lines[-1].get_ydata() == pytest.approx(
            found.problem.schedule[:steps, wheel], abs=DRAWN
        )


def test_margins_are_those_of_the_worst_step(found, runs):
    figure = figures.margins(found.problem, runs)
    limits = found.problem.error_set.offsets[:3]
    for coordinate, axes in enumerate(figure.axes):
        worst = np.abs(runs["uncompensated"].errors[..., coordinate]).max(axis=0)
        expected = 100 * (1 - worst / limits[coordinate])
        whiskers = np.concatenate([line.get_xdata() for line in axes.lines[:2]])
        assert whiskers.min() == pytest.approx(expected.min())
        assert whiskers.max() == pytest.approx(expected.max())


def test_stress_counts_and_marks_the_runs_outside(found, runs):
    generator = np.random.default_rng(5)
    boundary = generator.normal(size=(60, 3))
    case = {
        "title": "invented",
        "plain": runs["uncompensated"].errors,
        "tube": runs["compensated"].errors,
    }
    axes = figures.stress(found.problem, [case], boundary).axes
    (title,) = [text.get_text() for text in axes[0].texts if "invented" in text.get_text()]
    assert "MPC without tube in 4, by Tube MPC in 0 of 7 runs" in title
    plain, tube = axes[3].lines[1:]
    assert plain.get_xydata() == pytest.approx(case["plain"][0, :4, :2])
    assert len(tube.get_xydata()) == 0
    greatest = np.abs(case["tube"][..., 1]).max(axis=1)
    shown = axes[1].lines[5].get_ydata()
    assert shown == pytest.approx(greatest[: len(shown)])
    assert len(shown) > 150, "the last exit must be shown"
    assert patches_extent(axes[3], 0)[1] == pytest.approx(boundary[:, :2].max(axis=0))


def test_tube_polygons_reach_as_far_as_the_sections(found):
    axes = set_figures.tube_sections(found).axes[3]
    names = ("paper", "summed", "hull", "sequence")
    sections = [section for name in names for section in found.tubes[name][1:]]
    assert len(axes.patches) == len(sections)
    for index, section in enumerate(sections):
        reach = section.support(np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0]])) * (1e3, DEGREES[2])
        assert patches_extent(axes, index)[1] == pytest.approx(reach)


def test_tightened_bounds_are_those_of_the_controller(found):
    axes = set_figures.tightened_sets(found).axes
    for coordinate in range(3):
        expected = found.bounds.errors[0, :, coordinate] * DEGREES[coordinate]
        assert axes[coordinate].lines[0].get_ydata() == pytest.approx(expected)
        farthest = linprog(
            -np.eye(3)[coordinate],
            found.bounds.terminal_normals,
            found.bounds.terminal[0],
            bounds=(None, None),
        )
        last = axes[coordinate].lines[1].get_ydata()
        assert last == pytest.approx(-farthest.fun * DEGREES[coordinate], abs=LINEAR_PROGRAM)
    bounds = found.bounds.inputs[0]
    for index in range(found.problem.horizon):
        drawn = patches_extent(axes[3], 2 * index)[1, 0]
        assert drawn == pytest.approx((bounds[index, 0] + bounds[index, 1]) / 2)  # u1 = (p + q) / 2


def test_terminal_polygons_reach_as_far_as_the_sets_and_hold_the_ellipsoid(found):
    axes = set_figures.terminal_set(found).axes[1]
    maximal = found.terminal.maximal.polytope
    for index, polytope in (
        (0, found.problem.error_set),
        (1, maximal),
        (2, found.terminal.invariant),
    ):
        assert patches_extent(axes, index)[1] == pytest.approx(polytope.support(np.eye(3)[:2]))
    curve = axes.lines[0].get_xydata()
    assert np.all(curve.max(axis=0) <= maximal.support(np.eye(3)[:2]) + DRAWN)
    # Every level set of the cost has the proportions of the square roots of the diagonal of P^-1.
    sides = np.sqrt(np.diag(np.linalg.inv(found.cost.cost)))
    assert curve[:, 0].max() / curve[:, 1].max() == pytest.approx(sides[0] / sides[1], rel=1e-3)


def test_a_design_without_terminal_set_shows_how_it_escapes(found):
    escape = Escape(np.array([0.0, 1.0, 0.0]), 0.05, (0, 3, 1, 2, 0, 0, 3, 3, 1, 2))
    terminal = dataclasses.replace(
        found.terminal, maximal=MaximalRpi(None, escape, 10), invariant=None
    )
    (axes,) = set_figures.terminal_set(dataclasses.replace(found, terminal=terminal)).axes
    assert "No invariant terminal set" in axes.get_title()
    W = terminal.disturbance.vertices()
    excess, _ = escape_excess(terminal.loops, W, escape.normal, escape.offset, escape.loops)
    assert axes.lines[0].get_ydata()[-1] == pytest.approx(escape.offset + excess)


def test_realisations_outside_the_tube_are_marked_and_counted(found):
    horizon = found.problem.horizon
    sections = found.tubes["paper"][1:]
    inside = np.stack([section.vertices()[:3] for section in sections]) * 0.99
    deviations = np.concatenate([inside, 1.5 * inside[:, :1]], axis=1)
    axes = set_figures.realisations_in_tube(found, deviations).axes
    assert len(axes) == 2 * horizon
    for stage in range(horizon):
        assert "25.0 % outside" in axes[stage].get_title()
        near, far = axes[stage].lines
        assert len(near.get_xdata()) == 3
        assert far.get_xydata() == pytest.approx(deviations[stage, 3:, 1:] * (1e3, DEGREES[2]))


def test_the_look_is_independent_of_the_callers_settings(found, runs):
    with matplotlib.rc_context({"font.size": 30, "axes.grid": False}):
        figure = figures.margins(found.problem, runs)
    assert figure.axes[0].xaxis.label.get_size() == 9
    before = dict(matplotlib.rcParams)
    figures.margins(found.problem, runs)
    assert dict(matplotlib.rcParams) == before
