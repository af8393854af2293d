"""Cells of a search: every facet of every limit at every step, or at every stage of a followed
plan, in one row of numbers.

Limits come in the order of their names, then stage by stage, then facet by facet.
"""

from __future__ import annotations

import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Float, Int

from jaxtube.simulation.usage import Limits

DURING_PERIODS = ("input", "wheels", "acceleration")
"""Limits of what happens during a period; the others are met at its end."""


class UsageCells:
    """The cells of some limits.

    Attributes:
        shapes: (stages, facets) of each limit.
        slices: the numbers of its cells.
    """

    def __init__(self, limits: Limits, steps: int):
        self.shapes: dict[str, tuple[int, int]] = {}
        self.slices: dict[str, slice] = {}
        first = 0
        for name in sorted(limits):
            horizon, facets = limits[name].offsets.shape
            stages = horizon if name == "tube" else steps
            self.shapes[name] = (stages, facets)
            self.slices[name] = slice(first, first + stages * facets)
            first += stages * facets

    def list_by_facet(self, name: str) -> Int[np.ndarray, " k"]:
        """Return the cells of a limit one facet after the other, so that a grid over them covers
        facets and steps."""
        cells = np.arange(self.slices[name].start, self.slices[name].stop)
        return cells.reshape(self.shapes[name]).T.ravel()

    def pick(self, name: str, values: Float[np.ndarray, " cells"]) -> Float[np.ndarray, "k m"]:
        """Return the values of one limit, by stage and facet."""
        return values[self.slices[name]].reshape(self.shapes[name])

    def locate(self, name: str, cell: int) -> tuple[int, int]:
        """Return (stage, facet) of a cell of a limit."""
        facets = self.shapes[name][1]
        return divmod(cell - self.slices[name].start, facets)


def stack_cells(
    usages: dict[str, Float[Array, "stages facets batch"]],
) -> Float[Array, "cells batch"]:
    """Return the usages of all cells, one column an instance."""
    columns = [usages[name].reshape(-1, usages[name].shape[2]) for name in sorted(usages)]
    return jnp.concatenate(columns)
