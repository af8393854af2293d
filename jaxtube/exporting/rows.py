"""Rows of exported QPs beside those of the design, in exact rational arithmetic.

For every row, in the units of the design,

    over     by how much a plan that the controller accepts may miss the row of the design
    under    by how much a plan that meets the row of the design may miss that of the controller

With row a and bound b of the design, a' and b' of the constants, and a tolerance t

    over  = b' - b + |a' - a| x + t + r        under = b - b' + |a' - a| x + r

x being the magnitudes of errors and inputs, and r what the arithmetic of the row may be off by.

Source: Higham 2002, Accuracy and Stability of Numerical Algorithms, lemma 3.1, for r.
"""

from __future__ import annotations

from fractions import Fraction
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Float

from jaxtube.exporting.constants import WIDER, Constants
from jaxtube.synthesis.certificate.program import bound_rows, predict_rows
from jaxtube.synthesis.parts import Design
from jaxtube.synthesis.prediction import UNREACHED

KINDS = ("errors", "inputs", "terminal")
"""Of rows: on E_1 .. E_{N-1}, on U_0 .. U_{N-1}, on e_N."""

Exact = np.ndarray
"""Fractions, as an array of objects."""

NOTHING = Fraction(0)
UNBOUNDED = Fraction(10) ** 9
"""What rows miss that are bounded in the design or in the constants alone."""

as_fractions = np.vectorize(Fraction, otypes=[object])


class RowComparison:
    """Rows of a design, exact, beside those of constants, in the order of the constants."""

    def __init__(self, design: Design, constants: Constants):
        self._design = design
        self._constants = constants
        reached = np.abs(predict_rows(design)[:, :, 3:]).max(axis=(0, 2)) > UNREACHED
        self._order = np.concatenate([np.flatnonzero(reached), np.flatnonzero(~reached)])
        self._norms = self._find_norms(int(reached.sum()))
        self._lower, self._upper = bound_rows(design)

    def _find_norms(self, reached: int) -> Float[np.ndarray, "windows m"]:
        """Return by what the rows of the design were divided."""
        norms = np.ones((len(self._constants.rows), len(self._order)))
        norms[:, :reached] = self._design.tube_qps.factors.row_norms
        return norms

    @cached_property
    def _kinds(self) -> Bool[np.ndarray, "3 m"]:
        """Which rows are of which kind."""
        design = self._design
        N = design.problem.horizon
        half = design.problem.input_row_count // 2
        counts = (3 * (N - 1), half * N, len(design.bounds.terminal_normals))
        kinds = np.repeat(np.arange(3), counts)[self._order]
        return kinds == np.arange(3)[:, None]

    @cached_property
    def _box(self) -> Exact:
        """Magnitudes of errors and inputs."""
        problem = self._design.problem
        errors = problem.operating_set.support(np.eye(3))
        inputs = problem.input_set.support(np.concatenate([np.eye(2), -np.eye(2)]))
        largest = np.maximum(inputs[:2], inputs[2:])
        box = np.concatenate([errors, np.tile(largest, problem.horizon)])
        return WIDER * as_fractions(box)

    def find_missed(self) -> dict[str, Fraction]:
        """Return the largest over and the largest under together, by kind of row; infinite where a
        row is bounded in one of both alone."""
        misses = [self._miss_rows(window) for window in range(len(self._constants.rows))]
        over = np.max([over for over, _ in misses], axis=0)
        under = np.max([under for _, under in misses], axis=0)
        return {
            kind: max(over[of_kind], default=NOTHING) + max(under[of_kind], default=NOTHING)
            for kind, of_kind in zip(KINDS, self._kinds, strict=True)
        }

    def _miss_rows(self, window: int) -> tuple[Exact, Exact]:
        """Return over and under of every row of a window."""
        constants = self._constants
        norms = as_fractions(self._norms[window])
        exact = _predict_exactly(self._design, window)[self._order]
        written = np.hstack([constants.row_errors[window], constants.rows[window]])
        scaled = as_fractions(written.astype(float))
        differs = np.abs(norms[:, None] * scaled - exact) @ self._box
        size = np.abs(scaled) @ self._box
        tolerance = Fraction(constants.precision.tolerance)
        over = np.full(len(norms), NOTHING, object)
        under = np.full(len(norms), NOTHING, object)
        sides = (
            (-self._lower[window], -constants.lower[window]),
            (self._upper[window], constants.upper[window]),
        )
        for ours, theirs in sides:
            designed = ours[self._order]
            finite = np.isfinite(designed)
            if not np.array_equal(finite, np.isfinite(theirs)):
                return over + UNBOUNDED, under
            given = as_fractions(np.where(finite, theirs, 0.0).astype(float))
            wider = norms * given - as_fractions(np.where(finite, designed, 0.0))
            rounding = norms * self._bound_rounding(size + np.abs(given))
            by_tolerance = differs + rounding + norms * tolerance
            over = np.where(finite, np.maximum(over, wider + by_tolerance), over)
            under = np.where(finite, np.maximum(under, differs + rounding - wider), under)
        return over, under

    def _bound_rounding(self, size: Exact) -> Exact:
        """Return what the arithmetic of a row may be off by, its terms being of this size."""
        unit = Fraction(self._constants.precision.epsilon) / 2
        terms = len(self._box) + 6
        return size * (terms * unit / (1 - terms * unit))

    def enlarge_terminal(self, missed: Fraction) -> Fraction:
        """Return by which share rows missed by so much enlarge the terminal set."""
        offsets = self._design.bounds.terminal
        return (
            missed / Fraction(float(offsets.min())) if np.isfinite(offsets).all() else Fraction(0)
        )

    def find_largest_bound(self, kind: str) -> Fraction:
        """Return the largest bound of the rows of a kind."""
        return Fraction(float(np.max(getattr(self._design.bounds, kind))))


def _predict_exactly(design: Design, window: int) -> Exact:
    """Return the exact rows on the first error and the inputs of a plan, those on E_1 .. E_{N-1},
    on U_0 .. U_{N-1} and on e_N, by the model's matrices; of opposite rows the first stands for
    both."""
    problem = design.problem
    N = problem.horizon
    half = problem.input_row_count // 2
    input_rows = problem.rows_of(design.windows.regimes[window])
    transitions, matrices = problem.model.matrices(design.windows.schedules[window][None])
    error_rows = as_fractions(problem.operating_set.normals[:3])
    on_inputs = as_fractions(input_rows.inputs[:, :half])
    on_errors = as_fractions(input_rows.errors[:, :half])
    probes = as_fractions(np.eye(3 + 2 * N))
    errors = probes[:3]
    of_errors = []
    of_inputs = []
    for stage in range(N):
        inputs = probes[3 + 2 * stage : 5 + 2 * stage]
        if stage > 0:
            of_errors.append(error_rows @ errors)
        of_inputs.append(on_inputs[stage] @ inputs + on_errors[stage] @ errors)
        transition = as_fractions(transitions[0, stage])
        errors = transition @ errors + as_fractions(matrices[0, stage]) @ inputs
    of_terminal = as_fractions(design.bounds.terminal_normals) @ errors
    return np.concatenate([*of_errors, *of_inputs, of_terminal])
