"""How much of what the controller may use its tube fills at its widest, cap by cap.

    share(row) = h_R(row) / offset        R an invariant outer bound of the minimal RPI set of the gain

The largest share is the ratio of a design: below 1 an invariant set exists inside all caps, above it none may. R is a
polytope with the rows of the caps and a ring of facets in the plane of lateral and heading error, where loops turn.
"""

from __future__ import annotations

import numpy as np

from jaxtube.design.problem import Problem
from jaxtube.design.terminal import admissible_set
from jaxtube.design.tightening import ERROR_NAMES, LocalGain, gains_at_corners, input_names, vertex_loops
from sets.invariant import minimal_rpi_bound

RING = 60
"""Facets of the ring; the ratio of the reference design is then 0.4 % above the smallest possible."""


def cap_shares(problem: Problem, gain: LocalGain) -> dict[str, float]:
    """Return the share of each cap that the tube fills at its widest, by name; infinite where no bound was found."""
    E, rows = problem.operating_set, problem.input_rows
    names = [*ERROR_NAMES, *input_names(problem)]
    caps = admissible_set(problem, gain)
    angles = 2 * np.pi * np.arange(RING) / RING
    ring = np.stack([np.zeros(RING), *(np.stack([np.cos(angles), np.sin(angles)]) / E.offsets[1:3, None])], axis=1)
    normals = np.concatenate([caps.normals / caps.offsets[:, None], ring])
    bound = minimal_rpi_bound(vertex_loops(problem, gain), problem.disturbance_set.support, normals)
    if bound is None:
        return dict.fromkeys(names, np.inf)
    under = rows.under(gains_at_corners(problem, gain))
    errors = bound.support(E.normals) / E.offsets
    inputs = np.max([bound.support(each) for each in under], axis=0) / rows.offsets
    shares = np.concatenate([errors.reshape(2, -1).max(axis=0), inputs.reshape(2, -1).max(axis=0)])
    return dict(zip(names, shares.tolist(), strict=True))
