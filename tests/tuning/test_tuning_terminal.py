"""Laws of the terminal set as a function of the gains: it is the design's, made again for gains near by."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import msgspec
import numpy as np
import pytest
import tolerances as tol
import tuned

from jaxtube.design import prepare
from jaxtube.design.problem import with_controller
from jaxtube.tuning.loop import fix
from jaxtube.tuning.parameters import parameters
from jaxtube.tuning.terminal import LONGEST, terminal_set
from sets.polytope import Polytope


def made(problem, kappa):
    """Prepare the design of other gains."""
    chosen = parameters(problem)
    numbers = kappa / chosen.scales if len(chosen.scales) else np.log(kappa)
    return prepare(with_controller(problem, chosen.scenario(problem.scenario, np.append(chosen.vector[:9], numbers))))


def with_facets(problem, count):
    settings = msgspec.structs.replace(problem.scenario.controller, terminal_facets=count)
    return replace(problem, scenario=msgspec.structs.replace(problem.scenario, controller=settings))


@jax.jit
def rows_at(fixed, kappa):
    return terminal_set(
        fixed.terminal_rows,
        fixed.maps.vertex_loops.at(kappa),
        fixed.maps.corner_gains.at(kappa),
        fixed.generators,
        (fixed.error_rows, fixed.error_offsets),
        (fixed.input_rows, fixed.input_error_rows, fixed.input_offsets),
    )


def bounded(found):
    """Return the rows of unit offset that are not spare."""
    normals, offsets = (np.asarray(part) for part in found)
    used = np.isfinite(offsets)
    return normals[used] / offsets[used, None]


CASES = {
    "no predecessors": ("decoupled", None),
    "decoupled": ("decoupled", (1.4, 6.7, 4.8)),
    "vertices": ("vertices", None),
}


@pytest.fixture(scope="module", params=list(CASES))
def case(request):
    """A design of the problem's gains or of firm ones, and what tuning holds of it."""
    kind, kappa = CASES[request.param]
    problem = tuned.problem_of(kind)
    kappa = problem.given_gains if kappa is None else np.array(kappa)
    problem = with_facets(problem, 300)
    found = made(problem, kappa)
    return problem, kappa, found, fix(found)


def test_the_rows_are_those_of_the_design(case):
    _, kappa, found, fixed = case
    invariant = found.terminal.invariant
    rows = bounded(rows_at(fixed, jnp.asarray(kappa)))
    np.testing.assert_allclose(
        rows, invariant.normals / invariant.offsets[:, None], rtol=0, atol=tol.SAME_TERMINAL_ROWS
    )


def test_predecessors_are_followed(case, request):
    _, _, found, fixed = case
    lengths = (fixed.terminal_rows.paths >= 0).sum(axis=1)
    assert lengths.max() == max(map(len, found.terminal.maximal.paths)) <= LONGEST
    assert (lengths.max() > 1) == ("no predecessors" not in request.node.name)


@pytest.mark.parametrize("seed", range(3))
def test_for_gains_near_by_the_set_is_the_one_that_is_made_again(case, seed):
    """A row that comes or goes cuts nothing there, so the sets agree to second order and the slopes are equal."""
    problem, kappa, _, fixed = case
    rng = np.random.default_rng(seed)
    there = kappa * (1 + 1e-4 * rng.standard_normal(len(kappa)))
    again = made(problem, there).terminal.invariant
    rows = bounded(rows_at(fixed, jnp.asarray(there)))
    held = Polytope(rows, np.ones(len(rows)))
    directions = rng.normal(size=(50, 3))
    np.testing.assert_allclose(held.support(directions), again.support(directions), rtol=tol.SAME_TERMINAL_SET)


def test_every_row_is_necessary_for_whatever_gains(case):
    """Rows are predecessors of limits, which no invariant set inside the limits passes."""
    problem, kappa, _, fixed = case
    there = kappa * (1 + 0.02 * np.random.default_rng(9).standard_normal(len(kappa)))
    maximal = made(problem, there).terminal.maximal.polytope
    assert np.max(maximal.support(bounded(rows_at(fixed, jnp.asarray(there))))) <= 1 + tol.SAME_TERMINAL_ROWS


def test_a_set_of_few_facets_is_held(case):
    problem, kappa, found, _ = case
    few = made(with_facets(problem, len(found.terminal.maximal.roots) - 2), kappa)
    assert few.terminal.invariant is not few.terminal.maximal.polytope
    fixed = fix(few)
    for there in (kappa, 1.1 * kappa):
        rows = bounded(rows_at(fixed, jnp.asarray(there)))
        np.testing.assert_allclose(rows, few.terminal.invariant.normals, rtol=0, atol=tol.SAME_TERMINAL_ROWS)
