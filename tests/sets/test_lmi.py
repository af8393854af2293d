"""Laws of the terminal cost: it decreases, it is as good as claimed, and with one vertex it is the
Riccati cost."""

import dataclasses
import functools
import subprocess
import sys
from typing import get_args

import cvxpy
import numpy as np
import pytest
import scipy.linalg
from tolerances import RICCATI_GAIN

from sets.gap import optimality_gap
from sets.lmi import Objective, TerminalCost, decrease_margins, terminal_cost
from sets.riccati import lqr_gain

RICCATI_COST = 1e-6
"""Relative; semidefinite program against the Riccati solution."""
GAP_LIMIT = 1e-4
"""Relative for traces, absolute for log det."""
SCALED_UP = 1e-5
"""Relative; answers of a solver against answers that were scaled until they decrease."""
GAP_ROUNDING = 1e-9

Weights = tuple[np.ndarray, np.ndarray]
Problem = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]
OBJECTIVES: tuple[Objective, ...] = get_args(Objective)
PAPER = (np.diag([1.0, 1.0, 0.01]), np.eye(2))
LATERAL = (np.diag([1.0, 3.0, 1.0]), 0.3 * np.eye(2))
COUPLED = (
    np.array([[1.0, 0.2, 0.0], [0.2, 1.0, 0.1], [0.0, 0.1, 0.5]]),
    np.array([[1.0, 0.6], [0.6, 0.8]]),
)
SEMIDEFINITE = (np.diag([1.0, 1.0, 0.0]), np.eye(2))
CASES: dict[str, tuple[float, Weights]] = {
    "paper": (0.2, PAPER),
    "narrow": (0.4, PAPER),
    "lateral": (0.2, LATERAL),  # trace S is largest at a singular S
    "coupled": (0.2, COUPLED),
    "semidefinite": (0.2, SEMIDEFINITE),
}


def model(right: float, left: float) -> np.ndarray:
    """Matrix A of the paper's error model (Euler, 0.1 s) at wheel references in m/s."""
    g = 0.1 * (1 - 0.2) / 0.5
    d = 0.1 / 2
    turn = g * (right - left)
    drift = d * (right + left)
    return np.array([[1.0, turn, 0.0], [-turn, 1.0, drift], [0.0, 0.0, 1.0]])


INPUT = np.array([[0.1, 0.0], [0.0, 0.0], [0.0, 0.1]])


def vertices(slowest: float, fastest: float = 1.5) -> tuple[np.ndarray, np.ndarray]:
    pairs = [(right, left) for right in (slowest, fastest) for left in (slowest, fastest)]
    return np.array([model(*pair) for pair in pairs]), np.array([INPUT] * 4)


@functools.cache
def solved(case: str, objective: Objective) -> tuple[Problem, TerminalCost]:
    slowest, weights = CASES[case]
    problem = (*vertices(slowest), *weights)
    return problem, terminal_cost(*problem, objective)


each_case = pytest.mark.parametrize("case", CASES)
each_objective = pytest.mark.parametrize("objective", OBJECTIVES)


@each_objective
@each_case
def test_cost_is_symmetric_positive_and_decreases_at_every_vertex(case, objective):
    (A, B, Q, R), terminal = solved(case, objective)
    P = terminal.cost
    assert np.array_equal(P, P.T)
    assert np.linalg.eigvalsh(P)[0] > 0
    assert (decrease_margins(A, B, terminal.gains, P, Q, R) >= 0).all()


@each_objective
@each_case
def test_cost_decreases_inside_the_schedule_with_interpolated_gains(case, objective):
    (_, _, Q, R), terminal = solved(case, objective)
    P = terminal.cost
    slowest = CASES[case][0]
    rng = np.random.default_rng(0)
    for right, left in rng.uniform(size=(1000, 2)):
        weights = np.outer([1 - right, right], [1 - left, left]).ravel()
        gain = np.tensordot(weights, terminal.gains, axes=1)
        closed = model(*(slowest + (1.5 - slowest) * np.array([right, left]))) + INPUT @ gain
        assert np.linalg.eigvalsh(P - closed.T @ P @ closed - Q - gain.T @ R @ gain)[0] >= 0


@each_objective
@each_case
def test_cost_is_within_the_stated_gap_of_the_best(case, objective):
    problem, terminal = solved(case, objective)
    assert -GAP_ROUNDING <= optimality_gap(*problem, terminal) <= GAP_LIMIT


@pytest.mark.parametrize("case", ["paper", "narrow", "coupled"])
def test_each_objective_is_won_by_its_own_answer(case):
    merits = {
        "trace_s": lambda P: np.trace(np.linalg.inv(P)),
        "trace_p": lambda P: -np.trace(P),
        "logdet": lambda P: -np.linalg.slogdet(P)[1],
    }
    costs = {objective: solved(case, objective)[1].cost for objective in OBJECTIVES}
    for objective, merit in merits.items():
        assert max(costs, key=lambda other: merit(costs[other])) == objective
        assert abs(merit(costs[objective])) == pytest.approx(abs(solved(case, objective)[1].value))


def best_value(A, B, Q, R, objective: Objective) -> float:
    """Solve the inequality as it is written in the paper, by another modeller."""
    n = len(Q)
    roots = [scipy.linalg.sqrtm(weight) for weight in (Q, R)]
    S = cvxpy.Variable((n, n), symmetric=True)
    asked = []
    for a, b in zip(A, B, strict=True):
        Y = cvxpy.Variable(b.T.shape)
        after = a @ S + b @ Y
        weighted = cvxpy.vstack([roots[0] @ S, roots[1] @ Y])
        column = cvxpy.vstack([after, weighted])
        corner = cvxpy.bmat([[S, np.zeros((n, 5))], [np.zeros((5, n)), np.eye(5)]])
        asked.append(cvxpy.bmat([[S, column.T], [column, corner]]) >> 0)
    goal = {
        "trace_s": lambda: cvxpy.Maximize(cvxpy.trace(S)),
        "trace_p": lambda: cvxpy.Minimize(cvxpy.tr_inv(S)),
        "logdet": lambda: cvxpy.Maximize(cvxpy.log_det(S)),
    }[objective]()
    return cvxpy.Problem(goal, asked).solve(solver=cvxpy.CLARABEL)


@each_objective
@pytest.mark.parametrize("case", ["narrow", "coupled"])
def test_another_modeller_finds_the_same_best(case, objective):
    problem, terminal = solved(case, objective)
    assert terminal.value == pytest.approx(best_value(*problem, objective), rel=SCALED_UP)


def true_loss_of_one_percent(objective: Objective) -> float:
    return {"trace_s": 0.01, "trace_p": 0.01 / 1.01, "logdet": 3 * np.log(1.01)}[objective]


@each_objective
def test_gap_of_a_worse_cost_shows_its_true_loss(objective):
    problem, terminal = solved("coupled", objective)
    gap = optimality_gap(*problem, dataclasses.replace(terminal, cost=1.01 * terminal.cost))
    loss = true_loss_of_one_percent(objective)
    assert loss - GAP_ROUNDING <= gap <= 10 * loss


@each_objective
def test_gap_stays_above_the_true_loss_whatever_the_multipliers(objective):
    problem, terminal = solved("paper", objective)
    rng = np.random.default_rng(1)
    Z = terminal.multipliers
    noise = np.abs(Z).max() * rng.normal(size=Z.shape)
    random = [Z + 1e-6 * noise, Z + 1e-3 * noise, noise]
    indefinite = Z - np.trace(Z[0]) * np.diag([0, 0, 0, 0, 0, 0, 1, 1, 1, 1, 1])
    without_error = np.diag(np.repeat([1, 1, 0, 1], [3, 3, 3, 2]))
    without_input = np.diag(np.repeat([1, 1, 1, 0], [3, 3, 3, 2]))
    dropped = [without_error @ Z @ without_error, without_input @ Z @ without_input]
    for multipliers in (0 * Z, 0.5 * Z, 2 * Z, -Z, *random, indefinite, *dropped):
        worse = dataclasses.replace(terminal, cost=1.01 * terminal.cost, multipliers=multipliers)
        assert optimality_gap(*problem, worse) >= true_loss_of_one_percent(objective) - GAP_ROUNDING


@each_objective
@pytest.mark.parametrize("weights", [PAPER, LATERAL, COUPLED])
def test_one_vertex_gives_the_riccati_cost_and_the_lqr_gain(objective: Objective, weights: Weights):
    A = model(1.2, 0.6)
    B = INPUT
    terminal = terminal_cost(A[None], B[None], *weights, objective)
    P = scipy.linalg.solve_discrete_are(A, B, *weights)
    gain = lqr_gain(A, B, *weights)
    assert np.abs(terminal.cost - P).max() <= RICCATI_COST * np.abs(P).max()
    assert np.abs(terminal.gains[0] - gain).max() <= RICCATI_GAIN * np.abs(gain).max()


@each_objective
@pytest.mark.parametrize("unit", [1e-4, 1e4])
def test_cost_is_proportional_to_the_weights(objective, unit):
    (A, B, Q, R), terminal = solved("paper", objective)
    scaled = terminal_cost(A, B, unit * Q, unit * R, objective)
    merit = {
        "trace_s": unit * scaled.value,
        "trace_p": scaled.value / unit,
        "logdet": scaled.value + 3 * np.log(unit),
    }
    assert merit[objective] == pytest.approx(terminal.value, rel=GAP_LIMIT)
    assert (decrease_margins(A, B, scaled.gains, scaled.cost, unit * Q, unit * R) >= 0).all()


@each_objective
@pytest.mark.parametrize(
    ("error_factor", "input_weights"),
    [
        (1e-10, (1e-10, 1e-10)),
        (1e-30, (1e-30, 1e-30)),
        (1.0, (1e6, 1e6)),
        (1.0, (1e8, 1e8)),
        (1.0, (1.0, 1e12)),
        (1.0, (1e12, 1.0)),
        (1.0, (1e-8, 1e-8)),
    ],
)
def test_a_cost_exists_for_every_weight_where_one_exists(objective, error_factor, input_weights):
    A, B = vertices(0.2)
    Q = error_factor * PAPER[0]
    R = np.diag(input_weights)
    terminal = terminal_cost(A, B, Q, R, objective)
    assert (decrease_margins(A, B, terminal.gains, terminal.cost, Q, R) >= 0).all()


def test_weights_near_to_each_other_are_taken_as_they_are():
    (A, B, Q, R), terminal = solved("paper", "trace_p")
    unit = 1e-10
    scaled = terminal_cost(A, B, unit * Q, unit * R, "trace_p")
    np.testing.assert_allclose(scaled.value, unit * terminal.value, rtol=RICCATI_COST)


def test_margin_is_negative_where_the_cost_is_too_small():
    (A, B, Q, R), terminal = solved("paper", "trace_p")
    assert (decrease_margins(A, B, terminal.gains, 0.99 * terminal.cost, Q, R) < 0).any()
    assert (decrease_margins(A, B, 0 * terminal.gains, terminal.cost, Q, R) < 0).all()


@pytest.mark.parametrize(
    ("field", "change"),
    [
        ("error_weight", {"error_weight": np.diag([1.0, 1.0, -0.01])}),
        ("error_weight", {"error_weight": np.zeros((3, 3))}),
        ("error_weight", {"error_weight": np.triu(np.ones((3, 3)))}),
        ("error_weight", {"error_weight": np.eye(2)}),
        ("input_weight", {"input_weight": np.diag([1.0, 0.0])}),
        ("input_weight", {"input_weight": np.diag([1.0, np.nan])}),
        ("B", {"B": INPUT}),
        ("A", {"A": np.full((4, 3, 3), np.inf)}),
        ("A", {"A": 2 * np.array([np.eye(3)] * 4), "B": np.zeros((4, 3, 2))}),
        ("objective", {"objective": "trace"}),
    ],
)
def test_bad_input_is_refused_in_one_line_that_names_the_field(field, change):
    A, B = vertices(0.2)
    good = {
        "A": A,
        "B": B,
        "error_weight": PAPER[0],
        "input_weight": PAPER[1],
        "objective": "trace_s",
    }
    with pytest.raises(ValueError, match=rf"^{field} [^\n]*: [^\n]*$"):
        terminal_cost(**{**good, **change})


@each_objective
def test_vertices_without_a_common_cost_are_reported(objective):
    A = np.array(
        [[[0.0, 2.0], [0.0, 0.0]], [[0.0, 0.0], [2.0, 0.0]]]
    )  # each vanishes in two steps, their product grows
    with pytest.raises(RuntimeError, match="not optimal"):
        terminal_cost(A, np.zeros((2, 2, 1)), np.eye(2), np.eye(1), objective)


def test_importing_the_module_does_not_load_jax():
    check = "import sys, sets.lmi; sys.exit('jax' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", check], check=False).returncode == 0
