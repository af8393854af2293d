"""The error that the closed loop of an MPC ends within, where plans cost their deviation from the
tube's gain.

Let c_j = g_j - K e_j and J the least sum of |c_j|_R^2. The plan shifted by a period and continued
by K is admissible for every w in W and costs |c_0|_R^2 less, so

    J(k+1) <= J(k) - |c_0(k)|_R^2,      e(k+1) = Phi e(k) + B c_0(k) + w(k):

the sum of all |c_0(k)|_R^2 is at most J(0). Let S hold the minimal RPI set of the loops Phi, be
invariant itself, and P decrease along them, |Phi d|_P <= rho |d|_P with rho < 1. Then e(k) = s(k) +
d(k) with s(k) in S and |d(k+1)|_P <= rho |d(k)|_P + |B c_0(k)|_P, so that d(k) tends to 0. Where
S + {|d|_P <= r} lies inside all limits and the terminal set it is an invariant set in which c = 0
is a plan: once |d(k)|_P <= r, J is 0 and u = K e from then on, and the error ends within every set
that attracts the law u = K e (`fill.ultimate_bound`). That takes finitely many periods; a useful
number of them does not follow.

Source: new in this form; the cost is that of Chisci, Rossiter, Zappa 2001, and Kouvaritakis,
Rossiter, Schuurmans 2000.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import scipy.linalg
from jaxtyping import Float

from jaxtube.coordinates import describe_half_widths
from jaxtube.synthesis.certificate.fill import ultimate_bound, widest_tube
from jaxtube.synthesis.parts import Design
from jaxtube.synthesis.terminal import admissible_set, set_back_off
from sets.certificate import Condition, judge

NAME = "error_ends_within"


def check_ultimate_bound(design: Design) -> Iterator[Condition]:
    """Yield what the closed loop ends within, where a plan costs its deviation; for information."""
    if design.problem.scenario.controller.cost != "deviation":
        return
    try:
        widths = ultimate_bound(design.problem, design.terminal.gains)
    except ValueError as error:
        yield Condition(NAME, -np.inf, f"No ultimate bound: {error}.", "information")
        return
    yield judge(
        NAME,
        _find_room(design),
        "From every start with a plan the measured error of the MPC itself ends within "
        f"{describe_half_widths(widths)}: after finitely many periods its plans are those of the "
        "tube's gain for good, up to what a solver may miss.",
        "The tube of the gain, or the terminal set used, leaves no room to show that plans become "
        "those of the gain.",
        "information",
    )


def _find_room(design: Design) -> float:
    """Return the largest r with S + {|d|_P <= r} inside limits and terminal set; negative where S
    alone leaves them, or P does not decrease along the loops."""
    tube = widest_tube(design.problem, design.terminal.gains)
    invariant = design.terminal.invariant
    P = design.cost.cost
    contraction = _find_contraction(design.terminal.loops, P)
    if tube is None or invariant is None or contraction >= 1:
        return -np.inf
    limits = admissible_set(design.problem, design.terminal.gains)
    normals = np.concatenate([limits.normals, invariant.normals])
    offsets = np.concatenate([limits.offsets, invariant.offsets])
    backed_off = set_back_off(design.problem) * (1 + np.linalg.norm(normals, axis=1))
    lengths = np.sqrt(np.einsum("ki,ij,kj->k", normals, np.linalg.inv(P), normals))
    return float(np.min((offsets - backed_off - tube.support(normals)) / lengths))


def _find_contraction(loops: Float[np.ndarray, "v 3 3"], cost: Float[np.ndarray, "3 3"]) -> float:
    """Return the least rho with |Phi d|_P <= rho |d|_P for all loops."""
    squares = [
        scipy.linalg.eigh(loop.T @ cost @ loop, cost, eigvals_only=True)[-1] for loop in loops
    ]
    return float(np.sqrt(max(squares)))
