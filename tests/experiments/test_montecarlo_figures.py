"""What the figures of a Monte Carlo run show is what was counted: read back from the axes, against
the statistics."""

import dataclasses
import types

import numpy as np
import pytest
from matplotlib.collections import QuadMesh
from matplotlib.text import Annotation
from tolerances import DRAWN

from jaxtube.experiments.montecarlo import figures as montecarlo_figures
from jaxtube.experiments.montecarlo import heat_figures
from jaxtube.experiments.montecarlo import report as montecarlo_report
from jaxtube.experiments.options import MontecarloOptions
from jaxtube.statistics import histogram
from jaxtube.statistics import task as validation
from jaxtube.statistics.intervals import share_interval
from jaxtube.statistics.run import RANKED
from jaxtube.statistics.tally import CLOUD_CELLS, COVERAGE_CELLS, EVENTS, HEAT_CELLS, STAGE_EVENTS

LAPS, PLANS_EACH = 40, 3
MILLIMETRES = np.array([1e3, 1e3, np.rad2deg(1.0)])
DEGREES = np.array([1.0, 1.0, np.rad2deg(1.0)])


@pytest.fixture(scope="module")
def found(uncertified):
    return uncertified("paper")


@pytest.fixture(scope="module")
def quiet(found):
    """Statistics of laps in which nothing happened: no error, no disturbance, nothing outside, no
    plan."""
    steps, horizon = found.problem.reference.steps, found.problem.horizon
    lap_histogram = np.zeros((3, histogram.BUCKETS), np.int64)
    lap_histogram[:, 0] = LAPS
    events = np.zeros((len(EVENTS), steps + 1), np.int64)
    stage_events = np.zeros((horizon, len(STAGE_EVENTS), PLANS_EACH + 1), np.int64)
    events[:, 0] = stage_events[..., 0] = LAPS
    counts = {
        "events": events,
        "stage_events": stage_events,
        "plans_by_lap": np.array([LAPS, *[0] * PLANS_EACH]),
        "error_by_step": np.tile(lap_histogram, (steps, 1, 1)),
        "disturbance": steps * lap_histogram,
        **{name: lap_histogram for name in ("peak", "rms")},
        "map": np.zeros(HEAT_CELLS, np.int64),
        "cloud": np.zeros((horizon, 3, CLOUD_CELLS, CLOUD_CELLS), np.int64),
        **{
            name: np.zeros((3, COVERAGE_CELLS, COVERAGE_CELLS), np.int64)
            for name in ("starts", "starts_that_left")
        },
        **{name: np.int64(0) for name in ("plans", "next_plan_missing", "cost_excesses")},
        **{f"tube_outside/{name}": np.zeros(horizon, np.int64) for name in found.tubes},
        "laps": np.int64(LAPS),
    }
    sets = {"disturbance": found.problem.disturbance_set, "error": found.problem.error_set}
    extremes = {f"excess/{name}": -limits.offsets for name, limits in sets.items()}
    extremes |= {"excess/input": -found.problem.input_set.offsets, "cost_excess": -np.inf}
    extremes |= {f"tube_excess/{name}": np.full(horizon, -np.inf) for name in found.tubes}
    extremes |= {"ultimate_bound": np.full(3, np.inf)}
    worst = {f"worst_usage/{name}": np.zeros(1) for name in RANKED} | {
        f"worst_lap/{name}": np.array([7]) for name in RANKED
    }
    return counts | extremes | worst


@pytest.fixture(scope="module")
def eventful(found, quiet):
    """Invented statistics: w, e, plans and starts that leave their sets, in known numbers."""
    generator, steps = np.random.default_rng(4), found.problem.reference.steps
    s = {name: np.array(value) for name, value in quiet.items()}
    s["error_by_step"] = generator.multinomial(
        LAPS, np.full(histogram.BUCKETS, 1 / histogram.BUCKETS), (steps, 3)
    )
    s["disturbance"] = s["error_by_step"].sum(axis=0)
    limits = found.problem.disturbance_set.support(np.eye(3))
    for i, name in enumerate(("longitudinal", "lateral", "heading")):
        # What the bucket around the limit holds is cut in the middle.
        first = int(np.searchsorted(histogram.EDGES, limits[i]))
        outside = int(s["disturbance"][i, first:].sum() + s["disturbance"][i, first - 1] // 2)
        laps_outside = np.full(LAPS, outside // LAPS)
        laps_outside[: outside % LAPS] += 1
        s["events"][EVENTS.index(f"w_outside_{name}")] = np.bincount(
            laps_outside, minlength=steps + 1
        )
    s["events"][EVENTS.index("w_outside_W")] = np.bincount([steps] * LAPS, minlength=steps + 1)
    s["events"][EVENTS.index("e_outside_E")] = np.bincount(
        [5] * 3 + [0] * (LAPS - 3), minlength=steps + 1
    )
    s["excess/error"] = np.array([0.01, -0.2, -0.1, -0.3, -0.1, -0.2])
    s["excess/disturbance"] = np.full(6, 1.9)
    s["plans"], s["plans_by_lap"] = np.int64(PLANS_EACH * LAPS), np.array([*[0] * PLANS_EACH, LAPS])
    s["cloud"] = generator.multinomial(
        PLANS_EACH * LAPS - 6, np.full(CLOUD_CELLS**2, CLOUD_CELLS**-2.0), s["cloud"].shape[:2]
    )
    s["cloud"] = s["cloud"].reshape(quiet["cloud"].shape)
    s["stage_events"][1, 0] = [LAPS - 10, 4, 6, 0]
    s["tube_outside/paper"][1] = 4 + 2 * 6
    s["map"][3, 5], s["map"][40, 80] = 2, 900
    s["starts"][:] = generator.integers(0, 4, s["starts"].shape)
    s["starts_that_left"][:, 2, 3], s["starts"][:, 2, 3] = 1, 4
    return s


@pytest.fixture(scope="module")
def task(found):
    return validation.make_task(found, "local_gain", "robot", "scenario", 0)


def summary_of(found, statistics, **options):
    return montecarlo_report.summary(found, MontecarloOptions(**options), statistics)


@pytest.fixture(scope="module")
def summary(found, eventful):
    return summary_of(found, eventful)


def meshes(axes):
    return [mesh for mesh in axes.collections if isinstance(mesh, QuadMesh)]


def cells(mesh):
    """Return the numbers in the cells of a heat map, 0 where it is empty."""
    return np.ma.filled(mesh.get_array(), 0)


def extent(patch):
    corners = patch.get_xy()
    return np.stack([corners.min(axis=0), corners.max(axis=0)])


def levels(axes):
    return [line.get_ydata()[0] for line in axes.lines if len(line.get_ydata()) == 2]


def test_margins_show_quantiles_the_largest_error_and_the_limits(found, eventful):
    figure = montecarlo_figures.margins(found.problem, eventful)
    limits, largest = np.array([0.3, 0.3, np.deg2rad(20)]), (0.31, 0.2, np.deg2rad(20) - 0.1)
    for i, axes in enumerate(figure.axes):
        assert levels(axes) == pytest.approx([largest[i] * DEGREES[i], limits[i] * DEGREES[i]])
        assert f"{100 * largest[i] / limits[i]:.3g} %" in axes.get_title(loc="right")
        expected = histogram.quantile(eventful["error_by_step"][:, i], 0.5) * DEGREES[i]
        assert axes.lines[0].get_ydata() == pytest.approx(expected, rel=DRAWN)
        tops = [band.get_paths()[0].vertices[:, 1].max() for band in axes.collections]
        assert tops == sorted(tops)


def test_a_histogram_is_cut_at_the_limit_where_counts_beyond_it_are_known(eventful):
    counts = eventful["disturbance"][1]
    limit = 0.0051
    bucket = int(np.searchsorted(histogram.EDGES, limit)) - 1
    above = int(counts[bucket + 1 :].sum())
    edges, parts = montecarlo_figures.split_at(counts, limit, above + 2)
    assert parts.sum() == counts.sum() and parts[edges[:-1] >= limit].sum() == above + 2
    assert np.all(np.diff(edges) > 0) and limit in edges
    same, whole = montecarlo_figures.split_at(counts, histogram.EDGES[9], 0)
    assert len(whole) == len(counts) == len(same) - 1


def test_disturbances_outside_w_fill_the_share_that_was_counted(found, eventful, summary):
    figure = montecarlo_figures.disturbance(found.problem, eventful, summary)
    limits = found.problem.disturbance_set.support(np.eye(3)) * MILLIMETRES
    for i, name in enumerate(("longitudinal", "lateral", "heading")):
        density, exceedance = figure.axes[i], figure.axes[3 + i]
        areas = [
            float(np.sum(stairs.get_data().values * np.diff(stairs.get_data().edges)))
            for stairs in density.patches[:2]
        ]
        share = summary["events"][f"w_outside_{name}"]["share_of_steps"]
        assert 0 < share < 1 and areas == pytest.approx([1 - share, share])
        assert density.lines[0].get_xdata()[0] == pytest.approx(limits[i])
        sizes, shares = exceedance.lines[0].get_data()
        assert shares[np.argmin(np.abs(sizes - limits[i]))] == pytest.approx(share)
        assert np.all(np.diff(shares) <= 0)
        assert f"{100 * share:.3g} % outside" in density.get_title()


def test_shares_are_drawn_with_their_intervals_and_bounds_where_none_was_seen(eventful, summary):
    rows = montecarlo_figures.share_rows(summary)
    chart, proof = montecarlo_figures.violations(summary).axes
    labels = [label.get_text() for label in chart.get_yticklabels()]
    assert labels == [row.label for row in rows] and len(rows) == 7 + 5
    assert "40 laps" in labels[0] and "3 laps" in labels[1] and "$R_{2}$: 16 plans" in labels[3]
    dots = [
        line.get_xdata()[0]
        for line in chart.lines
        if len(line.get_xdata()) == 1 and line.get_marker() != "|"
    ]
    expected = [share.value for row in rows for share in row.shares.values() if share.value]
    assert dots == pytest.approx(expected) and 3 / LAPS in dots and 16 / (PLANS_EACH * LAPS) in dots
    whiskers = [line.get_xdata() for line in chart.lines if len(line.get_xdata()) == 2]
    low, high = share_interval(3, LAPS)
    assert any(list(ends) == pytest.approx([low, high]) for ends in whiskers)
    arrows = [text.xy[0] for text in chart.texts if isinstance(text, Annotation)]
    unseen = [share.high for row in rows for share in row.shares.values() if not share.value]
    caps = [line.get_xdata()[0] for line in chart.lines if line.get_marker() == "|"]
    assert caps == pytest.approx(unseen) and len(arrows) == len(unseen) and max(arrows) < min(caps)
    assert tuple(proof.lines[1].get_xydata()[0]) == pytest.approx((LAPS, 1 - 0.025 ** (1 / LAPS)))
    laps, bounds = proof.lines[0].get_data()
    assert bounds == pytest.approx(1 - 0.025 ** (1 / laps))


def test_events_that_a_run_cannot_have_are_not_listed(found, quiet):
    found_nothing = summary_of(found, quiet, controller="local_gain", plant="linear")
    labels = [row.label for row in montecarlo_figures.share_rows(found_nothing)]
    assert len(labels) == 4 and not any(
        word in label for label in labels for word in ("QP", "wheels", "R_")
    )


def test_clouds_hold_what_was_counted_around_the_section_of_their_stage(found, eventful, summary):
    figure = heat_figures.tube_cloud(found, eventful, summary)
    panels = np.reshape(figure.axes[:15], (3, 5))
    for stage, section in enumerate(found.tubes["paper"][1:]):
        reach = section.support(np.eye(3)) * MILLIMETRES
        for axes, plane, counts in zip(
            panels[:, stage], ((0, 1), (0, 2), (1, 2)), eventful["cloud"][stage], strict=True
        ):
            (mesh,) = meshes(axes)
            assert np.array_equal(cells(mesh), counts)
            assert extent(axes.patches[0])[1] == pytest.approx(reach[list(plane)])
            assert np.asarray(mesh.get_coordinates()[-1, -1]) == pytest.approx(
                2 * reach[list(plane)]
            )
            assert "5 % beyond" in axes.texts[0].get_text()
    assert (
        "13.3 % outside" in panels[0, 1].get_title()
        and ": none outside" in panels[0, 0].get_title()
    )


def test_a_tube_longer_than_a_row_goes_on_in_the_next(found, eventful, summary):
    sections = [*found.tube, found.tube[-1]]
    tubes = {"paper": dataclasses.replace(found.tube, sections=sections)}
    stages = [*summary["tube"]["stages"], summary["tube"]["stages"][1]]
    longer = dict(eventful, cloud=np.concatenate([eventful["cloud"], eventful["cloud"][:1]]))
    known = dict(summary, tube=dict(summary["tube"], stages=stages))
    panels = np.reshape(
        heat_figures.tube_cloud(dataclasses.replace(found, tubes=tubes), longer, known).axes[:30],
        (6, 5),
    )
    assert "$j = 6$: 13.3 %" in panels[3, 0].get_title()
    assert np.array_equal(cells(meshes(panels[3, 0])[0]), eventful["cloud"][0, 0])
    assert not panels[3, 1].axison


def test_the_map_shows_visits_where_they_were(found, eventful):
    checks = types.SimpleNamespace(map_corner=np.array([-3.0, -6.0]), map_cell=np.array(0.1))
    axes = heat_figures.trajectory_map(found.problem, checks, eventful["map"]).axes[0]
    (mesh,) = meshes(axes)
    # This reference is tall: x is drawn upwards, y to the right.
    assert cells(mesh)[80, 40] == 900 and cells(mesh).sum() == 902
    assert np.asarray(mesh.get_coordinates()[80, 40]) == pytest.approx((-6.0 + 4.0, -3.0 + 8.0))
    poses = found.problem.reference.poses[: found.problem.reference.steps + 1]
    assert axes.lines[0].get_xydata() == pytest.approx(poses[:, [1, 0]])
    assert axes.yaxis_inverted() and not axes.xaxis_inverted()


def test_coverage_tells_where_laps_started_and_what_share_left_e(found, eventful, summary):
    hull = np.random.default_rng(2).uniform(-0.2, 0.2, (30, 3))
    figure = heat_figures.coverage(found.problem, eventful, summary, hull)
    for column, plane in enumerate(((0, 1), (0, 2), (1, 2))):
        above, below = figure.axes[column], figure.axes[3 + column]
        assert np.array_equal(cells(meshes(above)[0]), eventful["starts"][column])
        shares = cells(meshes(below)[1])
        assert shares[2, 3] == pytest.approx(25.0) and np.count_nonzero(shares) == 1
        limits, drawn = np.array([0.3, 0.3, 20.0])[list(plane)], above.patches
        assert extent(drawn[0])[1] == pytest.approx(limits)
        assert extent(drawn[1])[1] == pytest.approx(
            hull[:, plane].max(axis=0) * DEGREES[list(plane)]
        )
    assert figure.axes[4].get_title().startswith("3 of 40 laps left")


def test_a_run_in_which_nothing_was_counted_is_drawn_without_tube_and_starts(
    found, quiet, task, monkeypatch
):
    monkeypatch.setattr("jaxtube.statistics.task.make_task", lambda *arguments: task)
    drawn = {}

    def save_figure(figure, name):
        figure.canvas.draw()
        drawn[name] = figure

    folder = types.SimpleNamespace(save_figure=save_figure)
    options = MontecarloOptions(controller="local_gain")
    montecarlo_figures.draw(
        found, options, quiet, summary_of(found, quiet, controller="local_gain"), folder
    )
    assert set(drawn) == {"violations", "margins", "disturbance", "map", "worst"}
    assert drawn["worst"].get_suptitle().startswith("Lap 7:")
    assert not any(
        "QP" in label.get_text() for label in drawn["violations"].axes[0].get_yticklabels()
    )


def test_nothing_counted_breaks_no_colours(found, quiet):
    summary = summary_of(found, quiet)
    heat_figures.coverage(
        found.problem, quiet, summary, np.random.default_rng(1).normal(size=(9, 3))
    ).canvas.draw()


def test_the_grid_of_the_map_is_that_of_the_checks(found, task):
    axes = heat_figures.trajectory_map(
        found.problem, task.checks, np.ones(HEAT_CELLS, np.int64)
    ).axes[0]
    poses = found.problem.reference.poses[: found.problem.reference.steps + 1, :2]
    corners = meshes(axes)[0].get_coordinates().reshape(-1, 2)[:, ::-1]
    assert np.all(corners.min(axis=0) < poses.min(axis=0)) and np.all(
        corners.max(axis=0) > poses.max(axis=0)
    )


def test_a_flat_disturbance_set_is_drawn(uncertified, eventful, summary):
    flat = uncertified("paper", "disturbance.lateral_m=0")
    figure = montecarlo_figures.disturbance(
        flat.problem, dict(eventful, **{"excess/disturbance": np.zeros(6)}), summary
    )
    figure.canvas.draw()
    axes = heat_figures.tube_cloud(flat, eventful, summary).axes[0]
    reach = 2 * flat.tubes["paper"][1].support(np.eye(3)[0]).item() * 1e3
    assert np.asarray(meshes(axes)[0].get_coordinates())[-1, -1] == pytest.approx((reach, 1e3))
