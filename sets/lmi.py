"""Terminal cost and vertex gains of a linear parameter-varying system, by one linear matrix
inequality a vertex.

For e+ = A_i e + B_i u, u = Gamma^i e, find one P with

    P - (A_i + B_i Gamma^i)^T P (A_i + B_i Gamma^i) >= Q + Gamma^iT R Gamma^i

at every vertex i. With S = P^-1 and Y_i = Gamma^i S this is, by Schur complements,

    L_i(S, Y_i) = [ S                (A_i S + B_i Y_i)^T   S Q^(1/2)   Y_i^T R^(1/2) ]
                  [ A_i S + B_i Y_i   S                     0           0            ]
                  [ Q^(1/2) S         0                     I_n         0            ]  >= 0,
                  [ R^(1/2) Y_i       0                     0           I_m          ]

Objectives: `trace_s` maximises trace S, `trace_p` minimises trace P, `logdet` maximises log det S.
Notation: Q error weight, R input weight, P cost, Gamma gains, Z_i >= 0 multiplier of L_i; u =
+Gamma e throughout.

Source: Gonzalez, Fiacchini, Guzman, Alamo 2009, eqs. (22) and (32)-(41), where (41) prints the last
identity as I_3.
"""

import itertools
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal, NamedTuple, get_args

import numpy as np
import scipy.linalg
from jaxtyping import Float

from sets.lyapunov import scale_to_decrease, stage_cost
from sets.riccati import (
    check_system,
    compute_decrease,
    compute_gain,
    is_stabilising,
    solve_riccati,
    transpose,
)
from sets.semidefinite import (
    ALMOST_SOLVED,
    INFEASIBLE,
    SOLVED,
    Affine,
    Answer,
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

Objective = Literal["trace_s", "trace_p", "logdet"]

WEIGHT_FLOOR = 1e-6
"""A semidefinite Q is raised to this share of its largest eigenvalue: a decrease that is asked for
in every direction keeps S bounded (S <= Q^-1)."""

SHARES = (1e-8, 1e-4, 1.0)
"""Eigenvalues of Q and R are raised to this share of the largest of both, the first with which the
solver answers: a cost for larger weights serves smaller ones as well, and where weights are many
orders apart solvers take feasible problems for infeasible ones."""

COST_FLOOR = 1e-4
"""Floor of S relative to the Riccati solutions, which keeps P <= P_riccati / COST_FLOOR.

Trace S alone can drive S to a singular matrix, whose P and gains do not exist. The price of the
floor is part of the gap that `sets.gap` reports.
"""

SOLVER_TOLERANCES = (1e-10, 1e-9, 1e-8)
"""The first that the solver reaches counts, without and with its chordal decomposition: each stalls
on some data."""


@dataclass(frozen=True)
class TerminalCost:
    """Terminal cost e^T P e with one gain a vertex, u = +gain e, and the multipliers that bound its
    suboptimality."""

    cost: Float[np.ndarray, "n n"]
    gains: Float[np.ndarray, "vertices m n"]
    multipliers: Float[np.ndarray, "vertices d d"]
    objective: Objective
    value: float


def terminal_cost(
    A: Float[np.ndarray, "vertices n n"],
    B: Float[np.ndarray, "vertices n m"],
    error_weight: Float[np.ndarray, "n n"],
    input_weight: Float[np.ndarray, "m m"],
    objective: Objective = "trace_s",
    shares_gain: bool = False,
) -> TerminalCost:
    """Return a quadratic terminal cost and vertex gains that decrease it by the stage cost at
    every vertex.

    Args:
        A, B: vertex matrices of e+ = A e + B u.
        error_weight: Q >= 0.
        input_weight: R > 0.
        objective: what the cost is best at, see the module.
        shares_gain: ask for one gain that serves all vertices, Y_i = Y.

    Returns:
        The cost, with `decrease_margins` >= 0 in float64 at every vertex. Where B or the gain is
        the same at all vertices this holds for every convex combination of them, with the gains
        combined by the same weights.

    Raises:
        ValueError: shapes or weights that are refused, or a vertex that no gain stabilises.
        RuntimeError: the solver finds no answer, or its answer does not decrease.

    Source: Gonzalez et al. 2009, eqs. (32)-(41).
    """
    if objective not in get_args(Objective):
        raise ValueError(
            f"objective is {objective!r}: choose one of {', '.join(get_args(Objective))}"
        )
    check_system(A.shape[:1], A, B, error_weight, input_weight)
    failure = RuntimeError(
        "terminal_cost: the answer does not decrease at a vertex; rescale the weights"
    )
    for Q, R in _raise_in_turn(error_weight, input_weight):
        try:
            terminal = _solve_scaled(A, B, Q, R, objective, shares_gain)
        except RuntimeError as refusal:
            failure = refusal
            continue
        margins = decrease_margins(A, B, terminal.gains, terminal.cost, error_weight, input_weight)
        if (margins >= 0).all():
            return terminal
    raise failure


def _solve_scaled(A, B, Q, R, objective: Objective, shares_gain: bool) -> TerminalCost:
    """Solve for the terminal cost in coordinates in which the mean Riccati cost and the input
    weight are identities.

    The solver then meets numbers of order one whatever the units, and 0 <= S <= I because no cost
    lies below a vertex's own Riccati cost.
    """
    riccati = [_find_scale(a, b, Q, R) for a, b in zip(A, B, strict=True)]
    L = np.linalg.cholesky(np.mean(riccati, axis=0))
    T = np.linalg.inv(L).T
    F = np.linalg.inv(compute_root(R))
    scaled = (L.T @ A @ T, L.T @ B @ F, compute_root(Q) @ T)
    S, Y, Z = _solve(*scaled, T, objective, shares_gain)
    S_inverse = np.linalg.inv(S)
    P = L @ S_inverse @ L.T
    gains = F @ Y @ S_inverse @ L.T
    # Solvers miss the decrease by about 1e-6.
    P = scale_to_decrease((P + P.T) / 2, A + B @ gains, stage_cost(gains, Q, R))
    back = scipy.linalg.block_diag(L.T, L.T, np.eye(sum(B.shape[1:])))
    return TerminalCost(P, gains, back.T @ Z @ back, objective, _compute_value(P, objective))


def decrease_margins(
    A: Float[np.ndarray, "vertices n n"],
    B: Float[np.ndarray, "vertices n m"],
    gains: Float[np.ndarray, "vertices m n"],
    cost: Float[np.ndarray, "n n"],
    error_weight: Float[np.ndarray, "n n"],
    input_weight: Float[np.ndarray, "m m"],
) -> Float[np.ndarray, " vertices"]:
    """Return the smallest eigenvalue of P - Phi^T P Phi - Q - Gamma^T R Gamma, Phi = A + B Gamma,
    at every vertex.

    Args:
        A, B, gains: vertex matrices and u = +gain e.
        cost: P.
        error_weight: Q.
        input_weight: R.

    Returns:
        One margin a vertex, up to rounding of float64; the cost decreases by the stage cost where
        it is >= 0.

    Source: Gonzalez et al. 2009, eq. (32).
    """
    surplus = compute_decrease(A, B, gains, cost) - stage_cost(gains, error_weight, input_weight)
    return np.linalg.eigvalsh(surplus)[:, 0]


class _Goal(NamedTuple):
    """An objective to minimise, scaled to order one, with the constraints that it needs and the
    unit that it was divided by."""

    objective: Float[np.ndarray, "1+k"]
    constraints: list[Affine]
    exponential: Float[np.ndarray, "1+k l 3"] | None
    unit: float


def _solve(
    A, B, Q_factor, T, objective: Objective, shares_gain: bool
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Solve L_i >= 0 for R = I and Q = Q_factor^T Q_factor, where P = T^-T S^-1 T^-1: S, Y_i and
    multipliers Z_i."""
    count, n, m = B.shape
    of_goal = {
        "trace_s": [],
        "trace_p": [symmetric_basis(n)],
        "logdet": [triangular_basis(n), full_basis(n, 1)],
    }[objective]
    gains = 1 if shares_gain else count
    S, *others = make_unknowns(symmetric_basis(n), *[full_basis(m, n)] * gains, *of_goal)
    Y = others[:1] * count if shares_gain else others[:count]
    decrease = [_state_decrease(a, b, S, y, Q_factor) for a, b, y in zip(A, B, Y, strict=True)]
    floor = S - lift(COST_FLOOR * np.eye(n), len(S) - 1)
    goal = _state_goal(S, others[gains:], T, objective)
    answer = _answer(goal, [*decrease, floor, *goal.constraints])
    multipliers = goal.unit * np.array(answer.multipliers[:count])
    return evaluate(S, answer.x), np.array([evaluate(y, answer.x) for y in Y]), multipliers


def _state_decrease(a, b, S: Affine, y: Affine, Q_factor) -> Affine:
    """Return the decrease of the cost at one vertex, as a Schur complement."""
    n, m = b.shape
    no_error = np.zeros((n, n))
    no_input = np.zeros((n, m))
    following = a @ S + b @ y
    weighted = Q_factor @ S
    rows = [
        [S, transpose(following), transpose(weighted), transpose(y)],
        [following, S, no_error, no_input],
        [weighted, no_error, np.eye(n), no_input],
        [y, no_input.T, no_input.T, np.eye(m)],
    ]
    return block_matrix(rows)


def _state_goal(S: Affine, unknowns: list[Affine], T: np.ndarray, objective: Objective) -> _Goal:
    """State the objective in S and in unknowns of its own: Z >= L S^-1 L^T for `trace_p`; for
    `logdet` an upper triangular U and t, where D = diag U, t_i <= log D_ii and S >= U^T D^-1 U,
    whose determinant is that of D."""
    if objective == "trace_s":
        unit = np.sum(T**2)
        return _Goal(-trace(T.T @ T / unit @ S), [], None, unit)
    if objective == "trace_p":
        (Z,) = unknowns
        L = np.linalg.inv(T).T
        unit = np.sum(L**2)
        scaled = L / np.sqrt(unit)
        return _Goal(trace(Z), [block_matrix([[Z, scaled], [scaled.T, S]])], None, unit)
    U, t = unknowns
    n = len(T)
    D = U * np.eye(n)
    bound = block_matrix([[D, U], [transpose(U), S]])
    logarithms = block_matrix([[t, np.ones((n, 1)), D @ np.ones((n, 1))]])
    return _Goal(-np.sum(t, axis=(1, 2)), [bound], logarithms, 1.0)


def _answer(goal: _Goal, constraints: list[Affine]) -> Answer:
    """Return the solver's answer with the first settings that bring one, else its last one that is
    almost one.

    Raises:
        RuntimeError: there is none.
    """
    answers = []
    for tolerance, decompose in itertools.product(SOLVER_TOLERANCES, (False, True)):
        tolerances = dict.fromkeys(("tol_gap_abs", "tol_gap_rel", "tol_feas"), tolerance)
        settings = {"chordal_decomposition_enable": decompose, **tolerances}
        answers.append(minimise(goal.objective, constraints, goal.exponential, **settings))
        if answers[-1].status in (SOLVED, INFEASIBLE):
            break
    # What is almost an answer is scaled and checked afterwards.
    usable = [answer for answer in answers if answer.status in (SOLVED, ALMOST_SOLVED)]
    if not usable or answers[-1].status == INFEASIBLE:
        raise RuntimeError(
            f"terminal_cost: Clarabel reports {answers[-1].status}, not optimal; narrow the "
            "schedule or bring the weights nearer to each other"
        )
    return usable[-1]


def _compute_value(P: np.ndarray, objective: Objective) -> float:
    if objective == "logdet":
        return -float(np.linalg.slogdet(P)[1])
    return float(np.trace(P if objective == "trace_p" else np.linalg.inv(P)))


def _find_scale(A, B, Q, R) -> np.ndarray:
    """Return the Riccati cost of one vertex, which sets the coordinates of the inequality.

    The solver's answer keeps ten digits of the objective and five of the gains, so it changes with
    the last bits of its coordinates: scipy's answer is taken wherever it is one.
    """
    try:
        P = scipy.linalg.solve_discrete_are(A, B, Q, R)
    except (np.linalg.LinAlgError, ValueError):
        return solve_riccati(A, B, Q, R)
    gain = compute_gain(A, B, P, R)
    residual = compute_decrease(A, B, gain, P) - Q - gain.T @ R @ gain
    is_solution = np.abs(residual).max() <= 1e-10 * np.abs(P).max()
    return P if is_solution and is_stabilising(A, B, P, R) else solve_riccati(A, B, Q, R)


def compute_root(weight: np.ndarray) -> np.ndarray:
    w, v = np.linalg.eigh(weight)
    return (v * np.sqrt(w)) @ v.T


def _raise_in_turn(Q: np.ndarray, R: np.ndarray) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Yield the weights raised to each of `SHARES`, those that differ from the last ones."""
    known: list[np.ndarray] = []
    for share in SHARES:
        weights = raise_weights(Q, R, share)
        if not known or not all(map(np.array_equal, weights, known)):
            yield weights
        known = list(weights)


def raise_weights(Q: np.ndarray, R: np.ndarray, share: float) -> tuple[np.ndarray, np.ndarray]:
    """Return Q and R with their eigenvalues raised to a share of the largest of both, those of Q to
    `WEIGHT_FLOOR` at least."""
    most_error = np.linalg.eigvalsh(Q)[-1]
    most_input = np.linalg.eigvalsh(R)[-1]
    least = share * max(most_error, most_input)
    return _raise_weight(Q, max(least, WEIGHT_FLOOR * most_error)), _raise_weight(R, least)


def _raise_weight(weight: np.ndarray, least: float) -> np.ndarray:
    w, v = np.linalg.eigh(weight)
    return weight if w[0] >= least else (v * np.maximum(w, least)) @ v.T
