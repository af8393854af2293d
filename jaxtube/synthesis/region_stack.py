"""The critical regions of windows as the arrays in which a controller looks them up.

Source: as `jaxtube.qp.regions`.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from jaxtube.qp.regions import Regions
from jaxtube.synthesis.region_tree import Tree


class Region(NamedTuple):
    """Where some rows are active: their multipliers, affine in (p, 1)."""

    multipliers: Float[np.ndarray, "a 4"]
    rows: Int[np.ndarray, " a"]


class Bank(NamedTuple):
    """The regions of a program, and the tree that tells them apart."""

    regions: Sequence[Region]
    tree: Tree


def stack_regions(programs: Sequence[Bank | None]) -> Regions | None:
    """Return the regions of a stack of programs; None where no program has any."""
    banks = [bank for bank in programs if bank is not None]
    if not banks:
        return None
    every = [region for bank in banks for region in bank.regions]
    shape = (
        len(programs),
        max(len(bank.regions) for bank in banks),
        max(len(region.rows) for region in every),
    )
    places = max(len(bank.tree.planes) for bank in banks)
    stack = Regions(
        planes=np.zeros((len(programs), places, 4)),
        # Where there is no region, region 0 is guessed, which has no rows.
        following=np.full((len(programs), places, 2), ~0, np.int32),
        multipliers=np.zeros((*shape, 4)),
        rows=np.full(shape, np.iinfo(np.int32).max, np.int32),
    )
    for program, bank in enumerate(programs):
        if bank is None:
            continue
        stack.planes[program, : len(bank.tree.planes)] = bank.tree.planes
        stack.following[program, : len(bank.tree.planes)] = bank.tree.following
        for number, region in enumerate(bank.regions):
            stack.multipliers[program, number, : len(region.rows)] = region.multipliers
            stack.rows[program, number, : len(region.rows)] = region.rows
    return stack
