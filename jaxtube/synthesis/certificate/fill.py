"""How much of what the controller may use its tube fills at its widest, cap by cap.

    share(row) = h_R(row) / offset        R an invariant outer bound of the minimal RPI set of the gain

The largest share is the ratio of a design: below 1 an invariant set exists inside all caps, above
it none may. R is a polytope with the rows of the caps and a ring of facets in the plane of lateral
and heading error, where loops turn.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from jaxtyping import Float

from jaxtube.synthesis.disturbance import with_computed_bound
from jaxtube.synthesis.problem import Problem
from jaxtube.synthesis.terminal import admissible_set
from jaxtube.synthesis.tightening import (
    ERROR_NAMES,
    LocalGain,
    gains_at_corners,
    input_names,
    vertex_loops,
)
from sets.invariant import minimal_rpi_bound
from sets.polytope import Polytope

NESTED, SETTLED = 12, 0.01
"""Nested sets at most, and the change of the half widths at which they have settled."""
RING = 60
"""Facets of the ring; the ratio of the reference design is then 0.4 % above the smallest possible."""


def cap_shares(problem: Problem, gain: LocalGain) -> dict[str, float]:
    """Return the share of each cap that the tube fills at its widest, by name; infinite where no
    bound was found."""
    E, rows = problem.operating_set, problem.input_rows
    names, bound = [*ERROR_NAMES, *input_names(problem)], widest_tube(problem, gain)
    if bound is None:
        return dict.fromkeys(names, np.inf)
    under = rows.under(gains_at_corners(problem, gain))
    errors = bound.support(E.normals) / E.offsets
    inputs = np.max([bound.support(each) for each in under], axis=0) / rows.offsets
    shares = np.concatenate([errors.reshape(2, -1).max(axis=0), inputs.reshape(2, -1).max(axis=0)])
    return dict(zip(names, shares.tolist(), strict=True))


def widest_tube(problem: Problem, gain: LocalGain) -> Polytope | None:
    """Return an invariant outer bound of the minimal RPI set of a gain, None where none was found."""
    caps, angles = admissible_set(problem, gain), 2 * np.pi * np.arange(RING) / RING
    widths = problem.operating_set.offsets[1:3, None]
    ring = np.stack(
        [np.zeros(RING), *(np.stack([np.cos(angles), np.sin(angles)]) / widths)], axis=1
    )
    normals = np.concatenate([caps.normals / caps.offsets[:, None], ring])
    return minimal_rpi_bound(vertex_loops(problem, gain), problem.disturbance_set.support, normals)


def ultimate_bound(problem: Problem, gain: LocalGain) -> Float[np.ndarray, "3"]:
    """Return half widths (m, m, rad) of the measured error that the law u = K e ends within, once
    in the terminal set.

    Nested: within the widest tube errors and inputs are smaller than their caps, so W is smaller
    there, so is the tube of this W, and so on. Each set holds the error from some time on, as the
    one before attracts it.

    Raises:
        ValueError: where the tube outgrows a cap, or W was not computed.
    """
    if problem.residual is None:
        raise ValueError(
            'disturbance.bound = "assumed": no bound shrinks with the errors; set it to "computed"'
        )
    if not max(cap_shares(problem, gain).values()) <= 1:
        raise ValueError(
            "the tube outgrows a cap: no ultimate bound; narrow slip.relative_error or the speeds"
        )
    gains, widths = gains_at_corners(problem, gain), problem.operating_set.offsets[:3]
    for _ in range(NESTED):
        tube = widest_tube(problem, gain)
        assert tube is not None
        before, widths = widths, np.minimum(tube.support(np.eye(3)), widths)
        reach = np.max([tube.support(np.concatenate([law, -law])) for law in gains], axis=0)
        smaller = replace(
            problem,
            operating_set=Polytope.box(-widths, widths),
            error_set=Polytope.box(-widths - _noise(problem), widths + _noise(problem)),
            input_set=Polytope.box(-reach[2:], reach[:2]),
        )
        problem = with_computed_bound(smaller)
        if np.all(widths >= (1 - SETTLED) * before):
            break
    return widths


def _noise(problem: Problem) -> Float[np.ndarray, "3"]:
    return problem.error_set.offsets[:3] - problem.operating_set.offsets[:3]
