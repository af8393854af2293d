# ruff: noqa: E741 -- l and u are the letters of the problem
"""Laws of the derivative of quadratic programs, against differences of an exact solver and unrolled
iterations."""

import daqp
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import tolerances as tol
from tube_programs import Family, family, hard

from jaxtube import qp
from jaxtube.qp import fixed_point, sensitivity

SENSITIVITY = 1e-6
"""Relative; derivatives against differences and against unrolled iterations."""
SENSITIVITY_EXCLUDED = 0.03
"""Of the solved instances: their active rows change within a difference, or are dependent."""
SENSITIVITY_FLOAT32 = 1e-2
"""Relative, on the worst conditioned of the active rows."""

DRAWN = 2000  # the first COUNT of them are used
COUNT = 400  # one shape for nearly all tests, so that one compilation serves them
STEP = 1e-5
DIFFERENCE = {
    2: -1 / 12,
    1: 8 / 12,
    -1: -8 / 12,
    -2: 1 / 12,
}  # weights of a central difference of fourth order


def loss(data, x_bar, y_bar):
    solution = qp.solve(qp.factorise(*data[:2]), *data[2:])
    return jnp.sum(solution.x * x_bar) + jnp.sum(solution.multipliers * y_bar), solution


compiled_gradient = jax.jit(jax.grad(loss, has_aux=True))


def gradient(
    data, x_bar, y_bar=None, *, dtype: type = np.float64
) -> tuple[list[np.ndarray], qp.Solution]:
    """Cotangents of P, A, q, l, u, and the solution, as numpy arrays."""
    y_bar = np.zeros(data[3].shape) if y_bar is None else y_bar
    arrays = jax.tree.map(lambda a: jnp.asarray(a, dtype), (data, x_bar, y_bar))
    found, solution = compiled_gradient(*arrays)
    return [np.asarray(part) for part in found], jax.tree.map(np.asarray, solution)


def programs(seed: int) -> list[np.ndarray]:
    fam = family(seed)
    return [fam.P, fam.A, *(part[:COUNT] for part in hard(fam, seed, DRAWN))]


def free_programs(fam: Family) -> list[np.ndarray]:
    """Programs of which no row is active."""
    return [fam.P, fam.A, *fam.programs(np.random.default_rng(0).uniform(-0.05, 0.05, (COUNT, 3)))]


def exact(P, A, q, l, u):
    """x and multipliers by a dual active-set solver; NaN where there is no answer."""
    sense = np.zeros(len(A), np.int32)
    found = []
    for i in range(len(q)):
        low = np.maximum(l[i], -1e30)
        high = np.minimum(u[i], 1e30)
        x, _, flag, info = daqp.solve(P, q[i], A, high, low, sense, primal_tol=tol.QP_ORACLE)
        found.append((x, info["lam"]) if flag == 1 else (x * np.nan, info["lam"] * np.nan))
    return [np.array(part) for part in zip(*found, strict=True)]


def moved(data, part: int, step):
    """The data with a step added to one part."""
    return [value + step if i == part else value for i, value in enumerate(data)]


def difference(data, part: int, direction):
    """Derivative of the exact x and multipliers along a direction of one part of the data, and
    where it is one.

    The rows that are active must be the same at all points, and their multipliers unique.
    """
    base = exact(*data)
    derivative = [0.0, 0.0]
    same = np.isfinite(base[0]).all(axis=1)
    for steps, weight in DIFFERENCE.items():
        end = exact(*moved(data, part, steps * STEP * direction))
        derivative = [
            total + weight / STEP * value for total, value in zip(derivative, end, strict=True)
        ]
        same &= (np.sign(end[1]) == np.sign(base[1])).all(axis=1)
    return derivative, same, base


def direction_of(part: int, data, rng):
    if part == 0:
        root = rng.normal(size=data[0].shape)
        return root + root.T
    return rng.normal(size=data[part].shape)


@pytest.mark.parametrize("part", range(5), ids=list("PAqlu"))
@pytest.mark.parametrize(
    "seed", [0, *(pytest.param(seed, marks=pytest.mark.slow) for seed in (1, 2))]
)
def test_agrees_with_differences_of_an_exact_solver(seed, part):
    data = programs(seed)
    rng = np.random.default_rng(seed)
    bars = (rng.normal(size=data[2].shape), rng.normal(size=data[3].shape))
    direction = direction_of(part, data, rng)
    derivative, same, (_, multipliers) = difference(data, part, direction)
    solution = gradient(data, *bars)[1]
    solved = solution.status == qp.SOLVED
    unique = np.abs(solution.multipliers - multipliers).max(axis=1) < tol.QP_ANSWER
    kept = solved & same & unique
    constrained = np.abs(multipliers).max(axis=1) > 0
    assert (solved & ~kept).sum() <= SENSITIVITY_EXCLUDED * solved.sum()
    assert (kept & constrained).sum() > 90
    for which in range(2):
        kept_bars = [bar * kept[:, None] * (which == i) for i, bar in enumerate(bars)]
        products = gradient(data, *kept_bars)[0][part] * direction
        by_difference = np.where(kept[:, None], derivative[which] * bars[which], 0.0).sum(axis=1)
        if part < 2:  # common to the batch, whose derivatives are summed
            products = products.reshape(1, -1)
            by_difference = by_difference.sum(keepdims=True)
        scale = np.maximum(np.abs(products).sum(axis=1), 1e-2)
        assert (np.abs(products.sum(axis=1) - by_difference) <= SENSITIVITY * scale).all()


def differentiable_gain(factors: qp.Factors) -> qp.Factors:
    """The factors with the derivative of the gain of the iterations, which `qp` leaves out."""
    gram = factors.rows.T @ factors.rows
    gain = jnp.linalg.inv(factors.hessian + factors.rho * gram)
    return factors._replace(iterated=factors.iterated._replace(admm_gain=gain))


@pytest.mark.slow
def test_agrees_with_unrolled_iterations():
    data = programs(0)
    x_bar = np.random.default_rng(1).normal(size=data[2].shape)
    solution = gradient(data, x_bar)[1]

    def unrolled(data, x_bar):
        P, A, q, l, u = data
        factors = differentiable_gain(qp.factorise(P, A))
        instances = fixed_point.unit_rows(factors, q, l, u)
        start = jnp.zeros_like(instances.q)
        x, y = fixed_point.admm(factors, factors.iterated, instances, start, 600)
        return jnp.sum(x.T * x_bar), fixed_point.residual(factors, instances, x, y)

    iterate = jax.jit(jax.grad(unrolled, has_aux=True))
    # The product of an infinite bound with its cotangent, zero, would be NaN.
    arrays = [jnp.asarray(np.maximum(part, -1e6)) for part in data]
    kept = (solution.status == qp.SOLVED) & (np.asarray(iterate(arrays, x_bar)[1]) < tol.QP_ORACLE)
    assert (kept & solution.multipliers.any(axis=1)).sum() > 50
    found = gradient(data, x_bar * kept[:, None])[0]
    expected, _ = iterate(arrays, x_bar * kept[:, None])
    expected[0] = (expected[0] + expected[0].T) / 2
    for mine, other in zip(found, expected, strict=True):
        np.testing.assert_allclose(mine, np.asarray(other), atol=SENSITIVITY * np.abs(mine).max())


def test_what_has_no_answer_has_no_derivative_and_leaves_the_others_as_they_are():
    data = programs(0)
    rng = np.random.default_rng(2)
    bars = (rng.normal(size=data[2].shape), rng.normal(size=data[3].shape))
    solved = gradient(data, *bars)[1].status == qp.SOLVED
    spoilt = np.flatnonzero(solved)[[0, 7, 20, 30]]
    without = [
        np.where((solved & ~np.isin(np.arange(COUNT), spoilt))[:, None], bar, 0.0) for bar in bars
    ]
    clean = gradient(data, *without)[0]
    poisoned = [part.copy() for part in data]
    poisoned[2][spoilt[0], 1] = np.nan
    poisoned[3][spoilt[1], 2] = np.nan
    poisoned[4][spoilt[2], 3] = poisoned[3][spoilt[2], 3] - 1.0
    poisoned[2][spoilt[3]] = np.inf
    lost = [np.where(without[0].any(axis=1, keepdims=True), bar, np.nan) for bar in bars]
    found, solution = gradient(poisoned, *lost)
    assert (solution.status[spoilt] != qp.SOLVED).all() and (
        solution.status == qp.INFEASIBLE
    ).sum() > 100
    for part in found[2:]:
        assert not part[solution.status != qp.SOLVED].any()
    jax.tree.map(np.testing.assert_array_equal, found, clean)


def test_a_hessian_that_is_not_positive_definite_has_no_derivative():
    data = programs(0)
    found = gradient([-data[0], *data[1:]], np.ones_like(data[2]))[0]
    assert not any(part.any() for part in found[2:])


def test_without_active_rows_the_derivative_is_that_of_the_unconstrained_optimum():
    fam = family(0)
    rng = np.random.default_rng(3)
    data = free_programs(fam)
    x_bar = rng.normal(size=data[2].shape)
    y_bar = rng.normal(size=data[3].shape)
    (P_bar, A_bar, *found), solution = gradient(data, x_bar, y_bar)
    assert not solution.multipliers.any()
    d = np.linalg.solve(fam.P, x_bar.T).T
    np.testing.assert_allclose(found[0], -d, atol=tol.QP_ROUNDING)
    half = -d.T @ solution.x / 2
    np.testing.assert_allclose(P_bar, half + half.T, atol=tol.QP_ROUNDING)
    assert not A_bar.any() and not found[1].any() and not found[2].any()


def test_a_constrained_instance_leaves_the_derivatives_of_the_free_ones_as_they_are():
    fam = family(0)
    data = free_programs(fam)
    x_bar = np.random.default_rng(4).normal(size=data[2].shape)
    (_, _, *alone), solution = gradient(data, x_bar)
    data[4][5, fam.is_input] = solution.x[5, 0] - 0.01
    (_, _, *together), solution = gradient(data, x_bar)
    assert solution.multipliers[5].any() and together[2][5].any()
    for before, after in zip(alone, together, strict=True):
        np.testing.assert_array_equal(np.delete(before, 5, 0), np.delete(after, 5, 0))


def test_rows_that_depend_on_each_other_share_the_derivative_of_one():
    P, A, *_ = programs(1)
    rng = np.random.default_rng(5)
    rows = slice(0, 20)
    copies = slice(20, 40)
    others = slice(20, None)
    scale = rng.uniform(0.1, 10, 20)
    twice = A.copy()
    once = A.copy()
    twice[others] = 0.0
    once[others] = 0.0
    twice[copies] = A[rows] * scale[:, None]
    q = 3 * rng.normal(size=(COUNT, 10))
    bound = np.ones((COUNT, len(A)))
    bound[:, rows] = rng.uniform(0.1, 0.3, (COUNT, 20))
    wider = bound.copy()
    wider[:, copies] = bound[:, rows] * scale
    x_bar = rng.normal(size=q.shape)
    (_, _, *found), of_twice = gradient([P, twice, q, -wider, wider], x_bar)
    (_, _, *expected), of_once = gradient([P, once, q, -bound, bound], x_bar)
    assert (of_twice.status == qp.SOLVED).all() and (of_once.status == qp.SOLVED).all()
    assert of_once.multipliers.any(axis=1).mean() > 0.5
    np.testing.assert_allclose(found[0], expected[0], atol=SENSITIVITY)
    for mine, other in zip(found[1:], expected[1:], strict=True):
        np.testing.assert_allclose(
            mine[:, rows] + mine[:, copies] * scale, other[:, rows], atol=SENSITIVITY
        )


def test_rows_that_are_nearly_parallel_count_as_two():
    P, A, *_ = programs(1)
    rng = np.random.default_rng(8)
    pair = rng.normal(size=(2, 10))
    pair[1] = pair[0] + 1e-4 * pair[1]
    rows = A.copy()
    rows[:2] = pair
    x = rng.normal(size=(COUNT, 10))
    upper = np.full((COUNT, len(A)), 1e3)
    upper[:, :2] = x @ pair.T
    q = -x @ P - rng.uniform(1, 2, (COUNT, 2)) @ pair
    x_bar = rng.normal(size=q.shape)
    (_, _, q_bar, *_), solution = gradient([P, rows, q, np.full_like(upper, -1e3), upper], x_bar)
    assert (solution.status == qp.SOLVED).all() and (solution.multipliers[:, :2] > 0).all()
    system = np.block([[P, pair.T], [pair, np.zeros((2, 2))]])
    d = np.linalg.solve(system, np.pad(x_bar, ((0, 0), (0, 2))).T)[:10].T
    np.testing.assert_allclose(q_bar, -d, atol=SENSITIVITY * np.abs(d).max())


@pytest.mark.slow
def test_float32_follows_float64():
    data = programs(2)
    rng = np.random.default_rng(6)
    data = [np.float32(part).astype(float) for part in data]
    x_bar = rng.normal(size=data[2].shape)
    (_, _, *double), exact = gradient(data, x_bar)
    (_, _, *single), rounded = gradient(data, x_bar, dtype=np.float32)
    assert all(part.dtype == np.float32 and np.isfinite(part).all() for part in single)
    both = (exact.status == qp.SOLVED) & (rounded.status == qp.SOLVED)
    alike = both & (
        (np.abs(exact.multipliers) > tol.QP_ANSWER_FLOAT32) == (rounded.multipliers != 0)
    ).all(axis=1)
    assert alike.sum() >= tol.QP_SHARE_FLOAT32 * both.sum()
    for mine, other in zip(single, double, strict=True):
        error = np.abs(mine - other).max(axis=1) / np.maximum(np.abs(other).max(axis=1), 1.0)
        assert error[alike].max() <= SENSITIVITY_FLOAT32


@pytest.mark.slow
def test_a_scan_of_checkpoints_differentiates_a_closed_loop():
    fam = family(0)
    rng = np.random.default_rng(7)
    feedback = jnp.asarray(np.eye(3) + 0.1 * rng.normal(size=(3, 3)))
    effect = jnp.asarray(0.1 * rng.normal(size=(10, 3)))
    start = jnp.asarray(0.3 * rng.normal(size=(40, 3)))
    stack = (np.stack([fam.P, 1.5 * fam.P, 2 * fam.P]), np.stack([fam.A, fam.A, fam.A[::-1]]))

    def cost(data):
        P, A, weights, lower, upper = data

        def step(errors, factors):
            solution = qp.solve(factors, errors @ weights, lower, upper)
            return errors @ feedback + solution.x @ effect, (solution.multipliers, solution.status)

        final, trace = jax.lax.scan(jax.checkpoint(step), start, jax.vmap(qp.factorise)(P, A))
        return jnp.sum(final**2), trace

    run = jax.jit(jax.value_and_grad(cost, has_aux=True))
    bound = rng.uniform(0.05, 0.3, len(fam.A))
    data = [jnp.asarray(part) for part in (*stack, fam.gradient.T, -bound, bound)]
    (_, trace), found = run(data)
    assert (trace[1] == qp.SOLVED).all() and (trace[0] != 0).any(axis=2).mean() > 0.3
    for part in range(5):
        direction = rng.normal(size=data[part].shape)
        total = 0.0
        direction = direction + direction.swapaxes(1, 2) if part == 0 else direction
        for steps, weight in DIFFERENCE.items():
            (value, ends), _ = run(moved(data, part, steps * STEP * direction))
            assert (np.sign(ends[0]) == np.sign(trace[0])).all()
            total += weight / STEP * float(value)
        products = np.asarray(found[part]) * direction
        assert abs(products.sum() - total) <= SENSITIVITY * np.abs(products).sum()


@pytest.mark.parametrize("m, kind", [(16383, np.int16), (16384, np.int32)])
def test_row_numbers_fit_their_integers(m, kind):
    assert sensitivity.find_row_type(m) is kind
    assert 2 * m <= np.iinfo(kind).max
