"""Laws of what `tune` says about designs: intervals, the grid, the paths it never saw."""

import numpy as np
import pytest
from tolerances import ROUNDING

from jaxtube.experiments.tune.baselines import GRID, Spots
from jaxtube.experiments.tune.compare import difference, grid_lines, rms_interval
from jaxtube.experiments.tune.paths import unseen_paths
from jaxtube.experiments.tune.result import Result, compute_reduction
from jaxtube.scenario import load
from jaxtube.synthesis.problem import make_problem

LATERAL = np.abs(np.random.default_rng(0).normal(5e-3, 1e-3, 400))


def result(lateral, effort):
    ones = np.ones(len(lateral))
    errors = np.stack([ones, lateral, ones], axis=1)
    return Result(
        costs=ones,
        errors=errors,
        effort=effort * ones,
        settled_effort=ones,
        unplanned=0,
        objective=1.0,
        certified=True,
        failing=(),
        half_widths=np.ones(3),
        fill=0.5,
    )


def test_errors_halved_lap_by_lap_are_half_as_large_with_certainty():
    assert compute_reduction(LATERAL, LATERAL / 2) == pytest.approx((0.5, 0.5, 0.5), abs=1e-6)
    assert compute_reduction(LATERAL, LATERAL) == (0, 0, 0)


def test_the_interval_of_a_reduction_holds_it_and_narrows_with_the_laps():
    noise = np.random.default_rng(1).uniform(0.2, 0.6, len(LATERAL))
    share, low, high = compute_reduction(LATERAL, noise * LATERAL)
    assert low < share < high
    few = compute_reduction(LATERAL[:40], (noise * LATERAL)[:40])
    assert high - low < few[2] - few[1]


def test_a_difference_has_the_interval_of_student():
    above = np.random.default_rng(2).normal(0.3, 1.0, 12)
    interval = difference(above + LATERAL[:12], LATERAL[:12])
    mean = above.mean()
    t = 2.200985160  # of 11 degrees of freedom, 97.5 %
    half = t * above.std(ddof=1) / np.sqrt(12)
    assert list(interval.values()) == pytest.approx([mean, mean - half, mean + half], rel=1e-8)
    assert difference(LATERAL, LATERAL) == {"mean": 0, "low": 0, "high": 0}


def test_an_rms_lies_in_its_interval():
    rms, low, high = rms_interval(LATERAL)
    assert rms == pytest.approx(np.sqrt(np.mean(LATERAL**2)), rel=ROUNDING)
    assert low < rms < high


def test_the_grid_has_200_points():
    assert np.prod([axis.count for axis in GRID.values()]) == 200


def test_the_best_of_a_grid_needs_no_more_effort_than_the_tuned_design():
    tuned = result(LATERAL, 0.03)
    efforts = np.array([0.031, 0.03, 0.02])
    spots = Spots(np.array([1e-3, 7e-3, 9e-3]), efforts, np.ones(3), np.ones(3, bool))
    (line,) = grid_lines(tuned, {"some gains": spots})
    assert "7.000 mm at 0.03000 m/s" in line


@pytest.mark.parametrize("name", ["lemniscate", "recorded"])
def test_paths_that_tuning_never_saw_keep_the_box_of_wheel_speeds(name):
    scenario = load("untuned")
    path = unseen_paths(scenario)[name]
    problem = make_problem(type(scenario)(reference=path, controller=scenario.controller))
    own = make_problem(scenario).reference.wheels
    assert problem.reference.steps == 300
    assert not np.array_equal(problem.reference.wheels[:300], own[:300])
