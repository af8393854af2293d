"""W by regime: a problem whose disturbances are wider in the first periods of a run."""

import dataclasses

import jax.numpy as jnp
import numpy as np
import pytest
from tolerances import ROUNDING

from jaxtube.scenario import load
from jaxtube.simulation import components
from jaxtube.simulation.rollout import realisation_keys, rollout
from jaxtube.statistics.checks import OUTSIDE
from jaxtube.statistics.task import disturbance_facets, make_checks
from jaxtube.synthesis.certificate.certify import certify
from jaxtube.synthesis.certificate.exact import recheck
from jaxtube.synthesis.design import finish, prepare
from jaxtube.synthesis.disturbance import complete_problem
from jaxtube.synthesis.problem import with_regimes
from jaxtube.synthesis.regimes import Disturbances, RegimesByAge
from jaxtube.synthesis.terminal import admissible_set
from sets.polytope import Polytope

FIRST = 2.5
"""How much wider W is in the first two periods."""


@pytest.fixture(scope="module")
def problem():
    """The certified robot, whose W is wider at first: what is proved of W is not asked here."""
    scenario = load("certified", ["reference.duration_s=3.0", "reference.certified_for=path"])
    whole = complete_problem(scenario)
    wide = dataclasses.replace(whole, disturbance_set=whole.disturbance_set.scale(FIRST))
    return with_regimes(whole, [wide, wide, whole], RegimesByAge(3))


@pytest.fixture(scope="module")
def design(problem):
    return finish(prepare(problem))


def test_periods_have_the_regime_of_their_age(problem, design):
    assert problem.period_regimes[:5].tolist() == [0, 1, 2, 2, 2]
    ahead = design.windows.regimes[design.windows.index]
    steps = np.arange(len(ahead))[:, None] + np.arange(problem.horizon)
    np.testing.assert_array_equal(ahead, np.minimum(steps, 2))


def test_one_set_stands_for_all_where_a_single_one_is_asked_for(problem):
    wide = problem.every_regime[0].disturbance_set
    assert problem.disturbance_set is wide
    apart = Disturbances((Polytope.box(-np.ones(3), np.array([1, 2, 1])), wide))
    assert all(apart.hull().containment_margin(one) >= -ROUNDING for one in apart.sets)


def test_the_tube_of_a_window_sums_what_its_own_periods_add(problem, design):
    """Against a forward simulation of the worst disturbance of each period."""
    rows = np.random.default_rng(0).normal(size=(6, 3))
    for stage in range(1, problem.horizon + 1):
        support = design.tube.support(stage, rows)
        for window in (0, int(design.windows.index[1]), int(design.windows.index[-1])):
            loops = design.windows.loops[window]
            expected = np.zeros(len(rows))
            for period in range(stage):
                transport = np.eye(3)
                for later in range(period + 1, stage):
                    transport = loops[later] @ transport
                regime = int(design.windows.regimes[window, period])
                points = problem.every_regime[regime].disturbance_set.vertices()
                expected += np.max(rows @ transport @ points.T, axis=1)
            np.testing.assert_allclose(support[window], expected, rtol=0, atol=ROUNDING)


def test_the_certificate_for_the_model_holds_and_is_confirmed_in_rationals(design):
    assert design.certificate.failing_for_model == []
    assert recheck(design).holds


def test_the_terminal_set_holds_the_w_that_lasts_alone(problem, design):
    """Were the first W to last, this set would not absorb it."""
    omega = design.terminal.invariant
    loops = design.terminal.gains.loops
    lasting = problem.every_regime[-1].disturbance_set
    first = problem.every_regime[0].disturbance_set

    def room(W):
        reach = np.max([omega.support(omega.normals @ loop) for loop in loops], axis=0)
        return float(np.min(omega.offsets - reach - W.support(omega.normals)))

    assert room(lasting) >= 0 > room(first)
    assert admissible_set(problem, design.terminal.gains).containment_margin(omega) >= 0


@pytest.mark.parametrize("late", [1, 2])
def test_tubes_that_take_the_first_periods_for_later_ones_are_found_out(problem, late):
    wrong = prepare(dataclasses.replace(problem, rule=_Aged(late)))
    regimes = np.zeros_like(wrong.windows.regimes)
    ahead = np.arange(problem.reference.steps)[:, None] + np.arange(problem.horizon)
    regimes[wrong.windows.index[::-1]] = problem.period_regimes[ahead[::-1]]
    windows = dataclasses.replace(wrong.windows, regimes=regimes)
    failing = certify(dataclasses.replace(wrong, problem=problem, windows=windows)).failing
    assert "tightening_covers_reach" in failing


@dataclasses.dataclass(frozen=True)
class _Aged:
    """A run that is taken to have begun some periods ago."""

    periods: int

    def number(self, wheels):
        return np.minimum(np.arange(len(wheels)) + self.periods, 2)

    def lasting(self, horizon):
        return (2,)


def test_a_horizon_that_ends_before_the_last_regime_is_refused():
    with pytest.raises(ValueError, match=r"lengthen controller\.horizon"):
        RegimesByAge(8).lasting(5)


def test_laps_are_judged_by_the_w_of_each_period(problem, design):
    """Of the linear model w is drawn from the W of its period, and counted by it."""
    plant = components.linear_plant(design)
    keys = realisation_keys(0, 0, 64)
    laps = rollout(
        components.make_tube_mpc(design),
        plant,
        keys,
        jnp.tile(0.5 * problem.initial_error, (64, 1)),
    )
    assert not np.any(laps.diagnostics.backup)
    facets = make_checks(design, components.make_tube_mpc(design)).disturbance
    transitions = np.asarray(plant.transitions)
    inputs = np.asarray(plant.input_matrices)
    for step in range(problem.reference.steps):
        moved = laps.measured[step] @ transitions[step].T + laps.inputs[step] @ inputs[step].T
        w = np.asarray(laps.measured[step + 1] - moved)
        due = facets.at(jnp.asarray(step))
        excess = w @ np.asarray(due.normals).T - np.asarray(due.offsets)
        assert np.max(excess) <= 1e3 * OUTSIDE
        regime = int(problem.period_regimes[step])
        margin = problem.disturbances[regime].margin(w)
        assert np.min(margin) == pytest.approx(-np.max(excess), abs=1e-12)
    assert len(disturbance_facets(problem).offsets) == 3 * len(problem.disturbance_set.offsets)
