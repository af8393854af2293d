"""Laws of the topics of `bench`: power laws are fitted, batches mixed as told, sets compared,
compilations counted, long runs left out, and lines of all topics in one table."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxtube.experiments.bench import lap_counts
from jaxtube.experiments.bench.cases import name_scenarios
from jaxtube.experiments.bench.command import write_closing_table
from jaxtube.experiments.bench.designs import compare
from jaxtube.experiments.bench.gradient_topic import refuse_gains_of_a_search
from jaxtube.experiments.bench.horizons import (
    choose_active,
    condense_first,
    fit_exponent,
    make_edge_family,
)
from jaxtube.experiments.bench.lap_counts import BLOCK, Extent, plan_counts
from jaxtube.experiments.bench.latencies import CountCompilations
from jaxtube.experiments.bench.latency_topic import find_latency
from jaxtube.experiments.bench.peers import invariant_sets
from jaxtube.experiments.bench.shares import TILES, mix
from jaxtube.experiments.bench.topic import Headline
from jaxtube.experiments.options import BenchOptions
from jaxtube.scenario.reading import load
from jaxtube.scenario.refusal import ScenarioError
from jaxtube.statistics.run import TILE
from jaxtube.synthesis.design import prepare
from jaxtube.synthesis.disturbance import complete_problem
from sets.invariant import maximal_rpi
from sets.polytope import Polytope


@pytest.fixture(scope="module")
def prepared():
    return prepare(complete_problem(load("certified", ())))


def test_the_exponent_of_a_power_law_is_found():
    x = np.array([5.0, 10.0, 20.0, 40.0])
    assert fit_exponent(np.column_stack([x, 0.3 * x**1.7])) == pytest.approx(1.7)


def test_the_first_window_alone_is_condensed_as_among_all(prepared):
    alone = jax.tree.leaves(condense_first(prepared))
    window = prepared.first_window
    # The unit of the cost, by which cost and gradient are divided, is that of all windows.
    for one, every in zip(alone, jax.tree.leaves(prepared.tube_qps), strict=True):
        assert one.shape[1:] == every.shape[1:] and len(one) == 1
    lower = condense_first(prepared).lower[0]
    np.testing.assert_array_equal(lower, prepared.tube_qps.lower[window])


def test_programs_whose_free_answer_breaks_a_row_have_active_rows(prepared):
    family = make_edge_family(prepared, 40, 0)
    chosen = choose_active(family)
    assert 0 < len(chosen.starts) <= 40
    inside = family._replace(
        starts=0 * family.starts, problems=family.problems._replace(q=0 * family.problems.q)
    )
    is_admissible = np.all(inside.problems.l <= 0, axis=1) & np.all(inside.problems.u >= 0, axis=1)
    assert len(choose_active(inside).starts) == np.sum(~is_admissible)


def test_every_batch_has_as_many_active_starts_as_told():
    active = np.ones((7, 3))
    for count in (0, 1, 100, TILE):
        starts = mix(active, np.zeros((5, 3)), count).reshape(TILES, TILE, 3)
        assert np.all(starts.sum(axis=(1, 2)) == 3 * count)


def test_sets_differ_by_the_share_that_one_has_to_grow():
    box = Polytope.box(-np.ones(3), np.ones(3))
    larger = Polytope.box(-1.25 * np.ones(3), np.ones(3))
    assert compare(box, box) == pytest.approx(0.0, abs=1e-12)
    assert compare(box, larger) == compare(larger, box) == pytest.approx(0.25)


def test_polytope_finds_the_same_invariant_set():
    if not invariant_sets.is_installed():
        pytest.skip(invariant_sets.CURE)
    loops = np.array([[[0.9, 0.3], [-0.2, 0.8]], [[0.7, -0.3], [0.3, 0.8]]])
    constraints = Polytope.box(-np.ones(2), np.ones(2))
    disturbance = Polytope.box(-0.01 * np.ones(2), 0.01 * np.ones(2))
    ours = maximal_rpi(loops, constraints, disturbance).polytope
    peer = invariant_sets.find_maximal_rpi(loops, constraints, disturbance, 60.0)
    assert ours is not None and peer.polytope is not None
    assert compare(ours, peer.polytope) < 1e-7
    stopped = invariant_sets.find_maximal_rpi(loops, constraints, disturbance, 0.0)
    assert stopped.polytope is None and stopped.steps == 0


def test_latency_is_that_of_the_steps():
    latency = find_latency(np.arange(1001.0))
    assert latency == pytest.approx((500.0, 990.0, 999.0, 1000.0))


def test_what_is_compiled_anew_is_counted():
    double = jax.jit(lambda x: 2 * x)
    three = jnp.zeros(3)
    four = jnp.zeros(4)
    double(three)
    with CountCompilations() as counted:
        double(three)
    assert counted.count == 0
    with CountCompilations() as counted:
        double(four)
    assert counted.count > 0


def test_runs_that_take_too_long_are_timed_once_or_left_out(monkeypatch):
    monkeypatch.setattr(lap_counts, "run_checked", lambda *_: None)
    monkeypatch.setattr(lap_counts, "time_checked", lambda *_: BLOCK * 1e-3)
    plan = plan_counts(None, Extent((1_000, 10_000, 100_000), (), 3, 30.0))
    assert plan.in_rounds == [1_000, 10_000] and plan.once == []
    assert plan.left_out == {100_000: pytest.approx(100.0)}
    plan = plan_counts(None, Extent((1_000, 10_000, 100_000), (), 3, 100.0))
    assert plan.once == [100_000] and not plan.left_out


def test_gains_of_a_search_are_refused_in_one_line():
    with pytest.raises(ScenarioError, match=r"^paper: controller.tracking_gains is empty: .*\w$"):
        refuse_gains_of_a_search([("paper", load("paper", ()))])
    refuse_gains_of_a_search([("certified", load("certified", ()))])


def test_a_scenario_that_is_asked_for_is_the_only_one():
    scenario = load("husky", ())
    assert [name for name, _ in name_scenarios(scenario, BenchOptions(), ["paper"])] == ["paper"]
    asked = BenchOptions(scenario="husky")
    assert name_scenarios(scenario, asked, ["paper"]) == [("husky", scenario)]


def test_lines_of_all_topics_stand_in_one_table():
    lines = [
        Headline("qp, tuned", "1 us", "DAQP: 2 us", "2.00"),
        Headline("b", "c", "", "", "1e-9"),
    ]
    table = write_closing_table(lines)
    assert "DAQP: 2 us" in table and table.splitlines()[-1].endswith("1e-9")
