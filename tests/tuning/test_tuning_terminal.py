"""Laws of the terminal set as a function of the gains: it is the design's, made again for gains
near by."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import msgspec
import numpy as np
import pytest
import tuned

from jaxtube.scenario import load
from jaxtube.synthesis.design import prepare
from jaxtube.synthesis.disturbance import complete_problem
from jaxtube.synthesis.problem import with_controller
from jaxtube.tuning import terminal
from jaxtube.tuning.loop import make_design_constants, terminal_set_at, tightened_bounds
from jaxtube.tuning.parameters import make_parameters
from jaxtube.tuning.terminal import LONGEST
from sets.polytope import Polytope

SAME_TERMINAL_ROWS = 1e-9
"""Of rows of unit offset."""
SAME_TERMINAL_SET = 1e-8
"""Relative, for gains a ten-thousandth apart: what is of second order."""


def prepare_with(problem, kappa):
    """Prepare the design of other gains."""
    parameters = make_parameters(problem)
    numbers = kappa / parameters.scales if len(parameters.scales) else np.log(kappa)
    vector = np.append(parameters.vector[:9], numbers)
    return prepare(with_controller(problem, parameters.scenario(problem.scenario, vector)))


def with_facets(problem, count):
    controller = msgspec.structs.replace(problem.scenario.controller, terminal_facets=count)
    scenario = msgspec.structs.replace(problem.scenario, controller=controller)
    return replace(problem, scenario=scenario)


compute_terminal_set = jax.jit(terminal_set_at)


def bounded_rows(constants, kappa):
    """Return the rows of unit offset that are not spare."""
    terminal_set = compute_terminal_set(constants, jnp.asarray(kappa))
    normals, offsets = jax.tree.map(np.asarray, terminal_set)
    used = np.isfinite(offsets)
    return normals[used] / offsets[used, None]


CASES = {
    "limits alone": ("decoupled", None, 0),
    "decoupled": ("decoupled", (1.4, 6.7, 4.8), 3),
    "vertices": ("vertices", None, 3),
}
"""Problem, gains, and how long the longest path is at least."""


@pytest.fixture(scope="module", params=list(CASES))
def case(request):
    """A design, what tuning holds of it, and how long its longest path is at least."""
    kind, kappa, longest = CASES[request.param]
    problem = tuned.problem_of(kind)
    kappa = problem.given_gains if kappa is None else np.array(kappa)
    problem = with_facets(problem, 300)
    design = prepare_with(problem, kappa)
    return problem, kappa, design, make_design_constants(design), longest


def test_the_rows_are_those_of_the_design(case):
    _, kappa, design, constants, _ = case
    invariant = design.terminal.invariant
    rows = bounded_rows(constants, kappa)
    np.testing.assert_allclose(
        rows, invariant.normals / invariant.offsets[:, None], rtol=0, atol=SAME_TERMINAL_ROWS
    )


def test_predecessors_are_followed(case):
    _, _, design, constants, longest = case
    lengths = (constants.terminal_rows.paths >= 0).sum(axis=1)
    assert lengths.max() == max(map(len, design.terminal.maximal.paths)) <= LONGEST
    assert lengths.max() >= longest and (longest or not lengths.any())


@pytest.mark.parametrize("seed", range(3))
def test_for_gains_near_by_the_set_is_the_one_that_is_made_again(case, seed):
    """A row that comes or goes cuts nothing there: the sets agree to second order at least."""
    problem, kappa, _, constants, _ = case
    rng = np.random.default_rng(seed)
    there = kappa * (1 + 1e-4 * rng.standard_normal(len(kappa)))
    again = prepare_with(problem, there).terminal.invariant
    rows = bounded_rows(constants, there)
    held = Polytope(rows, np.ones(len(rows)))
    directions = rng.normal(size=(50, 3))
    np.testing.assert_allclose(
        held.support(directions), again.support(directions), rtol=SAME_TERMINAL_SET
    )


def test_every_row_is_necessary_for_whatever_gains(case):
    """Rows are predecessors of limits, which no invariant set inside the limits passes."""
    problem, kappa, _, constants, _ = case
    there = kappa * (1 + 0.02 * np.random.default_rng(9).standard_normal(len(kappa)))
    maximal = prepare_with(problem, there).terminal.maximal.polytope
    assert np.max(maximal.support(bounded_rows(constants, there))) <= 1 + SAME_TERMINAL_ROWS


def test_equal_gains_at_all_vertices_are_followed_from_the_first():
    problem = tuned.problem_of("vertices")
    kappa = np.tile(np.mean(tuned.VERTEX_GAINS, axis=0).round(2), 4)
    design = prepare_with(problem, kappa)
    rows = bounded_rows(make_design_constants(design), kappa)
    assert design.terminal.invariant is design.terminal.maximal.polytope
    np.testing.assert_allclose(
        rows, design.terminal.invariant.normals, rtol=0, atol=SAME_TERMINAL_ROWS
    )


def assert_held(design, kappa):
    """The rows are those of the design whatever the gains."""
    constants = make_design_constants(design)
    for there in (kappa, 1.1 * kappa):
        rows = bounded_rows(constants, there)
        np.testing.assert_allclose(
            rows, design.terminal.invariant.normals, rtol=0, atol=SAME_TERMINAL_ROWS
        )


def test_a_set_of_few_facets_is_held(case):
    problem, kappa, design, *_ = case
    few = prepare_with(with_facets(problem, len(design.terminal.maximal.roots) - 2), kappa)
    assert few.terminal.invariant is not few.terminal.maximal.polytope
    assert_held(few, kappa)


def test_a_set_with_a_longer_history_is_held(monkeypatch):
    problem = tuned.problem_of("vertices")
    monkeypatch.setattr(terminal, "LONGEST", 2)
    assert_held(prepare_with(problem, problem.given_gains), problem.given_gains)


def test_what_takes_the_place_of_an_empty_set_is_held():
    problem = complete_problem(load("untuned"))
    kappa = problem.given_gains
    design = prepare_with(problem, kappa)
    assert design.terminal.fallback
    bounds = jax.jit(lambda *of: tightened_bounds(*of).terminal)(
        make_design_constants(design), jnp.asarray(kappa)
    )
    np.testing.assert_allclose(
        bounds[:, :6], design.bounds.terminal, rtol=0, atol=SAME_TERMINAL_ROWS
    )
    assert np.isinf(bounds[:, 6:]).all()
