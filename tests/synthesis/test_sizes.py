"""Laws of size: a robot whose lengths and speeds are all larger by a factor, or that does all of it
in another time, has the same design in its own units: shares, verdict, plans and gains."""

from typing import NamedTuple

import numpy as np
import pytest

from jaxtube.scenario import load, replace
from jaxtube.scenario.tree import Scenario
from jaxtube.scenario.units import rescale
from jaxtube.simulation.simulate import simulate
from jaxtube.synthesis.certificate.fill import cap_shares
from jaxtube.synthesis.design import Design, design, find_share_of_start
from jaxtube.synthesis.estimate import Estimate
from jaxtube.synthesis.optimise import optimise
from jaxtube.synthesis.problem import make_problem
from jaxtube.synthesis.starts import caps_and_gains, make_starts, without_caps

QUICK_SIZES = (0.01, 100.0)
ALL_SIZES = (0.01, 0.1, 0.3, 2.0, 3.0, 10.0, 100.0)
ALL_TIMES = (0.1, 0.5, 10.0)
SCENARIOS = ("certified", "certified_20", "certified_lag", "husky")
SHARES = 1e-6
"""Relative difference of shares of the same caps; W is bounded by the same cuts."""
SOLVED = 1e-6
"""The same of the terminal cost, and of plans by it."""
SEARCHED = 0.01
"""The same of shares that were searched: caps are rounded to four digits of their own units."""
LAPS = 64
SHORT = {"reference.duration_s": 2.0}
SAME_LAPS = 1e-3
"""Difference of the laps of two sizes, as a share of their limits: the smaller one is backed off by
more."""
LENGTHS = np.array([1, 1, 0, 1, 1, 0, 1, 0, 0, -1, 0, 0, 0, 0])
TIMES = np.array([0, 0, 0, -1, -1, -1, 0, -1, -1, -1, -1, 0, 0, 0])
"""Powers of length and time in the units of caps and gains."""
BACKED_OFF = 2e-3
"""What the back-off of the smallest robot takes of a plan, as a share."""


class Found(NamedTuple):
    """What a design comes to, without units."""

    shares: np.ndarray
    failing: list[str]
    share_of_start: float


def weigh(made: Design) -> Found:
    shares = np.array(list(cap_shares(made.problem, made.terminal.gains).values()))
    return Found(shares, made.certificate.failing, find_share_of_start(made))


def assert_same(found: Found, usual: Found, tolerance: float) -> None:
    np.testing.assert_allclose(found.shares, usual.shares, rtol=tolerance)
    assert found.failing == usual.failing
    assert found.share_of_start == pytest.approx(usual.share_of_start, abs=BACKED_OFF)


@pytest.fixture(scope="module")
def usual() -> Design:
    return design(load("certified"))


@pytest.mark.parametrize("size", QUICK_SIZES)
def test_the_same_caps_are_filled_alike_at_every_size(size, usual):
    other = design(rescale(load("certified"), size))
    assert_same(weigh(other), weigh(usual), SHARES)
    assert other.terminal.volume_share == pytest.approx(usual.terminal.volume_share, abs=1e-3)
    lengths = np.array([size, size, 1.0])
    cost = other.cost.cost * np.outer(lengths, lengths)
    np.testing.assert_allclose(cost, usual.cost.cost, rtol=SOLVED, atol=SOLVED)
    of_inputs = np.tile([size, 1.0], usual.problem.horizon)
    plans = other.tube_qps.free_inputs * lengths / of_inputs[:, None]
    np.testing.assert_allclose(plans, usual.tube_qps.free_inputs, rtol=SOLVED, atol=SOLVED)
    assert other.tube_qps.lower.shape == usual.tube_qps.lower.shape


@pytest.mark.slow
def test_laps_of_a_robot_of_another_size_are_the_same_in_its_units():
    """From starts all over the feasible set, where plans have active rows; slips are drawn by
    number, so they are the same."""
    usual = simulate(design(replace(load("certified"), SHORT)), laps=LAPS, starts="feasible")
    for size in QUICK_SIZES:
        scaled = rescale(replace(load("certified"), SHORT), size)
        other = simulate(design(scaled), laps=LAPS, starts=usual.errors[0] * [size, size, 1.0])
        moved = other.errors / [size, size, 1.0] - usual.errors
        assert np.max(np.abs(moved) / usual.error_limits) < SAME_LAPS
        assert other.without_plan == usual.without_plan == 0
    assert usual.trajectory.diagnostics.active.any()


@pytest.mark.slow
@pytest.mark.parametrize("name", SCENARIOS)
def test_every_certified_scenario_is_certified_at_every_size_and_pace(name):
    usual = weigh(design(load(name)))
    assert usual.failing == []
    for length, time in [(s, 1.0) for s in ALL_SIZES] + [(1.0, t) for t in ALL_TIMES]:
        assert_same(weigh(design(rescale(load(name), length, time))), usual, SHARES)


@pytest.mark.parametrize(("length", "time"), [(0.01, 1.0), (100.0, 1.0), (0.3, 7.0)])
def test_a_search_takes_the_same_steps_at_every_size_and_pace(length, time):
    """Points are in natural units, so they are the same numbers; their values are in their own."""
    usual = Estimate(make_problem(bare("certified")))
    other = Estimate(make_problem(rescale(bare("certified"), length, time)))
    for start, same in zip(make_starts(usual), make_starts(other), strict=True):
        np.testing.assert_array_equal(same, start)
        expected = usual.to_values(start) * length ** LENGTHS[:11] * time ** TIMES[:11]
        np.testing.assert_allclose(other.to_values(same), expected, rtol=1e-12)
        shares = usual.shares(start)
        others = other.shares(same)
        np.testing.assert_array_equal(others.caps, shares.caps)
        np.testing.assert_array_equal(others.limits, shares.limits)
        np.testing.assert_array_equal(other.to_point(other.to_values(same)), start.round(9))


@pytest.mark.slow
@pytest.mark.parametrize("name", SCENARIOS)
def test_the_optimum_is_the_same_design_at_every_size(name):
    usual = optimise(make_problem(bare(name)))
    found = weigh(design(usual.scenario))
    values = np.array(caps_and_gains(usual.scenario))
    for size in ALL_SIZES:
        other = optimise(make_problem(rescale(bare(name), size)))
        assert other.holds == usual.holds
        assert other.ratio == pytest.approx(usual.ratio, rel=SEARCHED)
        assert_same(weigh(design(other.scenario)), found, SEARCHED)
        expected = values * size ** LENGTHS[: len(values)]
        np.testing.assert_allclose(caps_and_gains(other.scenario), expected, rtol=SEARCHED)


def bare(name: str) -> Scenario:
    return without_caps(load(name))
