"""Terminal cost and vertex gains of a linear parameter-varying system, by one linear matrix
inequality a vertex.

For e+ = A_i e + B_i u, u = Gamma^i e, find one P with

    P - (A_i + B_i Gamma^i)^T P (A_i + B_i Gamma^i) >= Q + Gamma^iT R Gamma^i        at every vertex i.

With S = P^-1 and Y_i = Gamma^i S this is, by Schur complements,

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

from sets.lyapunov import scaled_to_decrease, stage_cost

Objective = Literal["trace_s", "trace_p", "logdet"]

# A semidefinite Q is raised to this share of its largest eigenvalue: a decrease that is asked for
# in every direction keeps S bounded (S <= Q^-1).
WEIGHT_FLOOR = 1e-6
# trace S alone can drive S to a singular matrix, whose P and gains do not exist. This floor,
# relative to the Riccati solutions, keeps P <= P_riccati / COST_FLOOR; its price is part of the gap
# that `optimality_gap` reports.
COST_FLOOR = 1e-4
# The first that the solver reaches counts, without and with its chordal decomposition: each stalls
# on some data.
SOLVER_TOLERANCES = (1e-10, 1e-9, 1e-8)
# Any number gives a valid lower bound on the cost; more sharpen it.
VALUE_ITERATIONS = 100


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

    Args: A, B: vertex matrices of e+ = A e + B u. error_weight: Q >= 0. input_weight: R > 0.
    Returns: the cost, with `decrease_margin` >= 0 in float64 at every vertex. Where B is the same
    at all vertices this
        holds for every convex combination of them, with the gains combined by the same weights.
    Raises: ValueError for shapes or weights that are refused or a vertex that no gain stabilises,
        RuntimeError if the solver does not report `optimal` or its answer does not decrease.
    Source: Gonzalez et al. 2009, eqs. (32)-(41).
    """
    if objective not in get_args(Objective):
        raise ValueError(
            f"objective is {objective!r}: choose one of {', '.join(get_args(Objective))}"
        )
    _check_system(A.shape[:1], A, B, error_weight, input_weight)
    Q, R = _floored(error_weight), input_weight
    # Coordinates in which the mean Riccati cost and the input weight are identities: the solver
    # then meets numbers of order one whatever the units, and 0 <= S <= I because no cost lies below
    # a vertex's own Riccati cost.
    L = np.linalg.cholesky(
        np.mean([_riccati(a, b, Q, R) for a, b in zip(A, B, strict=True)], axis=0)
    )
    T, F = np.linalg.inv(L).T, np.linalg.inv(_root(R))
    S, Y, Z = _solve(L.T @ A @ T, L.T @ B @ F, _root(Q) @ T, T, objective)
    P = L @ np.linalg.inv(S) @ L.T
    gains = F @ Y @ np.linalg.inv(S) @ L.T
    P = _repaired(A, B, gains, (P + P.T) / 2, Q, R)
    if not (decrease_margin(A, B, gains, P, error_weight, R) >= 0).all():
        raise RuntimeError(
            "terminal_cost: the answer does not decrease at a vertex; rescale the weights"
        )
    back = scipy.linalg.block_diag(L.T, L.T, np.eye(sum(B.shape[1:])))
    return TerminalCost(P, gains, back.T @ Z @ back, objective, _value(P, objective))


def lqr_gain(
    A: Float[np.ndarray, "n n"],
    B: Float[np.ndarray, "n m"],
    error_weight: Float[np.ndarray, "n n"],
    input_weight: Float[np.ndarray, "m m"],
) -> Float[np.ndarray, "m n"]:
    """Compute the gain K of the discrete linear-quadratic regulator, u = +K e.

    Args: A, B: e+ = A e + B u. error_weight: Q >= 0. input_weight: R > 0. Returns: K, for which A +
    B K is stable. Raises: ValueError for shapes or weights that are refused or a pair without
    stabilising solution. Source: Gonzalez et al. 2009, eq. (22).
    """
    _check_system((), A, B, error_weight, input_weight)
    P = _riccati(A, B, error_weight, input_weight)
    return -np.linalg.solve(input_weight + B.T @ P @ B, B.T @ P @ A)


def decrease_margin(
    A: Float[np.ndarray, "vertices n n"],
    B: Float[np.ndarray, "vertices n m"],
    gains: Float[np.ndarray, "vertices m n"],
    cost: Float[np.ndarray, "n n"],
    error_weight: Float[np.ndarray, "n n"],
    input_weight: Float[np.ndarray, "m m"],
) -> Float[np.ndarray, " vertices"]:
    """Return the smallest eigenvalue of P - Phi^T P Phi - Q - Gamma^T R Gamma, Phi = A + B Gamma,
    at every vertex.

    Args: A, B, gains: vertex matrices and u = +gain e. cost: P. error_weight: Q. input_weight: R.
    Returns: one margin a vertex, up to rounding of float64; the cost decreases by the stage cost
    where it is >= 0. Source: Gonzalez et al. 2009, eq. (32).
    """
    return np.linalg.eigvalsh(
        _decrease(A, B, gains, cost) - stage_cost(gains, error_weight, input_weight)
    )[:, 0]


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

    Args: A, B, error_weight, input_weight: as given to `terminal_cost`. terminal: its answer, or
    any other. Returns: an upper bound on the suboptimality, up to rounding of float64 and whatever
    the multipliers: relative to
        trace S or trace P, absolute for log det S. A semidefinite Q is raised as in
        `terminal_cost`.
    Raises: ValueError for shapes or weights that are refused.
    Source: Vandenberghe, Boyd 1996, section 3 (weak duality of semidefinite programs).
    """
    _check_system(A.shape[:1], A, B, error_weight, input_weight)
    n, P = A.shape[1], terminal.cost
    Q, R = _floored(error_weight), input_weight
    Q_root, R_root = _root(Q), _root(R)
    M, unit = {
        "trace_s": (np.eye(n), np.trace(np.linalg.inv(P))),
        "trace_p": (P @ P, np.trace(P)),
        "logdet": (P, 1.0),
    }[terminal.objective]
    w, v = np.linalg.eigh((terminal.multipliers + _transpose(terminal.multipliers)) / 2)
    Z = (v * np.maximum(w, 0)[:, None, :]) @ _transpose(v)
    Z_next, Z_error, Z_input = Z[:, n : 2 * n, :n], Z[:, 2 * n : 3 * n, :n], Z[:, 3 * n :, :n]
    r = M + np.sum(
        Z[:, :n, :n]
        + Z[:, n : 2 * n, n : 2 * n]
        + 2 * _transpose(A) @ Z_next
        + 2 * Q_root @ Z_error,
        axis=0,
    )
    r_inputs = 2 * (_transpose(B) @ Z_next + R_root @ Z_input)
    G_inverse = np.linalg.inv(np.linalg.cholesky(_least_cost(A, B, Q, R)))
    constant = np.trace(Z[:, 2 * n :, 2 * n :], axis1=1, axis2=2).sum()
    from_cost = np.maximum(np.linalg.eigvalsh(G_inverse @ (r + r.T) @ G_inverse.T / 2), 0).sum()
    from_gains = np.linalg.svd(
        np.linalg.solve(R_root, r_inputs @ G_inverse.T), compute_uv=False
    ).sum()
    return float((constant + from_cost + from_gains - np.trace(M @ np.linalg.inv(P))) / unit)


def _solve(A, B, Q_factor, T, objective: Objective) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Solve L_i >= 0 for R = I and Q = Q_factor^T Q_factor, where P = T^-T S^-1 T^-1: S, Y_i and
    multipliers Z_i."""
    import cvxpy as cp  # here because it takes seconds to import

    (_, n, m), zeros, eye = B.shape, np.zeros, np.eye
    S = cp.Variable((n, n), symmetric=True)
    Y = [cp.Variable((m, n)) for _ in A]

    def block(a, b, y) -> Any:
        following, weighted = a @ S + b @ y, Q_factor @ S
        rows = [
            [S, following.T, weighted.T, y.T],
            [following, S, zeros((n, n)), zeros((n, m))],
            [weighted, zeros((n, n)), eye(n), zeros((n, m))],
            [y, zeros((m, n)), zeros((m, n)), eye(m)],
        ]
        return cp.bmat(rows) >> 0

    decrease = [block(*vertex) for vertex in zip(A, B, Y, strict=True)]
    goal, extra, unit = _goal(cp, S, T, objective)
    problem = cp.Problem(goal, [*decrease, S >> COST_FLOOR * eye(n), *extra])
    for tolerance, decompose in itertools.product(SOLVER_TOLERANCES, (False, True)):
        settings = {name: tolerance for name in ("tol_gap_abs", "tol_gap_rel", "tol_feas")}
        with contextlib.suppress(cp.SolverError), warnings.catch_warnings():
            warnings.simplefilter(
                "ignore"
            )  # cvxpy warns of the inaccurate answers that are refused here
            problem.solve(solver=cp.CLARABEL, chordal_decomposition_enable=decompose, **settings)
        if problem.status in (cp.OPTIMAL, cp.INFEASIBLE):
            break
    if problem.status != cp.OPTIMAL:
        raise RuntimeError(
            f"terminal_cost: Clarabel reports {problem.status}, not optimal; narrow the schedule"
        )
    multipliers = unit * np.array([constraint.dual_value for constraint in decrease])
    return np.asarray(S.value), np.array([y.value for y in Y]), multipliers


def _goal(cp: Any, S: Any, T: np.ndarray, objective: Objective) -> tuple[Any, list[Any], float]:
    """State the objective, scaled to order one, with the constraints it needs and the unit it was
    divided by."""
    if objective == "trace_s":
        unit = np.sum(T**2)
        return cp.Maximize(cp.trace(T.T @ T / unit @ S)), [], unit
    if objective == "trace_p":
        L, n = np.linalg.inv(T).T, len(T)
        unit = np.sum(L**2)
        Z = cp.Variable((n, n), symmetric=True)
        bound = cp.bmat([[Z, L / np.sqrt(unit)], [L.T / np.sqrt(unit), S]]) >> 0
        return cp.Minimize(cp.trace(Z)), [bound], unit
    return cp.Maximize(cp.log_det(S)), [], 1.0


def _repaired(A, B, gains, P, Q, R) -> np.ndarray:
    """Scale P by the smallest factor that makes the decrease exact for these gains: solvers miss it
    by about 1e-6."""
    return scaled_to_decrease(P, A + B @ gains, stage_cost(gains, Q, R))


def _least_cost(A, B, Q, R) -> np.ndarray:
    """Bound every feasible P from below: value iteration from Q rises at each vertex and never
    passes it."""
    P = np.broadcast_to(Q, A.shape)
    for _ in range(VALUE_ITERATIONS):
        gains = -np.linalg.solve(R + _transpose(B) @ P @ B, _transpose(B) @ P @ A)
        P = P - _decrease(A, B, gains, P) + stage_cost(gains, Q, R)
    return P.mean(axis=0)


def _decrease(A, B, gains, P) -> np.ndarray:
    Phi = A + B @ gains
    return P - _transpose(Phi) @ P @ Phi


def _value(P: np.ndarray, objective: Objective) -> float:
    if objective == "logdet":
        return -float(np.linalg.slogdet(P)[1])
    return float(np.trace(P if objective == "trace_p" else np.linalg.inv(P)))


def _riccati(A, B, Q, R) -> np.ndarray:
    try:
        return scipy.linalg.solve_discrete_are(A, B, Q, R)
    except np.linalg.LinAlgError:
        raise ValueError(
            f"A = {A.tolist()} with this B has no stabilising gain: change the pair"
        ) from None


def _root(weight: np.ndarray) -> np.ndarray:
    w, v = np.linalg.eigh(weight)
    return (v * np.sqrt(w)) @ v.T


def _floored(Q: np.ndarray) -> np.ndarray:
    w, v = np.linalg.eigh(Q)
    return Q if w[0] >= WEIGHT_FLOOR * w[-1] else (v * np.maximum(w, WEIGHT_FLOOR * w[-1])) @ v.T


def _transpose(stack: np.ndarray) -> np.ndarray:
    return np.swapaxes(stack, -1, -2)


def _check_system(stack: tuple[int, ...], A, B, error_weight, input_weight) -> None:
    """Refuse shapes and weights that the problem does not cover; `stack` is the leading shape of A
    and B."""
    n, m = A.shape[-1], B.shape[-1]
    shapes = {
        "A": (*stack, n, n),
        "B": (*stack, n, m),
        "error_weight": (n, n),
        "input_weight": (m, m),
    }
    for (name, shape), matrix in zip(
        shapes.items(), (A, B, error_weight, input_weight), strict=True
    ):
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
            f"error_weight has eigenvalues {least:.3g} to {most:.3g}: make it semidefinite and not zero"
        )
    least = np.linalg.eigvalsh(input_weight)[0]
    if least <= 0:
        raise ValueError(f"input_weight has eigenvalue {least:.3g}: make it positive definite")
