# ruff: noqa: E741 -- l and u are the letters of the problem
"""Laws of the dual active-set method: what each exchange keeps, that it ends at the exact answer or
at a proof that there is none, and that no instance knows the others."""

import daqp
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import tolerances as tol
from tube_programs import BATCH, family, hard

from jaxtube import qp
from jaxtube.qp import blocks, dual_active_set, farkas, fixed_point, rounds, stages
from jaxtube.qp.exchange import (
    MET,
    NEXT,
    STUCK,
    Missed,
    Way,
    exchange,
    find_step,
    make_program,
)
from jaxtube.qp.source import Solution, Source
from jaxtube.qp.tags import largest, read_tag, tag, untag

EXACT = 1e-9
"""Answers of active sets against an exact solver's."""
INVERSE = 1e-12
"""Of the unit matrix, by the condition of the rows."""
WELL = 1e5
WELL_SHARE = 0.9
"""Of the lanes have rows of such a condition."""
KEPT = 1e-8
"""What else exchanges keep there, after a score of them."""
ROUNDS_SHARE = 0.99
"""Of the programs, decided by the rounds of iterations alone."""
COUNT = BATCH  # one shape for all tests of the solver, so that one compilation serves them

solve = jax.jit(qp.solve)
factorise = jax.jit(qp.factorise)
take_exchange = jax.jit(exchange)


@pytest.fixture(scope="module", params=[0, 3])
def programs(request):
    fam = family(request.param)
    return fam, [jnp.asarray(part) for part in hard(fam, request.param, COUNT)]


def exact(P, A, q, l, u):
    """x and whether it exists."""
    sense = np.zeros(len(A), np.int32)
    P, A, q = map(np.array, (P, A, q))
    low = np.maximum(l, -1e30)
    high = np.minimum(u, 1e30)
    found = [
        daqp.solve(P, q[i], A, high[i], low[i], sense, primal_tol=tol.QP_ORACLE)
        for i in range(len(q))
    ]
    return np.array([f[0] for f in found]), np.array([f[2] == 1 for f in found])


def prepare(fam, given):
    """The factors, and where the instances' numbers come from."""
    factors = factorise(jnp.asarray(fam.P), jnp.asarray(fam.A))
    return factors, make_source(factors, given)


def make_source(factors, given):
    return Source(tuple(given), lambda data: fixed_point.unit_rows(factors, *data))


@jax.jit
def begin(factors, given):
    """All instances, each in a lane of its own."""
    program = make_program(factors.whitened)
    count = len(given[0])
    places = jnp.arange(count, dtype=jnp.int32)
    start = stages.load_lanes(factors, make_source(factors, given), places)
    empty = dual_active_set._empty_lanes(program, 10, count)
    return program, dual_active_set._begin(empty, start, jnp.ones(count, bool))


@jax.jit
def search(factors, given):
    """What the method finds of all instances, its multipliers at the upper and at the lower bounds,
    and where these are proofs that there is no answer."""
    source = make_source(factors, given)
    count = len(given[0])
    found = dual_active_set.find_active_sets(
        make_program(factors.whitened),
        lambda places: stages.load_lanes(factors, source, places),
        jnp.ones(count, bool),
        32,
    )
    upper, lower = stages.push_of(found, len(factors.rows))
    block = source.form(source.data)
    proved = farkas.excludes(factors.rows, block.l, block.u, upper, lower, qp.TOLERANCE[8])
    return found, upper, lower, proved


def test_exchanges_keep_the_inverse_the_optimum_and_the_signs(programs):
    factors, source = prepare(*programs)
    program, lanes = begin(factors, source.data)
    z_0 = np.asarray(lanes.z)
    cost = np.full(COUNT, -np.inf)
    for _ in range(20):
        lanes = take_exchange(program, lanes)
        N = np.asarray(lanes.normals)
        y = np.asarray(lanes.multipliers)
        used = np.asarray(lanes.rows) >= 0
        runs = np.asarray(lanes.adding) > STUCK
        gram = np.einsum("inb,jnb->ijb", N, N)
        C = np.asarray(lanes.inverse)
        missed = np.einsum("ijb,jkb->ikb", C, gram)
        missed -= np.where(used[:, None] & used[None], np.eye(10)[..., None], 0.0)
        condition = np.maximum(1.0, np.abs(C).max(axis=(0, 1)) * np.abs(gram).max(axis=(0, 1)))
        assert (np.abs(missed).max(axis=(0, 1)) <= INVERSE * condition)[runs].all()
        assert (condition[runs] <= WELL).mean() >= WELL_SHARE
        runs &= condition <= WELL
        signed = np.asarray(program.signed)[np.maximum(lanes.adding, 0)].T
        added = np.where(np.asarray(lanes.adding) >= 0, lanes.multiplier, 0.0) * signed
        z = z_0 - np.einsum("inb,ib->nb", N, np.where(used, y, 0.0)) - added
        np.testing.assert_allclose(np.asarray(lanes.z)[:, runs], z[:, runs], atol=KEPT)
        assert (y[:, runs] >= 0).all() and not y[~used & runs].any()
        # The dual cost, at z the least of the Lagrange function.
        bounds = np.take_along_axis(np.asarray(lanes.bounds), np.maximum(lanes.rows, 0), axis=0)
        last = np.take_along_axis(
            np.asarray(lanes.bounds), np.maximum(lanes.adding, 0)[None], axis=0
        )[0]
        push = np.where(used, y * bounds, 0.0).sum(axis=0)
        push += np.where(np.asarray(lanes.adding) >= 0, lanes.multiplier * last, 0.0)
        now = 0.5 * (z_0**2).sum(axis=0) - 0.5 * (z**2).sum(axis=0) - push
        assert (now[runs] >= cost[runs] - KEPT).all()
        cost = np.where(runs, now, cost)
    assert (np.asarray(lanes.adding) != NEXT).mean() > 0.99


def test_active_sets_are_those_of_the_exact_answer_and_rays_are_proofs(programs):
    fam, given = programs
    factors, source = prepare(fam, given)
    found, upper, lower, proved = jax.tree.map(np.asarray, search(factors, source.data))
    x, feasible = exact(fam.P, fam.A, *map(np.asarray, given))
    np.testing.assert_array_equal(found.is_ray, ~feasible)
    rows = np.asarray(factors.rows)
    answer = np.linalg.solve(fam.P, -(np.asarray(given[0]).T + rows.T @ (upper - lower))).T
    np.testing.assert_allclose(answer[feasible], x[feasible], atol=EXACT)
    assert (found.multipliers >= 0).all()
    np.testing.assert_array_equal(proved, ~feasible)


def test_no_answer_knows_the_other_instances_to_the_last_bit(programs):
    fam, given = programs
    factors, _ = prepare(fam, given)
    together = solve(factors, *given)
    generator = np.random.default_rng(0)
    order = generator.permutation(COUNT)
    mixed = solve(factors, *(part[order] for part in given))
    jax.tree.map(
        lambda one, other: np.testing.assert_array_equal(np.asarray(one)[order], other),
        together,
        mixed,
    )
    # Among instances that need no solver, and others than before.
    chosen = order[:16]
    mostly_free = [jnp.asarray(np.resize(part[:1], part.shape)) for part in given]
    mostly_free[0] = jnp.zeros_like(given[0])
    mostly_free[1] = jnp.full_like(given[1], -1.0)
    mostly_free[2] = jnp.full_like(given[2], 1.0)
    few = solve(
        factors,
        *(free.at[:16].set(part[chosen]) for free, part in zip(mostly_free, given, strict=True)),
    )
    jax.tree.map(
        lambda one, other: np.testing.assert_array_equal(
            np.asarray(one)[chosen], np.asarray(other)[:16]
        ),
        together,
        few,
    )


@pytest.mark.parametrize("kind", ["crossing", "equal", "zero row", "no number"])
def test_what_has_no_usual_answer_ends_without_spoiling_a_lane(kind):
    fam = family(1)
    A = fam.A.copy()
    given = [part.copy() for part in hard(fam, 1, COUNT)]
    if kind == "crossing":
        given[1][:, 12] = given[2][:, 12] + 0.1
    if kind == "equal":
        given[1][:, 10:20] = given[2][:, 10:20]
    if kind == "zero row":
        A[30] = 0.0
        given[1][:, 30] = 0.1
    if kind == "no number":
        given[2][:, 4] = np.nan
    factors, source = prepare(fam._replace(A=A), [jnp.asarray(part) for part in given])
    program, lanes = begin(factors, source.data)
    for _ in range(40):
        lanes = take_exchange(program, lanes)
    for part in (lanes.z, lanes.normals, lanes.inverse, lanes.multipliers):
        assert np.isfinite(part).all()
    ended = np.asarray(lanes.adding)
    if kind in ("crossing", "zero row"):
        assert (ended <= STUCK).all()
    if kind == "no number":
        assert (ended == MET).all()


def test_rounds_of_iterations_decide_alone_what_the_method_may_leave():
    fam = family(2)
    given = [jnp.asarray(part) for part in hard(fam, 2, COUNT)]
    factors, source = prepare(fam, given)
    nothing = Solution(
        jnp.zeros((COUNT, 10)),
        jnp.zeros((COUNT, len(fam.A))),
        jnp.full(COUNT, qp.UNSOLVED, jnp.int32),
        jnp.ones(COUNT),
    )
    found = jax.jit(lambda start: rounds.play_rounds(factors, factors.iterated, source, start))(
        nothing
    )
    x, feasible = exact(fam.P, fam.A, *map(np.asarray, given))
    solved = np.asarray(found.status == qp.SOLVED)
    refuted = np.asarray(found.status == qp.INFEASIBLE)
    assert not (solved & ~feasible).any() and not (refuted & feasible).any()
    assert (solved | refuted).mean() >= ROUNDS_SHARE
    np.testing.assert_allclose(np.asarray(found.x)[solved], x[solved], atol=tol.QP_ANSWER)


@pytest.mark.parametrize("share", [0.0, 0.01, 0.4, 1.0])
def test_blocks_work_on_the_pending_instances_alone(share):
    generator = np.random.default_rng(5)
    pending = generator.random(100) < share
    data = jnp.asarray(generator.normal(size=(100, 3)))
    answers = jnp.asarray(generator.normal(size=(100, 3)))
    found = jax.jit(
        lambda: blocks.update_in_blocks(
            lambda data, before: data + before, 16, jnp.asarray(pending), data, answers
        )
    )()
    expected = np.where(pending[:, None], data + answers, answers)
    np.testing.assert_array_equal(found, expected)
    line = blocks.line_up(jnp.asarray(pending), 16)
    assert int(line.count) == pending.sum()
    np.testing.assert_array_equal(line.places[: int(line.count)], np.flatnonzero(pending))
    assert (np.asarray(line.places[int(line.count) :]) == 100).all()


@pytest.mark.parametrize("dtype", [np.float64, np.float32])
def test_tagged_numbers_keep_their_order_and_their_places(dtype):
    generator = np.random.default_rng(6)
    values = generator.normal(size=(104, 50)).astype(dtype) * np.geomspace(1e-8, 1e8, 50)
    values = jnp.asarray(values.astype(dtype))
    tagged = tag(values, jnp.arange(104)[:, None], 104)
    greatest = jnp.max(tagged, axis=0)
    place = np.asarray(read_tag(greatest, 104))
    share = 2.0**8 * np.finfo(dtype).eps
    np.testing.assert_allclose(untag(greatest, dtype), np.max(values, axis=0), rtol=share)
    taken = np.take_along_axis(np.asarray(values), place[None], axis=0)[0]
    np.testing.assert_allclose(taken, np.max(values, axis=0), rtol=share)


def test_the_largest_number_is_not_a_number_where_one_is_none():
    values = jnp.asarray([[1.0, np.inf, -np.nan, 0.0], [-3.0, 2.0, np.inf, -0.0]])
    np.testing.assert_array_equal(largest(values), [3.0, np.inf, np.nan, 0.0])


def test_a_step_of_no_length_lets_the_row_leave_that_allows_no_more(programs):
    fam, given = programs
    factors, source = prepare(fam, given)
    program, lanes = begin(factors, source.data)
    slots = len(lanes.rows)
    multipliers = jnp.ones((slots, COUNT)).at[2].set(0.0)
    lanes = lanes._replace(multipliers=multipliers, rows=jnp.zeros_like(lanes.rows))
    n = len(lanes.z)
    missed = Missed(jnp.ones(COUNT, jnp.int32), jnp.zeros((n, COUNT)), jnp.ones(COUNT))
    way = Way(jnp.full((slots, COUNT), 0.5), jnp.zeros((n, COUNT)), jnp.ones(COUNT))
    step = jax.jit(find_step)(program, lanes, missed, way)
    np.testing.assert_array_less(step.length, 1e-300)
    np.testing.assert_array_equal(step.slot, 2)
    np.testing.assert_array_equal(step.joins, 0.0)
