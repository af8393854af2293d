"""For information in a certificate: for which gains an invariant set inside the constraints exists
at all."""

from __future__ import annotations

from collections.abc import Iterator
from typing import get_args

import numpy as np

from jaxtube.synthesis.certificate.escape import escape_margin, say_what_is_passed
from jaxtube.synthesis.gains import Gain, vertex_gain
from jaxtube.synthesis.parts import Design
from jaxtube.synthesis.problem import Problem
from jaxtube.synthesis.terminal import admissible_set
from sets.certificate import ROUNDING, Condition, invariance_margin, judge
from sets.invariant import maximal_rpi
from sets.lmi import Objective, terminal_cost

OBJECTIVES: tuple[Objective, ...] = get_args(Objective)
"""Objectives of the LMI that the scenario may choose from."""


def say_what_exists(design: Design) -> Iterator[Condition]:
    """Say, for information, for which gains an invariant set inside E and U exists at all over the
    whole box."""
    problem = design.problem
    yield _say_whether_exists(
        problem, "invariant_set_for_tube_gain", "the tube gain", design.tube_gain
    )
    for objective in OBJECTIVES:
        name = f"terminal_set_for_{objective}"
        try:
            gain = _gain_of(design, objective)
        except RuntimeError as error:
            sentence = f"No LMI gains for {objective}: {error}"
            yield Condition(name, -np.inf, sentence, "information")
            continue
        yield _say_whether_exists(problem, name, f"the LMI gains of {objective}", gain)


def _gain_of(design: Design, objective: Objective) -> Gain:
    """Return the LMI gains of an objective, those of the design where it is its own."""
    if objective == design.cost.objective:
        return design.terminal.gains
    problem = design.problem
    A, B = problem.model.matrices(problem.model.vertices)
    cost = terminal_cost(A, B, problem.error_weight, problem.input_weight, objective)
    return vertex_gain(problem, cost.gains)


def _say_whether_exists(problem: Problem, name: str, label: str, gain: Gain) -> Condition:
    W = problem.disturbance_set
    admissible = admissible_set(problem, gain)
    maximal = maximal_rpi(gain.loops, admissible, W.support)
    if maximal.polytope is not None:
        facets = len(maximal.polytope.offsets)
        margin = min(
            invariance_margin(gain.loops, W.vertices(), maximal.polytope),
            admissible.containment_margin(maximal.polytope) + ROUNDING,
        )
    else:
        facets = 0
        margin = escape_margin(maximal.escape, gain.loops, W.vertices())
    refuted = ""
    if margin == -np.inf:
        refuted = f"With {label} neither an invariant set nor a proof that there is none was found."
    elif maximal.escape is not None:
        what = say_what_is_passed(problem, gain, maximal.escape, -margin)
        refuted = (
            f"With {label} no invariant set fits the constraints over the whole box: within "
            f"{maximal.iterations + 1} steps from e = 0 {what}."
        )
    return judge(
        name,
        margin,
        f"With {label} an invariant set ({facets} facets) inside the constraints exists at all "
        "four vertices.",
        refuted,
        "information",
    )
