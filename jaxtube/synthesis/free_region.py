"""The errors whose plan without constraints is the plan, by few rows.

While no row is active a plan is G e, and each row of the QP bounds e: l <= (R + A G) e <= u. Of
these rows most are implied by the others, which then decide alone. A row counts as implied only
where all errors that the others leave keep some distance from it, so that rounding cannot tell the
few rows from all.

Source: new.
"""

from __future__ import annotations

import jax
import numpy as np
from jaxtyping import Float

from jaxtube import qp
from jaxtube.control.planning import CondensedQp, HalfSpaces
from sets.polytope import Polytope

DISTANCE = 1e-7
"""From an implied row, by the bound of that row or its largest value, whichever is larger."""


def find_free_regions(*stacks: CondensedQp) -> list[HalfSpaces]:
    """Return the errors that have a free plan, window by window, for each stack of QPs.

    All have as many rows as the one that needs most, so that controllers of equal shapes stay so
    and share their compiled programs.

    Args:
        *stacks: condensed, with a leading axis over the windows.
    """
    regions = [_find_regions(qps) for qps in stacks]
    most = max(len(region.offsets) for of_stack in regions for region in of_stack)
    return [_stack_regions(of_stack, most) for of_stack in regions]


def _find_regions(qps: CondensedQp) -> list[HalfSpaces]:
    return [
        _find_region(jax.tree.map(lambda array, number=number: array[number], qps))
        for number in range(len(qps.lower))
    ]


def _find_region(condensed: CondensedQp) -> HalfSpaces:
    """Return the rows that bound the errors with a free plan; all of them where these are not
    bounded, or flat."""
    slack = qp.TOLERANCE[condensed.lower.dtype.itemsize]
    rows = np.concatenate([condensed.free_rows, condensed.check_errors])
    upper = np.concatenate([condensed.upper, condensed.check_upper + slack])
    lower = np.concatenate([condensed.lower, condensed.check_lower - slack])
    normals = np.concatenate([rows, -rows])
    offsets = np.concatenate([upper, -lower])
    finite = np.isfinite(offsets)
    normals = normals[finite]
    offsets = offsets[finite]
    region = Polytope(normals, offsets)
    if not region.is_bounded() or region.is_empty() or region.is_flat():
        return HalfSpaces(normals, offsets)
    values = normals @ region.vertices().T
    scale = np.maximum(np.abs(offsets), np.max(np.abs(values), axis=1))
    decides = np.max(values, axis=1) >= offsets - DISTANCE * scale
    return HalfSpaces(normals[decides], offsets[decides])


def _stack_regions(regions: list[HalfSpaces], most: int) -> HalfSpaces:
    padded = [_pad(region, most) for region in regions]
    return HalfSpaces(*map(np.stack, zip(*padded, strict=True)))


def _pad(region: HalfSpaces, most: int) -> HalfSpaces:
    missing = most - len(region.offsets)
    normals: Float[np.ndarray, "k 3"] = np.pad(region.normals, ((0, missing), (0, 0)))
    return HalfSpaces(normals, np.pad(region.offsets, (0, missing), constant_values=np.inf))
