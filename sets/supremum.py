"""The largest values of functions over boxes, bounded rigorously by branch and bound.

    sup {f(x) : x in cell} <= f(c) + sum_i max {g (x_i - c_i) : x in cell, g in G_i},

G_i being an enclosure of df/dx_i over the cell.

The centre c lies at an end of the cell along monotone variables, where the bound is exact, else
where both ends bound alike (Baumann 1988, BIT 28, "Optimal centered forms"). Values at such centres
are values of f, hence bounds from below. A cell is done once its bound exceeds the largest value
found by no more than the tolerance; others are halved along the variable that contributes most. All
objectives and all their cells are worked on in one batch.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from sets.interval import EPSILON, TINY, Dual, Interval

MOST_CELLS = 100_000
"""Cells after which a search stops, if nothing else is said."""
CHUNK = 1000
"""Cells that are evaluated at once: what they need fits a processor's cache."""
TIE = 1e-9
"""Relative difference below which two contributions are equal: the first variable is cut."""


@dataclass(frozen=True)
class Cells:
    """Boxes lower <= x <= upper, each with its objective and a bound of it."""

    lower: Float[np.ndarray, "variables cells"]
    upper: Float[np.ndarray, "variables cells"]
    objective: Int[np.ndarray, " cells"]
    bound: Float[np.ndarray, " cells"]

    def __getitem__(self, index) -> Cells:
        lower = self.lower[:, index]
        upper = self.upper[:, index]
        return Cells(lower, upper, self.objective[index], self.bound[index])

    def halve(self, variable: Int[np.ndarray, " cells"]) -> Cells:
        """Return both halves of every cell, cut along its variable."""
        cell = np.arange(len(variable))
        middle = 0.5 * (self.lower[variable, cell] + self.upper[variable, cell])
        upper_of_left = self.upper.copy()
        upper_of_left[variable, cell] = middle
        lower_of_right = self.lower.copy()
        lower_of_right[variable, cell] = middle
        return Cells(
            np.hstack([self.lower, lower_of_right]),
            np.hstack([upper_of_left, self.upper]),
            np.tile(self.objective, 2),
            np.tile(self.bound, 2),
        )


def suprema(
    function: Callable[[Sequence], Sequence],
    lower: Float[np.ndarray, "variables boxes"],
    upper: Float[np.ndarray, "variables boxes"],
    objectives: Sequence[tuple[int, int, int]],
    tolerance: float,
    negligible: float | Float[np.ndarray, " groups"] = 1e-9,
    most_cells: int = MOST_CELLS,
) -> tuple[Float[np.ndarray, " groups"], Float[np.ndarray, " groups"]]:
    """Bound sup {sign f_output(x) : lower <= x <= upper in some box} over every group of
    objectives.

    Args:
        function: takes the variables, floats or intervals or duals alike, and returns its outputs.
        lower, upper: ends of the boxes; equal ends are allowed.
        objectives: (output, sign, group) of each; only the largest of a group counts.
        tolerance: relative gap at which a cell is done, positive.
        negligible: gap at which a cell is done anyway, in the unit of the outputs; one for all
            groups, or one for each.
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
    count = len(output)
    boxes = lower.shape[1]
    found = np.full(group.max() + 1, -np.inf)
    least_gap = np.broadcast_to(negligible, found.shape)
    proved = np.full(group.max() + 1, -np.inf)
    cells = Cells(
        np.tile(lower, (1, count)),
        np.tile(upper, (1, count)),
        np.repeat(np.arange(count), boxes),
        np.full(count * boxes, np.inf),
    )
    evaluated = 0
    while len(cells.objective):
        evaluated += len(cells.objective)
        own = group[cells.objective]
        form = _evaluate_in_chunks(function, cells, output, sign)
        np.maximum.at(found, own, form.values)
        cells, spread = _collapse(replace(cells, bound=form.bound), form.gradient)
        gap = tolerance * np.abs(found[own]) + least_gap[own]
        is_tight = cells.bound <= found[own] + gap
        is_done = is_tight | (spread.max(axis=0) == 0) | (evaluated > most_cells)
        np.maximum.at(proved, own[is_done], cells.bound[is_done])
        cells = cells[~is_done].halve(_find_first_largest(spread[:, ~is_done]))
    return proved, found


def _find_first_largest(
    spread: Float[np.ndarray, "variables cells"],
) -> Int[np.ndarray, " cells"]:
    """Return the variable that contributes most; among variables equal up to `TIE`, the first."""
    return (spread >= (1 - TIE) * spread.max(axis=0)).argmax(axis=0)


class _Form(NamedTuple):
    """The values found in every cell, the gradients over it and its bound."""

    values: Float[np.ndarray, " cells"]
    gradient: Interval
    bound: Float[np.ndarray, " cells"]


def _evaluate_in_chunks(function, cells: Cells, output, sign) -> _Form:
    """Return the forms of all cells, with the output and the sign of every objective; cells whose
    same variables vary are evaluated together, for others have no derivatives then."""
    order = np.lexsort(cells.lower < cells.upper)
    forms = []
    for begin in range(0, len(order), CHUNK):
        chunk = cells[order[begin : begin + CHUNK]]
        forms.append(_evaluate(function, chunk, output[chunk.objective], sign[chunk.objective]))
    back = np.argsort(order)
    gradient = Interval(
        np.hstack([form.gradient.lower for form in forms])[:, back],
        np.hstack([form.gradient.upper for form in forms])[:, back],
    )
    values = np.concatenate([form.values for form in forms])[back]
    return _Form(values, gradient, np.concatenate([form.bound for form in forms])[back])


def _evaluate(function, cells: Cells, output, sign) -> _Form:
    """Evaluate the mean value form of the module docstring in every cell."""
    variables, count = cells.lower.shape
    value, gradient = _differentiate(function, cells, output, sign)
    width = np.maximum(gradient.upper - gradient.lower, TINY)
    share = np.clip(gradient.upper / width, 0.0, 1.0)
    centre = cells.lower + share * (cells.upper - cells.lower)
    centre = np.clip(centre, cells.lower, cells.upper)
    rises_mostly = gradient.lower + gradient.upper > TIE * width
    corner = np.where(rises_mostly, cells.upper, cells.lower)
    points = np.hstack([centre, corner])
    at_points = _enclose_values(function, points, np.tile(output, 2), np.tile(sign, 2))
    at_centre = at_points.upper[:count]
    rises = (gradient * (Interval(cells.lower, cells.upper) - centre)).upper
    size = np.abs(at_centre) + np.abs(rises).sum(axis=0)
    rounding = (variables + 1) * EPSILON * size
    bound = at_centre + rises.sum(axis=0) + 2.0 * rounding
    bound = np.minimum(np.minimum(bound, value), cells.bound)
    return _Form(at_points.lower.reshape(2, count).max(axis=0), gradient, bound)


def _differentiate(
    function, cells: Cells, output, sign
) -> tuple[Float[np.ndarray, " cells"], Interval]:
    """Return an upper bound of each cell's objective and the enclosure of its gradient, by interval
    arithmetic."""
    variables, count = cells.lower.shape
    # A variable of no width contributes nothing, whatever its derivative: that is left out.
    varies = (cells.lower < cells.upper).any(axis=1)
    seeds = np.eye(variables)[:, varies]
    boxes = zip(cells.lower, cells.upper, seeds, strict=True)
    duals = [Dual(Interval(low, high), _spread_seed(seed, count)) for low, high, seed in boxes]
    value = np.zeros(count)
    lower = np.zeros((variables, count))
    upper = np.zeros((variables, count))
    for index, result in enumerate(function(duals)):
        for direction in (1, -1):
            own = (output == index) & (sign == direction)
            if isinstance(result, Dual) and own.any():
                signed = result * float(direction)
                value[own] = signed.value.upper[own]
                lower[np.ix_(varies, own)] = signed.gradient.lower[:, own]
                upper[np.ix_(varies, own)] = signed.gradient.upper[:, own]
    return value, Interval(lower, upper)


def _spread_seed(seed: Float[np.ndarray, " variables"], count: int) -> Interval:
    """Return the derivatives of one variable, the same in all cells."""
    spread = np.broadcast_to(seed[:, None], (len(seed), count))
    return Interval(spread, spread)


def _enclose_values(
    function, points: Float[np.ndarray, "variables points"], output, sign
) -> Interval:
    """Enclose the objective of each point."""
    results = function([Interval(row, row) for row in points])
    count = points.shape[1]
    lower = np.zeros((len(results), count))
    upper = np.zeros((len(results), count))
    for index, result in enumerate(results):
        if isinstance(result, Interval):
            lower[index] = result.lower
            upper[index] = result.upper
    least = lower[output, np.arange(count)]
    most = upper[output, np.arange(count)]
    return Interval(np.where(sign > 0, least, -most), np.where(sign > 0, most, -least))


def _collapse(
    cells: Cells, gradient: Interval
) -> tuple[Cells, Float[np.ndarray, "variables cells"]]:
    """Return the cells shrunk to the ends that hold their suprema, and what each variable can still
    contribute."""
    lower = np.where(gradient.lower >= 0, cells.upper, cells.lower)
    upper = np.where((gradient.upper <= 0) & (gradient.lower < 0), cells.lower, cells.upper)
    up = np.maximum(gradient.upper, 0.0)
    down = np.maximum(-gradient.lower, 0.0)
    spread = up * down / np.maximum(up + down, TINY) * (upper - lower)
    return replace(cells, lower=lower, upper=upper), spread
