"""Figures of tuning: drawn without a warning, holding what they are given, and their rules."""

import numpy as np
import pytest
from figure_checks import assert_presentable, extent, legend_texts, save
from matplotlib.colors import to_hex
from matplotlib.text import Annotation, Text
from quadprog import solve_qp
from tolerances import DRAWN

from jaxtube.experiments.tune.comparison_figure import comparison_figure
from jaxtube.experiments.tune.figures import error_figure, settled_rms, tube_figure
from jaxtube.experiments.tune.front_figure import Group, front_figure
from jaxtube.experiments.tune.parameter_figure import parameter_figure, spread
from jaxtube.figures.learning import LearningCurve, learning_figure
from jaxtube.figures.style import CENTIMETRES
from jaxtube.figures.ticks import spans_decade
from sets.polytope import Polytope

SPREAD = 1e-9
"""Places of names, of order one, against a quadratic program."""

HALF_WIDTHS = np.array([0.3, 0.3, np.deg2rad(20.0)])
LIMIT = 0.0288


def make_curve(iterates=60, uncertified=10):
    """Return an invented run: uncertified at first, one iterate without a design and one without
    an objective."""
    generator = np.random.default_rng(1)
    i = np.arange(iterates)
    first = np.where(i < uncertified, 700.0 * np.exp(-i / 1.6), 0)
    base = 0.5 + 1.5 * np.exp(-i / 12) + first
    held_out = base * (1 + 0.02 * generator.normal(size=iterates))
    held_out[iterates // 3] = np.inf
    objective = base * (1 + 0.02 * generator.normal(size=iterates))
    objective[iterates // 2] = np.nan
    return LearningCurve(
        iteration=i,
        objective=objective,
        held_out=held_out,
        low=0.8 * held_out,
        high=1.3 * held_out,
        certified=(i >= uncertified) & np.isfinite(held_out),
        lateral=(9 * np.exp(-i / 10) + 1.3) * 1e-3,
        effort=0.026 + 0.0025 * (1 - np.exp(-i / 15)),
    )


def titles(figure):
    return {axes.get_title() for axes in figure.axes}


def marks(axes, marker, face=None):
    """Return the points of all lines with a mark, of those with a face of a colour where it is
    given."""
    lines = [line for line in axes.lines if line.get_marker() == marker]
    if face is not None:
        lines = [line for line in lines if to_hex(line.get_markerfacecolor()) == to_hex(face)]
    return np.concatenate([line.get_xydata() for line in lines]) if lines else np.empty((0, 2))


def test_iterates_are_filled_where_certified_and_the_best_of_these_is_returned():
    run = make_curve()
    figure = learning_figure({"Adam": run}, LIMIT)
    assert_presentable(figure)
    (effort,) = [axes for axes in figure.axes if axes.get_title() == "effort"]
    source = np.column_stack([run.iteration, run.effort])
    for chosen, face in ((run.certified, "#0072B2"), (~run.certified, "white")):
        assert marks(effort, "o", face) == pytest.approx(source[chosen], abs=DRAWN)
    best = min(np.flatnonzero(run.certified), key=lambda i: run.held_out[i])
    assert marks(effort, "*") == pytest.approx(source[[best]])
    text = legend_texts(figure)[0]
    assert text.startswith(f"Adam: objective {run.held_out[0]:.3g} → {run.held_out[best]:.3g}")


MAGNIFIED = "the same, magnified close to the best"


def test_the_magnified_panel_is_there_where_enough_iterates_are_close_to_the_best():
    run = make_curve()
    assert MAGNIFIED in titles(learning_figure({"": run}, None))
    certified = np.zeros(60, bool)
    nothing = learning_figure({"": run._replace(certified=certified)}, None)
    assert MAGNIFIED not in titles(nothing)
    assert legend_texts(nothing)[0] == "no certified iterate"
    certified = certified.copy()
    certified[-1] = True
    single = save(learning_figure({"": run._replace(certified=certified)}, None))
    assert MAGNIFIED not in titles(single)


def test_a_run_of_one_iterate_is_drawn():
    first = LearningCurve(*(values[:1] for values in make_curve()))
    save(learning_figure({"": first}, LIMIT))


def test_a_decade_is_spanned_by_positive_numbers_alone():
    assert spans_decade(np.array([1.0, np.inf, 11.0, np.nan]))
    assert not spans_decade(np.array([1.0, 9.0]))
    assert not spans_decade(np.array([-1.0, 11.0]))
    assert not spans_decade(np.array([np.nan]))


@pytest.fixture(scope="module")
def cloud():
    """Corners of a symmetric set that reaches 1 along every axis."""
    points = np.random.default_rng(5).uniform(-1, 1, (20, 3))
    points /= np.abs(points).max(axis=0)
    return np.vstack([points, -points])


def test_tubes_are_drawn_beside_the_box_of_the_caps(cloud):
    before = Polytope.from_vertices(cloud * HALF_WIDTHS * [0.4, 2.1, 0.8])
    after = Polytope.from_vertices(cloud * HALF_WIDTHS * [0.3, 0.46, 0.4])
    figure = tube_figure(before, after, HALF_WIDTHS)
    assert_presentable(figure)
    caps = (HALF_WIDTHS * CENTIMETRES.factors)[:2]
    assert extent(figure.axes[0].patches[0])[1] == pytest.approx(caps)
    reach = (after.support(np.eye(3)) * CENTIMETRES.factors)[:2]
    assert extent(figure.axes[0].patches[-1])[1] == pytest.approx(reach)
    first, last = legend_texts(figure)[:2]
    assert "(210 %)" in first and "up to 63 cm" in first and "(46 %)" in last
    unbounded = save(tube_figure(None, after, HALF_WIDTHS))
    assert legend_texts(unbounded)[0] == "before tuning: no bounded tube"


def test_errors_are_drawn_with_the_rms_once_settled():
    generator = np.random.default_rng(2)
    fall = np.exp(-np.arange(301) / 20)[:, None, None]
    start = np.array([0.2, 0.15, 0.1])
    before = fall * start + 9e-3 * generator.normal(size=(301, 20, 3))
    after = fall * start + 1.3e-3 * generator.normal(size=(301, 30, 3))
    figure = error_figure(before, after, 0.1, 100)
    assert_presentable(figure)
    lateral = np.reshape(figure.axes, (3, 2))[1, 1]
    assert "[mm]" in lateral.get_ylabel()
    means = []
    for errors in (before, after):
        by_lap = [np.linalg.norm(lap[100:, 1]) / np.sqrt(201) for lap in errors.swapaxes(0, 1)]
        means.append(np.mean(by_lap))
        assert settled_rms(errors, 100)[1] == pytest.approx(means[-1])
    expected = f"RMS {1e3 * means[0]:.3g} → {1e3 * means[1]:.3g} mm"
    assert lateral.get_title(loc="right") == expected


@pytest.mark.parametrize("full", [False, True])
def test_weights_and_gains_are_drawn_and_shaded_where_not_certified(full):
    i = np.arange(50)
    certified = (i >= 10) & (i != 25)
    lower = np.tile(np.eye(3), (50, 1, 1))
    lower[:, 1, 1] = np.exp(i / 20)
    lower[:, 1, 0] = 0.3 * np.sin(i / 30) if full else 0.0
    error_weights = lower @ lower.swapaxes(1, 2)
    input_weights = np.tile(np.diag([0.3, 0.2]), (50, 1, 1))
    gains = np.exp(np.outer(i / 40, [0.2, 0.4, 0.39]))
    names = ["k1", "k2", "k3"]
    figure = parameter_figure(error_weights, input_weights, gains, names, certified)
    assert_presentable(figure)
    assert ("off the diagonal of $Q$" in titles(figure)) == full
    (axes,) = [axes for axes in figure.axes if axes.get_title() == "gains"]
    for line, values in zip(axes.lines, gains.T, strict=True):
        assert line.get_ydata() == pytest.approx(values, abs=DRAWN)
    shaded = [patch.get_x() + 0.5 for patch in axes.patches]
    assert shaded == pytest.approx(np.flatnonzero(~certified))


@pytest.mark.parametrize("gap", [0.02, 0.08, 0.15, 0.4])
def test_names_are_spread_as_little_as_keeps_them_apart(gap):
    generator = np.random.default_rng(6)
    for count in (2, 3, 7):
        places = generator.uniform(-0.1, 1.1, count).clip(0, 1)
        order = np.argsort(places)
        room = min(gap, 1 / (count - 1))
        apart = np.diff(np.eye(count), axis=0)
        rows = np.vstack([apart, np.eye(count)[:1], -np.eye(count)[-1:]])
        bounds = np.array([*[room - 1e-12] * (count - 1), 0, -1])
        expected = solve_qp(np.eye(count), places[order], rows.T, bounds)[0]
        assert spread(places, gap)[order] == pytest.approx(expected, abs=SPREAD)
    assert spread(np.array([0.5]), gap) == pytest.approx([0.5])


def make_groups():
    """Return a grid of designs with its front, and designs whose names stand beside them."""
    generator = np.random.default_rng(3)
    effort = generator.uniform(0.0245, 0.0335, 60)
    lateral = 1.2e-3 + 9e-3 * np.exp((0.024 - effort) / 0.0018)
    lateral *= np.exp(0.5 * np.abs(generator.normal(size=60)))
    tube = 0.2 * np.exp(0.7 * generator.normal(size=60))
    tube[generator.random(60) < 0.15] = np.nan
    certified = np.nan_to_num(tube, nan=1.0) < 0.3
    front = [i for i in range(60) if not np.any((effort < effort[i]) & (lateral < lateral[i]))]
    singles = {
        "Nelder–Mead": (0.0016, 0.0284, 0.17, True, "search"),
        "paper's weights": (0.009, 0.026, 0.63, False, "start"),
        "LQR weights": (0.0082, 0.0262, np.nan, False, "start"),
        "tuned": (0.00131, 0.0285, 0.138, True, "tuned"),
    }
    groups = [
        Group("grid", lateral, effort, tube, certified, "grid"),
        Group("front", lateral[front], effort[front], tube[front], certified[front], "front"),
    ]
    for name, (error, spent, width, holds, kind) in singles.items():
        numbers = [np.array([value]) for value in (error, spent, width, holds)]
        groups.append(Group(name, *numbers, kind))
    return groups


def test_designs_stand_at_their_error_effort_and_tube_with_names_close_by():
    groups = make_groups()
    figure = front_figure(groups, LIMIT)
    assert_presentable(figure)
    effort, tube = figure.axes
    grid = groups[0]
    drawn = marks(effort, "o")
    expected = np.column_stack([grid.effort, 1e3 * grid.lateral])
    in_order = np.lexsort(expected.T)
    assert drawn[np.lexsort(drawn.T)] == pytest.approx(expected[in_order], abs=DRAWN)
    strip = tube.patches[0].get_x()
    assert np.sum(marks(tube, "o")[:, 0] > strip) == np.isnan(grid.tube).sum()
    figure.draw_without_rendering()
    names = [text for text in effort.texts if isinstance(text, Annotation)]
    assert {text.get_text() for text in names} == {group.name for group in groups[2:]}
    for text in names:
        box = Text.get_window_extent(text)
        assert effort.bbox.contains(*box.min) and effort.bbox.contains(*box.max)


def test_bounded_tubes_need_no_strip():
    groups = [group._replace(tube=np.nan_to_num(group.tube, nan=0.3)) for group in make_groups()]
    assert not save(front_figure(groups[2:], None)).axes[1].patches


ROWS = [
    ("lemniscate", "paper's weights", 9.1e-3, 8.7e-3, 9.5e-3),
    ("lemniscate", "tuned", 1.3e-3, 1.25e-3, 1.36e-3),
    ("circle", "paper's weights", 7.28e-3, 7.0e-3, 7.6e-3),
    ("circle", "tuned", 1.04e-3, 0.998e-3, 1.09e-3),
]


def test_each_design_has_its_mean_and_interval_in_millimetres_by_reference():
    figure = comparison_figure(ROWS)
    assert_presentable(figure)
    (axes,) = figure.axes
    assert [label.get_text() for label in axes.get_yticklabels()] == [row[1] for row in ROWS]
    for row, ends, dot in zip(ROWS, axes.lines[::2], axes.lines[1::2], strict=True):
        assert dot.get_xdata() == pytest.approx([1e3 * row[2]])
        assert ends.get_xdata() == pytest.approx([1e3 * row[3], 1e3 * row[4]])
    written = [text.get_text() for text in axes.texts]
    assert "1.04  (0.998 to 1.09)" in written
    assert axes.get_xlim()[0] == 0, "means within a decade are seen from zero"
    wide = [*ROWS, ("circle", "none", 0.5, 0.4, 0.6)]
    assert comparison_figure(wide).axes[0].get_xscale() == "log"
