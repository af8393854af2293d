"""The feasible set of the tube-MPC by its horizon, beside the largest set that any controller could
keep.

    F_N: measured errors from which there is a plan of N steps, by windows of the reference; the
         hull of some of its points (`sets.projection`)
    C:   the maximal robust control invariant set over the four corners of the speed range, for a
         controller that knows the present wheel speeds alone; an outer bound where the iteration
         has not settled

F_N may leave C: its plan knows N steps of the reference ahead, C is for any order. The coverage is
the volume of what both hold as a share of that of C, so that neither counts what the other lacks;
the hull makes it a little less than it is.

Source: new; the metric follows Houska and Villanueva 2019, Robust optimization for MPC, Handbook of
Model Predictive Control.
"""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxtube.experiments.bench.programs import run_bare_laps
from jaxtube.experiments.bench.rounds import time_rounds
from jaxtube.experiments.run.value_log import ValueLog
from jaxtube.progress import progress
from jaxtube.scenario.reading import replace
from jaxtube.scenario.tree import Scenario
from jaxtube.statistics.montecarlo import make_closed_loop_task
from jaxtube.statistics.run import BLOCK, TILE, BlockSize
from jaxtube.synthesis.design import Design
from jaxtube.synthesis.design import design as make_design
from jaxtube.synthesis.disturbance import complete_problem
from jaxtube.synthesis.feasible import project_feasible_set
from jaxtube.synthesis.problem import Problem
from sets.control_invariant import Limits, maximal_rci
from sets.polytope import Polytope

MOST_WINDOWS = 8
"""Windows of the reference, spread over all, whose feasible sets are found."""
ROUNDS = 3
"""In which the laps are timed; their median counts."""


class Extent(NamedTuple):
    """What is measured: horizons, and the seed of the laps that are timed."""

    horizons: tuple[int, ...]
    seed: int


def measure(scenario: Scenario, extent: Extent, log: ValueLog) -> dict:
    """Return volumes, corners and times by horizon, those of C, and the volume of the caps; each
    is saved in the log at once.

    Horizons at which no design exists have no volume, but the reason; `failing` names the
    conditions that fail.
    """
    known = {record["horizon"]: record for record in log.records}
    problem = complete_problem(scenario)
    total = len(extent.horizons) + 1
    done = len(known)
    with progress(total, "feasible sets", "sets", done, "the largest control invariant set") as bar:
        for horizon in (None, *extent.horizons):
            if horizon in known:
                continue
            if horizon is None:
                numbers = _find_largest(problem)
            else:
                largest = known[None]
                numbers = _measure_horizon(scenario, horizon, largest, extent.seed)
            known[horizon] = {"horizon": horizon, **numbers}
            log.append(known[horizon])
            bar.update()
    return {
        "operating_volume": problem.operating_set.volume(),
        "control_invariant": known[None],
        "horizons": [known[horizon] for horizon in extent.horizons],
    }


def _measure_horizon(scenario: Scenario, horizon: int, largest: dict, seed: int) -> dict:
    """Return F_N and the time of a step, or why there is no design."""
    try:
        design = make_design(replace(scenario, {"controller.horizon": horizon}))
    except ValueError as error:
        return {"volume": None, "reason": str(error)}
    C = Polytope.from_vertices(np.array(largest["corners"])) if largest["corners"] else None
    count = len(design.windows.schedules)
    windows = np.unique(np.linspace(0, count - 1, MOST_WINDOWS).round().astype(int))
    caps = design.problem.operating_set
    qps = design.tube_qps
    hulls = [project_feasible_set(qps, int(window), caps).inner for window in windows]
    volumes = [hull.volume() for hull in hulls]
    covered = [hull.intersect(C).volume() for hull in hulls] if C else None
    least = int(np.argmin(covered or volumes))
    return {
        **_describe(hulls[least]),
        "covered": covered[least] if covered else None,
        "windows": len(windows),
        "rows": design.tube_qps.lower.shape[1],
        "microseconds": _time_step(design, seed),
        "failing": design.certificate.failing,
    }


def _time_step(design: Design, seed: int) -> float:
    """Return the time of a period of bare laps from all over the feasible set, us of the processor,
    the median of rounds."""
    task = make_closed_loop_task(design, "tube_mpc", "robot", "feasible", None, seed)
    size = BlockSize(BLOCK, TILE)
    first = jnp.uint32(0)
    work = {"bare": lambda: jax.block_until_ready(run_bare_laps(task, first, size))}
    seconds = time_rounds(work, ROUNDS, lambda: None)["bare"]
    steps = design.problem.reference.steps
    return float(1e6 * np.median(seconds) / (steps * BLOCK))


def _find_largest(problem: Problem) -> dict:
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
    return {**steps, **_describe(iteration.polytope)}


def _describe(polytope: Polytope) -> dict:
    """Return volume and corners, (m, m, rad), of a set."""
    return {"volume": polytope.volume(), "corners": polytope.vertices().round(6).tolist()}
