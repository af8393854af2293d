"""Figures of a Monte Carlo run: drawn without a warning, and what they show is what was counted."""

import types

import numpy as np
import pytest
from figure_checks import assert_presentable, save
from matplotlib.collections import LineCollection, QuadMesh
from matplotlib.text import Annotation
from tolerances import DRAWN

from jaxtube.coordinates import NAMES, TO_DISPLAY
from jaxtube.experiments.guarantee.figures import laws_figure
from jaxtube.experiments.montecarlo import figures as montecarlo_figures
from jaxtube.experiments.montecarlo import heat_figures, map_figure
from jaxtube.figures import shares as shares_figure
from jaxtube.statistics import histogram
from jaxtube.statistics.events import EVENT_NAMES, find_row
from jaxtube.statistics.intervals import share_interval
from jaxtube.statistics.montecarlo import make_closed_loop_task, name_law
from jaxtube.statistics.run import RANKED
from jaxtube.statistics.summary import summarise
from jaxtube.statistics.tally import CLOUD_CELLS, COVERAGE_CELLS, HEAT_CELLS, STAGE_EVENTS

LAPS = 40
PLANS_EACH = 3
NUMBERS = ("plans", "next_plan_missing", "cost_excesses")
"""Statistics that are one number each."""


@pytest.fixture(scope="module")
def design(uncertified):
    return uncertified("paper")


@pytest.fixture(scope="module")
def problem(design):
    return design.problem


@pytest.fixture(scope="module")
def quiet(design):
    """Statistics of laps in which nothing happened: no error, no disturbance, nothing outside, no
    plan."""
    steps = design.problem.reference.steps
    horizon = design.problem.horizon
    smallest = np.zeros((3, histogram.BUCKETS), np.int64)
    smallest[:, 0] = LAPS
    events = np.zeros((len(EVENT_NAMES), steps + 1), np.int64)
    events[:, 0] = LAPS
    stage_events = np.zeros((horizon, len(STAGE_EVENTS), PLANS_EACH + 1), np.int64)
    stage_events[..., 0] = LAPS
    counts = {
        "laps": np.int64(LAPS),
        "events": events,
        "stage_events": stage_events,
        "plans_by_lap": np.array([LAPS, *[0] * PLANS_EACH]),
        "error_by_step": np.tile(smallest, (steps, 1, 1)),
        "disturbance": steps * smallest,
        "peak": smallest,
        "rms": smallest,
        "map": np.zeros(HEAT_CELLS, np.int64),
        "cloud": np.zeros((horizon, 3, CLOUD_CELLS, CLOUD_CELLS), np.int64),
        "starts": np.zeros((3, COVERAGE_CELLS, COVERAGE_CELLS), np.int64),
        "starts_that_left": np.zeros((3, COVERAGE_CELLS, COVERAGE_CELLS), np.int64),
    }
    counts |= {name: np.int64(0) for name in NUMBERS}
    counts |= {f"tube_outside/{name}": np.zeros(horizon, np.int64) for name in design.tubes}
    extremes = {
        "excess/disturbance": -design.problem.disturbance_set.offsets,
        "excess/error": -design.problem.error_set.offsets,
        "excess/input": -design.problem.input_rows.offsets,
        "cost_excess": -np.inf,
        "ultimate_bound": np.full(3, np.inf),
    }
    extremes |= {f"tube_excess/{name}": np.full(horizon, -np.inf) for name in design.tubes}
    worst = {f"worst_usage/{name}": np.zeros(1) for name in RANKED}
    worst |= {f"worst_lap/{name}": np.array([7]) for name in RANKED}
    return counts | extremes | worst


@pytest.fixture(scope="module")
def eventful(design, quiet):
    """Invented statistics: w, e, plans and starts that leave their sets, in known numbers."""
    generator = np.random.default_rng(4)
    steps = design.problem.reference.steps
    evenly = np.full(histogram.BUCKETS, 1 / histogram.BUCKETS)
    changed = {name: np.array(value) for name, value in quiet.items()}
    changed["error_by_step"] = generator.multinomial(LAPS, evenly, (steps, 3))
    changed["disturbance"] = changed["error_by_step"].sum(axis=0)
    limits = design.problem.disturbance_set.support(np.eye(3))
    for i, name in enumerate(NAMES):
        # What the bucket around the limit holds is cut in the middle.
        first = int(np.searchsorted(histogram.EDGES, limits[i]))
        counts = changed["disturbance"][i]
        outside = int(counts[first:].sum() + counts[first - 1] // 2)
        by_lap = np.full(LAPS, outside // LAPS)
        by_lap[: outside % LAPS] += 1
        _set_event(changed, f"w_outside_{name}", by_lap)
    _set_event(changed, "w_outside_W", [steps] * LAPS)
    _set_event(changed, "e_outside_E", [5] * 3 + [0] * (LAPS - 3))
    changed["excess/error"] = np.array([0.01, -0.2, -0.1, -0.3, -0.1, -0.2])
    changed["excess/disturbance"] = np.full(6, 1.9)
    changed["plans"] = np.int64(PLANS_EACH * LAPS)
    changed["plans_by_lap"] = np.array([*[0] * PLANS_EACH, LAPS])
    cells = np.full(CLOUD_CELLS**2, CLOUD_CELLS**-2.0)
    clouds = generator.multinomial(PLANS_EACH * LAPS - 6, cells, quiet["cloud"].shape[:2])
    changed["cloud"] = clouds.reshape(quiet["cloud"].shape)
    changed["stage_events"][1, 0] = [LAPS - 10, 4, 6, 0]
    changed["tube_outside/paper"][1] = 4 + 2 * 6
    changed["map"][3, 5] = 2
    changed["map"][40, 80] = 900
    changed["starts"][:] = generator.integers(0, 4, changed["starts"].shape)
    changed["starts"][:, 2, 3] = 4
    changed["starts_that_left"][:, 2, 3] = 1
    return changed


def _set_event(statistics, event, by_lap):
    steps = statistics["events"].shape[1] - 1
    statistics["events"][find_row(event)] = np.bincount(by_lap, minlength=steps + 1)


@pytest.fixture(scope="module")
def task(design):
    return make_closed_loop_task(design, "local_gain", "robot", "scenario", None, 0)


def summary_of(design, statistics, **options):
    options = {"controller": "tube_mpc", "plant": "robot", "starts": "scenario"} | options
    return summarise(design, name_law(design, **options), statistics)


@pytest.fixture(scope="module")
def summary(design, eventful):
    return summary_of(design, eventful)


def cells_of(axes):
    """Return the numbers in the cells of a panel's heat maps, 0 where they are empty."""
    meshes = [mesh for mesh in axes.collections if isinstance(mesh, QuadMesh)]
    return [np.ma.filled(mesh.get_array(), 0) for mesh in meshes]


def test_quantiles_of_the_errors_and_the_largest_one_are_drawn(problem, eventful):
    figure = montecarlo_figures.error_quantiles(problem, eventful)
    assert_presentable(figure)
    largest = np.array([0.31, 0.2, np.deg2rad(20) - 0.1]) * TO_DISPLAY
    for i, limit in enumerate((0.3, 0.3, 20.0)):
        median, *levels = figure.axes[i].lines
        expected = histogram.quantile(eventful["error_by_step"][:, i], 0.5) * TO_DISPLAY[i]
        assert median.get_ydata() == pytest.approx(expected, rel=DRAWN)
        heights = [line.get_ydata()[0] for line in levels]
        assert heights == pytest.approx([largest[i], limit])


def test_a_histogram_is_cut_at_the_limit_where_counts_beyond_it_are_known(eventful):
    counts = eventful["disturbance"][1]
    limit = 0.0051
    bucket = int(np.searchsorted(histogram.EDGES, limit)) - 1
    above = int(counts[bucket + 1 :].sum())
    edges, parts = montecarlo_figures.split_at(counts, limit, above + 2)
    assert parts.sum() == counts.sum()
    assert parts[edges[:-1] >= limit].sum() == above + 2
    same, whole = montecarlo_figures.split_at(counts, histogram.EDGES[9], 0)
    assert len(whole) == len(counts) == len(same) - 1


def test_disturbances_outside_w_fill_the_share_that_was_counted(problem, eventful, summary):
    figure = montecarlo_figures.disturbance(problem, eventful, summary)
    assert_presentable(figure)
    for axes, name in zip(figure.axes, NAMES, strict=False):
        drawn = [stairs.get_data() for stairs in axes.patches[:2]]
        areas = [float(np.sum(data.values * np.diff(data.edges))) for data in drawn]
        share = summary["events"][f"w_outside_{name}"]["share_of_steps"]
        assert areas == pytest.approx([1 - share, share])
        assert f"{100 * share:.3g} % outside" in axes.get_title()


def test_shares_are_drawn_with_their_intervals_and_bounds_where_none_was_seen(summary):
    rows = shares_figure.share_rows(summary)
    figure = shares_figure.violations(summary)
    assert_presentable(figure)
    chart, proof = figure.axes
    labels = [label.get_text() for label in chart.get_yticklabels()]
    assert labels == [row.label for row in rows]
    assert labels[1].startswith("$e$ outside $\\mathcal{E}$: 3 laps")
    assert labels[-1].startswith("not finite: ")
    assert "$R_{2}$: 16 plans" in labels[3]
    whiskers = [line.get_xdata() for line in chart.lines if len(line.get_xdata()) == 2]
    assert any(list(ends) == pytest.approx(share_interval(3, LAPS)) for ends in whiskers)
    unseen = [share for row in rows for share in row.shares.values() if not share.value]
    assert len([text for text in chart.texts if isinstance(text, Annotation)]) == len(unseen)
    laps, bounds = proof.lines[0].get_data()
    assert bounds == pytest.approx(1 - 0.025 ** (1 / laps))


def test_events_that_a_run_cannot_have_are_not_listed(summary):
    events = {name: summary["events"][name] for name in ("w_outside_W", "not_finite")}
    without_plans = {**summary, "plans": 0, "events": events}
    labels = [row.label for row in shares_figure.share_rows(without_plans)]
    assert len(labels) == 2 and labels[1].startswith("not finite")


def test_laws_are_drawn_design_by_design(summary):
    laws = {"iid": summary, "edge-vertex": summary}
    tested = [types.SimpleNamespace(name=name, laws=laws) for name in ("mine", "other")]
    figure = laws_figure(tested)
    assert_presentable(figure)
    for axes in figure.axes[::2]:
        assert [label.get_text() for label in axes.get_yticklabels()] == list(laws)
    shares = [
        share.value
        for row in shares_figure.share_rows(summary)[:2]
        for share in row.shares.values()
    ]
    assert all(axes.get_xlim()[0] < min(shares) for axes in figure.axes), "no dot is cut"


def test_clouds_hold_what_was_counted_stage_by_stage(design, eventful, summary):
    figure = heat_figures.tube_cloud(design, eventful, summary)
    assert_presentable(figure)
    panels = np.reshape(figure.axes[:15], (3, 5))
    for stage, clouds in enumerate(eventful["cloud"]):
        for axes, cloud in zip(panels[:, stage], clouds, strict=True):
            assert np.array_equal(cells_of(axes)[0], cloud)
            assert "5 % beyond" in axes.texts[0].get_text()
    assert "13.3 % outside" in panels[0, 1].get_title()


def test_the_map_lies_as_the_paths_do_and_has_the_colours_of_the_errors(
    problem, task, eventful, quiet
):
    checks = types.SimpleNamespace(map_corner=np.array([-3.0, -6.0]), map_cell=np.array(0.1))
    figure = map_figure.error_map(problem, checks, eventful)
    assert_presentable(figure)
    places = problem.reference.poses[: problem.reference.steps + 1, :2]
    for i, axes in enumerate(figure.axes[:3]):
        (path,) = [drawn for drawn in axes.collections if isinstance(drawn, LineCollection)]
        starts = np.array([segment[0] for segment in path.get_segments()])
        step = int(np.flatnonzero(np.all(starts == places[80], axis=1))[0])
        size = histogram.quantile(eventful["error_by_step"][80, i], map_figure.SHARE)
        size = min(size, histogram.EDGES[-1])
        factor = 1e3 if i < 2 else TO_DISPLAY[2]
        assert path.get_array()[step] == pytest.approx(size * factor)
        assert not axes.yaxis_inverted() and not axes.xaxis_inverted()
        assert cells_of(axes)[0].sum() == 2, "two cells were visited"
    save(map_figure.error_map(problem, task.checks, quiet))


def test_coverage_tells_where_laps_started_and_what_share_left_e(problem, eventful, summary):
    hull = np.random.default_rng(2).uniform(-0.2, 0.2, (30, 3))
    figure = heat_figures.coverage(problem, eventful, summary, hull)
    assert_presentable(figure)
    for column in range(3):
        (starts,) = cells_of(figure.axes[column])
        assert np.array_equal(starts, eventful["starts"][column])
        _, shares = cells_of(figure.axes[3 + column])
        assert shares[2, 3] == pytest.approx(25.0) and np.count_nonzero(shares) == 1
    assert figure.axes[4].get_title().startswith("3 of 40 laps left")


def test_a_run_in_which_nothing_was_counted_is_drawn_without_tube_and_starts(design, quiet, task):
    drawn = {}

    def save_figure(figure, name):
        drawn[name] = save(figure)

    folder = types.SimpleNamespace(save_figure=save_figure)
    summary = summary_of(design, quiet, controller="local_gain")
    montecarlo_figures.draw(design, task, 0, quiet, summary, folder)
    assert set(drawn) == {"violations", "error_quantiles", "disturbance", "map", "worst"}
    assert drawn["worst"].get_suptitle().startswith("Lap 7 uses")


def test_nothing_counted_breaks_no_colours(design, problem, quiet):
    hull = np.random.default_rng(1).normal(size=(9, 3))
    save(heat_figures.coverage(problem, quiet, summary_of(design, quiet), hull))


def test_a_flat_disturbance_set_is_drawn(uncertified, eventful, summary):
    flat = uncertified("paper", "disturbance.lateral_m=0")
    statistics = {**eventful, "excess/disturbance": np.zeros(6)}
    save(montecarlo_figures.disturbance(flat.problem, statistics, summary))
    save(heat_figures.tube_cloud(flat, eventful, summary))
