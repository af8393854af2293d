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
    """Where some rows are active."""

    optimum: Float[np.ndarray, "n 4"]  # x, affine in (p, 1)
    multipliers: Float[np.ndarray, "a 4"]  # likewise
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
    shape = (1 + len(every), max(len(region.rows) for region in every))
    # Region 0 is that of programs without any: it has no rows.
    optimum = np.zeros((len(every) + 1, len(every[0].optimum), 4))
    multipliers = np.zeros((*shape, 4))
    rows = np.full(shape, np.iinfo(np.int32).max, np.int32)
    for number, region in enumerate(every, start=1):
        optimum[number] = region.optimum
        multipliers[number, : len(region.rows)] = region.multipliers
        rows[number, : len(region.rows)] = region.rows
    begin: list[int] = []
    following = []
    planes = 0
    regions = 1
    for bank in programs:
        begin.append(~0 if bank is None else planes)
        if bank is not None:
            after = bank.tree.following
            following.append(np.where(after < 0, after - regions, after + planes))
            planes += len(bank.tree.planes)
            regions += len(bank.regions)
    return Regions(
        begin=np.array(begin, np.int32),
        planes=np.concatenate([bank.tree.planes for bank in banks]),
        following=np.concatenate(following).astype(np.int32),
        optimum=optimum,
        multipliers=multipliers,
        rows=rows,
    )
