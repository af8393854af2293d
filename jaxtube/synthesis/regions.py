"""The critical regions that a closed loop meets, found by playing some of it off line.

The condensed QP of a window depends on the error e alone, so each set of active rows W has a region
of errors in which the plan and the multipliers are affine in e: with rows A_W g + R_W e at their
bounds b,

    y = (A_W H^-1 A_W')^-1 ((R_W - A_W H^-1 F) e - b),    g = -H^-1 (F e + A_W' y)

wherever the other rows keep their bounds and y its signs. Of thousands of regions laps meet a few:
those along the ways from their starts. Laps of the prediction with w drawn from W find them, and a
tree learns from the errors of these laps which region an error lies in; what they miss is left to
the solver.

Source: Bemporad, Morari, Dua, Pistikopoulos 2002, "The explicit linear quadratic regulator for
constrained systems", Automatica 38(1), theorem 2.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import clarabel
import jax
import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.sparse import csc_array

from jaxtube.control.planning import CondensedQp
from jaxtube.qp.regions import Regions
from jaxtube.synthesis.region_stack import Bank, Region, stack_regions
from jaxtube.synthesis.region_tree import Tree, grow_tree

FIRST_LAPS = 512
"""Laps of the first set: it shows how many errors with active rows laps meet, and which regions."""
MOST_LAPS = 16384
"""Laps of the second set, at most."""
ERRORS_WANTED = 8192
"""Errors with active rows that the second set of laps is to meet."""
PERIODS = 40
"""Periods of a lap, at most."""
IDLE_PERIODS = 4
"""Periods in which no lap of a set has an active row, after which the set ends: rows are active
after starts far away, and then no more."""
MOST_REGIONS = 512
"""Regions of a window, at most."""
ENOUGH = 64
"""Errors by which a region is told from others; those of regions that meet fewer are spread."""
SPREADINGS = 8
"""Rounds in which errors of such regions are spread over them."""
AT_ONCE = 64
"""Errors that are compared with all regions at once."""
ON_A_FACET = 1e-9
"""By how much a row of norm one may miss its bound."""
ACTIVE = 1e-4
"""Share of the largest multiplier, of rows of norm one, above which a row is active."""
CORRECTIONS = 8
"""Guesses of active rows before an error is given up."""
INDEPENDENT = 1e-10
"""Least eigenvalue of A_W H^-1 A_W', by the greatest one, of active rows that are independent."""


Draw = Callable[[np.random.Generator, int], Float[np.ndarray, "count 3"]]
"""Returns first errors, (m, m, rad), as many as are asked for."""


def find_regions(
    qps: CondensedQp,
    index: Int[np.ndarray, " steps"],
    draw: Draw,
    noise: Float[np.ndarray, "3"],
    disturbances: Float[np.ndarray, "v 3"],
) -> Regions | None:
    """Return regions that laps meet, window by window; None where no row is ever active.

    Args:
        qps: condensed, with a leading axis over the windows.
        index: window of each period.
        draw: what laps start from.
        noise: half widths of what its measurement adds.
        disturbances: vertices of what is added to the error of a period.
    """
    windows = [_Window(_take_window(qps, number)) for number in range(len(qps.lower))]
    generator = np.random.default_rng(0)
    ahead = [windows[number] for number in index[:PERIODS]]
    laps = FIRST_LAPS
    for _ in range(2):
        errors = draw(generator, laps) + noise * generator.uniform(-1.0, 1.0, (laps, 3))
        active = _play(ahead, errors, disturbances, generator)
        if not active:
            break
        for window in windows:
            window.learn(generator)
        laps = min(laps * ERRORS_WANTED // active, MOST_LAPS)
    return stack_regions([window.find_bank() for window in windows])


def _play(
    windows: Sequence[_Window],
    errors: Float[np.ndarray, "k 3"],
    disturbances: Float[np.ndarray, "v 3"],
    generator: np.random.Generator,
) -> int:
    """Play laps through the windows of their periods; return how many errors had active rows."""
    total = 0
    idle = 0
    for window in windows:
        inputs, active = window.plan(errors)
        total += active
        idle = 0 if active else idle + 1
        if idle == IDLE_PERIODS:
            break
        known = np.isfinite(inputs).all(axis=1)
        # A lap whose plan is unknown ends.
        errors = window.predict(errors[known], inputs[known])
        weights = generator.dirichlet(np.ones(len(disturbances)), len(errors))
        errors = errors + weights @ disturbances
    return total


def _take_window(qps: CondensedQp, number: int) -> CondensedQp:
    """Return the QP of one window, in numpy."""
    return jax.tree.map(lambda array: array[number], qps)


class _Pieces(NamedTuple):
    """Everything that is affine in (e, 1) while some rows are active."""

    optimum: Float[np.ndarray, "*regions n 4"]  # the inputs
    multipliers: Float[np.ndarray, "*regions m 4"]  # zero of the rows that are not active
    values: Float[np.ndarray, "*regions m 4"]  # of the rows


class _Window:
    """The QP of one window, and the regions found in it."""

    def __init__(self, condensed: CondensedQp):
        factors = condensed.factors
        m, n = factors.rows.shape
        self.condensed = condensed
        self.norms = np.asarray(factors.row_norms)
        self.rows = np.asarray(factors.rows * factors.row_norms[:, None])
        self.inverse = np.linalg.inv(np.asarray(factors.hessian))
        self.lower = condensed.lower - ON_A_FACET * self.norms
        self.upper = condensed.upper + ON_A_FACET * self.norms
        self.count = 0
        self.sides = np.zeros((MOST_REGIONS, m))
        self.pieces = _Pieces(*(np.zeros((MOST_REGIONS, rows, 4)) for rows in (n, m, m)))
        self.points: list[Float[np.ndarray, "k 4"]] = []
        self.regions: list[Int[np.ndarray, " k"]] = []
        self.tree: Tree | None = None

    def find_bank(self) -> Bank | None:
        """Return the regions and their tree; None where there are none."""
        if self.tree is None:
            return None
        active = [np.flatnonzero(sides) for sides in self.sides[: self.count]]
        multipliers = self.norms[:, None] * self.pieces.multipliers
        regions = [
            Region(self.pieces.optimum[i], multipliers[i, rows], rows)
            for i, rows in enumerate(active)
        ]
        return Bank(regions, self.tree)

    def learn(self, generator: np.random.Generator) -> None:
        """Let the tree know the errors that were met, and others of their regions."""
        if not self.count:
            return
        known = slice(self.count)
        sides = self.sides[known]
        spread = self._spread(np.concatenate(self.points), np.concatenate(self.regions), generator)
        self.tree = grow_tree(self._find_planes(known), sides != 0, *spread)

    def _find_planes(self, known: slice) -> Float[np.ndarray, "r m 4"]:
        """Return where rows become active in known regions, or idle: on the side on which they are
        active somewhere."""
        sides = self.sides[known]
        side = np.where(sides.max(axis=0) > 0, 1.0, -1.0)
        bounds = np.where(side > 0, self.condensed.upper, self.condensed.lower)
        missed = self.pieces.values[known].copy()
        missed[..., 3] -= np.where(np.isfinite(bounds), bounds, 0.0)
        pushes = (sides != 0)[..., None]
        planes = side[:, None] * np.where(pushes, self.pieces.multipliers[known], missed)
        lengths = np.linalg.norm(planes[..., :3], axis=-1, keepdims=True)
        return np.divide(planes, lengths, out=np.zeros_like(planes), where=lengths > 0)

    def _spread(
        self,
        points: Float[np.ndarray, "k 4"],
        regions: Int[np.ndarray, " k"],
        generator: np.random.Generator,
    ) -> tuple[Float[np.ndarray, "j 4"], Int[np.ndarray, " j"]]:
        """Return these errors and, of regions that have few, others: each uniform on the part of a
        line through the last one that lies in its region (hit and run, Smith 1984)."""
        widths = np.append(points[:, :3].std(axis=0), 0.0)
        every = [(points, regions)]
        counts = np.bincount(regions)
        for _ in range(SPREADINGS):
            has_few = counts[regions] < ENOUGH
            points = points[has_few]
            regions = regions[has_few]
            ways = generator.normal(size=points.shape) * widths
            back, ahead = self._find_ends(points, ways, regions)
            share = generator.random(len(points))
            points = points + (share * ahead - (1 - share) * back)[:, None] * ways
            every.append((points, regions))
            counts = counts + np.bincount(regions, minlength=len(counts))
        all_points, all_regions = zip(*every, strict=True)
        return np.concatenate(all_points), np.concatenate(all_regions)

    def _find_ends(
        self,
        points: Float[np.ndarray, "k 4"],
        ways: Float[np.ndarray, "k 4"],
        regions: Int[np.ndarray, " k"],
    ) -> tuple[Float[np.ndarray, " k"], Float[np.ndarray, " k"]]:
        """Return how far regions reach from points in them, against a way and along it; 0 where
        they have no end."""
        sides = self.sides[regions]
        values, of_rows = self._see(regions, points)
        rates, of_ways = self._see(regions, ways)
        idle = np.where(sides == 0, 1.0, np.inf)
        room = np.concatenate(
            [
                idle * np.maximum(self.upper - values, 0.0),
                idle * np.maximum(values - self.lower, 0.0),
                np.where(sides == 0, np.inf, np.maximum(sides * of_rows, 0.0)),
            ],
            axis=1,
        )
        speed = np.concatenate([rates, -rates, -sides * of_ways], axis=1)
        lengths = np.divide(room, np.abs(speed), out=np.full_like(room, np.inf), where=speed != 0)
        back = np.min(lengths, axis=1, where=speed < 0, initial=np.inf)
        ahead = np.min(lengths, axis=1, where=speed > 0, initial=np.inf)
        return np.where(np.isfinite(back), back, 0.0), np.where(np.isfinite(ahead), ahead, 0.0)

    def _see(
        self, regions: Int[np.ndarray, " k"], points: Float[np.ndarray, "k 4"]
    ) -> tuple[Float[np.ndarray, "k m"], Float[np.ndarray, "k m"]]:
        """Return the values and the multipliers of all rows, each point in its region."""
        values = np.einsum("kij,kj->ki", self.pieces.values[regions], points)
        multipliers = np.einsum("kij,kj->ki", self.pieces.multipliers[regions], points)
        return values, multipliers

    def plan(self, errors: Float[np.ndarray, "k 3"]) -> tuple[Float[np.ndarray, "k 2"], int]:
        """Return the inputs that are due, NaN where none are known, and how many errors have active
        rows; regions that are met for the first time then are known."""
        condensed = self.condensed
        inputs = errors @ condensed.free_inputs[:2].T
        values = errors @ condensed.free_rows.T
        is_free = ((condensed.lower <= values) & (values <= condensed.upper)).all(axis=1)
        constrained = np.flatnonzero(~is_free)
        points = np.column_stack([errors[constrained], np.ones(len(constrained))])
        region = self._find(points)
        is_known = region >= 0
        self.points.append(points[is_known])
        self.regions.append(region[is_known])
        due = np.einsum("kij,kj->ki", self.pieces.optimum[region, :2], points)
        inputs[constrained] = np.where(is_known[:, None], due, np.nan)
        return inputs, len(constrained)

    def predict(
        self, errors: Float[np.ndarray, "k 3"], inputs: Float[np.ndarray, "k 2"]
    ) -> Float[np.ndarray, "k 3"]:
        """Return the errors that the model predicts of the next period."""
        return errors @ self.condensed.transition.T + inputs @ self.condensed.input_matrix.T

    def _find(self, points: Float[np.ndarray, "k 4"]) -> Int[np.ndarray, " k"]:
        """Return the regions of errors, -1 where none is known."""
        region = np.full(len(points), -1)
        if self.tree is not None:
            guess = self.tree.guess(points)
            region = np.where(self._holds(guess, points), guess, -1)
        pending = np.flatnonzero(region < 0)
        for first in range(0, len(pending), AT_ONCE):
            some = pending[first : first + AT_ONCE]
            region[some] = self._compare(points[some])
        pending = pending[region[pending] < 0]
        while len(pending) and self.count < MOST_REGIONS:
            number = self._find_region(points[pending[0]])
            if number is not None:
                region[pending[0]] = number
            pending = pending[1:]
            if number is not None:
                pending = self._assign(number, points, region, pending)
        return region

    def _compare(self, points: Float[np.ndarray, "k 4"]) -> Int[np.ndarray, " k"]:
        """Return the first known region that holds each error, -1 where none does."""
        if not self.count:
            return np.full(len(points), -1)
        known = slice(self.count)
        shape = (len(points), self.count, -1)
        values = points @ self.pieces.values[known].reshape(-1, 4).T
        multipliers = points @ self.pieces.multipliers[known].reshape(-1, 4).T
        holds = self._are_kept(self.sides[known], values.reshape(shape), multipliers.reshape(shape))
        return np.where(holds.any(axis=1), np.argmax(holds, axis=1), -1)

    def _assign(
        self,
        number: int,
        points: Float[np.ndarray, "k 4"],
        region: Int[np.ndarray, " k"],
        pending: Int[np.ndarray, " p"],
    ) -> Int[np.ndarray, " q"]:
        """Write down which of the pending errors lie in a region; return the others."""
        is_there = self._are_kept(
            self.sides[number],
            points[pending] @ self.pieces.values[number].T,
            points[pending] @ self.pieces.multipliers[number].T,
        )
        region[pending[is_there]] = number
        return pending[~is_there]

    def _holds(
        self, region: Int[np.ndarray, " k"], points: Float[np.ndarray, "k 4"]
    ) -> Bool[np.ndarray, " k"]:
        """Return which errors lie in the regions that are guessed."""
        return self._are_kept(self.sides[region], *self._see(region, points))

    def _are_kept(
        self,
        sides: Float[np.ndarray, "#k m"],
        values: Float[np.ndarray, "k m"],
        multipliers: Float[np.ndarray, "k m"],
    ) -> Bool[np.ndarray, " k"]:
        """Return where all rows keep their bounds and all multipliers their signs."""
        keeps = (self.lower <= values) & (values <= self.upper) & (sides * multipliers >= 0)
        return keeps.all(axis=-1)

    def _find_region(self, point: Float[np.ndarray, "4"]) -> int | None:
        """Return the number of the region that holds an error, which then is known; None where
        there is none."""
        multipliers = self._solve(point[:3]) * self.norms
        largest = np.abs(multipliers).max(initial=0.0)
        sides = np.where(np.abs(multipliers) > ACTIVE * largest, np.sign(multipliers), 0.0)
        for _ in range(CORRECTIONS):
            pieces = self._find_pieces(sides)
            if pieces is None:
                return None
            corrected = self._correct(sides, pieces, point)
            if np.array_equal(corrected, sides):
                return self._keep(sides, pieces)
            sides = corrected
        return None

    def _correct(
        self, sides: Float[np.ndarray, " m"], pieces: _Pieces, point: Float[np.ndarray, "4"]
    ) -> Float[np.ndarray, " m"]:
        """Return the rows that are active at an error, if those given are: without multipliers of
        the wrong sign, with rows that miss their bounds."""
        values = pieces.values @ point
        above = values > self.upper
        below = values < self.lower
        corrected = np.where(sides == 0, above * 1.0 - below, sides)
        return np.where(sides * (pieces.multipliers @ point) < 0, 0.0, corrected)

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
        multipliers = np.zeros((len(sides), 4))
        multipliers[active] = np.linalg.solve(gram, np.column_stack([seen, -bounds]))
        gradient = self.rows.T @ multipliers
        gradient[:, :3] += condensed.linear
        optimum = -self.inverse @ gradient
        values = self.rows @ optimum
        values[:, :3] += condensed.row_errors
        return _Pieces(optimum, multipliers, values)

    def _keep(self, sides: Float[np.ndarray, " m"], pieces: _Pieces) -> int:
        """Return the number of a region that is new."""
        number = self.count
        self.sides[number] = sides
        for every, one in zip(self.pieces, pieces, strict=True):
            every[number] = one
        self.count += 1
        return number
