# ruff: noqa: E741 -- l and u are the letters of the problem
"""Laws of the batched quadratic program solver, against exact active-set solvers and linear
programming."""

import daqp
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import quadprog
import tolerances as tol
from scipy.optimize import linprog
from tube_programs import BATCH, Family, easy, family, hard

from jaxtube import qp
from jaxtube.qp import batched_ldl, blocks, farkas, fixed_point

QP_SHARE = 0.999
"""Of the feasible instances solved, and of the infeasible ones proved."""
QP_RESIDUAL = 1e-8
QP_EDGE = 1e-5
"""Relative distance from the edge of the feasible set at which both sides are told apart."""
QP_POLISHED = 0.9
"""Of the constrained instances, made exact by Newton steps after ADMM."""
QP_ILL_CONDITIONED_FLOAT32 = 1e-3
"""Condition number 1e4, answers up to 30."""

solve = jax.jit(qp.solve)
factorise = jax.jit(qp.factorise)


def answer(P, A, q, l, u, dtype: type = np.float64) -> qp.Solution:
    """Solve, the batch repeated up to the common size, and give the answers of the first len(q) as
    numpy arrays."""
    arrays = [jnp.asarray(np.resize(a, (BATCH, a.shape[1])), dtype) for a in (q, l, u)]
    solution = solve(factorise(jnp.asarray(P, dtype), jnp.asarray(A, dtype)), *arrays)
    return jax.tree.map(lambda a: np.asarray(a)[: len(q)], solution)


def first(count, programs):
    """The first of q, l and u."""
    q, l, u = programs
    return q[:count], l[:count], u[:count]


def exact(P, A, q, l, u):
    """x and whether it exists, by a dual active-set solver."""
    sense = np.zeros(len(A), np.int32)
    l = np.maximum(l, -1e30)
    u = np.minimum(u, 1e30)
    found = [
        daqp.solve(P, q[i], A, u[i], l[i], sense, primal_tol=tol.QP_ORACLE) for i in range(len(q))
    ]
    return np.array([f[0] for f in found]), np.array([f[2] == 1 for f in found])


def residual_by_hand(P, A, q, l, u, x, multipliers):
    """The residual of answers of order one, relative to |q| where that is larger."""
    norms = np.linalg.norm(A, axis=1)
    norms[norms == 0] = 1
    scale = np.maximum(1, np.abs(q).max(axis=1))
    stationarity = np.abs(x @ P + q + multipliers @ A).max(axis=1)
    values = x @ A.T / norms
    shifted = values + multipliers * norms / scale[:, None]
    distance = np.abs(values - np.clip(shifted, l / norms, u / norms)).max(axis=1)
    return np.maximum(stationarity / scale, distance)


def check(fam: Family, q, l, u) -> tuple[np.ndarray, np.ndarray]:
    """Check the contract of `solve`; return which instances are feasible and how many rows each has
    active."""
    solution = answer(fam.P, fam.A, q, l, u)
    x, feasible = exact(fam.P, fam.A, q, l, u)
    solved = solution.status == qp.SOLVED
    infeasible = solution.status == qp.INFEASIBLE
    assert not (solved & ~feasible).any()
    assert not (infeasible & feasible).any()
    assert solved.sum() >= QP_SHARE * feasible.sum()
    assert infeasible.sum() >= QP_SHARE * (~feasible).sum()
    by_hand = residual_by_hand(fam.P, fam.A, q, l, u, solution.x, solution.multipliers)
    assert by_hand[solved].max() <= QP_RESIDUAL
    np.testing.assert_allclose(solution.residual[solved], by_hand[solved], atol=tol.QP_ROUNDING)
    np.testing.assert_allclose(solution.x[solved], x[solved], atol=tol.QP_ANSWER)
    assert np.isfinite(solution.x).all() and np.isfinite(solution.multipliers).all()
    return feasible, (np.abs(solution.multipliers) > tol.QP_ROUNDING).sum(axis=1)


@pytest.mark.parametrize("seed", range(5))
def test_agrees_with_an_exact_solver(seed):
    fam = family(seed)
    assert check(fam, *easy(fam, seed))[0].mean() > 0.5
    feasible, active = check(fam, *hard(fam, seed))
    assert 0.2 < feasible.mean() < 0.8
    assert (active[feasible] > 0).mean() > 0.2 and (active[feasible] >= 5).mean() > 0.05


def test_a_second_exact_solver_agrees():
    fam = family(7)
    programs = hard(fam, 7)
    solution = answer(fam.P, fam.A, *programs)
    for i in np.flatnonzero(solution.status == qp.SOLVED)[:100]:
        q = programs[0][i]
        l = programs[1][i]
        u = programs[2][i]
        bounded = np.isfinite(l)
        C = np.vstack([-fam.A, fam.A[bounded]])
        b = np.concatenate([-u, l[bounded]])
        np.testing.assert_allclose(
            solution.x[i], quadprog.solve_qp(fam.P, -q, C.T, b)[0], atol=tol.QP_ANSWER
        )


def edge(fam: Family, direction):
    """The largest t for which the error t * direction is feasible, by a linear program in x, t."""
    finite = np.isfinite(fam.lower)
    rows = np.column_stack([fam.A, fam.offset @ direction])
    found = linprog(
        np.eye(11)[10] * -1,
        A_ub=np.vstack([rows, -rows[finite]]),
        b_ub=np.concatenate([fam.upper, -fam.lower[finite]]),
        bounds=(None, None),
    )
    assert found.status == 0
    return found.x[10]


def test_the_edge_of_the_feasible_set_is_where_linear_programming_puts_it():
    fam = family(3)
    directions = np.random.default_rng(3).normal(size=(20, 3))
    edges = np.array([edge(fam, d) for d in directions])[:, None] * directions
    within = answer(fam.P, fam.A, *fam.programs(edges * (1 - QP_EDGE)))
    beyond = answer(fam.P, fam.A, *fam.programs(edges * (1 + QP_EDGE)))
    assert (within.status == qp.SOLVED).all()
    assert (beyond.status == qp.INFEASIBLE).all()


def test_float32_follows_float64():
    fam = family(0)
    rounded = [np.float32(part).astype(float) for part in (fam.P, fam.A, *hard(fam, 0))]
    double = answer(*rounded)
    single = answer(*rounded, dtype=np.float32)
    solved = (double.status == qp.SOLVED) & (single.status == qp.SOLVED)
    assert solved.sum() >= tol.QP_SHARE_FLOAT32 * (double.status == qp.SOLVED).sum()
    np.testing.assert_allclose(single.x[solved], double.x[solved], atol=tol.QP_ANSWER_FLOAT32)
    assert not ((single.status == qp.SOLVED) & (double.status == qp.INFEASIBLE)).any()
    assert not ((single.status == qp.INFEASIBLE) & (double.status == qp.SOLVED)).any()


def test_float32_takes_an_ill_conditioned_free_optimum():
    rng = np.random.default_rng(0)
    basis = np.linalg.qr(rng.normal(size=(10, 10)))[0]
    P = (basis * np.geomspace(0.1, 1e3, 10)) @ basis.T
    q = rng.normal(size=(100, 10))
    bound = np.full((100, 47), 1e3)
    solution = answer(P, family(0).A, q, -bound, bound, dtype=np.float32)
    assert (solution.status == qp.SOLVED).all()
    np.testing.assert_allclose(
        solution.x, np.linalg.solve(P, -q.T).T, atol=QP_ILL_CONDITIONED_FLOAT32
    )


def test_a_constrained_instance_leaves_the_free_ones_as_they_are():
    fam = family(0)
    q, l, u = fam.programs(np.random.default_rng(0).uniform(-0.05, 0.05, (BATCH, 3)))
    alone = answer(fam.P, fam.A, q, l, u)
    np.testing.assert_allclose(alone.x, -np.linalg.solve(fam.P, q.T).T, atol=tol.QP_ROUNDING)
    assert not alone.multipliers.any() and (alone.status == qp.SOLVED).all()
    u[5, fam.is_input] = alone.x[5, 0] - 0.01
    together = answer(fam.P, fam.A, q, l, u)
    assert together.multipliers[5].any()
    jax.tree.map(
        np.testing.assert_array_equal,
        *(jax.tree.map(lambda a: np.delete(a, 5, 0), s) for s in (alone, together)),
    )


def degenerate(kind: str):
    """Twenty rows of the family, the others replaced by rows that break solvers."""
    fam = family(1)
    rng = np.random.default_rng(1)
    A = fam.A.copy()
    x = rng.uniform(-0.5, 0.5, (100, 10))
    q = rng.normal(size=(100, 10)) * 3
    if kind == "duplicates":
        A[20:40] = A[:20] * rng.uniform(0.01, 100, (20, 1))
    if kind == "zero rows":
        A[20:] = 0
    if kind == "badly scaled":
        A *= np.geomspace(1e-4, 1e4, len(A))[:, None]
    width = rng.uniform(0, 0.1, (100, len(A))) * np.linalg.norm(A, axis=1)
    l = x @ A.T - width
    u = x @ A.T + width
    if kind == "equalities":
        l[:, 10:14] = u[:, 10:14] = (x @ A.T)[:, 10:14]
    if kind == "no bounds":
        l[:, ::2] = -np.inf
        u[:, 1::3] = np.inf
    return fam.P, A, q, l, u


@pytest.mark.parametrize(
    "kind", ["duplicates", "zero rows", "badly scaled", "equalities", "no bounds"]
)
def test_degenerate_rows_are_solved(kind):
    P, A, q, l, u = degenerate(kind)
    solution = answer(P, A, q, l, u)
    norms = np.where(np.linalg.norm(A, axis=1) > 0, np.linalg.norm(A, axis=1), 1)
    x, feasible = exact(P, A / norms[:, None], q, l / norms, u / norms)
    assert feasible.all() and (solution.status == qp.SOLVED).all()
    np.testing.assert_allclose(solution.x, x, atol=tol.QP_ANSWER)
    np.testing.assert_allclose(x @ P + q + solution.multipliers @ A, 0, atol=tol.QP_ANSWER * 20)


def test_a_row_of_zeros_asks_whether_zero_is_allowed():
    P, A, q, l, u = degenerate("zero rows")
    l[:, -1] = np.where(np.arange(100) % 2, 0.01, -0.01)
    u[:, -1] = 0.02
    status = answer(P, A, q, l, u).status
    assert (status == np.where(np.arange(100) % 2, qp.INFEASIBLE, qp.SOLVED)).all()


def test_crossing_bounds_are_infeasible():
    fam = family(0)
    q, l, u = first(3, easy(fam, 0))
    l[0, 4] = u[0, 4] + 1e-12
    u[1, -1] = -np.inf
    l[2, 2] = np.inf
    solution = answer(fam.P, fam.A, q, l, u)
    assert (solution.status == qp.INFEASIBLE).all() and np.isposinf(solution.residual).all()
    assert not solution.x.any() and not solution.multipliers.any()


@pytest.mark.parametrize("poison", [np.nan, np.inf])
def test_what_is_not_a_number_is_unsolved_and_spoils_nothing_else(poison):
    fam = family(0)
    q, l, u = first(200, hard(fam, 0))
    clean = answer(fam.P, fam.A, q, l, u)
    q[3, 2] = poison
    l[4, 1] = np.nan
    u[5, 0] = np.nan
    solution = answer(fam.P, fam.A, q, l, u)
    assert (solution.status[3:6] == qp.UNSOLVED).all() and np.isposinf(solution.residual[3:6]).all()
    assert not solution.x[3:6].any() and np.isfinite(solution.multipliers).all()
    others = np.delete(np.arange(200), [3, 4, 5])
    assert (solution.status[others] == clean.status[others]).all()
    solved = others[clean.status[others] == qp.SOLVED]
    np.testing.assert_allclose(solution.x[solved], clean.x[solved], atol=tol.QP_ANSWER)


def test_a_hessian_that_is_not_positive_definite_is_unsolved():
    fam = family(0)
    solution = answer(-fam.P, fam.A, *hard(fam, 0))
    assert (solution.status == qp.UNSOLVED).all() and not solution.x.any()


@pytest.mark.slow
def test_a_scan_over_programs_with_fewer_rows_than_unknowns_is_exact():
    rng = np.random.default_rng(2)
    root = rng.normal(size=(3, 10, 10))
    A = rng.normal(size=(3, 6, 10))
    P = root @ root.transpose(0, 2, 1) + np.eye(10)
    q = 3 * rng.normal(size=(3, 50, 10))
    bound = np.full(6, 0.2)
    stack = jax.vmap(qp.factorise)(jnp.asarray(P), jnp.asarray(A))

    def step(_, given):
        factors, q = given
        return None, qp.solve(factors, q, jnp.asarray(-bound), jnp.asarray(bound))

    scan = jax.jit(lambda *given: jax.lax.scan(step, None, given)[1])
    solution = scan(stack, jnp.asarray(q))
    assert (solution.status == qp.SOLVED).all()
    for k in range(3):
        x, _ = exact(P[k], A[k], q[k], np.tile(-bound, (50, 1)), np.tile(bound, (50, 1)))
        np.testing.assert_allclose(solution.x[k], x, atol=tol.QP_ANSWER)


def test_polish_makes_most_iterates_exact_and_loses_none():
    fam = family(2)
    programs = hard(fam, 2)

    @jax.jit
    def before_and_after(P, A, q, l, u):
        factors = qp.factorise(P, A)
        instances = fixed_point.unit_rows(factors, q, l, u)
        x, y = fixed_point.admm(factors, factors.iterated, instances, jnp.zeros_like(q.T), 30)
        start = fixed_point.Iterate(x, y, fixed_point.residual(factors, instances, x, y))
        polished = fixed_point.polish(factors, factors.iterated, instances, start, (x, y), 4)
        return start.residual, polished.residual

    before, after = before_and_after(fam.P, fam.A, *programs)
    solution = answer(fam.P, fam.A, *programs)
    constrained = (solution.status == qp.SOLVED) & solution.multipliers.any(axis=1)
    assert (after <= before).all()
    assert (before[constrained] > QP_RESIDUAL).mean() > QP_POLISHED
    assert (after[constrained] < QP_RESIDUAL).mean() > QP_POLISHED


def test_no_multipliers_exclude_a_set_that_holds_a_point():
    fam = family(0)
    rng = np.random.default_rng(4)
    unit = fam.A / np.linalg.norm(fam.A, axis=1)[:, None]
    excludes = jax.jit(farkas.excludes)
    for reach in (1e-3, 1.0, 1e2):
        values = unit @ rng.uniform(-reach, reach, (10, BATCH))
        l = values - rng.exponential(0.01, values.shape)
        u = values + rng.exponential(0.01, values.shape)
        upper, lower = rng.exponential(1, (2, *values.shape)) * (
            rng.random((2, *values.shape)) < 0.05
        )
        assert not excludes(unit, l, u, upper, lower, 0.0).any()
        assert excludes(unit, l, l - 1.0, np.ones_like(l), np.ones_like(l), 0.0).all()


def test_ldl_solves_what_numpy_solves():
    rng = np.random.default_rng(5)
    A = rng.normal(size=(12, 7))
    d = rng.exponential(1, (12, 9))
    r = rng.normal(size=(7, 9))

    @jax.jit
    def solved(A, d, r):
        packed = batched_ldl.pack(jnp.eye(7))[:, None] + batched_ldl.pair_products(A) @ d
        return batched_ldl.solve(batched_ldl.factorise(packed), r)

    matrices = np.eye(7) + np.einsum("mi,mb,mj->bij", A, d, A)
    x = np.linalg.solve(matrices, r.T[..., None])[..., 0].T
    np.testing.assert_allclose(solved(A, d, r), x, atol=tol.QP_ROUNDING)


def test_shapes_that_do_not_fit_are_refused():
    with pytest.raises(ValueError, match="P, A"):
        qp.factorise(jnp.eye(3), jnp.ones((5, 2)))
    with pytest.raises(ValueError, match="m >= 1"):
        qp.factorise(jnp.eye(3), jnp.ones((0, 3)))


@pytest.mark.parametrize("factor", [1e8, 1e12])
def test_the_size_of_the_cost_neither_moves_the_answer_nor_widens_the_bounds(factor):
    fam = family(0)
    q, l, u = first(200, hard(fam, 0))
    solution = answer(factor * fam.P, fam.A, factor * q, l, u)
    x, feasible = exact(fam.P, fam.A, q, l, u)
    solved = solution.status == qp.SOLVED
    assert not (solved & ~feasible).any()
    assert solved.sum() >= QP_SHARE * feasible.sum()
    norms = np.linalg.norm(fam.A, axis=1)
    values = solution.x @ fam.A.T
    missed = np.maximum(l - values, values - u) / norms
    assert missed[solved].max() <= qp.bound_tolerance(1.0)
    np.testing.assert_allclose(solution.x[solved], x[solved], atol=tol.QP_ANSWER)


def test_an_accelerator_finds_the_answers_of_a_processor(monkeypatch):
    fam = family(3)
    programs = first(64, hard(fam, 3))
    expected = answer(fam.P, fam.A, *programs)
    monkeypatch.setattr(blocks, "_assumed", True)
    arrays = [jnp.asarray(part) for part in programs]
    # A function of its own: the processor's program is kept under the name of the other one.
    found = jax.jit(lambda *given: qp.solve(*given))(factorise(fam.P, fam.A), *arrays)
    np.testing.assert_array_equal(found.status, expected.status)
    solved = expected.status == qp.SOLVED
    np.testing.assert_allclose(found.x[solved], expected.x[solved], rtol=0, atol=tol.QP_ANSWER)


def test_a_product_of_few_terms_is_that_of_matrices(monkeypatch):
    rng = np.random.default_rng(0)
    for left, right in (((4, 3), (3, 7)), ((7, 5), (5, 2)), ((2, 4, 3), (2, 3, 6))):
        one = jnp.asarray(rng.normal(size=left))
        other = jnp.asarray(rng.normal(size=right))
        expected = np.asarray(one) @ np.asarray(other)
        for assumed in (False, True):
            monkeypatch.setattr(blocks, "_assumed", assumed)
            product = batched_ldl.matmul(one, other)
            np.testing.assert_allclose(product, expected, rtol=0, atol=tol.QP_ROUNDING)
