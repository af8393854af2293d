"""Figures of tuning show what they are given: read back from the axes, texts apart, units at every
axis."""

import itertools

import numpy as np
import pytest
from matplotlib.collections import FillBetweenPolyCollection
from matplotlib.colors import to_hex
from matplotlib.text import Annotation, Text
from quadprog import solve_qp
from tolerances import DRAWN, SPREAD

from jaxtube.experiments.tune.figures import (
    AFTER,
    BEFORE,
    Curve,
    error_figure,
    learning_figure,
    settled_rms,
    spans_decade,
    tube_figure,
)
from jaxtube.experiments.tune.front_figure import Group, comparison_figure, front_figure
from jaxtube.experiments.tune.parameter_figure import parameter_figure, spread
from sets.polytope import Polytope

CENTIMETRES = np.array([1e2, 1e2, np.rad2deg(1.0)])
HALF_WIDTHS = np.array([0.3, 0.3, np.deg2rad(20.0)])
LIMIT = 0.0288


def curve(iterates=60, uncertified=10, start=700.0):
    """An invented run: uncertified at first, with an iterate that has no design at all and one not
    looked at."""
    generator, i = np.random.default_rng(1), np.arange(iterates)
    base = 0.5 + 1.5 * np.exp(-i / 12) + np.where(i < uncertified, start * np.exp(-i / 1.6), 0)
    held_out, objective = base * (1 + 0.02 * generator.normal(size=(2, iterates)))
    held_out[20], objective[30] = np.inf, np.nan
    lateral, effort = (9 * np.exp(-i / 10) + 1.3) * 1e-3, 0.026 + 0.0025 * (1 - np.exp(-i / 15))
    certified = (i >= uncertified) & (i != 20) & (i != 35)
    held_out[35] = 0.45
    return Curve(i, objective, held_out, 0.8 * held_out, 1.3 * held_out, certified, lateral, effort)


def shown_texts(figure):
    """Return the boxes of all texts that a reader sees, with the texts; the figure is drawn."""
    figure.draw_without_rendering()
    texts = [text for legend in figure.legends for text in legend.get_texts()]
    for axes in figure.axes:
        texts += [axes.xaxis.label, axes.yaxis.label, axes.title, *axes.texts]
        texts += [axes._left_title, axes._right_title]
        for axis in (axes.xaxis, axes.yaxis):
            low, high = sorted(axis.get_view_interval())
            ticks = [*axis.get_major_ticks(), *axis.get_minor_ticks()]
            texts += [tick.label1 for tick in ticks if low <= tick.get_loc() <= high]
    shown = [text for text in texts if text.get_visible() and text.get_text().strip()]
    return [(text.get_text(), Text.get_window_extent(text)) for text in shown]


def assert_readable(figure):
    """Texts do not overlap, lie on the page, and axes tell units."""
    boxes = shown_texts(figure)
    assert len(boxes) > 10
    for (first, box), (second, other) in itertools.combinations(boxes, 2):
        assert not box.padded(-0.5).overlaps(other.padded(-0.5)), f"{first!r} lies on {second!r}"
    for text, box in boxes:
        assert figure.bbox.contains(*box.min) and figure.bbox.contains(*box.max), (
            f"{text!r} leaves the page"
        )
    labels = [
        label.get_text() for axes in figure.axes for label in (axes.xaxis.label, axes.yaxis.label)
    ]
    assert all("[" in label or label in ("iteration", "") for label in labels)


def panels(figure):
    return {axes.get_title() or axes.get_title(loc="left"): axes for axes in figure.axes}


def marks(axes, marker, face=None):
    """Return the points of all lines with a mark, of those with a face of a colour where it is
    given."""
    chosen = [line for line in axes.lines if line.get_marker() == marker]
    if face is not None:
        chosen = [line for line in chosen if to_hex(line.get_markerfacecolor()) == to_hex(face)]
    return np.concatenate([line.get_xydata() for line in chosen]) if chosen else np.empty((0, 2))


def legend_texts(figure):
    return [text.get_text() for legend in figure.legends for text in legend.get_texts()]


def extent(patch):
    return np.stack([patch.get_xy().min(axis=0), patch.get_xy().max(axis=0)])


def test_iterates_are_filled_where_certified_and_hollow_where_not():
    run = curve()
    shown = panels(learning_figure({"Adam": run}, LIMIT))
    sources = {
        "objective": run.held_out,
        "lateral error once settled": 1e3 * run.lateral,
        "effort": run.effort,
    }
    for name, source in sources.items():
        source = np.where(np.isfinite(source), source, np.nan)
        for chosen, face in ((run.certified, "#0072B2"), (~run.certified, "white")):
            expected = np.column_stack([run.iteration, source])[chosen]
            assert marks(shown[name], "o", face) == pytest.approx(expected, abs=DRAWN, nan_ok=True)


def test_the_star_marks_the_best_certified_iterate_and_its_numbers_are_told():
    run = curve()
    best = min(np.flatnonzero(run.certified), key=lambda i: run.held_out[i])
    assert run.returned == best and run.held_out[best] > run.held_out[35]
    figure = learning_figure({"Adam": run}, LIMIT)
    assert marks(panels(figure)["effort"], "*") == pytest.approx(
        np.array([[best, run.effort[best]]])
    )
    text = legend_texts(figure)[0]
    assert text.startswith(f"Adam: objective {run.held_out[0]:.3g} → {run.held_out[best]:.3g}")
    assert f"{1e3 * run.lateral[best]:.3g} mm" in text and f"(iteration {best})" in text


def test_without_certified_iterate_none_is_returned_and_nothing_is_magnified():
    run = curve()._replace(certified=np.zeros(60, bool))
    figure = learning_figure({"Adam": run}, None)
    assert run.returned is None and len(figure.axes) == 3
    assert legend_texts(figure)[
        0
    ] == "Adam: no certified iterate" and "returned" not in legend_texts(figure)
    assert all(len(marks(axes, "*")) == 0 for axes in figure.axes)


def test_the_magnified_panel_holds_the_certified_iterates_close_to_the_best_and_their_bands_alone():
    run = curve()
    shown = panels(learning_figure({"Adam": run}, LIMIT))
    low, high = shown["the same, magnified close to the best"].get_ylim()
    close = run.certified & (run.held_out <= 2 * run.held_out[run.returned])
    assert low < run.low[close].min() and run.high[close].max() < high < run.held_out[0] / 100
    assert 1 < close.sum() < run.certified.sum()
    for name in ("objective", "the same, magnified close to the best"):
        (band,) = [
            band for band in shown[name].collections if isinstance(band, FillBetweenPolyCollection)
        ]
        ordinates = np.concatenate([path.vertices[:, 1] for path in band.get_paths()])
        finite = np.isfinite(run.low)
        assert set(ordinates.tolist()) == set(run.low[finite]) | set(run.high[finite])
    assert any(
        line.get_ydata() == pytest.approx(run.objective, nan_ok=True)
        for line in shown["objective"].lines
        if len(line.get_xdata()) == 60
    )


def test_objectives_are_logarithmic_and_magnified_only_beyond_a_decade():
    near = learning_figure({"Adam": curve(start=0.0)}, LIMIT)
    far = learning_figure({"Adam": curve(uncertified=12)}, LIMIT)
    assert panels(near)["objective"].get_yscale() == "linear" and len(near.axes) == 3
    assert panels(far)["objective"].get_yscale() == "log" and len(far.axes) == 4
    assert not spans_decade(np.array([-1.0, 100.0])) and not spans_decade(
        np.array([np.nan, np.inf])
    )
    assert spans_decade(np.array([1.0, 11.0, np.nan])) and not spans_decade(np.array([1.0, 9.0]))


def test_the_limit_of_the_effort_is_drawn_where_there_is_one():
    lines = panels(learning_figure({"Adam": curve()}, LIMIT))["effort"].lines
    assert (
        sum(np.allclose(line.get_ydata(), LIMIT) and len(line.get_ydata()) == 2 for line in lines)
        == 1
    )
    assert "limit of the effort" not in legend_texts(learning_figure({"Adam": curve()}, None))


@pytest.fixture(scope="module")
def cloud():
    points = np.random.default_rng(0).uniform(-1, 1, (30, 3))
    return np.vstack([points, -points]) / np.abs(points).max(axis=0)


def test_projected_tubes_reach_as_far_as_the_tubes_beside_the_box_of_the_caps(cloud):
    before = Polytope.from_vertices(cloud * HALF_WIDTHS * [0.4, 2.1, 0.8])
    after = Polytope.from_vertices(cloud * HALF_WIDTHS * [0.3, 0.46, 0.4])
    figure = tube_figure(before, after, HALF_WIDTHS)
    for axes, plane in zip(figure.axes, ([0, 1], [0, 2], [1, 2]), strict=True):
        reaches = [(set_.support(np.eye(3)) * CENTIMETRES)[plane] for set_ in (before, after)]
        for patch, reach in zip(
            axes.patches,
            [(HALF_WIDTHS * CENTIMETRES)[plane], *np.repeat(reaches, 2, axis=0)],
            strict=True,
        ):
            assert extent(patch) == pytest.approx(np.stack([-reach, reach]))
            assert np.all(np.abs([axes.get_xlim(), axes.get_ylim()]).min(axis=1) >= reach)
    first, last = legend_texts(figure)[:2]
    assert "(210 %)" in first and "up to 63 cm" in first and "(46 %)" in last and "(40 %)" in last
    colours = [line.get_color() for line in figure.legends[0].get_lines()[:2]]
    assert colours == [BEFORE.colour, AFTER.colour]


def test_a_tube_without_bound_is_said_to_have_none(cloud):
    figure = tube_figure(None, Polytope.from_vertices(cloud * HALF_WIDTHS / 2), HALF_WIDTHS)
    assert legend_texts(figure)[0] == "before tuning: no bounded tube"
    assert all(len(axes.patches) == 3 for axes in figure.axes)


@pytest.fixture(scope="module")
def laps():
    """Errors before and after: a start that dies out, then noise of 9 mm and of 1.3 mm, of unlike
    numbers of laps."""
    generator, fall = np.random.default_rng(2), np.exp(-np.arange(301) / 20)[:, None, None]
    return [
        fall * [0.2, 0.15, 0.1] + generator.normal(size=(301, count, 3)) * size
        for count, size in ((20, 9e-3), (30, 1.3e-3))
    ]


def test_errors_are_medians_inside_their_bands_in_units_that_fit(laps):
    figure = error_figure(*laps, 0.1, 100)
    for coordinate, row in enumerate(np.reshape(figure.axes, (3, 2))):
        for axes, first, unit in zip(row, (0, 100), ("cm", "mm"), strict=True):
            scale = np.rad2deg(1.0) if coordinate == 2 else {"cm": 1e2, "mm": 1e3}[unit]
            assert f"[{'deg' if coordinate == 2 else unit}]" in axes.get_ylabel()
            bands = [
                band for band in axes.collections if isinstance(band, FillBetweenPolyCollection)
            ]
            drawn = [line for line in axes.lines if line.get_linewidth() == 1.2]
            for errors, line, band in zip(laps, drawn, bands, strict=True):
                values = errors[first:, :, coordinate] * scale
                time = np.arange(first, 301) * 0.1
                assert line.get_xydata() == pytest.approx(
                    np.column_stack([time, np.median(values, axis=1)]), abs=DRAWN
                )
                low, high = np.quantile(values, (0.05, 0.95), axis=1)
                ordinates = band.get_paths()[0].vertices[:, 1]
                assert set(np.round(ordinates, 9)) == set(np.round(np.concatenate([low, high]), 9))


def test_the_rms_once_settled_is_the_mean_over_laps_and_stands_over_the_panel(laps):
    figure = error_figure(*laps, 0.1, 100)
    by_lap = [
        np.mean([np.linalg.norm(lap[100:, 1]) / np.sqrt(201) for lap in errors.swapaxes(0, 1)])
        for errors in laps
    ]
    assert [settled_rms(errors, 100)[1] for errors in laps] == pytest.approx(by_lap)
    title = np.reshape(figure.axes, (3, 2))[1, 1].get_title(loc="right")
    assert title == f"RMS {1e3 * by_lap[0]:.3g} → {1e3 * by_lap[1]:.3g} mm"


@pytest.fixture(scope="module")
def parameters():
    """Q, R, gains and which iterates are certified; entries off the diagonal of R are zero."""
    i = np.arange(50)
    lower = np.tile(np.eye(3), (50, 1, 1))
    lower[:, 0, 0], lower[:, 1, 1], lower[:, 1, 0] = (
        np.exp(-i / 20),
        np.exp(i / 20),
        0.3 * np.sin(i / 30),
    )
    inputs = np.tile(np.diag([0.3, 0.2]), (50, 1, 1))
    return (
        lower @ lower.swapaxes(1, 2),
        inputs,
        np.exp(np.outer(i / 40, [0.2, 0.4, 0.39])),
        (i >= 10) & (i != 25),
    )


@pytest.fixture(scope="module")
def drawn_parameters(parameters):
    error, inputs, gains, certified = parameters
    return parameter_figure(error, inputs, gains, ["k1", "k2", "k3"], certified)


def test_weights_and_gains_are_drawn_and_named_at_the_ends_of_their_lines(
    parameters, drawn_parameters
):
    error, inputs, gains, _ = parameters
    shown = panels(drawn_parameters)
    pairs = [(0, 1), (0, 2), (1, 2)]
    diagonals = [np.sqrt(error[:, i, i] * error[:, j, j]) for i, j in pairs]
    sources = {
        "diagonal of $Q$": {f"$Q_{{{i}{i}}}$": error[:, i - 1, i - 1] for i in (1, 2, 3)},
        "off the diagonal of $Q$": {
            f"$Q_{{{i + 1}{j + 1}}}$": error[:, i, j] / root
            for (i, j), root in zip(pairs, diagonals, strict=True)
        },
        "diagonal of $R$": {f"$R_{{{i}{i}}}$": inputs[:, i - 1, i - 1] for i in (1, 2)},
        "off the diagonal of $R$": {"$R_{12}$": np.zeros(50)},
        "gains": {f"$k_{{{i}}}$": gains[:, i - 1] for i in (1, 2, 3)},
    }
    assert set(shown) == set(sources)
    for name, lines in sources.items():
        axes = shown[name]
        assert [text.get_text() for text in axes.texts] == list(lines)
        for line, text, values in zip(axes.lines, axes.texts, lines.values(), strict=True):
            assert line.get_ydata() == pytest.approx(values, abs=DRAWN)
            assert text.xy[1] == pytest.approx(values[-1]) and text.get_color() == line.get_color()
        assert axes.get_yscale() == ("linear" if name.startswith("off") else "log")


def test_iterates_that_are_not_certified_are_shaded(parameters, drawn_parameters):
    *given, certified = parameters
    for axes in drawn_parameters.axes:
        assert [patch.get_x() + 0.5 for patch in axes.patches] == pytest.approx(
            np.flatnonzero(~certified)
        )
    certain = parameter_figure(*given, ["k1", "k2", "k3"], np.ones(50, bool))
    assert not certain.legends


def test_diagonal_weights_have_no_panels_off_the_diagonal(parameters):
    error, *others, certified = parameters
    shown = panels(parameter_figure(error * np.eye(3), *others, ["k1", "k2", "k3"], certified))
    assert set(shown) == {"diagonal of $Q$", "diagonal of $R$", "gains"}


@pytest.mark.parametrize("gap", [0.02, 0.08, 0.15, 0.4])
def test_names_are_spread_as_little_as_keeps_them_apart(gap):
    generator = np.random.default_rng(6)
    for count in (2, 3, 7):
        places = generator.uniform(-0.1, 1.1, count).clip(0, 1)
        order, room = np.argsort(places), min(gap, 1 / (count - 1))
        apart = np.diff(np.eye(count), axis=0)
        rows = np.vstack([apart, np.eye(count)[:1], -np.eye(count)[-1:]])
        bounds = np.array([*[room - 1e-12] * (count - 1), 0, -1])
        expected = solve_qp(np.eye(count), places[order], rows.T, bounds)[0]
        assert spread(places, gap)[order] == pytest.approx(expected, abs=SPREAD)
    assert spread(np.array([0.5]), gap) == pytest.approx([0.5])


@pytest.fixture(scope="module")
def groups():
    """A grid of 200 designs with its front, and six designs whose names stand beside them."""
    generator, n = np.random.default_rng(3), 200
    effort = generator.uniform(0.0245, 0.0335, n)
    lateral = (1.2e-3 + 9e-3 * np.exp((0.024 - effort) / 0.0018)) * np.exp(
        0.5 * np.abs(generator.normal(size=n))
    )
    tube = np.where(
        generator.random(n) < 0.15, np.nan, 0.2 * np.exp(0.7 * generator.normal(size=n))
    )
    certified = np.nan_to_num(tube, nan=1.0) < 0.3
    front = [i for i in range(n) if not np.any((effort < effort[i]) & (lateral < lateral[i]))]
    values = np.column_stack([lateral, effort, tube])
    singles = {
        "Nelder–Mead": (0.0016, 0.0284, 0.17, True, "search"),
        "random search": (0.0019, 0.0286, 0.19, True, "search"),
        "paper's weights": (0.009, 0.026, 0.63, False, "start"),
        "LQR weights": (0.0082, 0.0262, np.nan, False, "start"),
        "tuned, robust": (0.00131, 0.0285, 0.138, True, "tuned"),
        "tuned, laps only": (0.00125, 0.02855, 0.22, True, "tuned"),
    }
    return [
        Group("grid", *values.T, certified, "grid"),
        Group("front of the grid", *values[front].T, certified[front], "front"),
        *(
            Group(name, *np.array([row[:3]]).T, np.array([row[3]]), row[4])
            for name, row in singles.items()
        ),
    ]


@pytest.fixture(scope="module")
def front(groups):
    return front_figure(groups, LIMIT)


@pytest.fixture(scope="module")
def few(groups):
    """The same figure without grid and front."""
    return front_figure(groups[2:], None)


def in_order(points):
    return points[np.lexsort(np.round(points, 9).T)]


def test_designs_stand_at_their_error_effort_and_tube(groups, front):
    effort, tube = front.axes
    strip = tube.patches[0]
    for kind, marker in {
        "grid": "o",
        "front": "s",
        "search": "^",
        "start": "X",
        "tuned": "*",
    }.items():
        columns = [
            np.concatenate(values)
            for values in zip(*(g[1:5] for g in groups if g.kind == kind), strict=True)
        ]
        lateral, spent, size, certified = columns
        expected = np.column_stack([spent, 1e3 * lateral])
        assert in_order(marks(effort, marker)) == pytest.approx(in_order(expected), abs=DRAWN)
        hollow = marks(effort, marker, "white")
        assert in_order(hollow) == pytest.approx(in_order(expected[~certified]), abs=DRAWN)
        drawn, bounded = marks(tube, marker), np.isfinite(size)
        beside = drawn[:, 0] < strip.get_x()
        expected = np.column_stack([1e2 * size, 1e3 * lateral])[bounded]
        assert in_order(drawn[beside]) == pytest.approx(in_order(expected), abs=DRAWN)
        assert np.all(drawn[~beside][:, 0] < strip.get_x() + strip.get_width())
        assert np.sort(drawn[~beside][:, 1]) == pytest.approx(np.sort(1e3 * lateral[~bounded]))
    assert tube.get_title(loc="right") == "no bounded tube"
    assert max(tube.get_xticks()) < strip.get_x()
    assert effort.get_shared_y_axes().joined(effort, tube)


def test_the_front_is_joined_in_the_order_of_effort_where_effort_is_drawn(front):
    effort, tube = front.axes
    (line,) = [line for line in effort.lines if line.get_linestyle() == "-"]
    assert np.all(np.diff(line.get_xdata()) > 0) and np.all(np.diff(line.get_ydata()) < 0)
    assert not [line for line in tube.lines if line.get_linestyle() != "None"]
    assert [line.get_xdata()[0] for line in effort.lines if line.get_linestyle() == "--"] == [LIMIT]


def test_a_strip_for_tubes_without_bound_is_there_only_if_one_has_none(groups):
    bounded = [group._replace(tube=np.nan_to_num(group.tube, nan=0.3)) for group in groups[2:]]
    tube = front_figure(bounded, LIMIT).axes[1]
    assert not tube.patches and not tube.get_title(loc="right")


@pytest.mark.parametrize("name", ["front", pytest.param("few", marks=pytest.mark.slow)])
def test_names_stand_close_to_their_marks_inside_the_panel(groups, name, request):
    figure = request.getfixturevalue(name)
    figure.draw_without_rendering()
    for axes in figure.axes:
        names = [text for text in axes.texts if isinstance(text, Annotation)]
        assert sorted(text.get_text() for text in names) == sorted(
            group.name for group in groups[2:]
        )
        for text in names:
            box = Text.get_window_extent(text)
            assert axes.bbox.contains(*box.min) and axes.bbox.contains(*box.max)
            nearest = np.clip(axes.transData.transform(text.xy), box.min, box.max)
            gap = np.linalg.norm(nearest - axes.transData.transform(text.xy)) * 72 / figure.dpi
            assert 5 < gap < 60


ROWS = [
    ("lemniscate", "paper's weights", 9.1e-3, 8.7e-3, 9.5e-3),
    ("lemniscate", "local gain", 2.4e-3, 2.3e-3, 2.52e-3),
    ("lemniscate", "tuned", 1.3e-3, 1.25e-3, 1.36e-3),
    ("circle", "paper's weights", 7.28e-3, 7.0e-3, 7.6e-3),
    ("circle", "tuned", 1.04e-3, 0.998e-3, 1.09e-3),
]


def test_each_design_has_its_mean_and_interval_in_millimetres_by_reference():
    (axes,) = comparison_figure(ROWS).axes
    assert [label.get_text() for label in axes.get_yticklabels()] == [row[1] for row in ROWS]
    for row, place, ends, dot in zip(
        ROWS, axes.get_yticks(), axes.lines[::2], axes.lines[1::2], strict=True
    ):
        assert dot.get_xydata() == pytest.approx(np.array([[1e3 * row[2], place]]))
        assert ends.get_xydata() == pytest.approx(
            np.array([[1e3 * row[3], place], [1e3 * row[4], place]])
        )
        assert (to_hex(dot.get_color()) == to_hex(AFTER.colour)) == (row[1] == "tuned")
        assert to_hex(dot.get_color()) == to_hex(ends.get_color())
    written = {text.get_text(): text.get_position()[1] for text in axes.texts}
    assert (
        written["2.40  (2.30 to 2.52)"] == axes.get_yticks()[1]
        and "1.04  (0.998 to 1.09)" in written
    )
    assert axes.get_yticks()[2] < written["circle"] < axes.get_yticks()[3]
    assert "95 % interval [mm]" in axes.get_xlabel()


def test_means_within_a_decade_are_seen_from_zero():
    assert comparison_figure(ROWS[:3]).axes[0].get_xlim()[0] == 0
    wide = [*ROWS, ("circle", "none", 0.5, 0.4, 0.6)]
    assert comparison_figure(wide).axes[0].get_xscale() == "log"


def test_texts_keep_apart_and_axes_tell_units(cloud, laps, drawn_parameters, front):
    before, after = (Polytope.from_vertices(cloud * HALF_WIDTHS * size) for size in (2.1, 0.46))
    for figure in (
        learning_figure({"Adam": curve()}, LIMIT),
        tube_figure(before, after, HALF_WIDTHS),
        error_figure(*laps, 0.1, 100),
        drawn_parameters,
        front,
        comparison_figure(ROWS),
    ):
        assert_readable(figure)


@pytest.mark.slow
def test_texts_keep_apart_in_fuller_and_emptier_figures(parameters, groups, few):
    error, inputs, gains, certified = parameters
    vertex_names = [f"K{v}_{i}{j}" for v, i, j in itertools.product("1234", "12", "123")]
    vertex_gains = np.random.default_rng(8).normal(size=(50, 24)) / 5
    unbounded = [group._replace(tube=np.full_like(group.tube, np.nan)) for group in groups[2:]]
    for figure in (
        learning_figure({"gradient": curve(), "BFGS": curve(40, 4)}, None),
        parameter_figure(error, inputs, vertex_gains, vertex_names, certified),
        parameter_figure(error * np.eye(3), inputs, gains, ["k1", "k2", "k3"], certified),
        few,
        front_figure(unbounded, None),
    ):
        assert_readable(figure)
