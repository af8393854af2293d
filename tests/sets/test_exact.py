"""Laws of the exact check: bounds are maxima, and every broken condition is refused."""

import math
from fractions import Fraction
from itertools import product

import numpy as np
import pytest
from exact_problem import (
    BOX,
    DT,
    FAST,
    FEEDBACKS,
    GAINS,
    LOOPS,
    OMEGA,
    POINTS,
    SLOW,
    WIDTH,
    E,
    Q,
    R,
    U,
    W,
    floats,
)
from scipy.linalg import solve_discrete_lyapunov
from scipy.optimize import linprog
from tolerances import EXACT_AGAINST_FLOAT

from sets import certificate
from sets.exact import (
    ExactReport,
    Halfspaces,
    decrease_pivot,
    exact_containment_margin,
    exact_invariance_margin,
    exact_row,
    exact_rows,
    mapped_rows,
    smallest_pivot,
)
from sets.polytope import Polytope
from sets.robot.exact_tube import exact_vertex_feedbacks, exact_vertex_loops, schedule_box

EXACT_PULLED_FACET = 1e-12
"""The same margins in float64, where a facet moves by a millionth."""

# Bounds over polytopes


@pytest.mark.parametrize("seed", range(3))
def test_bounds_equal_those_of_a_linear_program(seed):
    rng = np.random.default_rng(seed)
    normals = rng.normal(size=(20, 3)) * rng.uniform(0.1, 30, size=(20, 1))
    offsets = rng.uniform(0.2, 2, size=20)
    normals = np.vstack([normals, E[0]])
    offsets = np.concatenate([offsets, np.full(6, 3.0)])
    polytope = Halfspaces(normals, offsets)
    for row in rng.normal(size=(10, 3)):
        answer = linprog(-row, A_ub=normals, b_ub=offsets, bounds=(None, None))
        assert float(polytope.bound(exact_row(row))) == pytest.approx(
            -answer.fun, rel=EXACT_AGAINST_FLOAT
        )


def test_bounds_of_the_invariant_set_equal_those_of_a_linear_program():
    polytope = Halfspaces(OMEGA.normals, OMEGA.offsets)
    for row in (OMEGA.normals @ floats(LOOPS)).reshape(-1, 3):
        answer = linprog(-row, A_ub=OMEGA.normals, b_ub=OMEGA.offsets, bounds=(None, None))
        assert float(polytope.bound(exact_row(row))) == pytest.approx(
            -answer.fun, rel=EXACT_AGAINST_FLOAT
        )


def test_bounds_are_exact_where_many_facets_meet():
    octahedron = Halfspaces(list(product((-1.0, 1.0), repeat=3)) * 2, [1.0] * 16)
    cube = Halfspaces(E[0], np.ones(6))
    for row in exact_rows([(0.1, -0.3, 0.2), (0.0, 0.0, -1e-30), (1.0, 1.0, 1.0), (0.0, 0.0, 0.0)]):
        assert octahedron.bound(row) == max(map(abs, row))
        assert cube.bound(row) == sum(map(abs, row))


def test_an_empty_set_is_bounded_by_its_rows():
    crossed = Halfspaces(E[0], (1, 1, 1, -2, 1, 1))
    assert crossed.bound(exact_row((1, 1, 0))) == 2
    assert crossed.bound(exact_row((-3, 0, 0))) == -6


def test_rows_on_inputs_and_errors_become_rows_on_the_error():
    rng = np.random.default_rng(6)
    inputs = rng.normal(size=(4, 2))
    errors = rng.normal(size=(4, 3))
    expected = np.vstack([inputs @ gain + errors for gain in floats(FEEDBACKS)])
    np.testing.assert_allclose(
        floats(mapped_rows(inputs, errors, FEEDBACKS)), expected, rtol=EXACT_AGAINST_FLOAT
    )


def test_open_and_malformed_polytopes_are_refused():
    with pytest.raises(ValueError, match="bound the direction"):
        Halfspaces(E[0][:5], np.ones(5)).bound(exact_row((0, 0, -1)))
    with pytest.raises(ValueError, match="offsets"):
        Halfspaces(E[0], np.ones(5))
    with pytest.raises(ValueError, match="normals"):
        Halfspaces(np.eye(2), np.ones(2))
    with pytest.raises(ValueError, match="offsets"):
        exact_containment_margin(E[0], [1, 1, 1, 1, 1, math.inf], E[0], np.ones(6))


# Invariance and containment


def test_the_invariance_margin_agrees_with_floats_and_is_not_negative():
    scale = np.linalg.norm(OMEGA.normals, axis=1)
    margin = exact_invariance_margin(
        OMEGA.normals / scale[:, None], OMEGA.offsets / scale, LOOPS, W
    )
    expected = certificate.invariance_margin(floats(LOOPS), POINTS, OMEGA)
    assert float(margin) == pytest.approx(expected, abs=EXACT_AGAINST_FLOAT)
    assert margin > 0
    assert exact_invariance_margin(OMEGA.normals, OMEGA.offsets, LOOPS, W) > 0


def test_a_facet_pulled_in_by_a_millionth_is_refused_where_others_lean_on_it():
    scale = np.linalg.norm(OMEGA.normals, axis=1)
    margins = []
    for facet in range(len(OMEGA.offsets)):
        pulled = OMEGA.offsets / scale
        pulled[facet] *= 1 - 1e-6
        polytope = Polytope(OMEGA.normals / scale[:, None], pulled)
        margins.append(float(exact_invariance_margin(polytope.normals, pulled, LOOPS, W)))
        expected = certificate.invariance_margin(floats(LOOPS), POINTS, polytope)
        assert margins[-1] == pytest.approx(expected, abs=EXACT_PULLED_FACET)
    assert min(margins) < -10 * EXACT_PULLED_FACET
    assert max(margins) > 0  # a facet that bounds no image may move alone


def test_a_wider_disturbance_another_gain_and_a_wider_schedule_are_refused():
    wider = [tuple(Fraction(100_001, 100_000) * a for a in point) for point in W]
    assert exact_invariance_margin(OMEGA.normals, OMEGA.offsets, LOOPS, wider) < 0
    for gains in ((2.999, 6.5, 6.5), (3.0, 6.499, 6.5), (3.0, 6.5, 6.501)):
        assert (
            exact_invariance_margin(
                OMEGA.normals, OMEGA.offsets, exact_vertex_loops(gains, BOX, DT), W
            )
            < 0
        )
    wide = schedule_box((SLOW, SLOW), (FAST + 1e-3, FAST + 1e-3), DT, WIDTH)
    assert (
        exact_invariance_margin(
            OMEGA.normals, OMEGA.offsets, exact_vertex_loops(GAINS, wide, DT), W
        )
        < 0
    )


def test_the_invariant_set_is_admissible_and_narrower_limits_are_refused():
    errors = exact_containment_margin(OMEGA.normals, OMEGA.offsets, *E)
    rows = mapped_rows(U[0], np.zeros((4, 3)), FEEDBACKS)
    limits = np.tile(U[1], 2)
    inputs = exact_containment_margin(OMEGA.normals, OMEGA.offsets, rows, limits)
    room = limits - OMEGA.support(np.vstack([U[0] @ gain for gain in floats(FEEDBACKS)]))
    assert errors >= 0
    assert inputs >= 0
    assert float(inputs) == pytest.approx(room.min(), abs=EXACT_AGAINST_FLOAT)
    assert (
        exact_containment_margin(OMEGA.normals, OMEGA.offsets, E[0], E[1] - float(errors) - 1e-12)
        < 0
    )
    assert (
        exact_containment_margin(OMEGA.normals, OMEGA.offsets, rows, limits - float(inputs) - 1e-12)
        < 0
    )


# Decrease


def congruent(pivots) -> tuple:
    lower = np.array([[1, 0, 0], [Fraction(2, 3), 1, 0], [-5, Fraction(1, 7), 1]], dtype=object)
    matrix = lower @ np.diag([Fraction(p) for p in pivots]) @ lower.T
    return tuple(tuple(Fraction(a) for a in row) for row in matrix)


def test_the_smallest_pivot_is_exact_and_tells_a_semidefinite_matrix():
    assert smallest_pivot(congruent((3, Fraction(1, 9), 2))) == Fraction(1, 9)
    assert smallest_pivot(congruent((3, 0, 2))) == 0
    assert smallest_pivot(congruent((0, 1, 1))) == 0
    assert smallest_pivot(congruent((3, 2, Fraction(-1, 10**40)))) == Fraction(-1, 10**40)
    assert smallest_pivot(exact_rows([(0, 1, 0), (1, 5, 0), (0, 0, 1)])) < 0
    rng = np.random.default_rng(3)
    for matrix in rng.normal(size=(50, 3, 3)):
        symmetric = matrix + matrix.T + np.eye(3)
        assert (smallest_pivot(exact_rows(symmetric)) >= 0) == (
            np.linalg.eigvalsh(symmetric)[0] >= 0
        )
    with pytest.raises(ValueError, match="symmetric"):
        smallest_pivot(exact_rows([(1, 0, 0), (1e-16, 1, 0), (0, 0, 1)]))


def test_the_decrease_of_the_cost_is_proved_and_its_loss_is_seen():
    loop = floats(LOOPS).mean(axis=0)
    gain = floats(FEEDBACKS).mean(axis=0)
    cost = solve_discrete_lyapunov(loop.T, 1.6 * (Q + gain.T @ R @ gain))
    cost = (cost + cost.T) / 2
    assert decrease_pivot(cost, LOOPS, FEEDBACKS, Q, R) > 0
    pairs = list(product(floats(LOOPS), floats(FEEDBACKS)))
    assert certificate.decrease_margin(*zip(*pairs, strict=True), cost, Q, R) > 0
    for right, left in np.random.default_rng(4).uniform(SLOW, FAST, size=(20, 2)):
        here = schedule_box((right, left), (right, left), DT, WIDTH)
        inside = (exact_vertex_loops(GAINS, here, DT)[:1], exact_vertex_feedbacks(GAINS, here)[:1])
        assert certificate.decrease_margin(*map(floats, inside), cost, Q, R) > 0
    faster = [tuple(tuple(Fraction(6, 5) * a for a in row) for row in LOOPS[3])]
    assert decrease_pivot(cost, LOOPS[:3] + faster, FEEDBACKS, Q, R) < 0
    assert decrease_pivot(0.7 * cost, LOOPS, FEEDBACKS, Q, R) < 0
    assert decrease_pivot(cost, LOOPS, FEEDBACKS, 1.4 * Q, R) < 0
    assert decrease_pivot(cost, LOOPS, FEEDBACKS, Q, 1.4 * R) < 0
    assert decrease_pivot(cost, LOOPS, FEEDBACKS, Q, -1e-9 * R) < 0


def test_the_cost_of_an_indefinite_form_is_refused_although_it_decreases():
    grows = exact_rows(2 * np.eye(3))
    still = [((Fraction(0),) * 3,) * 2]
    assert decrease_pivot(-np.eye(3), [grows], still, np.eye(3), R) < 0


# Report


def test_a_report_holds_only_where_every_margin_is_proved():
    assert not ExactReport().holds
    assert ExactReport({"zero": Fraction(0)}).holds
    report = ExactReport({"zero": Fraction(0), "missed": Fraction(-1, 10**60)})
    assert not report.holds
    assert report.failing == ["missed"]
