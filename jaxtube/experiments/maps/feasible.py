"""The feasible set of the tube-MPC by its horizon, beside the largest set that any controller could
keep.

    F_N: measured errors from which there is a plan of N steps in the first window of the reference,
         inside the hull of its boundary along random directions
    C:   the maximal robust control invariant set of the four corners of the speed range, of a controller that knows the
         present wheel speeds alone, outside of it as far as the iteration got

F_N may leave C: its plan knows N steps of the reference ahead, C is for any order.
"""

from __future__ import annotations

import msgspec
import numpy as np
from jaxtyping import Float

from jaxtube.experiments.maps.points import Log
from jaxtube.experiments.run.progress import progress
from jaxtube.scenario import Scenario
from jaxtube.synthesis.design import design
from jaxtube.synthesis.disturbance import complete_problem
from jaxtube.synthesis.feasible import boundary
from jaxtube.synthesis.problem import Problem
from sets.control_invariant import Limits, maximal_rci
from sets.polytope import Polytope

HORIZONS = tuple(range(1, 11))
DIRECTIONS = 600


def feasible_sets(scenario: Scenario, log: Log) -> dict:
    """Return volumes and corners by horizon, those of C, and of E_op; each is saved in the log at
    once.

    Horizons at which no design exists have no volume, but the reason; `failing` names the
    conditions that fail.
    """
    known = {record["horizon"]: record for record in log.records}
    problem = complete_problem(scenario)
    with progress(len(HORIZONS) + 1, "feasible sets", "sets", len(known), "starting") as bar:
        for horizon in (None, *HORIZONS):
            if horizon not in known:
                found = _largest(problem) if horizon is None else _of_horizon(scenario, horizon)
                known[horizon] = {"horizon": horizon, **found}
                log.append(known[horizon])
                bar.update()
    return {
        "operating_volume": problem.operating_set.volume(),
        "control_invariant": known[None],
        "horizons": [known[horizon] for horizon in HORIZONS],
    }


def _of_horizon(scenario: Scenario, horizon: int) -> dict:
    settings = msgspec.structs.replace(scenario.controller, horizon=horizon)
    try:
        found = design(msgspec.structs.replace(scenario, controller=settings))
    except ValueError as error:
        return {"volume": None, "reason": str(error)}
    window, problem = int(found.windows.index[0]), found.problem
    points = boundary(found.tube_window, window, problem.operating_set, DIRECTIONS)
    return {**_hull(points), "failing": found.certificate.failing}


def _largest(problem: Problem) -> dict:
    rows = problem.input_rows
    found = maximal_rci(
        *problem.model.matrices(np.unique(problem.corners, axis=0)),
        problem.operating_set,
        Limits(rows.inputs, rows.errors, rows.offsets),
        problem.disturbance_set.support,
    )
    steps = {"steps": len(found.volumes) - 1, "settled": found.settled}
    return (
        {**steps, "volume": 0.0, "corners": []}
        if found.polytope is None
        else {**steps, **_hull(found.polytope)}
    )


def _hull(found: Polytope | Float[np.ndarray, "k 3"]) -> dict:
    hull = found if isinstance(found, Polytope) else Polytope.from_vertices(found)
    return {"volume": hull.volume(), "corners": hull.vertices().round(6).tolist()}
