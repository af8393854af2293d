"""That functions stay below levels over boxes, proved on integers.

The mean value form of `sets.supremum`, in units of 1/GRID. Where the level is known the search ends
as soon as every cell is below it, after a few of the cells that finding the level took. Floats only
choose centres and cuts, of which any would do.

Source: Moore, Kearfott, Cloud 2009, Introduction to Interval Analysis, chapters 5, 6.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from fractions import Fraction
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from sets.deferred import defer, force
from sets.exact_interval import (
    BITS,
    GRID,
    ExactInterval,
    Gradient,
    enclose_numbers,
    scale_down,
    scale_up,
)
from sets.interval import Dual

CENTRE_UNITS = 2**53
"""Steps in which a centre may lie between the ends of a cell."""


class Room(NamedTuple):
    """By how much a function stays below a level at least, and at most.

    Attributes:
        proved: not negative where it never passes the level.
        met: negative where it does.
    """

    proved: Fraction
    met: Fraction

    def scaled(self, factor: Fraction) -> Room:
        """Return the room in another unit."""
        return Room(self.proved * factor, self.met * factor)


def find_least(rooms: Iterable[Room]) -> Room:
    """Return the room that several functions leave together."""
    proved, met = zip(*rooms, strict=True)
    return Room(min(proved), min(met))


class _Form(NamedTuple):
    """An upper bound in every cell, a value met there, and the ends of the gradient over it, in
    units."""

    bound: np.ndarray
    value: np.ndarray
    least: np.ndarray
    most: np.ndarray


def find_room(
    function: Callable[[Sequence], Dual],
    lower: Float[np.ndarray, "variables boxes"],
    upper: Float[np.ndarray, "variables boxes"],
    level: Fraction,
    most_cells: int = 20_000,
) -> Room:
    """Bound by how much a function stays below a level over all of the boxes.

    Args:
        function: takes the variables, intervals or duals alike, and returns one of their kind.
        lower, upper: ends of the boxes; equal ends are allowed.
        level: to stay below.
        most_cells: number of cells after which the search gives up.

    Returns:
        The room; where the search gives up, for the level is passed or cells are too many, less
        than none is proved.

    Raises:
        ValueError: an operation of the function refuses the boxes.
    """
    low = scale_down(lower)
    high = scale_up(upper)
    target = level.numerator * GRID // level.denominator
    bounds = []
    values = []
    count = 0
    while low.size:
        form = _bound_cells(function, low, high)
        count += len(form.bound)
        below = form.bound <= target
        low, high = _collapse(low, high, form)
        spread = _find_spread(low, high, form)
        values.extend(form.value)
        gives_up = count > most_cells or max(values) > target
        ends = below | (spread.max(axis=0) == 0) | gives_up
        bounds.extend(form.bound[ends])
        low, high = _halve(low[:, ~ends], high[:, ~ends], spread[:, ~ends].argmax(axis=0))
    return Room(Fraction(target - max(bounds), GRID), Fraction(target - max(values), GRID))


def _bound_cells(function, low: np.ndarray, high: np.ndarray) -> _Form:
    """Bound the function in every cell, from the point that bounds best."""
    size, count = low.shape
    ends = [ExactInterval(*pair) for pair in zip(low, high, strict=True)]
    result = force(function(defer([_seed(index, end) for index, end in enumerate(ends)])))
    least = np.zeros((size, count), dtype=object)
    most = np.zeros((size, count), dtype=object)
    for variable, row in result.gradient.rows.items():
        least[variable] = row.lower
        most[variable] = row.upper
    centre = _choose_centre(low, high, least, most)
    at_centre = force(function(defer([ExactInterval(row, row) for row in centre])))
    rises = np.maximum(most * (high - centre), least * (low - centre)).sum(axis=0)
    bound = at_centre.upper - (-rises >> BITS)
    return _Form(np.minimum(bound, result.value.upper), at_centre.lower, least, most)


def _seed(variable: int, ends: ExactInterval) -> Dual:
    """Return a variable with its gradient; one whose ends are equal has no part in it."""
    is_wide = np.any(ends.lower < ends.upper)
    return Dual(ends, Gradient({variable: enclose_numbers([1])} if is_wide else {}))


def _choose_centre(low, high, least, most) -> np.ndarray:
    """Return the ends along which the function is monotone, and points where both ends bound alike
    (Baumann 1988, BIT 28, "Optimal centered forms")."""
    width = np.maximum(most - least, 1)
    share = np.clip(most * CENTRE_UNITS // width, 0, CENTRE_UNITS)
    return low + (high - low) * share // CENTRE_UNITS


def _collapse(low, high, form: _Form) -> tuple[np.ndarray, np.ndarray]:
    """Return the cells shrunk to the ends that hold their suprema."""
    rises = form.least >= 0
    falls = (form.most <= 0) & ~rises
    return np.where(rises, high, low), np.where(falls, low, high)


def _find_spread(low, high, form: _Form) -> Float[np.ndarray, "variables cells"]:
    """Return what each variable can still contribute."""
    up = np.maximum(form.most, 0).astype(float)
    down = np.maximum(-form.least, 0).astype(float)
    return up * down / np.maximum(up + down, 1.0) * (high - low).astype(float)


def _halve(low, high, variable) -> tuple[np.ndarray, np.ndarray]:
    """Return both halves of every cell, cut along its variable."""
    cell = np.arange(len(variable))
    middle = (low[variable, cell] + high[variable, cell]) // 2
    first_high = high.copy()
    first_high[variable, cell] = middle
    second_low = low.copy()
    second_low[variable, cell] = middle
    return np.hstack([low, second_low]), np.hstack([first_high, high])
