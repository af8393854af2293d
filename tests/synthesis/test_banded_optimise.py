"""Laws of the search for caps and gains of several bands at once: one tube for all of them, the
estimate beside the rigorous bound, no end worse than its start."""

import itertools

import numpy as np
import pytest
from tolerances import ROUNDING

from jaxtube.scenario import ScenarioError, load, replace
from jaxtube.scenario.tree import Scenario
from jaxtube.synthesis.banded_estimate import BandedEstimate
from jaxtube.synthesis.certificate.fill import cap_shares
from jaxtube.synthesis.descent import descend
from jaxtube.synthesis.design import design, refuse_infeasible_start
from jaxtube.synthesis.disturbance import complete_problem
from jaxtube.synthesis.estimate import Estimate
from jaxtube.synthesis.lateral_tube import Ring, reach, settle, solve
from jaxtube.synthesis.optimise import optimise, wheel_excess
from jaxtube.synthesis.optimum import describe
from jaxtube.synthesis.problem import make_problem
from jaxtube.synthesis.starts import caps_and_gains, with_caps_and_gains, without_caps

RING = Ring(0.8)
ESTIMATED = 0.03
"""Relative difference of the estimated and the rigorous ratio."""
ROWS = np.array([[1.0, 0.0], [0.0, 1.0], [9.0, 9.0]])
FAST = {"reference.wheel_speed_min_mps": 0.85}
"""The two fastest bands alone: W of each other one takes as long again."""


@pytest.fixture(scope="module")
def scenario() -> Scenario:
    return load("certified_wide")


@pytest.fixture(scope="module")
def estimate(scenario) -> BandedEstimate:
    return BandedEstimate(make_problem(scenario))


@pytest.fixture(scope="module")
def own(scenario, estimate):
    values = caps_and_gains(scenario)
    assert values is not None
    return estimate.to_point(values)


def test_caps_and_gains_of_bands_are_read_back_as_written(scenario):
    values = caps_and_gains(scenario)
    assert values is not None and len(values) == 3 + 8 * len(scenario.operating.bands)
    assert with_caps_and_gains(without_caps(scenario), values).operating == scenario.operating
    assert caps_and_gains(without_caps(scenario)) is None


def test_a_set_of_loops_with_disturbances_of_their_own_holds_every_order_of_them():
    loops = np.array([[[0.94, 0.06], [-0.9, 0.1]], [[0.93, 0.08], [-0.8, 0.2]]])
    sides = np.array([[0.01, 0.01], [0.003, 0.04]])
    steps = sides @ np.abs(RING.directions).T
    images = RING.directions @ loops
    policy = settle(RING, images, steps, ROWS)
    assert policy is not None
    chosen = steps[policy.loops, np.arange(len(policy.loops))]
    found = reach(RING, policy.rows, solve(RING, policy, images[None], chosen[None]), ROWS[None])[0]
    most = np.zeros(len(ROWS))
    for order in itertools.product((0, 1), repeat=8):
        directions = ROWS.copy()
        reached = np.zeros(len(ROWS))
        for which in itertools.islice(itertools.cycle(order), 60):
            reached += np.abs(directions) @ sides[which]
            directions = directions @ loops[which]
        most = np.maximum(most, reached)
    assert np.all(most <= found * (1 + 1e-9))
    assert np.all(most >= 0.9 * found), "the bound is close to what some order reaches"


def test_of_one_band_it_is_the_estimate_without_bands(scenario):
    """One band over the whole box of `certified`, with its caps: the shares differ by the boxes
    that cover a band alone, of which one is the box itself."""
    usual = load("certified", ["controller.horizon=8"])
    values = caps_and_gains(usual)
    assert values is not None
    plain = Estimate(make_problem(usual))
    fastest = usual.reference.wheel_speed_max_mps
    bands = replace(without_caps(usual), {"operating.bands": [{"below_mps": fastest}]})
    banded = BandedEstimate(make_problem(bands))
    point = plain.to_point(values)
    np.testing.assert_allclose(banded.to_point(values), point, atol=ROUNDING)
    alone = plain.shaped_like(point).shares(point)
    joined = banded.shaped_like(point).shares(point)
    assert alone is not None and joined is not None
    np.testing.assert_allclose(joined.caps, alone.caps, rtol=2e-3)
    np.testing.assert_allclose(joined.limits, alone.limits, rtol=2e-3)


def test_slopes_between_neighbours_are_those_of_fresh_estimates(estimate, own):
    active = estimate.find_active(own)
    assert active is not None
    step = 1e-5
    nearby = own + step * np.eye(len(own))[[0, 1, 5, 12, 30, 50]]
    quick = estimate.shares_nearby(nearby, active)
    for number, point in enumerate(nearby):
        fresh = estimate.shares(point)
        assert fresh is not None
        np.testing.assert_allclose(quick.caps[number], fresh.caps[0], rtol=1e-7)
        np.testing.assert_allclose(quick.limits[number], fresh.limits[0], rtol=1e-7)


@pytest.mark.slow
def test_a_search_over_bands_ends_better_than_hand_made_caps_and_keeps_all_limits(scenario):
    fast = replace(scenario, {**FAST, "operating.bands": scenario.operating.bands[4:]})
    values = caps_and_gains(fast)
    assert values is not None
    estimate = BandedEstimate(make_problem(fast))
    begun = estimate.shares(estimate.to_point(values))
    ended = descend(estimate, estimate.to_point(values))
    assert begun is not None and ended is not None
    found = describe(ended)
    assert found.holds
    assert found.ratio < begun.caps.max()
    assert found.ratio == pytest.approx(max(found.shares[row] for row in found.cap_rows))
    assert found.excess == pytest.approx(max(found.shares[row] for row in found.limit_rows))
    assert caps_and_gains(found.scenario) is not None


@pytest.mark.slow
def test_bands_without_caps_get_some_that_are_certified_and_start_where_the_paper_does(scenario):
    bare = replace(
        without_caps(scenario),
        {**FAST, "operating.bands": [{"below_mps": 1.15}, {"below_mps": 1.5}]},
    )
    found = optimise(make_problem(bare))
    made = design(found.scenario)
    assert made.certificate.failing == []
    assert wheel_excess(made.problem) <= 1
    refuse_infeasible_start(made)
    shares = cap_shares(made.problem, made.tube_gain)
    assert max(shares.values()) == pytest.approx(found.ratio, rel=ESTIMATED)


def test_bands_without_caps_are_refused_where_they_are_needed(scenario):
    with pytest.raises(ScenarioError, match="design --optimise"):
        complete_problem(make_problem(without_caps(scenario)).scenario)
    some = [{"below_mps": 0.4, "yaw_rate_deficit_radps": 1.0}, {"below_mps": 1.5}]
    with pytest.raises(ScenarioError, match="lack speed_deficit_min_mps; give all"):
        replace(scenario, {"operating.bands": some})
