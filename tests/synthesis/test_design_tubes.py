"""Laws of windows and tubes: speeds are not rounded, tubes know their kind, the first of equals."""

import dataclasses
from fractions import Fraction
from typing import get_args, get_type_hints

import numpy as np
import pytest
from tolerances import TUBE_ROUNDING

from jaxtube.plant import input_maps, model
from jaxtube.scenario import load
from jaxtube.scenario.tree import ControllerTable
from jaxtube.synthesis.certificate.exact import recheck
from jaxtube.synthesis.certificate.existence import OBJECTIVES
from jaxtube.synthesis.design import prepare
from jaxtube.synthesis.disturbance import complete_problem
from jaxtube.synthesis.problem import make_problem, merge_equal_speeds
from jaxtube.synthesis.tubes import find_widest_window
from jaxtube.synthesis.windows import make_windows
from sets.robot import plant


def test_equal_speeds_are_merged_and_none_is_rounded():
    speeds = np.array([[1 / 3, 2.0], [1 / 3 + 1e-16, 2 / 3], [0.5, 1 / 3]])
    merged = merge_equal_speeds(speeds)
    assert merged[0, 0] == merged[1, 0] == merged[2, 1] == 1 / 3
    assert merged[1, 1] == 2 / 3
    assert set(merged.ravel()) <= set(speeds.ravel())


@pytest.mark.parametrize("radius", [2.5, 2.7])
def test_a_box_of_the_paths_own_speeds_is_covered_in_rationals(radius):
    path = make_problem(load("certified", [f"reference.radius_m={radius}"])).reference.wheels
    speeds = [
        f"reference.wheel_speed_min_mps={float(path.min())!r}",
        f"reference.wheel_speed_max_mps={float(path.max())!r}",
    ]
    design = prepare(complete_problem(load("certified", [f"reference.radius_m={radius}", *speeds])))
    schedules = design.windows.schedules
    assert path.min() <= schedules.min() and schedules.max() <= path.max()
    assert recheck(design).margins["schedules"] >= 0
    outside = dataclasses.replace(design.windows, schedules=schedules + 1e-9)
    failing = recheck(dataclasses.replace(design, windows=outside)).margins["schedules"]
    assert failing < Fraction(-1e-10)


def test_the_first_of_equally_wide_windows_is_shown(robust_design):
    windows = robust_design.windows
    twice = dataclasses.replace(
        windows,
        loops=np.concatenate([windows.loops, windows.loops * (1 + 1e-15)]),
        regimes=np.concatenate([windows.regimes, windows.regimes]),
    )
    shown = find_widest_window(robust_design.problem, windows)
    assert find_widest_window(robust_design.problem, twice) == shown
    assert robust_design.tubes["sequence"].shown_window == shown


@pytest.mark.parametrize("name", ["paper", "hull", "summed", "sequence"])
def test_a_tubes_support_is_that_of_its_sections(robust_design, name):
    tube = robust_design.tubes[name]
    rows = np.random.default_rng(0).normal(size=(5, 3))
    for stage in range(len(tube)):
        by_window = tube.support(stage, rows)
        assert len(by_window) == len(tube.sections_by_window)
        for numbers, sections in zip(by_window, tube.sections_by_window, strict=True):
            np.testing.assert_allclose(numbers, sections[stage].support(rows), atol=TUBE_ROUNDING)


def test_a_tube_knows_in_which_windows_its_sections_are_shown(robust_design):
    index = robust_design.windows.index
    for tube in robust_design.tubes.values():
        shown = tube.shows(index)
        assert tube.follows_reference == (not shown.all())
        assert shown.any()


def test_windows_of_a_gain_hold_its_loops(robust_design):
    gain = robust_design.tube_gain
    windows = make_windows(robust_design.problem, gain)
    np.testing.assert_array_equal(windows.loops, gain.loops_along(windows.schedules))
    for window in range(len(windows.schedules)):
        steps = np.flatnonzero(windows.index[:-1] == window)
        assert set(windows.followers(window)) == set(windows.index[steps + 1])


def test_choices_of_the_scenario_are_those_of_plant_model_and_sets():
    choices = get_type_hints(ControllerTable)
    assert get_args(choices["input_map"]) == plant.INPUT_MAPS == tuple(input_maps.INPUT_MAPS)
    assert get_args(choices["model"]) == plant.MODELS == model.MODELS
    assert get_args(choices["discretisation"]) == plant.DISCRETISATIONS == model.DISCRETISATIONS
    assert get_args(choices["lmi_objective"]) == OBJECTIVES
