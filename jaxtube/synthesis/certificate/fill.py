"""Utilisation of each cap by the widest tube of a gain.

    share(row) = h_R(row) / offset,   R an invariant outer bound of the minimal RPI set of the gain

The largest share is the ratio of a design: below 1 an invariant set exists inside all caps, above
it none may. R is a polytope with the rows of the caps and a ring of facets in the plane of lateral
and heading error, where loops turn.
"""

from __future__ import annotations

from dataclasses import replace
from types import ModuleType

import numpy as np
from jaxtyping import Float

from jaxtube.coordinates import ERROR_NAMES
from jaxtube.qp.regions import AnyArray
from jaxtube.synthesis.disturbance import with_computed_bound
from jaxtube.synthesis.gains import Gain
from jaxtube.synthesis.limits import make_input_rows
from jaxtube.synthesis.problem import Problem
from jaxtube.synthesis.terminal import admissible_set, pair_lasting_loops
from jaxtube.synthesis.tightening import input_names
from sets.certificate import Condition, judge
from sets.invariant import minimal_rpi_bound
from sets.polytope import Polytope

MOST_NESTED = 12
"""Nested sets at most."""
SETTLED = 0.01
"""Relative change of the half widths at which nested sets have settled."""
RING = 60
"""Facets of the ring; they make the ratio of the reference design 0.4 % larger than need be."""


def cap_shares(problem: Problem, gain: Gain) -> dict[str, float]:
    """Return the share of each cap that the tube fills at its widest, by name; infinite where no
    bound was found.

    Of several regimes it is the one tube of all that last, in any order, and of each cap on inputs
    the largest share over these regimes.
    """
    E = problem.operating_set
    names = [*ERROR_NAMES, *input_names(problem)]
    tube = widest_tube(problem, gain)
    if tube is None:
        return dict.fromkeys(names, np.inf)
    of_errors = tube.support(E.normals) / E.offsets
    lasting = list(problem.rule.lasting(problem.horizon))
    of_inputs = np.max(find_input_shares(problem, gain, tube)[lasting], axis=0)
    shares = [*_take_larger_of_pairs(of_errors), *of_inputs]
    return dict(zip(names, map(float, shares), strict=True))


def find_input_shares(
    problem: Problem, gain: Gain, tube: Polytope
) -> Float[np.ndarray, "regimes half"]:
    """Return the share of each cap on input and error that a tube fills, regime by regime; of each
    row and the opposite one the larger."""
    shares = []
    for number, regime in enumerate(problem.every_regime):
        rows = regime.input_rows
        on_errors = rows.on_errors(gain.of_regime(number).corner_gains)
        by_gain = [tube.support(row) for row in on_errors]
        shares.append(_take_larger_of_pairs(np.max(by_gain, axis=0) / rows.offsets))
    return np.array(shares)


def _take_larger_of_pairs(shares: Float[np.ndarray, " k"]) -> Float[np.ndarray, " half"]:
    """Return the larger share of each row and the opposite one."""
    return shares.reshape(2, -1).max(axis=0)


def widest_tube(problem: Problem, gain: Gain) -> Polytope | None:
    """Return an invariant outer bound of a gain's minimal RPI set, None where none was found."""
    caps = admissible_set(problem, gain)
    normals = np.concatenate(
        [caps.normals / caps.offsets[:, None], ring_normals(problem.operating_set.offsets)]
    )
    return minimal_rpi_bound(*pair_lasting_loops(problem, gain), normals)


def ring_normals(widths: Float[AnyArray, "3"], xp: ModuleType = np) -> Float[AnyArray, "RING 3"]:
    """Return directions around the plane of lateral and heading error, in units of their caps.

    Args:
        widths: caps of the errors (m, m, rad).
        xp: numpy or jax.numpy.
    """
    angles = xp.asarray(2 * np.pi * np.arange(RING) / RING, dtype=widths.dtype)
    lateral = xp.cos(angles) / widths[1]
    heading = xp.sin(angles) / widths[2]
    return xp.stack([xp.zeros_like(angles), lateral, heading], axis=1)


def ultimate_bound(problem: Problem, gain: Gain) -> Float[np.ndarray, "3"]:
    """Return half widths (m, m, rad) of the measured error that the law u = K e ends within, once
    in the terminal set.

    Nested: within the widest tube errors and inputs are smaller than their caps, so W is smaller
    there, so is the tube of this W, and so on. Each set holds the error from some time on, as the
    one before attracts it.

    Raises:
        ValueError: where the tube outgrows a cap, or W was not computed.
    """
    if problem.regimes:
        raise ValueError("W differs from period to period: no bound shrinks with the errors")
    if problem.disturbance_bound is None:
        raise ValueError(
            'disturbance.bound = "assumed": no bound shrinks with the errors; set it to "computed"'
        )
    if not max(cap_shares(problem, gain).values()) <= 1:
        raise ValueError(
            "the tube outgrows a cap: no ultimate bound; narrow slip.relative_error or the speeds"
        )
    widths = problem.operating_set.offsets[:3]
    for _ in range(MOST_NESTED):
        tube = widest_tube(problem, gain)
        assert tube is not None
        before = widths
        widths = np.minimum(tube.support(np.eye(3)), widths)
        problem = _restrict_to_tube(problem, gain, tube, widths)
        if np.all(widths >= (1 - SETTLED) * before):
            break
    return widths


def _restrict_to_tube(
    problem: Problem, gain: Gain, tube: Polytope, widths: Float[np.ndarray, "3"]
) -> Problem:
    """Return the problem inside a tube: its errors, the inputs of its gain, and the W of these."""
    by_gain = [tube.support(np.concatenate([law, -law])) for law in gain.corner_gains]
    reach = np.max(by_gain, axis=0)
    input_set = Polytope.box(-reach[2:], reach[:2])
    smaller = replace(
        problem,
        operating_set=Polytope.box(-widths, widths),
        error_set=Polytope.box(-widths - problem.estimate_error, widths + problem.estimate_error),
        input_set=input_set,
        input_rows=make_input_rows(problem.scenario, input_set),
    )
    return with_computed_bound(smaller)


def check_widest_tube(problem: Problem, gain: Gain) -> Condition:
    """Say, for information, how much of each cap the tube of the terminal gain fills, and which one
    binds."""
    shares = cap_shares(problem, gain)
    binding = max(shares, key=lambda name: shares[name])
    listed = ", ".join(f"{name} {share:.1%}" for name, share in shares.items())
    return judge(
        "widest_tube_fits",
        1 - shares[binding],
        f"The tube of the terminal gain fills at its widest {shares[binding]:.1%} of the "
        f"{binding}, which binds ({listed}).",
        f"The tube of the terminal gain may outgrow the caps; the {binding} binds ({listed}).",
        "information",
    )
