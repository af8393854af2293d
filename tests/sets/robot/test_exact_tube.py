"""Laws of exact tubes along a schedule: margins are those of vertices, and offsets that miss one
are named."""

from dataclasses import dataclass, replace
from fractions import Fraction
from functools import cache
from itertools import product

import numpy as np
import pytest
from exact_problem import (
    DT,
    FAST,
    GAINS,
    HORIZON,
    POINTS,
    SLOW,
    STEP,
    WIDTH,
    E,
    U,
    W,
    floats,
    invariant,
)
from tolerances import EXACT_AGAINST_FLOAT

from sets.exact import ExactReport
from sets.polytope import Polytope
from sets.robot.exact_tube import (
    exact_vertex_feedbacks,
    exact_vertex_loops,
    schedule_box,
    sequence_margins,
)
from sets.tubes import sequence_support

EXACT_ROUNDED_OFFSETS = 1e-14
"""Float64 offsets, sums of some ten terms below one."""


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
SEQUENCE_LOOPS = floats([[exact_vertex_loops(GAINS, box, DT)[0] for box in row] for row in BOXES])
SEQUENCE_GAINS = floats([[exact_vertex_feedbacks(GAINS, box)[0] for box in row] for row in BOXES])


def taken(rows: np.ndarray, steps: int) -> np.ndarray:
    """Support numbers of R_steps, window by window."""
    along = np.broadcast_to(rows, (len(BOXES), *rows.shape[-2:]))
    return sequence_support(SEQUENCE_LOOPS, Polytope.from_vertices(POINTS), along, steps)


@cache
def used_sets(graded: bool) -> Used:
    """E - R_j, U - K R_j, Omega - R_N window by window, backed off by STEP, or by STEP more at
    every stage."""
    omega = invariant(STEP)
    back = STEP * (np.arange(1, HORIZON + 2) if graded else np.ones(HORIZON + 1))
    errors = [E[1] - taken(E[0], j) - back[j] for j in range(HORIZON)]
    inputs = [U[1] - taken(U[0] @ SEQUENCE_GAINS[:, j], j) - back[j] for j in range(HORIZON)]
    last = (
        omega.offsets
        - taken(omega.normals, HORIZON)
        - back[-1] * np.linalg.norm(omega.normals, axis=1)
    )
    return Used(np.stack(errors, axis=1), np.stack(inputs, axis=1), omega.normals, last)


UNCOUPLED = (U[0], np.zeros((4, 3)), U[1])


def margins(
    used: Used,
    disturbance=W,
    boxes=BOXES,
    followers=FOLLOWERS,
    gains=GAINS,
    input_set=UNCOUPLED,
):
    omega = invariant(STEP)
    sets = (E, input_set, (omega.normals, omega.offsets))
    return sequence_margins(boxes, followers, gains, DT, [disturbance], *sets, used)


NAMES = {
    "nonempty",
    "errors reach",
    "errors shifted",
    "errors returns",
    "inputs reach",
    "inputs shifted",
    "inputs returns",
    "terminal reach",
    "terminal returns",
}


def test_tubes_backed_off_further_at_every_stage_hold():
    found = margins(used_sets(True))
    assert set(found) == NAMES
    assert ExactReport(found).holds
    assert float(found["errors reach"]) == pytest.approx(STEP, abs=EXACT_AGAINST_FLOAT)
    assert float(found["errors shifted"]) == pytest.approx(STEP, abs=EXACT_AGAINST_FLOAT)
    assert float(found["inputs shifted"]) == pytest.approx(STEP, abs=EXACT_AGAINST_FLOAT)


def test_rows_that_couple_input_and_error_lose_what_both_reach():
    signs = np.array(list(product((-1.0, 1.0), repeat=2)))  # |e_x| / 0.3 + |u2| / 1.5 <= 1
    D = np.vstack([U[0], signs[:, :1] * [0, 1 / 1.5]])
    C = np.vstack([np.zeros((4, 3)), signs[:, 1:] * [1 / 0.3, 0, 0]])
    offsets = np.concatenate([U[1], np.ones(4)])
    inputs = [
        offsets - taken(D @ SEQUENCE_GAINS[:, j] + C, j) - (j + 1) * STEP for j in range(HORIZON)
    ]
    used = replace(used_sets(True), inputs=np.stack(inputs, axis=1))
    found = margins(used, input_set=(D, C, offsets))
    assert ExactReport(found).holds
    for name in ("inputs reach", "inputs shifted"):
        assert float(found[name]) == pytest.approx(STEP, abs=EXACT_AGAINST_FLOAT)
    assert "inputs reach" in ExactReport(margins(used, input_set=(D, 1.001 * C, offsets))).failing


def test_tubes_backed_off_once_hold_up_to_the_rounding_of_their_offsets():
    found = margins(used_sets(False))
    assert -EXACT_ROUNDED_OFFSETS <= found["errors shifted"] <= EXACT_ROUNDED_OFFSETS
    for name, margin in found.items():
        assert margin >= (-EXACT_ROUNDED_OFFSETS if name.endswith("shifted") else 0)


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
        rooms["terminal returns"].append(
            np.min(used.terminal[later] - images @ used.terminal_normals.T)
        )
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
    blurred = {
        wheels: schedule_box(wheels, np.array(wheels) + 1e-3, DT, WIDTH) for wheels in WHEELS
    }
    boxes = [[blurred[wheels] for wheels in window] for window in WINDOWS]
    assert not ExactReport(margins(used_sets(True), boxes=boxes)).holds


def test_a_window_that_does_not_follow_is_refused():
    with pytest.raises(ValueError, match="followers"):
        margins(used_sets(True), followers=[(0, len(BOXES) - 1)])


@pytest.mark.parametrize(
    ("field", "cut"),
    [("errors", np.s_[:, 1:]), ("inputs", np.s_[:, :, 1:]), ("terminal", np.s_[1:])],
)
def test_offsets_of_another_shape_are_refused(field, cut):
    used = used_sets(True)
    with pytest.raises(ValueError):
        margins(replace(used, **{field: getattr(used, field)[cut]}))
