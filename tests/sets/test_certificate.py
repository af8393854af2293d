"""Laws of the certificate: every margin equals what enumeration, simulation or sampling finds, and
broken sets fail."""

import dataclasses
import itertools
import math

import numpy as np
import pytest
from paper_problem import PAPER, U, W, terminal_gains, terminal_problem, tube_gains, tube_loops
from tolerances import CERTIFICATE_MARGIN, TUBE_ROUNDING

from sets.certificate import (
    Certificate,
    decrease_margin,
    escape_excess,
    invariance_margin,
    judge,
    nonempty_margin,
    reach_supports,
    sequence_reach,
    terminal_margins,
)
from sets.invariant import maximal_rpi
from sets.polytope import Polytope
from sets.riccati import lqr_gain
from sets.tubes import hull_tube, propagate, sequence_tube

PRUNED_REACH = 1e-10
"""Relative; extreme directions are found after a joggle of 1e-11."""

LOOPS = tube_loops()
POINTS = W.vertices()
RANDOM = np.random.default_rng(0).uniform(-0.5, 0.5, size=(2, 3, 3))
SPINNING = (
    0.9 * np.linalg.qr(np.random.default_rng(2).normal(size=(3, 2, 2)))[0]
)  # planar turns that shrink
UNEVEN = np.random.default_rng(1).uniform(
    -0.2, 1.0, size=(5, 3)
)  # a disturbance set without symmetry
CUBE = Polytope.box(-np.ones(3), np.ones(3))


def width(points: np.ndarray, rows: np.ndarray) -> np.ndarray:
    return np.max(rows @ points.T, axis=-1)


def unpruned(loops: np.ndarray, points: np.ndarray, direction: np.ndarray, steps: int):
    """Yield reach and greatest last term of j = 0..steps, over every product kept to the end."""
    rows = direction[None]
    sums = np.zeros(1)
    for _ in range(steps + 1):
        terms = width(points, rows)
        yield sums.max(), terms.max()
        rows = np.concatenate([rows @ loop for loop in loops])
        sums = np.tile(sums + terms, len(loops))


@pytest.mark.parametrize("loops", [LOOPS, RANDOM], ids=["paper", "random"])
def test_reach_equals_the_greatest_over_enumerated_products(loops):
    direction = np.array([0.3, -1.0, 0.5])
    reach, last = reach_supports(loops, UNEVEN, direction, 4)
    for j in range(5):
        totals = []
        terms = []
        for chosen in itertools.product(loops, repeat=max(j, 0)):
            row = direction
            total = 0.0
            for loop in chosen:
                total += width(UNEVEN, row)
                row = row @ loop
            totals.append(total)
            terms.append(width(UNEVEN, row))
        assert reach[j] == pytest.approx(max(totals), abs=TUBE_ROUNDING)
        assert last[j] == pytest.approx(max(terms), abs=TUBE_ROUNDING)


@pytest.mark.parametrize(
    ("loops", "steps", "count"), [(LOOPS, 8, 4), (SPINNING, 10, 40)], ids=["paper", "spinning"]
)
def test_pruning_does_not_change_the_reach(loops, steps, count):
    points = UNEVEN[:, : loops.shape[-1]]
    for direction in np.random.default_rng(9).normal(size=(count, loops.shape[-1])):
        expected = np.array(list(unpruned(loops, points, direction, steps)))
        found = np.transpose(reach_supports(loops, points, direction, steps))
        np.testing.assert_allclose(found, expected, rtol=PRUNED_REACH)


def test_clusters_of_almost_equal_products_do_not_stop_the_pruning():
    rng = np.random.default_rng(11)
    loops = 0.9 * np.eye(3) + 1e-13 * rng.normal(size=(8, 3, 3))
    direction = np.array([0.3, -1.0, 0.5])
    reach, last = reach_supports(loops, UNEVEN, direction, 6)
    step = width(UNEVEN, direction)
    np.testing.assert_allclose(last, step * 0.9 ** np.arange(7), rtol=PRUNED_REACH)
    np.testing.assert_allclose(reach[6], step * (1 - 0.9**6) / 0.1, rtol=PRUNED_REACH)


def test_of_disturbances_that_are_equally_bad_the_first_is_taken():
    loops = np.array([0.5 * np.eye(2)])
    square = np.array([[1.0, 1.0], [1.0, -1.0], [-1.0, 1.0], [-1.0, -1.0]])
    normal = np.array([1.0, 0.0])
    for bits in np.random.default_rng(0).uniform(-1e-15, 1e-15, size=(20, 4, 2)):
        _, state = escape_excess(loops, square + bits, normal, 1.0, (0, 0))
        np.testing.assert_allclose(state, [1.75, 1.75], rtol=1e-14)


def test_reach_and_last_term_equal_those_of_the_tubes():
    rows = np.random.default_rng(2).normal(size=(5, 3))
    hull = hull_tube(LOOPS, W, 7)
    clouds = propagate(LOOPS, W, 7)
    for row in rows:
        reach, last = reach_supports(LOOPS, POINTS, row, 7)
        np.testing.assert_allclose(
            reach, [section.support(row)[0] for section in hull], atol=TUBE_ROUNDING
        )
        np.testing.assert_allclose(
            last, [cloud.support(row)[0] for cloud in clouds], atol=TUBE_ROUNDING
        )


def test_reach_along_a_schedule_equals_the_sections_of_its_tube():
    rng = np.random.default_rng(3)
    loops = LOOPS[rng.integers(4, size=6)]
    rows = rng.normal(size=(7, 3))
    reach, last = sequence_reach(loops, POINTS, rows)
    expected = [section.support(rows) for section in sequence_tube(loops, W)]
    np.testing.assert_allclose(reach, expected, rtol=0, atol=TUBE_ROUNDING)
    product = np.eye(3)
    for j in range(len(loops)):
        product = loops[j] @ product if j else product
        np.testing.assert_allclose(
            last[j], width(POINTS, rows @ product), rtol=0, atol=TUBE_ROUNDING
        )


def test_reach_along_a_schedule_is_attained_by_the_best_of_all_disturbances():
    rng = np.random.default_rng(4)
    loops = rng.uniform(-1, 1, size=(3, 3, 3))
    rows = rng.normal(size=(4, 3))
    reach, _ = sequence_reach(loops, UNEVEN, rows)
    ends = []
    for chosen in itertools.product(UNEVEN, repeat=3):
        state = np.zeros(3)
        for loop, disturbance in zip(loops, chosen, strict=True):
            state = loop @ state + disturbance
        ends.append(state)
    np.testing.assert_allclose(reach[3], width(np.array(ends), rows), rtol=0, atol=TUBE_ROUNDING)


def test_the_escape_is_the_furthest_of_all_simulated_runs():
    path = (2, 0, 1, 1)
    normal = np.array([0.4, 1.0, -0.2])
    loops = np.random.default_rng(5).uniform(-1, 1, size=(3, 3, 3))
    excess, state = escape_excess(loops, UNEVEN, normal, 0.7, path)
    ends = []
    for chosen in itertools.product(UNEVEN, repeat=len(path) + 1):
        end = chosen[0]
        for index, disturbance in zip(path, chosen[1:], strict=True):
            end = loops[index] @ end + disturbance
        ends.append(end)
    assert excess == pytest.approx(np.max(ends @ normal) - 0.7, abs=TUBE_ROUNDING)
    assert normal @ state - 0.7 == pytest.approx(excess, abs=TUBE_ROUNDING)
    assert np.min(np.linalg.norm(ends - state, axis=1)) <= TUBE_ROUNDING


def test_the_escape_of_an_empty_set_leaves_and_a_shortened_one_does_not():
    loops, constraints = terminal_problem(0.2, False, "trace_p")
    escape = maximal_rpi(loops, constraints, W.support).escape
    assert escape is not None
    assert escape_excess(loops, POINTS, escape.normal, escape.offset, escape.loops)[0] > 0
    assert escape_excess(loops, POINTS, escape.normal, escape.offset, escape.loops[1:])[0] < 0


def test_invariance_margin_is_the_least_room_of_images_of_vertices():
    box = Polytope(CUBE.normals * np.array([[2.0], [1], [1], [1], [3], [1]]), CUBE.offsets)
    scale = np.linalg.norm(box.normals, axis=1)
    room = np.inf
    for loop, vertex, disturbance in itertools.product(RANDOM, box.vertices(), 0.1 * UNEVEN):
        room = min(
            room, np.min((box.offsets - box.normals @ (loop @ vertex + disturbance)) / scale)
        )
    assert invariance_margin(RANDOM, 0.1 * UNEVEN, box) == pytest.approx(
        room, abs=CERTIFICATE_MARGIN
    )


def test_invariance_margin_tells_an_invariant_set_from_one_pushed_out():
    loops, constraints = terminal_problem(0.2, True, "trace_p")
    found = maximal_rpi(loops, constraints, W.support).polytope
    assert found is not None
    assert invariance_margin(loops, POINTS, found) >= 0
    margins = []
    for facet in range(len(found.offsets)):
        pushed = found.offsets.copy()
        pushed[facet] *= 1.05
        margins.append(invariance_margin(loops, POINTS, Polytope(found.normals, pushed)))
    assert np.mean(np.array(margins) < 0) > 0.5
    assert invariance_margin(loops, 1.1 * POINTS, found) < 0


def test_decrease_margin_bounds_the_decrease_along_every_loop():
    rng = np.random.default_rng(6)
    gains = terminal_gains(0.4, False, "trace_p")
    loops = terminal_problem(0.4, False, "trace_p")[0]
    cost = np.diag([20.0, 60.0, 30.0])
    states = rng.normal(size=(20000, 3))
    states /= np.linalg.norm(states, axis=1, keepdims=True)

    def form(matrix: np.ndarray, at: np.ndarray) -> np.ndarray:
        return np.einsum("si,ij,sj->s", at, matrix, at)

    Q, R = PAPER
    decreases = [
        form(cost, states)
        - form(cost, states @ loop.T)
        - form(Q, states)
        - form(R, states @ gain.T)
        for loop, gain in zip(loops, gains, strict=True)
    ]
    margin = decrease_margin(loops, gains, cost, Q, R)
    assert margin <= np.min(decreases)
    assert margin == pytest.approx(np.min(decreases), abs=0.05)


def test_decrease_margin_is_zero_for_the_riccati_cost():
    A = np.array([[1.0, 0.1], [0.0, 1.0]])
    B = np.array([[0.0], [0.1]])
    gain = lqr_gain(A, B, np.eye(2), np.eye(1))
    loop = A + B @ gain
    cost = np.zeros((2, 2))
    for _ in range(2000):
        cost = np.eye(2) + gain.T @ gain + loop.T @ cost @ loop
    margin = decrease_margin(loop[None], gain[None], cost, np.eye(2), np.eye(1))
    assert margin == pytest.approx(0, abs=CERTIFICATE_MARGIN)


def test_terminal_margins_are_the_least_room_over_vertices():
    rng = np.random.default_rng(7)
    terminal = Polytope.from_vertices(0.3 * rng.normal(size=(8, 3)))
    following = Polytope.from_vertices(rng.normal(size=(8, 3)))
    reach = Polytope.from_vertices(0.05 * UNEVEN)
    errors = Polytope.box(-2 * np.ones(3), np.array([1.0, 3.0, 2.0]))
    inputs = U
    gains = tube_gains()
    points = (terminal.vertices()[:, None] + reach.vertices()[None]).reshape(-1, 3)

    def room(polytope: Polytope, images: np.ndarray) -> float:
        slack = polytope.offsets - images @ polytope.normals.T
        return np.min(slack / np.linalg.norm(polytope.normals, axis=1))

    scale = np.linalg.norm(inputs.normals, axis=1)
    rows = inputs.normals / scale[:, None] @ gains
    offsets = inputs.offsets / scale
    found = terminal_margins(terminal, following, LOOPS, errors, rows, offsets, reach.vertices())
    expected = {
        "admissible_errors": room(errors, points),
        "admissible_inputs": min(room(inputs, points @ gain.T) for gain in gains),
        "returns": min(room(following, points @ loop.T) for loop in LOOPS),
    }
    assert found == pytest.approx(expected, abs=CERTIFICATE_MARGIN)


def test_nonempty_margin_is_the_least_radius_and_negative_for_an_empty_set():
    narrow = Polytope.box(np.array([-1.0, -0.2, -3.0]), np.array([1.0, 0.2, 3.0]))
    empty = Polytope.box(np.zeros(3), np.array([1.0, -0.1, 1.0]))
    assert nonempty_margin([CUBE, narrow]) == pytest.approx(0.2)
    assert nonempty_margin([CUBE, empty]) < 0


def test_a_certificate_holds_exactly_when_every_required_condition_does():
    held = judge("zero", 0.0, "yes", "no")
    told = judge("for information", -1.0, "yes", "no", "information")
    unknown = judge("unknown", math.nan, "yes", "no")
    missed = judge("missed", -1e-15, "yes", "no")
    certificate = Certificate((held, told))
    assert certificate.holds_for_model
    assert certificate.failing == []
    failed = Certificate((held, told, unknown, missed))
    assert not failed.holds_for_model
    assert failed.failing == failed.failing_for_model == ["unknown", "missed"]
    assert failed.reasons == ["no", "no"]
    assert [condition.sentence for condition in failed.checked] == ["yes", "no", "no", "no"]
    assert failed.conditions["missed"].margin == -1e-15


def test_a_certificate_of_the_robot_needs_the_model_and_conditions_of_its_own():
    model = judge("model", 1.0, "yes", "no")
    robot = judge("robot", 1.0, "yes", "no", "robot")
    refuted = judge("robot", -1.0, "yes", "W is refuted", "robot")
    broken = judge("model", -1.0, "yes", "no")
    assert Certificate((model, robot)).holds_for_robot
    assert not Certificate((model,)).holds_for_robot
    assert not Certificate((broken, robot)).holds_for_robot
    of_model_alone = Certificate((model, refuted))
    assert of_model_alone.holds_for_model
    assert not of_model_alone.holds_for_robot
    assert of_model_alone.failing == ["robot"]
    assert of_model_alone.failing_for_model == []


def test_where_nothing_was_checked_nothing_is_certified():
    assert not Certificate().holds_for_model
    assert not Certificate().holds_for_robot
    assert Certificate().verdict == "NOT CERTIFIED: nothing was checked"


def test_a_certificate_says_its_verdict_first_and_then_what_fails():
    model = judge("model", 1.0, "yes", "no")
    refuted = judge("premise", -1.0, "yes", "W is refuted", "robot")
    verdict, count, reason = repr(Certificate((model, refuted))).splitlines()
    assert verdict == (
        "CERTIFIED for the linear model with w in W alone; NOT CERTIFIED for the robot: premise"
    )
    assert count.strip() == "1 of 2 required conditions hold"
    assert reason.strip() == "W is refuted"
    with pytest.raises(dataclasses.FrozenInstanceError):
        Certificate((model,)).checked = ()


def test_a_table_tells_every_condition_with_its_margin_and_its_sentence():
    long = "a sentence that is too long for a line of a table, " * 4
    checked = (
        judge("one", 0.25, "it holds", "it fails"),
        judge("two", -1.5, "it holds", long, "robot"),
        judge("three", -1.0, "so", "not so", "information"),
    )
    required, informative = Certificate(checked).table().split("\n\nfor information\n")
    lines = required.splitlines()
    assert lines[0].split() == ["holds", "one", "margin", "0.25"] and lines[1].strip() == "it holds"
    assert lines[2].split() == ["FAILS", "two", "margin", "-1.5"]
    assert " ".join(line.strip() for line in lines[3:]) == long.strip()
    assert max(map(len, lines)) <= 100
    assert informative.split() == ["no", "three", "margin", "-1", "not", "so"]
    assert "for information" not in Certificate(checked[:2]).table()
