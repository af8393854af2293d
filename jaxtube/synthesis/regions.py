"""The critical regions that a closed loop meets, found by playing some of it off line.

The condensed QP of a window depends on the error e alone, so each set of active rows W has a region
of errors in which the plan and the multipliers are affine in e: with rows A_W g + R_W e at their
bounds b,

    y = (A_W H^-1 A_W')^-1 ((R_W - A_W H^-1 F) e - b),    g = -H^-1 (F e + A_W' y)

wherever the other rows keep their bounds and y its signs. Of thousands of regions laps meet a few:
those along the ways from their starts. Laps of the prediction with w drawn from W find them; what
they miss is left to the solver.

Source: Bemporad, Morari, Dua, Pistikopoulos 2002, "The explicit linear quadratic regulator for
constrained systems", Automatica 38(1), theorem 2.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import clarabel
import jax
import numpy as np
from jaxtyping import Float, Int
from scipy.sparse import csc_array

from jaxtube.control.mpc import CondensedQp
from jaxtube.qp.regions import Regions
from jaxtube.synthesis.region_stack import ON_A_FACET, Region, stack_regions
from sets.polytope import Polytope

LAPS = 256
"""Laps that are played."""
PERIODS = 40
"""Of each: rows are active after starts far away, and then no more."""
MOST_REGIONS = 32
"""Of a window: a look-up costs as much for every one of them, met or not."""
ACTIVE = 1e-4
"""Share of the largest multiplier, of rows of norm one, above which a row is active."""
CORRECTIONS = 8
"""Guesses of active rows before an error is given up."""
INDEPENDENT = 1e-10
"""Least eigenvalue of A_W H^-1 A_W', by the greatest one, of active rows that are independent."""


def find_regions(
    qps: CondensedQp,
    index: Int[np.ndarray, " steps"],
    start: Float[np.ndarray, "3"],
    noise: Float[np.ndarray, "3"],
    disturbances: Float[np.ndarray, "v 3"],
) -> Regions | None:
    """Return regions that laps meet, window by window; None where no row is ever active.

    Args:
        qps: condensed, with a leading axis over the windows.
        index: window of each period.
        start: first error, (m, m, rad).
        noise: half widths of what its measurement adds.
        disturbances: vertices of what is added to the error of a period.
    """
    windows = [_Window(_take_window(qps, number)) for number in range(len(qps.lower))]
    generator = np.random.default_rng(0)
    errors = start + noise * generator.uniform(-1.0, 1.0, (LAPS, 3))
    for number in index[:PERIODS]:
        window = windows[number]
        inputs = window.plan(errors)
        known = np.isfinite(inputs).all(axis=1)
        # A lap whose plan is unknown ends.
        errors = window.predict(errors[known], inputs[known])
        weights = generator.dirichlet(np.ones(len(disturbances)), len(errors))
        errors = errors + weights @ disturbances
    return stack_regions([window.regions for window in windows], qps.linear.shape[1])


def _take_window(qps: CondensedQp, number: int) -> CondensedQp:
    """Return the QP of one window, in numpy."""
    return jax.tree.map(lambda array: array[number], qps)


class _Pieces(NamedTuple):
    """The plan, the multipliers of the active rows and the values of all rows, affine in (e, 1)."""

    optimum: Float[np.ndarray, "n 4"]
    multipliers: Float[np.ndarray, "a 4"]
    values: Float[np.ndarray, "m 4"]


class _Window:
    """The QP of one window, and the regions found in it."""

    def __init__(self, condensed: CondensedQp):
        factors = condensed.factors
        self.condensed = condensed
        self.norms = np.asarray(factors.row_norms)
        self.rows = np.asarray(factors.rows * factors.row_norms[:, None])
        self.inverse = np.linalg.inv(np.asarray(factors.hessian))
        self.regions: list[Region] = []

    def plan(self, errors: Float[np.ndarray, "k 3"]) -> Float[np.ndarray, "k 2"]:
        """Return the inputs that are due, NaN where none are known."""
        condensed = self.condensed
        inputs = errors @ condensed.free_inputs[:2].T
        values = errors @ condensed.free_rows.T
        is_free = (condensed.lower <= values) & (values <= condensed.upper)
        for number in np.flatnonzero(~is_free.all(axis=1)):
            inputs[number] = self._look_up(errors[number])
        return inputs

    def predict(
        self, errors: Float[np.ndarray, "k 3"], inputs: Float[np.ndarray, "k 2"]
    ) -> Float[np.ndarray, "k 3"]:
        """Return the errors that the model predicts of the next period."""
        return errors @ self.condensed.transition.T + inputs @ self.condensed.input_matrix.T

    def _look_up(self, error: Float[np.ndarray, "3"]) -> Float[np.ndarray, "2"]:
        region = next((each for each in self.regions if each.holds(error)), None)
        if region is None and len(self.regions) < MOST_REGIONS:
            region = self._find_region(error)
        if region is None:
            return np.full(2, np.nan)
        return region.optimum[:2] @ np.append(error, 1.0)

    def _find_region(self, error: Float[np.ndarray, "3"]) -> Region | None:
        """Return the region that holds an error, which then is known; None where there is none."""
        multipliers = self._solve(error) * self.norms
        largest = np.abs(multipliers).max(initial=0.0)
        sides = np.where(np.abs(multipliers) > ACTIVE * largest, np.sign(multipliers), 0.0)
        for _ in range(CORRECTIONS):
            pieces = self._find_pieces(sides)
            if pieces is None:
                return None
            corrected = self._correct(sides, pieces, error)
            if np.array_equal(corrected, sides):
                return self._keep(sides, pieces)
            sides = corrected
        return None

    def _correct(
        self, sides: Float[np.ndarray, " m"], pieces: _Pieces, error: Float[np.ndarray, "3"]
    ) -> Float[np.ndarray, " m"]:
        """Return the rows that are active at an error, if those given are: without multipliers of
        the wrong sign, with rows that miss their bounds."""
        extended = np.append(error, 1.0)
        values = pieces.values @ extended
        above = values > self.condensed.upper + ON_A_FACET * self.norms
        below = values < self.condensed.lower - ON_A_FACET * self.norms
        corrected = np.where(sides == 0, above * 1.0 - below, sides)
        active = np.flatnonzero(sides)
        wrong = sides[active] * (pieces.multipliers @ extended) < 0
        corrected[active[wrong]] = 0.0
        return corrected

    def _solve(self, error: Float[np.ndarray, "3"]) -> Float[np.ndarray, " m"]:
        """Return multipliers, positive at upper and negative at lower bounds; zero where there is
        no answer."""
        condensed = self.condensed
        shift = condensed.row_errors @ error
        bounds = np.concatenate([condensed.upper - shift, shift - condensed.lower])
        finite = np.isfinite(bounds)
        sides = np.vstack([self.rows, -self.rows])[finite]
        solve: Any = clarabel  # its stubs name none of these
        settings = solve.DefaultSettings()
        settings.verbose = False
        solver = solve.DefaultSolver(
            csc_array(np.triu(condensed.factors.hessian)),
            condensed.linear @ error,
            csc_array(sides),
            bounds[finite],
            [solve.NonnegativeConeT(len(sides))],
            settings,
        )
        answer = solver.solve()
        both = np.zeros(len(bounds))
        if str(answer.status) == "Solved":
            both[finite] = answer.z
        upper, lower = np.split(both, 2)
        return upper - lower

    def _find_pieces(self, sides: Float[np.ndarray, " m"]) -> _Pieces | None:
        """Return what is affine while some rows are at their upper (1) or lower (-1) bounds; None
        where these rows depend on each other."""
        condensed = self.condensed
        active = np.flatnonzero(sides)
        rows = self.rows[active]
        gram = rows @ self.inverse @ rows.T
        spectrum = np.linalg.eigvalsh(gram)
        if not len(active) or spectrum[0] < INDEPENDENT * spectrum[-1]:
            return None
        bounds = np.where(sides > 0, condensed.upper, condensed.lower)[active]
        seen = condensed.row_errors[active] - rows @ self.inverse @ condensed.linear
        multipliers = np.linalg.solve(gram, np.column_stack([seen, -bounds]))
        gradient = rows.T @ multipliers
        gradient[:, :3] += condensed.linear
        optimum = -self.inverse @ gradient
        values = self.rows @ optimum
        values[:, :3] += condensed.row_errors
        return _Pieces(optimum, multipliers, values)

    def _keep(self, sides: Float[np.ndarray, " m"], pieces: _Pieces) -> Region | None:
        """Return the region of some active rows, which then is known; None where it is flat."""
        active = np.flatnonzero(sides)
        others = np.flatnonzero(sides == 0)
        signed = sides[active, None] * pieces.multipliers
        facets = _bound(
            np.vstack([pieces.values[others], -pieces.values[others], -signed]),
            np.concatenate(
                [self.condensed.upper[others], -self.condensed.lower[others], np.zeros(len(active))]
            ),
        )
        if facets is None:
            return None
        region = Region(facets, pieces.optimum, pieces.multipliers, active)
        self.regions.append(region)
        return region


def _bound(values: Float[np.ndarray, "k 4"], limits: Float[np.ndarray, " k"]) -> Polytope | None:
    """Return {e : values (e, 1) <= limits} by the rows that bound it, of norm one; None where it
    has no interior."""
    finite = np.isfinite(limits)
    normals = values[finite, :3]
    offsets = limits[finite] - values[finite, 3]
    lengths = np.linalg.norm(normals, axis=1)
    plain = lengths > np.finfo(float).eps * lengths.max()
    if np.any(offsets[~plain] < 0):
        return None
    region = Polytope(normals[plain], offsets[plain])
    if region.is_empty() or region.is_flat():
        return None
    return region.reduce().with_unit_normals()
