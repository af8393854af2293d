"""How much a path is smoothed: as much as its noise asks for, and then as much as it takes to be
driven, within a largest deviation.

The length l of `jaxtube.paths.curve` is the one of least generalised cross-validation,

    GCV(l) = mean |p - c|^2 / (1 - degrees of freedom / n)^2

which leaves a path without noise as it is. Arc lengths are then taken from the nearest points of
the curve, so that noise along the path is none.

Source: Craven, Wahba 1979, Smoothing noisy data with spline functions, eq. (1.9).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from jaxtube.paths.cells import arc_lengths, make_chain
from jaxtube.paths.curve import Curve, degrees_of_freedom, fit_curve, row_weights
from jaxtube.paths.pieces import Piece

LEAST_SHARE = 0.5
"""Least smoothing length, in radii of the cells."""

FINEST = 20.0
"""Smoothing lengths in the way between two rows at most: such curves go through waypoints."""

GREATEST_SHARE = 0.25
"""Greatest smoothing length, as a share of the path."""

STEP = 1.3
"""From one smoothing length to the next."""

REFITS = 2

TIE = 1.1
"""Times the least GCV up to which a smoother curve is as good."""


@dataclass(frozen=True, eq=False)
class Fit:
    """A smooth curve along a piece of a path.

    Attributes:
        curve: the curve.
        smoothing: its smoothing length, m.
        rows: parameter of the point of the curve nearest to each row.
        deviations: distance of each row to that point, m.
    """

    curve: Curve
    smoothing: float
    rows: Float[np.ndarray, " n"]
    deviations: Float[np.ndarray, " n"]

    @property
    def largest_deviation(self) -> float:
        """Largest distance of a row from the curve, m."""
        return float(self.deviations.max())

    @property
    def rms_deviation(self) -> float:
        """Root mean square of the rows' distances, m."""
        return float(np.sqrt(np.mean(self.deviations**2)))


def smooth(piece: Piece, gap: float | None, largest_deviation: float) -> Iterator[Fit]:
    """Yield smoother and smoother curves along a piece: first the one that its noise asks for, or a
    less smooth one where that is further from a row than the largest deviation.

    Args:
        piece: of a path.
        gap: from the end of a closed path on to its start, m (`Closed.gap`); None for an open one.
        largest_deviation: m.
    """
    positions = piece.raw.positions
    lengths = arc_lengths(positions, make_chain(positions, piece.radius))
    end = float(lengths[-1])
    closed = None
    if gap is not None:
        closed = end + gap
        lengths = lengths % closed
    candidates = _smoothing_lengths(piece.radius, end, len(lengths))
    first = 0
    for _ in range(REFITS):
        first = _cross_validate(positions, lengths, candidates, closed)
        fit = _fit(positions, lengths, candidates[first], closed)
        lengths = fit.rows
    while first > 0 and fit.largest_deviation > largest_deviation:
        first -= 1
        fit = _fit(positions, lengths, candidates[first], closed)
    yield fit
    for smoothing in candidates[first + 1 :]:
        yield _fit(positions, lengths, smoothing, closed)


def _smoothing_lengths(radius: float, length: float, rows: int) -> list[float]:
    least = max(LEAST_SHARE * radius, length / (FINEST * rows))
    count = max(1, int(np.log(GREATEST_SHARE * length / least) / np.log(STEP)))
    return [least * STEP**power for power in range(count)]


def _cross_validate(
    positions: Float[np.ndarray, "n 2"],
    lengths: Float[np.ndarray, " n"],
    candidates: list[float],
    closed: float | None,
) -> int:
    """Return which smoothing length has the least GCV, the greatest of those as good; rows count by
    the way they stand for."""
    end = float(lengths.max()) if closed is None else closed
    weights = row_weights(lengths, end)
    number = weights.sum() ** 2 / np.sum(weights**2)
    scores = np.full(len(candidates), np.inf)
    for which, smoothing in enumerate(candidates):
        taken = degrees_of_freedom(end, smoothing) / number
        if taken < 1.0:
            curve = fit_curve(positions, lengths, smoothing, closed)
            squares = np.sum((positions - curve.spline(lengths)) ** 2, axis=1)
            scores[which] = np.average(squares, weights=weights) / (1.0 - taken) ** 2
    return int(np.flatnonzero(scores <= TIE * scores.min())[-1])


def _fit(
    positions: Float[np.ndarray, "n 2"],
    lengths: Float[np.ndarray, " n"],
    smoothing: float,
    closed: float | None,
) -> Fit:
    curve = fit_curve(positions, lengths, smoothing, closed)
    rows = curve.project(positions, lengths)
    deviations = np.linalg.norm(positions - curve.spline(rows), axis=1)
    return Fit(curve, smoothing, rows, deviations)
