"""Laws of the exact check: enclosures hold many digits, bounds are maxima, and every broken condition is refused."""

import math
from dataclasses import dataclass, replace
from fractions import Fraction
from functools import cache
from itertools import product

import mpmath
import numpy as np
import pytest
from scipy.linalg import solve_discrete_lyapunov
from scipy.optimize import linprog
from tolerances import (
    EXACT_AGAINST_FLOAT,
    EXACT_ENCLOSURE,
    EXACT_JACOBIAN,
    EXACT_PULLED_FACET,
    EXACT_ROUNDED_OFFSETS,
    EXACT_WHEEL_TRAVEL,
)

from sets import certificate
from sets.exact import (
    ExactReport,
    Halfspaces,
    containment_margin,
    decrease_pivot,
    exact_row,
    exact_rows,
    invariance_margin,
    mapped_rows,
    schedule_box,
    sequence_margins,
    smallest_pivot,
    tangent_ratio,
    vertex_feedbacks,
    vertex_loops,
    wheel_loops,
)
from sets.invariant import maximal_rpi
from sets.polytope import Polytope
from sets.tubes import sequence_support

DT, WIDTH, GAINS, HORIZON = 0.1, 0.5, (3.0, 6.5, 6.5), 5
SLOW, FAST = 1.224, 1.496
BOX = schedule_box((SLOW, SLOW), (FAST, FAST), DT, WIDTH)
LOOPS, FEEDBACKS = vertex_loops(GAINS, BOX, DT), vertex_feedbacks(GAINS, BOX)
KICK = (Fraction(0), Fraction(0.0208) * Fraction(0.068), Fraction(0.0208))
NOISE = exact_row((8.90e-3, 19.26e-3, math.radians(0.04)))
W = [tuple(sign * kick + side * width for kick, side, width in zip(KICK, sides, NOISE, strict=True))
     for sign in (-1, 1) for sides in product((-1, 1), repeat=3)]  # fmt: skip
POINTS = np.array(W, dtype=float)
E = np.vstack([np.eye(3), -np.eye(3)]), np.tile([0.12, 0.28, math.radians(18)], 2)
U = np.vstack([np.eye(2), -np.eye(2)]), np.array([0.40, 0.9, 0.27, 0.9])
STEP = 1e-6  # every further stage of the plan is backed off by as much more
Q, R = np.diag([1.0, 3.0, 1.0]), 0.3 * np.eye(2)


def floats(matrices) -> np.ndarray:
    return np.array(matrices, dtype=float)


def maximal(loops: np.ndarray, room: float) -> Polytope:
    """The maximal set inside constraints backed off by `room`, for W and a ball of twenty times that."""
    rows = np.vstack([E[0], *(U[0] @ gain for gain in floats(FEEDBACKS))])
    offsets = np.concatenate([E[1], U[1], U[1]]) - room * (1 + np.linalg.norm(rows, axis=1))

    def disturbance(normals):
        return np.max(normals @ POINTS.T, axis=1) + 20 * room * np.linalg.norm(normals, axis=1)

    found = maximal_rpi(loops, Polytope(rows, offsets), disturbance).polytope
    assert found is not None
    return found


@cache
def invariant(room: float) -> Polytope:
    """The same for the four loops of turn and speed apart."""
    return maximal(floats(LOOPS), room)


OMEGA = invariant(1e-10)


# Enclosures


@pytest.mark.parametrize("x", [0.0, 1e-9, 0.0272, -0.3, 0.77, 1.0, -1.0])
def test_the_tangent_ratio_lies_in_its_enclosure_and_fills_it(x):
    low, high = tangent_ratio(Fraction(x))
    with mpmath.workdps(60):
        value = mpmath.tan(x) / mpmath.mpf(x) if x else mpmath.mpf(1)
        assert mpmath.mpf(low.numerator) / low.denominator <= value <= mpmath.mpf(high.numerator) / high.denominator
    assert 0 <= high - low <= EXACT_ENCLOSURE


def turn_and_advance(right: float, left: float):
    V, x = (mpmath.mpf(right) + left) / 2, mpmath.mpf(DT) * (mpmath.mpf(right) - left) / (2 * mpmath.mpf(WIDTH))
    return mpmath.tan(x), DT * V * (mpmath.tan(x) / x if x else 1)


@pytest.mark.parametrize(
    ("lower", "upper"), [((SLOW, SLOW), (FAST, FAST)), ((0.2, 0.2), (1.5, 1.5)), ((-1.0, 0.3), (0.5, 0.3))]
)
def test_the_schedule_box_is_the_range_over_all_wheel_speeds(lower, upper):
    box = schedule_box(lower, upper, DT, WIDTH)
    schedules = np.vstack([
        np.random.default_rng(0).uniform(lower, upper, size=(300, 2)),
        list(product(*zip(lower, upper, strict=True))),
    ])  # fmt: skip
    with mpmath.workdps(60):
        found = np.array([turn_and_advance(*schedule) for schedule in schedules.tolist()])
        for values, bounds in zip(found.T, (box.turn, box.advance), strict=True):
            low, high = (mpmath.mpf(bound.numerator) / bound.denominator for bound in bounds)
            assert low <= min(values)
            assert max(values) <= high
            assert max(min(values) - low, high - max(values)) <= EXACT_ENCLOSURE
    rates = (schedules[:, 0] - schedules[:, 1]) / WIDTH
    np.testing.assert_allclose(floats(box.yaw_rate), [rates.min(), rates.max()], rtol=EXACT_AGAINST_FLOAT)


def test_a_reversed_box_a_long_period_and_what_is_not_a_number_are_refused():
    with pytest.raises(ValueError, match="lower"):
        schedule_box((1.0, 1.2), (1.1, 1.1), DT, WIDTH)
    with pytest.raises(ValueError, match="dt"):
        schedule_box((0.2, 0.2), (1.5, 1.5), 0.4, WIDTH)
    with pytest.raises(ValueError, match="x: half a turn"):
        tangent_ratio(Fraction(101, 100))
    with pytest.raises(ValueError, match="upper"):
        schedule_box((0.2, 0.2), (1.5, math.nan), DT, WIDTH)


def test_loops_are_the_model_under_its_feedback_whatever_the_yaw_rate():
    T, k = Fraction(DT), exact_row(GAINS)
    for (h, c), loop in zip(product(BOX.turn, BOX.advance), LOOPS, strict=True):
        for rate in (*BOX.yaw_rate, Fraction(7, 3)):
            A = np.array([[1, T * rate, 0], [-2 * h, 1 - h * T * rate, c], [0, 0, 1]], dtype=object)
            B = np.array([[T, 0], [-h * T, c * T / 2], [0, T]], dtype=object)
            gain = np.array([[-k[0], -rate, 0], [0, -k[1], -k[2]]], dtype=object)
            assert np.all(A + B @ gain == np.array(loop, dtype=object))
    assert {feedback[0][1] for feedback in FEEDBACKS} == {-rate for rate in BOX.yaw_rate}


def travels(loop) -> tuple[Fraction, Fraction]:
    """Read p, q = c +- b h off a loop."""
    h = -loop[1][0] / (2 - Fraction(DT) * Fraction(GAINS[0]))
    c = loop[1][2] / (1 - Fraction(DT) * Fraction(GAINS[2]) / 2)
    return c + Fraction(WIDTH) * h, c - Fraction(WIDTH) * h


@pytest.mark.parametrize(
    ("lower", "upper"), [((SLOW, SLOW), (FAST, FAST)), ((-0.5, 0.3), (0.5, 0.3)), ((0.2, 1.0), (0.4, 1.5))]
)
def test_loops_of_the_wheels_cover_every_schedule_of_the_box_closely(lower, upper):
    vertices = [travels(loop) for loop in wheel_loops(GAINS, lower, upper, DT, WIDTH)]
    corners = list(product(*zip(lower, upper, strict=True)))
    schedules = np.vstack([np.random.default_rng(5).uniform(lower, upper, size=(100, 2)), corners])
    found = []
    for schedule in schedules:
        found += [travels(loop) for loop in vertex_loops(GAINS, schedule_box(schedule, schedule, DT, WIDTH), DT)]
    for inside, bounds in zip(zip(*found, strict=True), zip(*vertices, strict=True), strict=True):
        assert min(bounds) <= min(inside) + Fraction(EXACT_ENCLOSURE)
        assert max(inside) <= max(bounds) + Fraction(EXACT_ENCLOSURE)
        assert min(inside) - min(bounds) <= EXACT_WHEEL_TRAVEL
        assert max(bounds) - max(inside) <= EXACT_WHEEL_TRAVEL
    assert len(set(vertices)) == 4


def test_loops_of_the_wheels_leave_a_larger_invariant_set_than_turn_and_speed_apart():
    loops = wheel_loops(GAINS, (SLOW, SLOW), (FAST, FAST), DT, WIDTH)
    assert invariance_margin(OMEGA.normals, OMEGA.offsets, loops, W) > 0
    assert maximal(floats(loops), 1e-10).volume() > OMEGA.volume()


def sampled_step(error: np.ndarray, right: float, left: float) -> np.ndarray:
    """Move robot and reference along their arcs for a period; the speed makes the first row of the model exact."""
    V, rate = (right + left) / 2, (right - left) / WIDTH
    speed_deficit = -GAINS[0] * error[0] - rate * error[1]
    a = DT * (rate + GAINS[1] * error[1] + GAINS[2] * error[2])
    chord = (
        np.exp(1j * error[2]) * V * (np.exp(1j * DT * rate) - 1) / (1j * rate)
        if rate
        else DT * V * np.exp(1j * error[2])
    )
    planar = complex(error[0], error[1]) + chord  # the reference after the period, in the frame of the robot before
    wanted = error[0] + DT * rate * error[1] + DT * speed_deficit
    advanced = (np.exp(-1j * a) * planar).real - wanted  # T v sin(a)/a, what the robot covers in its new frame
    moved = advanced / (np.sin(a) / a) * (np.exp(1j * a) - 1) / (1j * a) if a else advanced
    after = np.exp(-1j * a) * (planar - moved)
    return np.array([after.real, after.imag, error[2] + DT * rate - a])


@pytest.mark.parametrize("wheels", [(FAST, SLOW), (SLOW, FAST), (1.3, 1.29)])
def test_the_loop_is_the_jacobian_of_the_sampled_robot(wheels):
    here = schedule_box(wheels, wheels, DT, WIDTH)
    steps = 1e-5 * np.eye(3)
    columns = [(sampled_step(step, *wheels) - sampled_step(-step, *wheels)) / 2e-5 for step in steps]
    np.testing.assert_allclose(np.transpose(columns), floats(vertex_loops(GAINS, here, DT))[0], atol=EXACT_JACOBIAN)


# Bounds over polytopes


@pytest.mark.parametrize("seed", range(3))
def test_bounds_equal_those_of_a_linear_program(seed):
    rng = np.random.default_rng(seed)
    normals, offsets = rng.normal(size=(20, 3)) * rng.uniform(0.1, 30, size=(20, 1)), rng.uniform(0.2, 2, size=20)
    normals, offsets = np.vstack([normals, E[0]]), np.concatenate([offsets, np.full(6, 3.0)])
    polytope = Halfspaces(normals, offsets)
    for row in rng.normal(size=(10, 3)):
        answer = linprog(-row, A_ub=normals, b_ub=offsets, bounds=(None, None))
        assert float(polytope.bound(exact_row(row))) == pytest.approx(-answer.fun, rel=EXACT_AGAINST_FLOAT)


def test_bounds_of_the_invariant_set_equal_those_of_a_linear_program():
    polytope = Halfspaces(OMEGA.normals, OMEGA.offsets)
    for row in (OMEGA.normals @ floats(LOOPS)).reshape(-1, 3):
        answer = linprog(-row, A_ub=OMEGA.normals, b_ub=OMEGA.offsets, bounds=(None, None))
        assert float(polytope.bound(exact_row(row))) == pytest.approx(-answer.fun, rel=EXACT_AGAINST_FLOAT)


def test_bounds_are_exact_where_many_facets_meet():
    octahedron = Halfspaces(list(product((-1.0, 1.0), repeat=3)) * 2, [1.0] * 16)
    cube = Halfspaces(E[0], np.ones(6))
    for row in exact_rows([(0.1, -0.3, 0.2), (0.0, 0.0, -1e-30), (1.0, 1.0, 1.0), (0.0, 0.0, 0.0)]):
        assert octahedron.bound(row) == max(map(abs, row))
        assert cube.bound(row) == sum(map(abs, row))


def test_open_and_malformed_polytopes_are_refused():
    with pytest.raises(ValueError, match="bound the direction"):
        Halfspaces(E[0][:5], np.ones(5)).bound(exact_row((0, 0, -1)))
    with pytest.raises(ValueError, match="offsets"):
        Halfspaces(E[0], np.ones(5))
    with pytest.raises(ValueError, match="normals"):
        Halfspaces(np.eye(2), np.ones(2))
    with pytest.raises(ValueError, match="offsets"):
        containment_margin(E[0], [1, 1, 1, 1, 1, math.inf], E[0], np.ones(6))


# Invariance and containment


def test_the_invariance_margin_agrees_with_floats_and_is_not_negative():
    scale = np.linalg.norm(OMEGA.normals, axis=1)
    margin = invariance_margin(OMEGA.normals / scale[:, None], OMEGA.offsets / scale, LOOPS, W)
    expected = certificate.invariance_margin(floats(LOOPS), POINTS, OMEGA)
    assert float(margin) == pytest.approx(expected, abs=EXACT_AGAINST_FLOAT)
    assert margin > 0
    assert invariance_margin(OMEGA.normals, OMEGA.offsets, LOOPS, W) > 0


def test_a_facet_pulled_in_by_a_millionth_is_refused_where_others_lean_on_it():
    scale = np.linalg.norm(OMEGA.normals, axis=1)
    margins = []
    for facet in range(len(OMEGA.offsets)):
        pulled = OMEGA.offsets / scale
        pulled[facet] *= 1 - 1e-6
        polytope = Polytope(OMEGA.normals / scale[:, None], pulled)
        margins.append(float(invariance_margin(polytope.normals, pulled, LOOPS, W)))
        expected = certificate.invariance_margin(floats(LOOPS), POINTS, polytope)
        assert margins[-1] == pytest.approx(expected, abs=EXACT_PULLED_FACET)
    assert min(margins) < -10 * EXACT_PULLED_FACET
    assert max(margins) > 0  # a facet that bounds no image may move alone


def test_a_wider_disturbance_another_gain_and_a_wider_schedule_are_refused():
    wider = [tuple(Fraction(100_001, 100_000) * a for a in point) for point in W]
    assert invariance_margin(OMEGA.normals, OMEGA.offsets, LOOPS, wider) < 0
    for gains in ((2.999, 6.5, 6.5), (3.0, 6.499, 6.5), (3.0, 6.5, 6.501)):
        assert invariance_margin(OMEGA.normals, OMEGA.offsets, vertex_loops(gains, BOX, DT), W) < 0
    wide = schedule_box((SLOW, SLOW), (FAST + 1e-3, FAST + 1e-3), DT, WIDTH)
    assert invariance_margin(OMEGA.normals, OMEGA.offsets, vertex_loops(GAINS, wide, DT), W) < 0


def test_the_invariant_set_is_admissible_and_narrower_limits_are_refused():
    errors = containment_margin(OMEGA.normals, OMEGA.offsets, *E)
    rows, limits = mapped_rows(U[0], FEEDBACKS), np.tile(U[1], 2)
    inputs = containment_margin(OMEGA.normals, OMEGA.offsets, rows, limits)
    room = limits - OMEGA.support(np.vstack([U[0] @ gain for gain in floats(FEEDBACKS)]))
    assert errors >= 0
    assert inputs >= 0
    assert float(inputs) == pytest.approx(room.min(), abs=EXACT_AGAINST_FLOAT)
    assert containment_margin(OMEGA.normals, OMEGA.offsets, E[0], E[1] - float(errors) - 1e-12) < 0
    assert containment_margin(OMEGA.normals, OMEGA.offsets, rows, limits - float(inputs) - 1e-12) < 0


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
        assert (smallest_pivot(exact_rows(symmetric)) >= 0) == (np.linalg.eigvalsh(symmetric)[0] >= 0)
    with pytest.raises(ValueError, match="symmetric"):
        smallest_pivot(exact_rows([(1, 0, 0), (1e-16, 1, 0), (0, 0, 1)]))


def test_the_decrease_of_the_cost_is_proved_and_its_loss_is_seen():
    loop, gain = floats(LOOPS).mean(axis=0), floats(FEEDBACKS).mean(axis=0)
    cost = solve_discrete_lyapunov(loop.T, 1.6 * (Q + gain.T @ R @ gain))
    cost = (cost + cost.T) / 2
    assert decrease_pivot(cost, LOOPS, FEEDBACKS, Q, R) > 0
    pairs = list(product(floats(LOOPS), floats(FEEDBACKS)))
    assert certificate.decrease_margin(*zip(*pairs, strict=True), cost, Q, R) > 0
    for right, left in np.random.default_rng(4).uniform(SLOW, FAST, size=(20, 2)):
        here = schedule_box((right, left), (right, left), DT, WIDTH)
        inside = vertex_loops(GAINS, here, DT)[:1], vertex_feedbacks(GAINS, here)[:1]
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


# Tubes along a schedule


@dataclass(frozen=True)
class Used:
    errors: np.ndarray
    inputs: np.ndarray
    terminal_normals: np.ndarray
    terminal: np.ndarray


SCHEDULE = [(FAST, SLOW)] * 7 + [(SLOW, FAST)] * 7
# Two turns of seven periods each, so that every window with a change of direction occurs.
WINDOWS = sorted({tuple((SCHEDULE * 2)[k : k + HORIZON]) for k in range(len(SCHEDULE))})
ORDER = [WINDOWS.index(tuple((SCHEDULE * 2)[k : k + HORIZON])) for k in range(len(SCHEDULE))]
FOLLOWERS = list(zip(ORDER, ORDER[1:] + ORDER[:1], strict=True))
WHEELS = {wheels: schedule_box(wheels, wheels, DT, WIDTH) for wheels in {*SCHEDULE}}
BOXES = [[WHEELS[wheels] for wheels in window] for window in WINDOWS]
SEQUENCE_LOOPS = floats([[vertex_loops(GAINS, box, DT)[0] for box in row] for row in BOXES])
SEQUENCE_GAINS = floats([[vertex_feedbacks(GAINS, box)[0] for box in row] for row in BOXES])


@cache
def used_sets(graded: bool) -> Used:
    """E - R_j, U - K R_j, Omega - R_N window by window, backed off by STEP, or by STEP more at every stage."""
    omega, disturbance = invariant(STEP), Polytope.from_vertices(POINTS)

    def taken(rows, steps):
        return sequence_support(
            SEQUENCE_LOOPS, disturbance, np.broadcast_to(rows, (len(BOXES), *rows.shape[-2:])), steps
        )

    back = STEP * (np.arange(1, HORIZON + 2) if graded else np.ones(HORIZON + 1))
    errors = [E[1] - taken(E[0], j) - back[j] for j in range(HORIZON)]
    inputs = [U[1] - taken(U[0] @ SEQUENCE_GAINS[:, j], j) - back[j] for j in range(HORIZON)]
    last = omega.offsets - taken(omega.normals, HORIZON) - back[-1] * np.linalg.norm(omega.normals, axis=1)
    return Used(np.stack(errors, axis=1), np.stack(inputs, axis=1), omega.normals, last)


def margins(used: Used, slack=0, disturbance=W, boxes=BOXES, followers=FOLLOWERS, gains=GAINS):
    omega = invariant(STEP)
    return sequence_margins(boxes, followers, gains, DT, disturbance, E, U, (omega.normals, omega.offsets), used, slack)


NAMES = {
    "nonempty", "errors reach", "errors shifted", "errors returns", "inputs reach", "inputs shifted", "inputs returns",
    "terminal reach", "terminal returns",
}  # fmt: skip


def test_tubes_backed_off_further_at_every_stage_hold_without_slack():
    found = margins(used_sets(True))
    assert set(found) == NAMES
    assert ExactReport(found).holds
    assert float(found["errors reach"]) == pytest.approx(STEP, abs=EXACT_AGAINST_FLOAT)
    assert float(found["errors shifted"]) == pytest.approx(STEP, abs=EXACT_AGAINST_FLOAT)
    assert float(found["inputs shifted"]) == pytest.approx(STEP, abs=EXACT_AGAINST_FLOAT)


def test_tubes_backed_off_once_hold_up_to_the_rounding_of_their_offsets():
    found = margins(used_sets(False))
    assert -EXACT_ROUNDED_OFFSETS <= found["errors shifted"] <= EXACT_ROUNDED_OFFSETS
    assert ExactReport(margins(used_sets(False), EXACT_ROUNDED_OFFSETS)).holds


def test_what_returns_is_the_room_of_vertices_under_products_of_loops():
    used = used_sets(True)
    found = margins(used)
    rooms = {"errors returns": [], "inputs returns": [], "terminal returns": []}
    for now, later in set(FOLLOWERS):
        planned = Polytope(used.terminal_normals, used.terminal[now]).vertices()
        psi = np.linalg.multi_dot(SEQUENCE_LOOPS[now, :0:-1])
        ends = (planned[:, None] + (POINTS @ psi.T)[None]).reshape(-1, 3)
        inputs = ends @ SEQUENCE_GAINS[later, -1].T
        rooms["errors returns"].append(np.min(used.errors[later, -1] - ends @ E[0].T))
        rooms["inputs returns"].append(np.min(used.inputs[later, -1] - inputs @ U[0].T))
        images = ends @ SEQUENCE_LOOPS[later, -1].T
        rooms["terminal returns"].append(np.min(used.terminal[later] - images @ used.terminal_normals.T))
    for name, expected in rooms.items():
        assert float(found[name]) == pytest.approx(min(expected), abs=EXACT_AGAINST_FLOAT)


@pytest.mark.parametrize(
    ("field", "entry", "change", "name"),
    [
        ("errors", (3, 2, 1), 1.1 * 3 * STEP, "errors reach"),
        ("errors", (3, 2, 1), 1.1 * STEP, "errors shifted"),
        ("errors", (3, 2, 1), -1.1 * STEP, "errors shifted"),
        ("inputs", (4, 1, 3), 1.1 * 2 * STEP, "inputs reach"),
        ("inputs", (4, 1, 3), -1.1 * STEP, "inputs shifted"),
        ("errors", (5, 4, 0), -0.1, "errors returns"),
        ("inputs", (5, 4, 2), -0.2, "inputs returns"),
        ("terminal", (2, 0), -1e-2, "terminal returns"),
        ("terminal", (2,), 1e-3, "terminal reach"),
        ("inputs", (0, 0, 0), -1.0, "nonempty"),
    ],
)
def test_offsets_used_on_line_that_miss_a_condition_are_named(field, entry, change, name):
    used = used_sets(True)
    changed = getattr(used, field).copy()
    changed[entry] += change
    report = ExactReport(margins(replace(used, **{field: changed})))
    assert not report.holds
    assert name in report.failing


def test_wider_disturbances_other_gains_and_blurred_schedules_are_refused_along_a_schedule():
    wider = [tuple(Fraction(10_001, 10_000) * a for a in point) for point in W]
    assert "errors reach" in ExactReport(margins(used_sets(True), disturbance=wider)).failing
    assert not ExactReport(margins(used_sets(True), gains=(3.0, 6.45, 6.5))).holds
    blurred = {wheels: schedule_box(wheels, np.array(wheels) + 1e-3, DT, WIDTH) for wheels in WHEELS}
    boxes = [[blurred[wheels] for wheels in window] for window in WINDOWS]
    assert not ExactReport(margins(used_sets(True), boxes=boxes)).holds


def test_a_window_that_does_not_follow_is_refused():
    with pytest.raises(ValueError, match="followers"):
        margins(used_sets(True), followers=[(0, len(BOXES) - 1)])


@pytest.mark.parametrize(
    ("field", "cut"), [("errors", np.s_[:, 1:]), ("inputs", np.s_[:, :, 1:]), ("terminal", np.s_[1:])]
)
def test_offsets_of_another_shape_are_refused(field, cut):
    used = used_sets(True)
    with pytest.raises(ValueError):
        margins(replace(used, **{field: getattr(used, field)[cut]}))


def test_a_report_holds_only_where_every_margin_is_proved():
    assert not ExactReport().holds
    assert ExactReport({"zero": Fraction(0)}).holds
    report = ExactReport({"zero": Fraction(0), "missed": Fraction(-1, 10**60)})
    assert not report.holds
    assert report.failing == ["missed"]
