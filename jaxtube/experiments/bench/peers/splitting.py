# ruff: noqa: E741 -- l and u are the letters of the problem
"""Solvers that approach the answer by first-order or proximal steps: OSQP and ProxQP.

Source: Stellato, Banjac, Goulart, Bemporad, Boyd, Mathematical Programming Computation 2020 (OSQP);
Bambade, El-Kazdadi, Taylor, Carpentier, Robotics: Science and Systems 2022 (ProxQP).
"""

from __future__ import annotations

import importlib
from typing import Any

from scipy.sparse import csc_matrix

from jaxtube.experiments.bench.peers.problems import (
    Problems,
    Solver,
    contiguous,
    one_by_one,
    without_infinity,
)

MOST_ITERATIONS = 100_000


def make_osqp(problems: Problems, tolerance: float, polishing: bool) -> Solver:
    """Return OSQP, each program begun without the answer of the one before."""
    osqp: Any = importlib.import_module("osqp")
    solver = osqp.OSQP()
    # It takes no arrays of scipy's newer kind.
    solver.setup(
        csc_matrix(problems.P),
        problems.q[0],
        csc_matrix(problems.A),
        problems.l[0],
        problems.u[0],
        verbose=False,
        eps_abs=tolerance,
        eps_rel=0.0,
        max_iter=MOST_ITERATIONS,
        polishing=polishing,
        warm_starting=False,
    )

    def solve(q, l, u):
        solver.update(q=q, l=l, u=u)
        return solver.solve(raise_error=False)

    return one_by_one(list(contiguous(problems.q, problems.l, problems.u)), solve, _read_osqp)


def _read_osqp(answer) -> tuple:
    return answer.x, answer.y


def make_proxqp(problems: Problems, tolerance: float) -> Solver:
    """Return ProxQP, dense, each program begun without the answer of the one before."""
    proxqp: Any = importlib.import_module("proxsuite").proxqp
    rows, columns = problems.A.shape
    solver = proxqp.dense.QP(columns, 0, rows)
    data = list(contiguous(problems.q, without_infinity(problems.l), without_infinity(problems.u)))
    q, l, u = data[0]
    solver.settings.eps_abs = tolerance
    solver.settings.eps_rel = 0.0
    # Its other cold start, at zero, calls some of the programs infeasible.
    solver.settings.initial_guess = proxqp.InitialGuess.EQUALITY_CONSTRAINED_INITIAL_GUESS
    solver.init(problems.P, q, None, None, problems.A, l, u)

    def solve(q, l, u):
        solver.update(g=q, l=l, u=u)
        solver.solve()
        return solver.results

    return one_by_one(data, solve, _read_proxqp)


def _read_proxqp(results) -> tuple:
    return results.x, results.z
