"""The set W of a scenario, and the part of it that a log can witness.

A log has e_m = 0 and u = 0 (`jaxtube.witness.motion`), so that its w is of the part

    kick (0, g_y, 1) + slip + sideslip + noise

which is bounded here jointly, over the whole operation as W itself is. W must hold the bilinear,
the sine and the sampling part beside it, which are mathematics and no log can witness. Both sets
are a box and a segment, wider than what single wheel speeds allow (`jaxtube.witness.verdict`). They
are of one period of the controller, and compared with spans as long.

Source: `sets.robot.disturbance`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from jaxtube.scenario.refusal import ScenarioError
from jaxtube.scenario.tree import Scenario
from jaxtube.synthesis.disturbance import complete_problem, kinematics, operation, prove_bound
from jaxtube.synthesis.problem import Problem
from jaxtube.witness.spans import Spans
from sets.polytope import Polytope
from sets.robot.disturbance import DisturbanceBound
from sets.robot.operation import COARSE
from sets.robot.plant import split_disturbance
from sets.supremum import suprema

TOLERANCE = 0.02
"""Of the part, relative; it is for information, as the causes of W are."""

SAME_LENGTH = 0.05
"""By which a span may be longer or shorter than the controller's period, relative."""


@dataclass(frozen=True, eq=False)
class ModelSets:
    """W of a scenario, and spans that it is about.

    Attributes:
        part: of slip, sideslip and noise.
        whole: W.
        is_computed: whether W is computed, not assumed.
        compared: spans of one period, whose wheels the controller may command.
    """

    part: Polytope
    whole: Polytope
    is_computed: bool
    compared: Bool[np.ndarray, "k"]


def find_model_sets(scenario: Scenario, spans: Spans) -> ModelSets | str:
    """Return W of a scenario, or in words why it has nothing to compare.

    Args:
        scenario: that is put to the test.
        spans: to compare.
    """
    dt = scenario.controller.dt_s
    if scenario.slip.is_measured:
        return "the controller measures slip, and a log has no such measurement"
    if scenario.operating.bands:
        return "W goes by speed (operating.bands), and a log is compared with one W"
    if scenario.controller.has_observer:
        return (
            "the controller acts on an estimate, and a log is of what was measured; set "
            "controller.observer_gain = [1, 1, 1] to compare that"
        )
    is_period = np.abs(spans.duration / dt - 1.0) <= SAME_LENGTH
    if not is_period.any():
        return f"spans take {np.median(spans.duration):.3g} s, W is of a period of {dt:.3g} s"
    try:
        problem = complete_problem(scenario)
        bound = prove_bound(problem)
    except (ScenarioError, ValueError) as error:
        return f"the scenario has no W yet ({error})"
    ground = spans.ways.mean(axis=1) * spans.ways.shape[1] / spans.duration[:, None]
    ground = ground * (1.0 - np.array(scenario.slip.nominal))
    low, high = bound.ground_speeds
    is_commanded = np.all((ground >= low) & (ground <= high), axis=1)
    is_computed = scenario.disturbance.bound == "computed"
    compared = is_period & is_commanded
    return ModelSets(_bound_part(problem), problem.disturbance_set, is_computed, compared)


def _bound_part(problem: Problem) -> Polytope:
    """Return the part of W that a log can witness."""
    where = operation(problem)
    period = where.period

    def outputs(piece):
        parts = split_disturbance(kinematics(problem), period, where.variables(piece))
        return parts.yaw, *parts.unpredicted

    lower, upper = where.pieces()
    both_signs = [(output, sign, output) for output in (0, 1, 2) for sign in (1, -1)]
    negligible = COARSE * np.array([1.0, where.travel, where.travel])
    proved, found = suprema(
        outputs, lower, upper, both_signs, TOLERANCE, negligible, most_cells=20_000
    )
    # Noise enters the plane with the next measurement too, and the heading twice.
    box = np.append(proved[1:], where.noise[2]) + where.noise
    found_box = np.append(found[1:], where.noise[2]) + where.noise
    speeds = np.zeros((2, 2))
    return DisturbanceBound(
        float(proved[0]), period.lateral_per_yaw, box, speeds, float(found[0]), found_box
    ).polytope()


def measure_usage(polytope: Polytope, points: Float[np.ndarray, "k 3"]) -> Float[np.ndarray, "k"]:
    """Return by how much a set would have to be scaled to hold each point; 1 on its boundary."""
    return np.max(points @ polytope.normals.T / polytope.offsets, axis=1)
