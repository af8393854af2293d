"""Laws of the critical regions that laps meet: their plans are those of the solver, each region is
what its rows say, and what a bank holds changes nothing but the time."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxtube import qp
from jaxtube.control import planning
from jaxtube.qp import parametric
from jaxtube.qp.regions import look_up
from jaxtube.scenario import load
from jaxtube.simulation import batches, components
from jaxtube.simulation.choices import choose_starts
from jaxtube.simulation.rollout import realisation_keys
from jaxtube.synthesis import regions
from jaxtube.synthesis.regions import find_regions

SAME = 1e-9
"""In the units of inputs: the accuracy that the solver accepts."""


COUNT = 1000
"""Errors of a batch: one shape, for one program of each kind."""

plan = jax.jit(planning.plan)
known_plan = jax.jit(planning.known_plan)
look_up_answers = jax.jit(look_up, static_argnums=2)
take_qp = jax.jit(planning.take_qp)


@pytest.fixture(scope="module")
def tuned(uncertified):
    """A design whose rows are active after its start."""
    return uncertified("tuned")


@pytest.fixture(scope="module")
def controller(tuned):
    return components.make_tube_mpc(tuned)


@pytest.fixture(scope="module")
def first(tuned, controller):
    """The QP of the first window."""
    return take_qp(controller.qps, tuned.first_window)


@pytest.fixture(scope="module")
def errors(tuned):
    """Errors around the start and on the way from there, in the regions and beside them."""
    rng = np.random.default_rng(4)
    shares = rng.uniform(0.0, 1.0, (COUNT, 1))
    widths = np.array([0.02, 0.02, 0.05])
    return shares * tuned.problem.initial_error + rng.uniform(-widths, widths, (COUNT, 3))


def start_at(error):
    """Draw one first error again and again."""
    return lambda _, count: np.broadcast_to(error, (count, 3))


def without_regions(condensed):
    return condensed._replace(regions=None)


def test_plans_are_those_of_the_solver(first, errors):
    known = plan(first, jnp.asarray(errors))
    solved = plan(without_regions(first), jnp.asarray(errors))
    np.testing.assert_array_equal(known.status, solved.status)
    np.testing.assert_array_equal(known.active, solved.active)
    assert np.mean(known.active) > 0.3
    np.testing.assert_allclose(known.inputs, solved.inputs, rtol=0, atol=SAME)
    assert np.all(known.residual[known.status == qp.SOLVED] <= qp.TOLERANCE[8])


def test_a_plan_without_a_solver_is_that_of_the_solver_or_none(first, errors):
    known = known_plan(first, jnp.asarray(errors))
    solved = plan(without_regions(first), jnp.asarray(errors))
    found = np.asarray(known.status) != qp.UNSOLVED
    assert 0.5 < np.mean(found) < 1.0
    assert np.sum(known.active[found]) > 50
    np.testing.assert_array_equal(known.status[found], solved.status[found])
    np.testing.assert_array_equal(known.active[found], solved.active[found])
    np.testing.assert_allclose(known.inputs[found], solved.inputs[found], rtol=0, atol=SAME)
    assert np.all(known.residual[known.status == qp.SOLVED] <= qp.TOLERANCE[8])


@jax.jit
def find_known(condensed, errors):
    factors = condensed.factors
    found = parametric.look_up(factors, condensed.parametric, errors, condensed.regions)
    return found.status == qp.SOLVED


def are_known(condensed, errors):
    """Whether the region that is guessed holds each error; at most COUNT at a time."""
    padded = np.resize(errors, (-(-len(errors) // COUNT), COUNT, 3))
    known = [find_known(condensed, jnp.asarray(block)) for block in padded]
    return np.concatenate(known)[: len(errors)]


def share_of_known(design, controller, starts):
    """The share of the active programs of laps whose regions are guessed."""
    lap = batches.run_realisations(controller, components.slipping_robot(design), starts, seed=9)
    active = np.asarray(lap.diagnostics.active)
    windows = np.asarray(controller.index)
    known = []
    for window in np.unique(windows[active.any(axis=1)]):
        of_window = active & (windows == window)[:, None]
        met = np.asarray(lap.measured)[:-1][of_window]
        known.append(are_known(take_qp(controller.qps, window), met))
    answered = np.concatenate(known)
    assert len(answered) > 100
    return np.mean(answered)


def test_active_programs_of_laps_are_known(tuned, controller):
    starts = np.tile(tuned.problem.initial_error, (64, 1))
    assert share_of_known(tuned, controller, starts) > 0.995


def test_programs_from_starts_that_are_drawn_are_known_as_well(uncertified):
    """Of laps from the edge, which those from the scenario's start do not resemble."""
    robust = uncertified("robust")
    law = choose_starts(robust, "edge")
    controller = components.make_tube_mpc(robust, law)
    assert components.make_tube_mpc(robust).qps.regions is None
    starts = np.asarray(law.draw(realisation_keys(3, 0, 512)))
    assert share_of_known(robust, controller, starts) > 0.95


def test_answers_of_regions_satisfy_the_optimality_conditions(first, errors):
    """At points of each region, by the conditions themselves."""
    factors = first.factors
    rows = factors.rows * factors.row_norms[:, None]
    x, y = (part.T for part in look_up_answers(first.regions, jnp.asarray(errors), len(rows)))
    y = y / factors.row_norms
    gradient = x @ factors.hessian + errors @ first.linear.T + y @ rows
    values = x @ rows.T + errors @ first.row_errors.T
    inside = are_known(first, errors)
    assert inside.sum() > 50
    bounds = np.where(y > 0, first.upper, np.where(y < 0, first.lower, values))
    np.testing.assert_allclose(gradient[inside], 0.0, atol=SAME)
    np.testing.assert_allclose(values[inside], bounds[inside], atol=SAME)
    assert np.all(values[inside] <= first.upper + SAME)
    assert np.all(values[inside] >= first.lower - SAME)


def test_a_wrong_answer_is_not_taken(first, errors):
    wrong = first.regions._replace(multipliers=first.regions.multipliers * 1.01)
    assert not np.any(are_known(first._replace(regions=wrong), errors))
    spoilt = plan(first._replace(regions=wrong), jnp.asarray(errors))
    solved = plan(without_regions(first), jnp.asarray(errors))
    np.testing.assert_array_equal(spoilt.status, solved.status)
    np.testing.assert_allclose(spoilt.inputs, solved.inputs, rtol=0, atol=SAME)


def test_a_window_without_regions_guesses_no_row(tuned, controller):
    """Nothing is taken from it."""
    begin = np.asarray(controller.qps.regions.begin)
    empty = take_qp(controller.qps, np.flatnonzero(begin < 0)[0])
    errors = jnp.asarray(np.tile(tuned.problem.initial_error, (COUNT, 1)))
    _, multipliers = look_up_answers(empty.regions, errors, len(empty.lower))
    assert not np.any(multipliers)
    assert not np.any(are_known(empty, errors))


def test_no_plan_depends_on_the_other_instances(first, errors):
    together = plan(first, jnp.asarray(errors))
    some = errors[::7]
    # Each of them again and again, in other places, and none of the others.
    among_others = plan(first, jnp.asarray(np.resize(some, errors.shape)))
    found = among_others.inputs[: len(some)]
    np.testing.assert_allclose(together.inputs[::7], found, rtol=0, atol=1e-13)


def test_derivatives_do_not_know_the_bank(first, errors):
    def total(condensed, scale):
        return jnp.sum(planning.plan(condensed, scale * jnp.asarray(errors[:32])).inputs ** 2)

    slope = jax.jit(jax.grad(total, argnums=1))
    known = slope(first, 1.0)
    solved = slope(without_regions(first), 1.0)
    np.testing.assert_allclose(known, solved, rtol=1e-7)


def test_a_start_where_no_row_is_active_has_no_bank(tuned):
    problem = tuned.problem
    found = find_regions(
        tuned.tube_qps, tuned.windows.index, start_at(0.0), problem.noise, np.zeros((1, 3))
    )
    assert found is None


def test_a_bank_has_an_end(tuned, monkeypatch):
    most = 32
    monkeypatch.setattr(regions, "MOST_REGIONS", most)
    far = 10 * tuned.problem.disturbance_set.vertices()
    begin = start_at(tuned.problem.initial_error)
    found = find_regions(tuned.tube_qps, tuned.windows.index, begin, np.zeros(3), far)
    windows = np.count_nonzero(found.begin >= 0)
    assert most < len(found.rows) <= 1 + windows * most


def test_a_controller_that_keeps_its_nominal_error_has_no_bank(tuned):
    scenario = load("tuned", ["controller.restart=false"])
    problem = dataclasses.replace(tuned.problem, scenario=scenario)
    controller = components.make_tube_mpc(dataclasses.replace(tuned, problem=problem))
    assert controller.qps.regions is None
