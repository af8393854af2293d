"""Searches without gradients at a given number of evaluations, which descent by gradients has to
beat.

    minimise  f(x)   over x in R^n, with f called `budget` times, no more and no less.

A value that is not finite counts as +inf.

Source: random search: Bergstra, Bengio 2012; simplex: Nelder, Mead 1965, with the coefficients of
Gao, Han 2012 (scipy), begun anew around its best point whenever it has collapsed.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.optimize import minimize

Point = Float[np.ndarray, " parameters"]
EvaluateValue = Callable[[Point], float]


@dataclass(frozen=True, eq=False)
class ValueSearch:
    """All points of a search in the order of their evaluation, and the value of each, +inf where it
    was not finite."""

    points: Float[np.ndarray, "budget parameters"]
    values: Float[np.ndarray, " budget"]

    @property
    def best(self) -> Point:
        """The evaluated point of the least value; of equals the first."""
        return self.points[np.argmin(self.values)]

    @property
    def value(self) -> float:
        """The least value."""
        return float(self.values.min())


def random_search(
    evaluate_value: EvaluateValue, start: Point, scales: Point, budget: int, seed: int
) -> ValueSearch:
    """Evaluate the start, then points drawn around it (see `random_point`).

    Raises:
        ValueError: for a budget below one.
    """
    record = _Record(evaluate_value, budget)
    for index in range(budget):
        record(random_point(start, scales, seed, index))
    return record.search()


def random_point(start: Point, scales: Point, seed: int, index: int) -> Point:
    """Return point `index` of a random search, a function of seed and index alone: N(start,
    diag(scales^2)).

    Point 0 is the start itself. Around the logarithm of a weight this is a log-normal weight.
    """
    if index == 0:
        return np.array(start)
    generator = np.random.default_rng((seed, index))
    return start + scales * generator.standard_normal(len(start))


def nelder_mead(
    evaluate_value: EvaluateValue, start: Point, budget: int, size: float
) -> ValueSearch:
    """Search by the adaptive simplex method, from the start and its neighbours at `size` along each
    axis.

    Returns:
        The search; its first point is the start.

    Raises:
        ValueError: for a budget below one, or a size that is zero or not finite.
    """
    if not 0 < abs(size) < math.inf:
        raise ValueError(f"size = {size}: spans no simplex; choose a finite number other than zero")
    record = _Record(evaluate_value, budget)
    while record.left:
        centre = record.search().best if record.values else start
        simplex = np.vstack([centre, centre + size * np.eye(len(start))])
        options = {
            "adaptive": True,
            "initial_simplex": simplex,
            "maxfev": record.left,
            "xatol": 0.0,
            "fatol": 0.0,
        }
        # Differences of infinite values are not numbers; the method only asks whether they are
        # small.
        with np.errstate(invalid="ignore"):
            minimize(record, start, method="Nelder-Mead", options=options)
        size *= -0.5  # neighbours on the other side, and closer
    return record.search()


def log_grid(
    centre: Point, decades: float | Point, shape: Sequence[int]
) -> Float[np.ndarray, "points parameters"]:
    """Return the points of a full factorial grid of positive parameters, the last one varying
    fastest.

    Args:
        centre: positive; on the grid wherever a parameter's number of values is odd.
        decades: from the centre to the last value of each parameter, up and down.
        shape: number of values of each parameter; a single one is the centre's.

    Raises:
        ValueError: for a centre that is not positive, or a shape that does not fit it.
    """
    if len(shape) != len(centre) or min(shape, default=0) < 1:
        raise ValueError(
            f"shape = {tuple(shape)}: does not fit {len(centre)} parameters; "
            "count one value or more each"
        )
    if not np.all(np.isfinite(centre) & (centre > 0)):
        raise ValueError(f"centre = {centre}: has no logarithm; give positive numbers")
    steps = [np.linspace(-1.0, 1.0, count) if count > 1 else np.zeros(1) for count in shape]
    axes = np.meshgrid(*steps, indexing="ij")
    exponents = np.stack(axes, axis=-1).reshape(-1, len(shape))
    return centre * 10.0 ** (decades * exponents)


class _Record:
    """An objective that keeps what it was asked and what it answered."""

    def __init__(self, evaluate_value: EvaluateValue, budget: int) -> None:
        if budget < 1:
            raise ValueError(
                f"budget = {budget}: leaves nothing to compare; allow one evaluation or more"
            )
        self._evaluate_value = evaluate_value
        self._budget = budget
        self.points: list[Point] = []
        self.values: list[float] = []

    @property
    def left(self) -> int:
        """Evaluations left of the budget."""
        return self._budget - len(self.values)

    def __call__(self, point: Point) -> float:
        """Evaluate a point, and return +inf where its value is not finite."""
        value = float(self._evaluate_value(np.array(point)))
        self.points.append(np.array(point))
        self.values.append(value if math.isfinite(value) else math.inf)
        return self.values[-1]

    def search(self) -> ValueSearch:
        """Return what was asked so far."""
        return ValueSearch(np.array(self.points), np.array(self.values))
