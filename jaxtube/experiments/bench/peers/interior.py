"""Interior point solvers: PIQP and Clarabel one program at a time, qpax the whole batch.

Source: Schwan, Jiang, Kuhn, Jones, CDC 2023 (PIQP); Goulart and Chen, arXiv 2405.12762 (Clarabel);
Tracy and Manchester, arXiv 2406.11749 (qpax).
"""

from __future__ import annotations

import importlib
from collections.abc import Callable
from typing import Any

import numpy as np
from scipy.sparse import csc_array

from jaxtube.experiments.bench.peers.problems import (
    Answers,
    OneSided,
    Problems,
    Solver,
    contiguous,
    one_by_one,
)

QPAX_ITERATIONS = 60


def make_piqp(problems: Problems, tolerance: float) -> Solver:
    """Return PIQP, dense."""
    piqp: Any = importlib.import_module("piqp")
    solver = piqp.DenseSolver()
    solver.settings.eps_abs = tolerance
    solver.settings.eps_rel = 0.0
    solver.settings.eps_duality_gap_abs = tolerance
    solver.settings.eps_duality_gap_rel = 0.0
    data = list(contiguous(problems.q, problems.l, problems.u))
    q, lower, upper = data[0]
    P = np.asfortranarray(problems.P)
    solver.setup(P, q, G=np.asfortranarray(problems.A), h_l=lower, h_u=upper)

    def solve(q, lower, upper):
        solver.update(c=q, h_l=lower, h_u=upper)
        solver.solve()
        return solver.result

    return one_by_one(data, solve, _read_piqp)


def _read_piqp(result) -> tuple:
    return result.x, result.z_u - result.z_l


def make_clarabel(problems: Problems, tolerance: float) -> Solver:
    """Return Clarabel, whose data are updated from program to program."""
    clarabel: Any = importlib.import_module("clarabel")
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    settings.presolve_enable = False
    settings.max_threads = 1
    settings.tol_feas = tolerance
    settings.tol_gap_abs = tolerance
    settings.tol_gap_rel = tolerance
    sides = OneSided.of(problems)
    data = list(contiguous(problems.q, sides.h))
    cones = [clarabel.NonnegativeConeT(len(sides.G))]
    P = csc_array(np.triu(problems.P))
    solver = clarabel.DefaultSolver(P, data[0][0], csc_array(sides.G), data[0][1], cones, settings)
    rows = len(problems.A)

    def solve(q, h):
        solver.update(q=q, b=h)
        return solver.solve()

    def read(answer):
        return answer.x, sides.fold(np.array(answer.z), rows)

    return one_by_one(data, solve, read)


def make_qpax(problems: Problems, tolerance: float) -> Solver:
    """Return qpax in float64, jitted, mapped over all programs at once."""
    import jax
    import jax.numpy as jnp

    solve_all = _map_qpax(problems, tolerance)
    sides = OneSided.of(problems)
    q = jnp.asarray(problems.q)
    h = jnp.asarray(sides.h)
    rows = len(problems.A)

    def run():
        return jax.block_until_ready(solve_all(q, h))

    def answer() -> Answers:
        x, z = run()
        folded = [sides.fold(each, rows) for each in np.asarray(z)]
        return Answers(np.asarray(x), np.array(folded))

    return Solver(run, answer)


def _map_qpax(problems: Problems, tolerance: float) -> Callable:
    import jax
    import jax.numpy as jnp

    qpax: Any = importlib.import_module("qpax")
    P = jnp.asarray(problems.P)
    G = jnp.asarray(OneSided.of(problems).G)
    no_rows = jnp.zeros((0, len(P)))
    no_bounds = jnp.zeros(0)

    def solve(q, h):
        x, _, z, *_ = qpax.solve_qp(
            P, q, no_rows, no_bounds, G, h, solver_tol=tolerance, max_iter=QPAX_ITERATIONS
        )
        return x, z

    return jax.jit(jax.vmap(solve))
