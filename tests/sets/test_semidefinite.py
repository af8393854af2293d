"""Laws of semidefinite programs in affine matrix expressions: algebra, duality, closed forms, and
another modeller."""

import cvxpy
import numpy as np
import pytest
from tolerances import ROUNDING

from sets.semidefinite import (
    INFEASIBLE,
    SOLVED,
    block_matrix,
    evaluate,
    full_basis,
    lift,
    make_unknowns,
    minimise,
    symmetric_basis,
    trace,
    triangular_basis,
)

ANSWER = 1e-6
"""Of a solver whose tolerance is 1e-8, on numbers of order one."""
SEEDS = range(4)


def draw_symmetric(rng, n):
    square = rng.normal(size=(n, n))
    return square + square.T


def draw_positive(rng, n):
    square = rng.normal(size=(n, n))
    return square @ square.T + 0.1 * np.eye(n)


@pytest.mark.parametrize("seed", SEEDS)
def test_expressions_have_the_values_of_matrices(seed):
    rng = np.random.default_rng(seed)
    S, Y = make_unknowns(symmetric_basis(3), full_basis(2, 3))
    x = rng.normal(size=len(S) - 1)
    A = rng.normal(size=(3, 3))
    B = rng.normal(size=(3, 2))
    s = evaluate(S, x)
    y = evaluate(Y, x)
    assert np.array_equal(s, s.T)
    assert np.array_equal(np.sort(np.concatenate([s[np.triu_indices(3)], y.ravel()])), np.sort(x))
    following = A @ S + B @ Y
    blocks = block_matrix([[S, np.swapaxes(following, 1, 2)], [following, np.eye(3)]])
    direct = A @ s + B @ y
    expected = np.block([[s, direct.T], [direct, np.eye(3)]])
    np.testing.assert_allclose(evaluate(blocks, x), expected, atol=10 * ROUNDING)
    value = trace(S - lift(A, len(x)))
    assert value[0] + value[1:] @ x == pytest.approx(np.trace(s - A), abs=10 * ROUNDING)


def test_bases_span_their_matrices_column_by_column():
    numbers = np.arange(1.0, 10.0)
    square = np.tensordot(numbers, full_basis(3, 3), axes=1)
    assert np.array_equal(square.ravel(order="F"), numbers)
    upper = np.tensordot(numbers[:6], triangular_basis(3), axes=1)
    assert np.array_equal(upper, [[1, 2, 4], [0, 3, 5], [0, 0, 6]])
    symmetric = np.tensordot(numbers[:6], symmetric_basis(3), axes=1)
    assert np.array_equal(symmetric, np.triu(upper) + np.triu(upper, 1).T)


@pytest.mark.parametrize("seed", SEEDS)
def test_the_least_eigenvalue_is_the_most_that_may_be_taken_off(seed):
    A = draw_symmetric(np.random.default_rng(seed), 4)
    (t,) = make_unknowns(full_basis(1, 1))
    answer = minimise(-trace(t), [lift(A, 1) - t * np.eye(4)])
    w, v = np.linalg.eigh(A)
    assert answer.status == SOLVED
    assert answer.x[0] == pytest.approx(w[0], abs=ANSWER)
    np.testing.assert_allclose(answer.multipliers[0], np.outer(v[:, 0], v[:, 0]), atol=1e-4)


@pytest.mark.parametrize("seed", SEEDS)
def test_multipliers_prove_the_answer(seed):
    """Weak duality: c_j = sum_i <Z_i, F_ij> and Z_i >= 0 bound c^T x by - sum_i <Z_i, F_i0>."""
    rng = np.random.default_rng([seed, 1])
    (P,) = make_unknowns(symmetric_basis(3))
    above = [draw_positive(rng, 3), draw_positive(rng, 3)]
    constraints = [P - lift(bound, len(P) - 1) for bound in above]
    objective = trace(draw_positive(rng, 3) @ P)
    answer = minimise(objective, constraints)
    slopes = np.zeros(len(P))
    for Z, constraint in zip(answer.multipliers, constraints, strict=True):
        assert np.linalg.eigvalsh(Z)[0] >= -ANSWER
        assert np.linalg.eigvalsh(evaluate(constraint, answer.x))[0] >= -ANSWER
        slopes += np.tensordot(constraint, Z, axes=2)
    np.testing.assert_allclose(slopes[1:], objective[1:], atol=ANSWER)
    assert objective[1:] @ answer.x == pytest.approx(-slopes[0], abs=10 * ANSWER)


@pytest.mark.parametrize("seed", SEEDS)
def test_the_largest_determinant_below_a_matrix_is_its_own(seed):
    A = draw_positive(np.random.default_rng([seed, 2]), 3)
    bases = (symmetric_basis(3), triangular_basis(3), full_basis(3, 1))
    S, U, t = make_unknowns(*bases)
    D = U * np.eye(3)
    below = lift(A, len(S) - 1) - S
    factored = block_matrix([[D, U], [np.swapaxes(U, 1, 2), S]])
    logarithms = block_matrix([[t, np.ones((3, 1)), D @ np.ones((3, 1))]])
    answer = minimise(-t.sum(axis=(1, 2)), [below, factored], logarithms)
    assert answer.status == SOLVED
    assert answer.x[-3:].sum() == pytest.approx(np.linalg.slogdet(A)[1], abs=ANSWER)
    np.testing.assert_allclose(evaluate(S, answer.x), A, atol=1e-3)


def test_what_nothing_fulfils_is_told():
    (P,) = make_unknowns(symmetric_basis(2))
    answer = minimise(trace(P), [P - lift(np.eye(2), 3), -P])
    assert answer.status == INFEASIBLE


@pytest.mark.parametrize("seed", SEEDS)
def test_another_modeller_finds_the_same(seed):
    """Least trace of P with  [P, (A P)^T; A P, P] >= [I, 0; 0, 0]  and P >= C."""
    rng = np.random.default_rng([seed, 3])
    A = rng.normal(size=(3, 3))
    A *= 0.8 / np.abs(np.linalg.eigvals(A)).max()
    C = draw_positive(rng, 3)
    (P,) = make_unknowns(symmetric_basis(3))
    after = A @ P
    constant = np.kron(np.diag([1.0, 0.0]), np.eye(3))
    decrease = block_matrix([[P, np.swapaxes(after, 1, 2)], [after, P]]) - lift(constant, 6)
    answer = minimise(trace(P), [decrease, P - lift(C, 6)])
    Q = cvxpy.Variable((3, 3), symmetric=True)
    asked = [cvxpy.bmat([[Q, (A @ Q).T], [A @ Q, Q]]) >> constant, Q >> C]
    problem = cvxpy.Problem(cvxpy.Minimize(cvxpy.trace(Q)), asked)
    value = problem.solve(solver=cvxpy.CLARABEL)
    assert answer.status == SOLVED
    assert trace(P)[1:] @ answer.x == pytest.approx(value, rel=ANSWER)
    for ours, theirs in zip(answer.multipliers, asked, strict=True):
        np.testing.assert_allclose(ours, theirs.dual_value, atol=1e-4)
