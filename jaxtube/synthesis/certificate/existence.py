"""For information in a certificate: for which gains an invariant set inside the constraints exists
at all."""

from __future__ import annotations

import numpy as np

from jaxtube.synthesis.problem import Problem
from jaxtube.synthesis.terminal import Terminal, admissible_set
from jaxtube.synthesis.tightening import LocalGain, vertex_loops
from sets import certificate as check
from sets.certificate import Certificate
from sets.invariant import MaximalRpi, maximal_rpi
from sets.lmi import terminal_cost

OBJECTIVES = ("trace_s", "trace_p", "logdet")


def say_what_exists(
    certificate: Certificate, problem: Problem, tube_gain: LocalGain, terminal: Terminal, cost
) -> None:
    """Say, for information, for which gains an invariant set inside E and U exists at all over the
    whole box."""
    _exists(certificate, "invariant_set_for_tube_gain", "the tube gain", problem, tube_gain)
    vertices = problem.model.matrices(problem.model.vertices)
    for objective in OBJECTIVES:
        name, gain = f"terminal_set_for_{objective}", terminal.gains
        if objective != cost.objective:
            try:
                gains = terminal_cost(
                    *vertices, problem.error_weight, problem.input_weight, objective
                ).gains
            except RuntimeError as error:
                certificate.add(
                    name, -np.inf, "", f"No LMI gains for {objective}: {error}", required=False
                )
                continue
            gain = LocalGain(gains.mean(axis=0), gains)
        _exists(certificate, name, f"the LMI gains of {objective}", problem, gain)


def _exists(
    certificate: Certificate, name: str, label: str, problem: Problem, gain: LocalGain
) -> None:
    loops, W = vertex_loops(problem, gain), problem.disturbance_set
    admissible = admissible_set(problem, gain)
    found = maximal_rpi(loops, admissible, W.support)
    if found.polytope is not None:
        margin = check.invariance_margin(loops, W.vertices(), found.polytope)
        margin = min(margin, admissible.containment_margin(found.polytope) + check.ROUNDING)
    else:
        margin = escape_margin(found, loops, W.vertices())
    facets = 0 if found.polytope is None else len(found.polytope.offsets)
    certificate.add(
        name,
        margin,
        f"With {label} an invariant set ({facets} facets) inside the constraints exists at all four vertices.",
        f"With {label} neither an invariant set nor a proof that there is none was found."
        if margin == -np.inf
        else f"With {label} no invariant set fits the constraints over the whole box: within {found.iterations + 1} "
        f"steps the reach of the origin passes a constraint by {-margin:.3g}.",
        required=False,
    )


def escape_margin(found: MaximalRpi, loops, disturbance) -> float:
    """Return minus what the escape passes its constraint by, -inf where none does: then nothing is
    proved."""
    if found.escape is None:
        return -np.inf
    excess, _ = check.escape_excess(
        loops, disturbance, found.escape.normal, found.escape.offset, found.escape.loops
    )
    return -excess if excess > 0 else -np.inf
