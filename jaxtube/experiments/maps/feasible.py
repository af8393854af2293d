"""The feasible set of the tube-MPC by its horizon, beside the largest set that any controller could
keep.

    F_N: measured errors from which there is a plan of N steps in the first window of the reference,
         inside the hull of its boundary along random directions
    C:   the maximal robust control invariant set over the four corners of the speed range, for a
         controller that knows the present wheel speeds alone; an outer bound where the iteration
         has not settled

F_N may leave C: its plan knows N steps of the reference ahead, C is for any order.
"""

from __future__ import annotations

import numpy as np

from jaxtube.experiments.run.value_log import ValueLog
from jaxtube.progress import progress
from jaxtube.scenario.reading import replace
from jaxtube.scenario.tree import Scenario
from jaxtube.synthesis.design import design as make_design
from jaxtube.synthesis.disturbance import complete_problem
from jaxtube.synthesis.feasible import boundary
from jaxtube.synthesis.problem import Problem
from sets.control_invariant import Limits, maximal_rci
from sets.polytope import Polytope

HORIZONS = tuple(range(1, 11))
DIRECTIONS = 600


def feasible_sets(scenario: Scenario, log: ValueLog) -> dict:
    """Return volumes and corners by horizon, those of C, and the volume of the caps; each set is
    saved in the log at once.

    Horizons at which no design exists have no volume, but the reason; `failing` names the
    conditions that fail.
    """
    known = {record["horizon"]: record for record in log.records}
    problem = complete_problem(scenario)
    with progress(len(HORIZONS) + 1, "feasible sets", "sets", len(known), "starting") as bar:
        for horizon in (None, *HORIZONS):
            if horizon in known:
                continue
            numbers = _largest(problem) if horizon is None else _of_horizon(scenario, horizon)
            known[horizon] = {"horizon": horizon, **numbers}
            log.append(known[horizon])
            bar.update()
    return {
        "operating_volume": problem.operating_set.volume(),
        "control_invariant": known[None],
        "horizons": [known[horizon] for horizon in HORIZONS],
    }


def _of_horizon(scenario: Scenario, horizon: int) -> dict:
    """Return F_N, or why there is no design."""
    try:
        design = make_design(replace(scenario, {"controller.horizon": horizon}))
    except ValueError as error:
        return {"volume": None, "reason": str(error)}
    caps = design.problem.operating_set
    points = boundary(design.tube_qps, design.first_window, caps, DIRECTIONS)
    hull = Polytope.from_vertices(points)
    return {**_measure(hull), "failing": design.certificate.failing}


def _largest(problem: Problem) -> dict:
    """Return C."""
    rows = problem.input_rows
    corners = np.unique(problem.corners, axis=0)
    iteration = maximal_rci(
        *problem.model.matrices(corners),
        problem.operating_set,
        Limits(rows.inputs, rows.errors, rows.offsets),
        problem.disturbance_set.support,
    )
    steps = {"steps": len(iteration.volumes) - 1, "settled": iteration.settled}
    if iteration.polytope is None:
        return {**steps, "volume": 0.0, "corners": []}
    return {**steps, **_measure(iteration.polytope)}


def _measure(polytope: Polytope) -> dict:
    """Return volume and corners, (m, m, rad), of a set."""
    return {"volume": polytope.volume(), "corners": polytope.vertices().round(6).tolist()}
