"""How much a path is smoothed: as much as its noise asks for, with turns as wide as wheels can
drive, and then as much as it takes.

The length l of `jaxtube.paths.fitting` is the one of least generalised cross-validation,

    GCV(l) = mean |p - c|^2 / (1 - degrees of freedom / n)^2

which leaves a path without noise as it is. Arc lengths are then taken from the nearest points of
the curve, so that noise along the path is none.

Source: Craven, Wahba 1979, Smoothing noisy data with spline functions, eq. (1.9).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from jaxtube.paths.cells import arc_lengths, make_chain
from jaxtube.paths.curve import Curve
from jaxtube.paths.fitting import (
    degrees_of_freedom,
    limit_curvature,
    make_fitting,
    row_weights,
)
from jaxtube.paths.pieces import Piece

LEAST_SHARE = 0.5
"""Least smoothing length, in radii of the cells."""

FINEST = 20.0
"""Smoothing lengths in the way between two rows at most: such curves go through waypoints."""

GREATEST_SHARE = 0.25
"""Greatest smoothing length, as a share of the path."""

STEP = 1.3
"""From one smoothing length to the next."""

LEAST_WAVE = 0.2
"""Smoothing lengths, in least radii, from which on turns are widened one by one: shorter waves
widen with the smoothing, and longer ones keep circles of that radius to 1e-4."""

REFITS = 2

TIE = 1.1
"""Times the least GCV up to which a smoother curve is as good."""


@dataclass(frozen=True, eq=False)
class Fit:
    """A smooth curve along a piece of a path.

    Attributes:
        curve: the curve, no sharper than it may be where that is possible.
        unbent: the same before its sharp turns were widened.
        smoothing: its smoothing length, m.
        rows: parameter of the point of the curve nearest to each row.
        deviations: distance of each row to that point, m.
        unbent_deviation: largest distance of a row from the unbent curve, m.
    """

    curve: Curve
    unbent: Curve
    smoothing: float
    rows: Float[np.ndarray, " n"]
    deviations: Float[np.ndarray, " n"]
    unbent_deviation: float

    @property
    def largest_deviation(self) -> float:
        """Largest distance of a row from the curve, m."""
        return float(self.deviations.max())


@dataclass(frozen=True, eq=False)
class Smoother:
    """Rows of a piece, to be fitted by curves of any smoothing length.

    Attributes:
        positions: of the rows, m.
        lengths: arc length of each, m.
        closed: length of a closed path, m; None for an open one.
    """

    positions: Float[np.ndarray, "n 2"]
    lengths: Float[np.ndarray, " n"]
    closed: float | None

    def fit(self, smoothing: float, sharpest: float = np.inf) -> Fit:
        """Return the curve of a smoothing length; one long enough has its sharp turns widened."""
        fitting = make_fitting(self.positions, self.lengths, smoothing, self.closed)
        unbent = fitting.solve()
        curve = unbent
        rows, deviations = self._measure(unbent)
        largest = float(deviations.max())
        if smoothing * sharpest >= LEAST_WAVE and unbent.sharpest > sharpest:
            curve = limit_curvature(fitting, unbent, sharpest, smoothing)
            rows, deviations = self._measure(curve)
        return Fit(curve, unbent, smoothing, rows, deviations, largest)

    def _measure(self, curve: Curve) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"]]:
        """Return the nearest parameter of a curve to each row, and the distance there, m."""
        rows = curve.project(self.positions, self.lengths)
        return rows, np.linalg.norm(self.positions - curve.spline(rows), axis=1)

    def cross_validate(self, candidates: list[float]) -> int:
        """Return which smoothing length has the least GCV, the greatest of those as good; rows
        count by the way they stand for."""
        end = float(self.lengths.max()) if self.closed is None else self.closed
        weights = row_weights(self.lengths, end)
        number = weights.sum() ** 2 / np.sum(weights**2)
        scores = np.full(len(candidates), np.inf)
        for which, smoothing in enumerate(candidates):
            taken = degrees_of_freedom(end, smoothing) / number
            if taken < 1.0:
                fitting = make_fitting(self.positions, self.lengths, smoothing, self.closed)
                off = self.positions - fitting.solve().spline(self.lengths)
                squares = np.sum(off**2, axis=1)
                scores[which] = np.average(squares, weights=weights) / (1.0 - taken) ** 2
        return int(np.flatnonzero(scores <= TIE * scores.min())[-1])


def smooth(
    piece: Piece, gap: float | None, largest_deviation: float, sharpest: float
) -> Iterator[Fit]:
    """Yield smoother and smoother curves along a piece: first the one that its noise asks for, or a
    less smooth one where that is further from a row than the largest deviation.

    Args:
        piece: of a path.
        gap: from the end of a closed path on to its start, m (`Closed.gap`); None for an open one.
        largest_deviation: m.
        sharpest: curvature to which sharper turns are widened, 1/m.
    """
    positions = piece.raw.positions
    lengths = arc_lengths(positions, make_chain(positions, piece.radius))
    closed = None if gap is None else float(lengths[-1]) + gap
    candidates = _smoothing_lengths(piece.radius, float(lengths[-1]), len(lengths))
    smoother = Smoother(positions, lengths if closed is None else lengths % closed, closed)
    first = 0
    for _ in range(REFITS):
        first = smoother.cross_validate(candidates)
        smoother = replace(smoother, lengths=smoother.fit(candidates[first]).rows)
    while first > 0 and smoother.fit(candidates[first]).unbent_deviation > largest_deviation:
        first -= 1
    for smoothing in candidates[first:]:
        yield smoother.fit(smoothing, sharpest)


def _smoothing_lengths(radius: float, length: float, rows: int) -> list[float]:
    """Return the smoothing lengths that are tried, increasing, m."""
    least = max(LEAST_SHARE * radius, length / (FINEST * rows))
    count = max(1, int(np.log(GREATEST_SHARE * length / least) / np.log(STEP)))
    return [least * STEP**power for power in range(count)]
