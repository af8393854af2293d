"""The largest values of functions over boxes, bounded rigorously by branch and bound.

    sup {f(x) : x in cell} <= f(c) + sum_i max {g (x_i - c_i) : x in cell, g in G_i},    G_i encloses df/dx_i there

The centre c lies at an end of the cell along monotone variables, where the bound is exact, else
where both ends bound alike (Baumann 1988, BIT 28, "Optimal centered forms"). Values at such centres
are values of f, hence bounds from below. A cell is done once its bound exceeds the largest value
found by no more than the tolerance; others are halved along the variable that contributes most. All
objectives and all their cells are worked on in one batch.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from sets.interval import EPSILON, TINY, Dual, Interval


@dataclass
class Cells:
    """Boxes lower <= x <= upper, each with its objective and the bound of the cell it was cut from."""

    lower: Float[np.ndarray, "variables cells"]
    upper: Float[np.ndarray, "variables cells"]
    objective: Int[np.ndarray, " cells"]
    bound: Float[np.ndarray, " cells"]

    def __getitem__(self, chosen) -> Cells:
        return Cells(
            self.lower[:, chosen], self.upper[:, chosen], self.objective[chosen], self.bound[chosen]
        )

    def halves(self, variable: Int[np.ndarray, " cells"]) -> Cells:
        """Return both halves of every cell, cut along its variable."""
        cell = np.arange(len(variable))
        middle = 0.5 * (self.lower[variable, cell] + self.upper[variable, cell])
        lower, upper = self.lower.copy(), self.upper.copy()
        upper[variable, cell] = lower[variable, cell] = middle
        ends = np.hstack([self.lower, lower]), np.hstack([upper, self.upper])
        return Cells(*ends, np.tile(self.objective, 2), np.tile(self.bound, 2))


def suprema(
    function: Callable[[Sequence], Sequence],
    lower: Float[np.ndarray, "variables boxes"],
    upper: Float[np.ndarray, "variables boxes"],
    objectives: Sequence[tuple[int, int, int]],
    tolerance: float,
    negligible: float = 1e-9,
    most_cells: int = 100_000,
) -> tuple[Float[np.ndarray, " groups"], Float[np.ndarray, " groups"]]:
    """Bound sup {sign f_output(x) : lower <= x <= upper in some box} over every group of
    objectives.

    Args:
        function: takes the variables, floats or intervals or duals alike, and returns its outputs.
        lower, upper: ends of the boxes; equal ends are allowed.
        objectives: (output, sign, group) of each; only the largest of a group counts.
        tolerance: relative gap at which a cell is done, positive.
        negligible: gap at which a cell is done anyway, in the unit of the outputs.
        most_cells: number of cells after which the search stops; the bounds hold all the same, only
            less tightly.

    Returns:
        (bounds, values found) of every group: its supremum lies between the value found and the
        bound.

    Raises:
        ValueError: tolerance not positive, or an operation of the function refuses the box.

    Source: Moore, Kearfott, Cloud 2009, Introduction to Interval Analysis, chapters 5, 6.
    """
    if not tolerance > 0:
        raise ValueError(
            f"tolerance: {tolerance} is not positive; give a relative gap such as 0.01"
        )
    output, sign, group = np.array(objectives).T
    found, proved = np.full((2, group.max() + 1), -np.inf)
    boxes, count = lower.shape[1], len(output)
    low, high = (np.tile(end, (1, count)) for end in (lower, upper))
    cells = Cells(low, high, np.repeat(np.arange(count), boxes), np.full(count * boxes, np.inf))
    evaluated = 0
    while len(cells.objective):
        evaluated += len(cells.objective)
        own = group[cells.objective]
        of_cell = output[cells.objective], sign[cells.objective]
        values, gradient, cells.bound = _mean_value_form(function, cells, *of_cell)
        np.maximum.at(found, own, values)
        gap = tolerance * np.abs(found[own]) + negligible
        cells, spread = _collapsed(cells, gradient)
        done = (
            (cells.bound <= found[own] + gap) | (spread.max(axis=0) == 0) | (evaluated > most_cells)
        )
        np.maximum.at(proved, own[done], cells.bound[done])
        cells = cells[~done].halves(spread[:, ~done].argmax(axis=0))
    return proved, found


def _mean_value_form(function, cells: Cells, output, sign):
    """Return the values found in every cell, the gradients over it and its bound."""
    variables, count = cells.lower.shape
    value, gradient = _derivatives(function, cells, output, sign)
    share = np.clip(gradient.upper / np.maximum(gradient.upper - gradient.lower, TINY), 0.0, 1.0)
    centre = np.clip(cells.lower + share * (cells.upper - cells.lower), cells.lower, cells.upper)
    corner = np.where(gradient.lower + gradient.upper > 0, cells.upper, cells.lower)
    at_points = _values(function, np.hstack([centre, corner]), np.tile(output, 2), np.tile(sign, 2))
    rises = (gradient * (Interval(cells.lower, cells.upper) - centre)).upper
    rounding = (
        (variables + 1) * EPSILON * (np.abs(at_points.upper[:count]) + np.abs(rises).sum(axis=0))
    )
    bound = at_points.upper[:count] + rises.sum(axis=0) + 2.0 * rounding
    return (
        at_points.lower.reshape(2, count).max(axis=0),
        gradient,
        np.minimum(np.minimum(bound, value), cells.bound),
    )


def _derivatives(
    function, cells: Cells, output, sign
) -> tuple[Float[np.ndarray, " cells"], Interval]:
    """Return an upper bound of each cell's objective and the enclosure of its gradient, by interval
    arithmetic."""
    variables, count = cells.lower.shape
    seeds = np.broadcast_to(np.eye(variables)[:, :, None], (variables, variables, count))
    boxes = zip(cells.lower, cells.upper, seeds, strict=True)
    results = function(
        [Dual(Interval(low, high), Interval(seed, seed)) for low, high, seed in boxes]
    )
    value, lower, upper = (
        np.zeros(count),
        np.zeros((variables, count)),
        np.zeros((variables, count)),
    )
    for index, result in enumerate(results):
        for direction in (1, -1):
            chosen = (output == index) & (sign == direction)
            if isinstance(result, Dual) and chosen.any():
                signed = result * float(direction)
                value[chosen] = signed.value.upper[chosen]
                lower[:, chosen], upper[:, chosen] = (
                    signed.gradient.lower[:, chosen],
                    signed.gradient.upper[:, chosen],
                )
    return value, Interval(lower, upper)


def _values(function, points: Float[np.ndarray, "variables points"], output, sign) -> Interval:
    """Enclose the objective of each point."""
    results = function([Interval(row, row) for row in points])
    ends = np.zeros((2, len(results), points.shape[1]))
    for index, result in enumerate(results):
        if isinstance(result, Interval):
            ends[0, index], ends[1, index] = result.lower, result.upper
    lower, upper = ends[:, output, np.arange(points.shape[1])]
    return Interval(np.where(sign > 0, lower, -upper), np.where(sign > 0, upper, -lower))


def _collapsed(
    cells: Cells, gradient: Interval
) -> tuple[Cells, Float[np.ndarray, "variables cells"]]:
    """Return the cells shrunk to the ends that hold their suprema, and what each variable can still
    contribute."""
    lower = np.where(gradient.lower >= 0, cells.upper, cells.lower)
    upper = np.where((gradient.upper <= 0) & (gradient.lower < 0), cells.lower, cells.upper)
    up, down = np.maximum(gradient.upper, 0.0), np.maximum(-gradient.lower, 0.0)
    spread = up * down / np.maximum(up + down, TINY) * (upper - lower)
    return Cells(lower, upper, cells.objective, cells.bound), spread
