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

import contextlib
import itertools
import warnings
from dataclasses import dataclass
from typing import Any, Literal, get_args

import numpy as np
import scipy.linalg
from jaxtyping import Float

from sets.lyapunov import scale_to_decrease, stage_cost

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
floor is part of the gap that `optimality_gap` reports.
"""

SOLVER_TOLERANCES = (1e-10, 1e-9, 1e-8)
"""The first that the solver reaches counts, without and with its chordal decomposition: each stalls
on some data."""

VALUE_ITERATIONS = 100
"""Any number gives a valid lower bound on the cost; more sharpen it."""

DOUBLINGS = 60
"""Doublings of the horizon after which a Riccati recursion without limit is given up."""


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
) -> TerminalCost:
    """Compute a quadratic terminal cost and vertex gains that decrease it by the stage cost at
    every vertex.

    Args:
        A, B: vertex matrices of e+ = A e + B u.
        error_weight: Q >= 0.
        input_weight: R > 0.
        objective: what the cost is best at, see the module.

    Returns:
        The cost, with `decrease_margins` >= 0 in float64 at every vertex. Where B is the same at
        all vertices this holds for every convex combination of them, with the gains combined by
        the same weights.

    Raises:
        ValueError: shapes or weights that are refused, or a vertex that no gain stabilises.
        RuntimeError: the solver does not report `optimal`, or its answer does not decrease.

    Source: Gonzalez et al. 2009, eqs. (32)-(41).
    """
    if objective not in get_args(Objective):
        raise ValueError(
            f"objective is {objective!r}: choose one of {', '.join(get_args(Objective))}"
        )
    _check_system(A.shape[:1], A, B, error_weight, input_weight)
    failure = None
    last = None
    for share in SHARES:
        weights = _raise_weights(error_weight, input_weight, share)
        if last is not None and all(map(np.array_equal, weights, last)):
            continue
        last = weights
        try:
            terminal = _solve_scaled(A, B, *weights, objective)
        except RuntimeError as refusal:
            failure = refusal
            continue
        margins = decrease_margins(A, B, terminal.gains, terminal.cost, error_weight, input_weight)
        if (margins >= 0).all():
            return terminal
    raise failure or RuntimeError(
        "terminal_cost: the answer does not decrease at a vertex; rescale the weights"
    )


def _solve_scaled(A, B, Q, R, objective: Objective) -> TerminalCost:
    """Solve for the terminal cost in coordinates in which the mean Riccati cost and the input
    weight are identities.

    The solver then meets numbers of order one whatever the units, and 0 <= S <= I because no cost
    lies below a vertex's own Riccati cost.
    """
    riccati = [_find_scale(a, b, Q, R) for a, b in zip(A, B, strict=True)]
    L = np.linalg.cholesky(np.mean(riccati, axis=0))
    T = np.linalg.inv(L).T
    F = np.linalg.inv(_compute_root(R))
    S, Y, Z = _solve(L.T @ A @ T, L.T @ B @ F, _compute_root(Q) @ T, T, objective)
    S_inverse = np.linalg.inv(S)
    P = L @ S_inverse @ L.T
    gains = F @ Y @ S_inverse @ L.T
    # Solvers miss the decrease by about 1e-6.
    P = scale_to_decrease((P + P.T) / 2, A + B @ gains, stage_cost(gains, Q, R))
    back = scipy.linalg.block_diag(L.T, L.T, np.eye(sum(B.shape[1:])))
    return TerminalCost(P, gains, back.T @ Z @ back, objective, _compute_value(P, objective))


def lqr_gain(
    A: Float[np.ndarray, "n n"],
    B: Float[np.ndarray, "n m"],
    error_weight: Float[np.ndarray, "n n"],
    input_weight: Float[np.ndarray, "m m"],
) -> Float[np.ndarray, "m n"]:
    """Compute the gain K of the discrete linear-quadratic regulator, u = +K e.

    Args:
        A, B: e+ = A e + B u.
        error_weight: Q >= 0.
        input_weight: R > 0.

    Returns:
        K, for which A + B K is stable.

    Raises:
        ValueError: shapes or weights that are refused, or a pair without stabilising solution.

    Source: Gonzalez et al. 2009, eq. (22).
    """
    _check_system((), A, B, error_weight, input_weight)
    P = _solve_riccati(A, B, error_weight, input_weight)
    return _compute_gain(A, B, P, input_weight)


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
    surplus = _compute_decrease(A, B, gains, cost) - stage_cost(gains, error_weight, input_weight)
    return np.linalg.eigvalsh(surplus)[:, 0]


def optimality_gap(
    A: Float[np.ndarray, "vertices n n"],
    B: Float[np.ndarray, "vertices n m"],
    error_weight: Float[np.ndarray, "n n"],
    input_weight: Float[np.ndarray, "m m"],
    terminal: TerminalCost,
) -> float:
    """Bound how far a terminal cost is from the best one for its objective, by weak duality.

    The objectives are concave in S, so none gains more over S_0 = P^-1 than its tangent <M, S -
    S_0>, M = I, P^2 or P. For every Z_i >= 0, projected here, and every feasible (S, Y_i),

        <M, S> <= <M, S> + sum_i <Z_i, L_i(S, Y_i)> = constant + <r, S> + sum_i <r_i, Y_i>,

    and with any P_0 = G G^T below every feasible P, L_i >= 0 gives 0 <= G^T S G <= I and |R^(1/2)
    Y_i G| <= 1: the residual terms are below a sum of positive eigenvalues and nuclear norms.

    Args:
        A, B, error_weight, input_weight: as given to `terminal_cost`.
        terminal: its answer, or any other.

    Returns:
        An upper bound on the suboptimality, up to rounding of float64 and whatever the multipliers:
        relative to trace S or trace P, absolute for log det S. Q and R are raised as in
        `terminal_cost`.

    Raises:
        ValueError: shapes or weights that are refused.

    Source: Vandenberghe, Boyd 1996, section 3 (weak duality of semidefinite programs).
    """
    _check_system(A.shape[:1], A, B, error_weight, input_weight)
    n = A.shape[1]
    P = terminal.cost
    S = np.linalg.inv(P)
    Q, R = _raise_weights(error_weight, input_weight, SHARES[0])
    Q_root = _compute_root(Q)
    R_root = _compute_root(R)
    M, unit = {
        "trace_s": (np.eye(n), np.trace(S)),
        "trace_p": (P @ P, np.trace(P)),
        "logdet": (P, 1.0),
    }[terminal.objective]
    Z = _project(terminal.multipliers)
    Z_now = Z[:, :n, :n]
    Z_next = Z[:, n : 2 * n, :n]
    Z_error = Z[:, 2 * n : 3 * n, :n]
    Z_input = Z[:, 3 * n :, :n]
    own = Z_now + Z[:, n : 2 * n, n : 2 * n]
    r = M + np.sum(own + 2 * _transpose(A) @ Z_next + 2 * Q_root @ Z_error, axis=0)
    r_inputs = 2 * (_transpose(B) @ Z_next + R_root @ Z_input)
    G_inverse = np.linalg.inv(np.linalg.cholesky(_bound_cost_below(A, B, Q, R)))
    constant = np.trace(Z[:, 2 * n :, 2 * n :], axis1=1, axis2=2).sum()
    along_cost = np.linalg.eigvalsh(G_inverse @ (r + r.T) @ G_inverse.T / 2)
    along_gains = np.linalg.solve(R_root, r_inputs @ G_inverse.T)
    from_cost = np.maximum(along_cost, 0).sum()
    from_gains = np.linalg.svd(along_gains, compute_uv=False).sum()
    return float((constant + from_cost + from_gains - np.trace(M @ S)) / unit)


def _project(multipliers: np.ndarray) -> np.ndarray:
    """Return the nearest positive semidefinite matrices."""
    w, v = np.linalg.eigh((multipliers + _transpose(multipliers)) / 2)
    return (v * np.maximum(w, 0)[:, None, :]) @ _transpose(v)


def _solve(A, B, Q_factor, T, objective: Objective) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Solve L_i >= 0 for R = I and Q = Q_factor^T Q_factor, where P = T^-T S^-1 T^-1: S, Y_i and
    multipliers Z_i."""
    import cvxpy as cp  # here because it takes seconds to import

    _, n, m = B.shape
    S = cp.Variable((n, n), symmetric=True)
    Y = [cp.Variable((m, n)) for _ in A]
    no_error = np.zeros((n, n))
    no_input = np.zeros((n, m))

    def require_decrease(a, b, y) -> Any:
        following = a @ S + b @ y
        weighted = Q_factor @ S
        rows = [
            [S, following.T, weighted.T, y.T],
            [following, S, no_error, no_input],
            [weighted, no_error, np.eye(n), no_input],
            [y, no_input.T, no_input.T, np.eye(m)],
        ]
        return cp.bmat(rows) >> 0

    decrease = [require_decrease(a, b, y) for a, b, y in zip(A, B, Y, strict=True)]
    goal, extra, unit = _state_goal(cp, S, T, objective)
    problem = cp.Problem(goal, [*decrease, S >> COST_FLOOR * np.eye(n), *extra])
    for tolerance, decompose in itertools.product(SOLVER_TOLERANCES, (False, True)):
        settings = dict.fromkeys(("tol_gap_abs", "tol_gap_rel", "tol_feas"), tolerance)
        with contextlib.suppress(cp.SolverError), warnings.catch_warnings():
            # cvxpy warns of the inaccurate answers that are refused here.
            warnings.simplefilter("ignore")
            problem.solve(solver=cp.CLARABEL, chordal_decomposition_enable=decompose, **settings)
        if problem.status in (cp.OPTIMAL, cp.INFEASIBLE):
            break
    # What is inaccurate is scaled and checked afterwards.
    if problem.status not in (cp.OPTIMAL, cp.OPTIMAL_INACCURATE):
        raise RuntimeError(
            f"terminal_cost: Clarabel reports {problem.status}, not optimal; narrow the schedule "
            "or bring the weights nearer to each other"
        )
    multipliers = unit * np.array([constraint.dual_value for constraint in decrease])
    return np.asarray(S.value), np.array([y.value for y in Y]), multipliers


def _state_goal(
    cp: Any, S: Any, T: np.ndarray, objective: Objective
) -> tuple[Any, list[Any], float]:
    """State the objective, scaled to order one, with the constraints it needs and the unit it was
    divided by."""
    if objective == "trace_s":
        unit = np.sum(T**2)
        return cp.Maximize(cp.trace(T.T @ T / unit @ S)), [], unit
    if objective == "trace_p":
        n = len(T)
        L = np.linalg.inv(T).T
        unit = np.sum(L**2)
        scaled = L / np.sqrt(unit)
        Z = cp.Variable((n, n), symmetric=True)
        bound = cp.bmat([[Z, scaled], [scaled.T, S]]) >> 0
        return cp.Minimize(cp.trace(Z)), [bound], unit
    return cp.Maximize(cp.log_det(S)), [], 1.0


def _bound_cost_below(A, B, Q, R) -> np.ndarray:
    """Bound every feasible P from below: value iteration from Q rises at each vertex and never
    passes it."""
    P = np.broadcast_to(Q, A.shape)
    for _ in range(VALUE_ITERATIONS):
        gains = _compute_gain(A, B, P, R)
        P = P - _compute_decrease(A, B, gains, P) + stage_cost(gains, Q, R)
    return P.mean(axis=0)


def _compute_gain(A, B, P, R) -> np.ndarray:
    """Return the inputs that minimise u^T R u + e+^T P e+, as a gain."""
    return -np.linalg.solve(R + _transpose(B) @ P @ B, _transpose(B) @ P @ A)


def _compute_decrease(A, B, gains, P) -> np.ndarray:
    """Return P - Phi^T P Phi."""
    Phi = A + B @ gains
    return P - _transpose(Phi) @ P @ Phi


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
        return _solve_riccati(A, B, Q, R)
    gain = _compute_gain(A, B, P, R)
    residual = _compute_decrease(A, B, gain, P) - Q - gain.T @ R @ gain
    is_solution = np.abs(residual).max() <= 1e-10 * np.abs(P).max()
    return P if is_solution and _is_stabilising(A, B, P, R) else _solve_riccati(A, B, Q, R)


def _solve_riccati(A, B, Q, R) -> np.ndarray:
    """Return the stabilising solution of P = Q + A^T P (I + B R^-1 B^T P)^-1 A by a recursion whose
    every step doubles the horizon of the cost P.

    With G = B R^-1 B^T, Phi = A, P = Q at first:

        Phi+ = Phi M Phi,    G+ = G + Phi M G Phi^T,    P+ = P + Phi^T P M Phi,    M = (I + G P)^-1

    Unlike an ordered Schur form it depends on the ratio of the weights alone, however far apart.

    Source: Chu, Fan, Lin, Wang 2004, Int. J. Control 77, 767-788.
    """
    eye = np.eye(len(A))
    G = B @ np.linalg.solve(R, B.T)
    Phi = A
    P = Q
    with np.errstate(all="ignore"):
        for _ in range(DOUBLINGS):
            M = np.linalg.inv(eye + G @ P)
            rise = Phi.T @ P @ M @ Phi
            G = G + Phi @ M @ G @ Phi.T
            Phi = Phi @ M @ Phi
            P = P + (rise + rise.T) / 2
            if not all(np.isfinite(matrix).all() for matrix in (P, Phi, G)):
                break
            if np.abs(rise).max() <= 1e-16 * np.abs(P).max() and _is_stabilising(A, B, P, R):
                return P
    raise ValueError(
        f"A = {A.tolist()} with this B has no stabilising gain: change the pair or weigh all errors"
    )


def _is_stabilising(A, B, P, R) -> bool:
    loop = A + B @ _compute_gain(A, B, P, R)
    return bool(np.abs(np.linalg.eigvals(loop)).max() < 1)


def _compute_root(weight: np.ndarray) -> np.ndarray:
    w, v = np.linalg.eigh(weight)
    return (v * np.sqrt(w)) @ v.T


def _raise_weights(Q: np.ndarray, R: np.ndarray, share: float) -> tuple[np.ndarray, np.ndarray]:
    """Return Q and R with their eigenvalues raised to a share of the largest of both, those of Q to
    `WEIGHT_FLOOR` at least."""
    most_error = np.linalg.eigvalsh(Q)[-1]
    most_input = np.linalg.eigvalsh(R)[-1]
    least = share * max(most_error, most_input)
    return _raise_weight(Q, max(least, WEIGHT_FLOOR * most_error)), _raise_weight(R, least)


def _raise_weight(weight: np.ndarray, least: float) -> np.ndarray:
    w, v = np.linalg.eigh(weight)
    return weight if w[0] >= least else (v * np.maximum(w, least)) @ v.T


def _transpose(stack: np.ndarray) -> np.ndarray:
    return np.swapaxes(stack, -1, -2)


def _check_system(stack: tuple[int, ...], A, B, error_weight, input_weight) -> None:
    """Refuse shapes and weights that the problem does not cover; `stack` is the leading shape of A
    and B."""
    n = A.shape[-1]
    m = B.shape[-1]
    expected = (
        ("A", A, (*stack, n, n)),
        ("B", B, (*stack, n, m)),
        ("error_weight", error_weight, (n, n)),
        ("input_weight", input_weight, (m, m)),
    )
    for name, matrix, shape in expected:
        if matrix.shape != shape:
            raise ValueError(f"{name} has shape {matrix.shape}: give it shape {shape}")
        if not np.isfinite(matrix).all():
            raise ValueError(f"{name} holds {matrix[~np.isfinite(matrix)][0]}: give finite numbers")
    for name, weight in (("error_weight", error_weight), ("input_weight", input_weight)):
        skew = np.abs(weight - weight.T).max()
        if skew > 1e-12 * np.abs(weight).max():
            raise ValueError(f"{name} differs from its transpose by {skew:.3g}: make it symmetric")
    least, most = np.linalg.eigvalsh(error_weight)[[0, -1]]
    if most <= 0 or least < -1e-12 * most:
        raise ValueError(
            f"error_weight has eigenvalues {least:.3g} to {most:.3g}: "
            "make it semidefinite and not zero"
        )
    least = np.linalg.eigvalsh(input_weight)[0]
    if least <= 0:
        raise ValueError(f"input_weight has eigenvalue {least:.3g}: make it positive definite")
