"""Exact solvers that add and remove active rows: DAQP and quadprog, called from Python.

Source: Arnstroem, Bemporad, Axehill, IEEE Transactions on Automatic Control 2022 (DAQP); Goldfarb
and Idnani, Mathematical Programming 1983 (quadprog).
"""

from __future__ import annotations

from collections.abc import Iterator
from operator import itemgetter
from typing import Any, NamedTuple

import numpy as np

from jaxtube.experiments.bench.peers.problems import (
    OneSided,
    Problems,
    Solver,
    contiguous,
    one_by_one,
    without_infinity,
)

DAQP_TOLERANCE = 1e-9
"""By which a row of norm one may miss its bound."""


def make_cold_daqp(problems: Problems) -> Solver:
    """Return DAQP that starts each program without active rows: update, then solve."""
    daqp = set_up_daqp(problems)
    update = daqp.model.update
    find = daqp.model.solve
    no_rows = np.zeros(len(problems.A), np.int32)

    def solve(q, lower, upper, daqp=daqp):
        update(f=q, blower=lower, bupper=upper, sense=no_rows)
        return find()

    data = list(make_daqp_data(problems))
    return one_by_one(data, solve, read_daqp, read_daqp_clock)


class DaqpModel(NamedTuple):
    """A model of DAQP, and the arrays that it may point to."""

    model: Any
    matrices: tuple[np.ndarray, ...]


def set_up_daqp(problems: Problems) -> DaqpModel:
    """Return a DAQP model of the first program."""
    import daqp

    model = daqp.Model()
    P = np.array(problems.P, order="C")
    A = np.array(problems.A, order="C")
    no_rows = np.zeros(len(A), np.int32)
    q, lower, upper = next(make_daqp_data(problems))
    model.setup(P, q, A, upper, lower, no_rows)
    model.settings = {"primal_tol": DAQP_TOLERANCE}
    return DaqpModel(model, (P, A, no_rows, q, lower, upper))


def make_daqp_data(problems: Problems) -> Iterator[tuple[np.ndarray, ...]]:
    """Yield q, l and u of every program."""
    return contiguous(problems.q, without_infinity(problems.l), without_infinity(problems.u))


def read_daqp(raw) -> tuple:
    """Return x and multipliers of what DAQP returns; NaN where it found no optimum."""
    x, _, flag, info = raw
    known = 1.0 if flag == 1 else np.nan
    return x * known, info["lam"] * known


def read_daqp_clock(raw) -> float:
    """Return the seconds of DAQP's own clock: to solve, without the update before."""
    return raw[3]["solve_time"]


def make_quadprog(problems: Problems) -> Solver:
    """Return quadprog with P factorised beforehand."""
    import quadprog

    sides = OneSided.of(problems)
    # R^-1 of P = R' R, R upper triangular.
    root = np.linalg.inv(np.linalg.cholesky(problems.P).T)
    columns = np.array(-sides.G.T)
    rows = len(problems.A)

    def solve(a, b):
        return quadprog.solve_qp(root, a, columns, b, 0, True)

    def read(raw):
        x, multipliers = itemgetter(0, 4)(raw)
        return x, sides.fold(multipliers, rows)

    return one_by_one(list(contiguous(-problems.q, -sides.h)), solve, read)
