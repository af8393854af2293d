"""Laws of parametric programs: those that are wanted are answered as by the solver that is given
their numbers, with its derivative, and the others are left alone."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import tolerances as tol
from tube_programs import BATCH, family

from jaxtube import qp
from jaxtube.qp.parametric import Parametric, form, solve_parametric

SLOPE = 1e-9
"""Relative; derivatives along two ways of the same product."""


@pytest.fixture(scope="module")
def posed():
    """Factors, program, errors within and beyond the feasible set, and which are wanted."""
    fam = family(4)
    factors = jax.jit(qp.factorise)(jnp.asarray(fam.P), jnp.asarray(fam.A))
    program = Parametric(*map(jnp.asarray, (fam.gradient, fam.offset, fam.lower, fam.upper)))
    generator = np.random.default_rng(4)
    errors = jnp.asarray(generator.uniform(-0.3, 0.3, (BATCH, 3)))
    return factors, program, errors, jnp.asarray(generator.random(BATCH) < 0.5)


def test_wanted_programs_are_answered_as_by_the_solver(posed):
    factors, program, errors, is_wanted = posed
    found = jax.jit(solve_parametric)(factors, program, errors, is_wanted, None)
    expected = jax.jit(qp.solve)(factors, *form(program, errors))
    wanted = np.asarray(is_wanted)
    np.testing.assert_array_equal(found.status[wanted], expected.status[wanted])
    assert 0.2 < (np.asarray(expected.status) == qp.SOLVED).mean() < 1.0
    solved = wanted & np.asarray(found.status == qp.SOLVED)
    np.testing.assert_allclose(found.x[solved], expected.x[solved], atol=tol.QP_ORACLE)
    np.testing.assert_allclose(
        found.multipliers[solved], expected.multipliers[solved], atol=tol.QP_ANSWER
    )
    assert (np.asarray(found.status)[~wanted] == qp.UNSOLVED).all()
    assert not np.asarray(found.x)[~wanted].any()
    assert np.isposinf(np.asarray(found.residual)[~wanted]).all()


def test_derivatives_are_those_of_the_solver(posed):
    factors, program, errors, is_wanted = posed
    weights = jnp.asarray(np.random.default_rng(5).normal(size=(BATCH, 10)))

    def of_parameters(factors, program, errors):
        found = solve_parametric(factors, program, errors, is_wanted, None)
        return jnp.sum(weights * found.x)

    def of_numbers(factors, program, errors):
        found = qp.solve(factors, *form(program, errors))
        return jnp.sum(jnp.where(is_wanted[:, None], weights * found.x, 0.0))

    found, expected = (
        jax.jit(jax.grad(function, argnums=(0, 1, 2)))(factors, program, errors)
        for function in (of_parameters, of_numbers)
    )
    for one, other in zip(jax.tree.leaves(found), jax.tree.leaves(expected), strict=True):
        np.testing.assert_allclose(one, other, atol=SLOPE * max(1.0, np.abs(other).max()))


def test_parameters_that_are_no_numbers_are_unsolved_and_spoil_nothing(posed):
    factors, program, errors, _ = posed
    everyone = jnp.ones(len(errors), bool)
    solve = jax.jit(solve_parametric)
    clean = solve(factors, program, errors, everyone, None)
    found = solve(factors, program, errors.at[7, 1].set(jnp.nan), everyone, None)
    assert found.status[7] == qp.UNSOLVED and np.isposinf(found.residual[7])
    assert not np.asarray(found.x)[7].any()
    for one, other in zip(clean, found, strict=True):
        np.testing.assert_array_equal(np.delete(one, 7, 0), np.delete(other, 7, 0))
