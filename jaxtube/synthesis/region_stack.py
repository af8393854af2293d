"""Critical regions one by one, and as the arrays in which a controller looks them up.

Source: as `jaxtube.qp.regions`.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from jaxtube.qp.regions import Regions
from sets.polytope import Polytope

ON_A_FACET = 1e-9
"""By how much an error may lie beyond facets of norm one."""


class Region(NamedTuple):
    """Where some rows are active: its facets, of norm one, and x and the multipliers of the active
    rows, affine in (p, 1)."""

    facets: Polytope
    optimum: Float[np.ndarray, "n 4"]
    multipliers: Float[np.ndarray, "a 4"]
    rows: Int[np.ndarray, " a"]

    def holds(self, p: Float[np.ndarray, "3"]) -> bool:
        """Return whether p lies in the region."""
        return bool(self.facets.contains(p, ON_A_FACET))


def stack_regions(programs: Sequence[Sequence[Region]], variables: int) -> Regions | None:
    """Return the regions of a stack of programs of so many variables; None where there are none."""
    every = [region for regions in programs for region in regions]
    if not every:
        return None
    count = max(map(len, programs))
    facets = max(len(region.facets.offsets) for region in every)
    active = max(len(region.rows) for region in every)
    shape = (len(programs), count)
    nowhere = np.iinfo(np.int32).max
    stack = Regions(
        normals=np.zeros((len(programs), facets, count, 3)),
        offsets=np.full((len(programs), facets, count), np.inf),
        optimum=np.zeros((*shape, variables, 4)),
        multipliers=np.zeros((*shape, active, 4)),
        rows=np.full((*shape, active), nowhere, np.int32),
    )
    for program, regions in enumerate(programs):
        # Nothing lies in a region that is not there.
        stack.offsets[program, 0, len(regions) :] = -np.inf
        for number, region in enumerate(regions):
            place = (program, number)
            used = len(region.facets.offsets)
            stack.normals[program, :used, number] = region.facets.normals
            stack.offsets[program, :used, number] = region.facets.offsets
            stack.optimum[place] = region.optimum
            stack.multipliers[place][: len(region.rows)] = region.multipliers
            stack.rows[place][: len(region.rows)] = region.rows
    return stack
