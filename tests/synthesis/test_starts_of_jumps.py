"""Of `certified_wide`: in how many windows of references that jump the paper's start has a plan,
and that a longer horizon takes none away."""

import numpy as np
import pytest

from jaxtube.scenario import load, replace
from jaxtube.synthesis.design import SHORT, design
from jaxtube.synthesis.feasible import noise_corners, shortfall
from jaxtube.synthesis.live import LiveWindows
from jaxtube.synthesis.problem import make_problem

pytestmark = pytest.mark.slow  # two designs of six bands, and thousands of linear programs

SEEDS = range(20)
STRIDE = 12
"""Every so many periods a window is asked about."""
HORIZONS = (5, 8)
KNOWN = 16
"""Periods known ahead of the references, whichever horizon a plan has."""


def find_windows(horizon: int):
    """Return windows (k, horizon, 2) along the references of all seeds, the same whatever the
    horizon."""
    windows = []
    for seed in SEEDS:
        drive = {
            "reference.shape": "jumps",
            "reference.jump_seed": seed,
            "controller.horizon": KNOWN,
        }
        problem = make_problem(replace(load("certified_wide"), drive))
        first = np.arange(0, problem.reference.steps, STRIDE)
        windows.append(problem.schedule[first[:, None] + np.arange(horizon)])
    return np.concatenate(windows)


def find_started(made) -> np.ndarray:
    """Return in which windows every measurement of the scenario's start has a plan."""
    problem = made.problem
    corners = problem.initial_error + noise_corners(problem)
    qps = LiveWindows(made).condense(find_windows(problem.horizon)).qps
    return np.array(
        [
            all(shortfall(qps, window, corner) <= SHORT for corner in corners)
            for window in range(len(qps.lower))
        ]
    )


def test_the_papers_start_has_a_plan_in_most_windows_and_a_longer_horizon_keeps_them():
    started = {
        horizon: find_started(design(load("certified_wide", [f"controller.horizon={horizon}"])))
        for horizon in HORIZONS
    }
    shorter, longer = (started[horizon] for horizon in HORIZONS)
    assert not np.any(shorter & ~longer)
    assert np.mean(longer) > np.mean(shorter)
    assert np.mean(longer) >= LEAST
