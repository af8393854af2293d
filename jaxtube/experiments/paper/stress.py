"""Runs in which the tube matters: starts spread over the feasible set, w in W on the linear plant,
slip that persists.

On the linear plant with w in W the guarantee is a theorem, so a single run outside E or one QP
without a plan refutes the code. On the nonlinear plant it holds for the runs in which every w
stayed in W; these are counted.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from jaxtube import qp
from jaxtube.simulation import closed_loop
from jaxtube.simulation.rollout import Trajectory
from jaxtube.synthesis.design import Design
from jaxtube.synthesis.feasible import spread_starts, true_starts

CASES = {
    "linear_w_in_W": "linear plant, w in W",
    "slip_constant": "slip constant per run",
    "slip_patches": "patches of ground",
}


@dataclass(frozen=True, eq=False)
class Stress:
    """Starts, the boundary points of the feasible set they were drawn from, and the runs by case
    and controller."""

    boundary: Float[np.ndarray, "rays 3"]
    starts: Float[np.ndarray, "runs 3"]
    runs: dict[str, dict[str, Trajectory]]


def run(design: Design, count: int, seed: int, advanced=None) -> Stress:
    """Run tube-MPC and MPC without tube from the same starts, in each case."""
    first_window = int(design.windows.index[0])
    points = true_starts(design.tube_window, first_window, design.problem, seed=seed)
    starts = spread_starts(points, count, seed)
    plants = {
        "linear_w_in_W": closed_loop.linear_plant(design),
        "slip_constant": closed_loop.slipping_robot(design, "constant"),
        "slip_patches": closed_loop.slipping_robot(design, "patches"),
    }
    loops = closed_loop.controllers(design)
    runs = {
        case: {
            name: closed_loop.run_realisations(loops[name], plant, starts, seed, advanced)
            for name in ("tube_mpc", "plain_mpc")
        }
        for case, plant in plants.items()
    }
    return Stress(points, starts, runs)


def metrics(design: Design, stress: Stress) -> dict:
    """Return, by case and controller, what left E, what turned infeasible and how it came back."""
    return {
        case: {name: _metrics(design, trajectory) for name, trajectory in controllers.items()}
        for case, controllers in stress.runs.items()
    }


def _metrics(design: Design, trajectory: Trajectory) -> dict:
    limits = design.problem.error_set.offsets[:3]
    widths = design.problem.disturbance_set.support(np.eye(3))
    outside = ~np.all(np.abs(trajectory.errors) <= limits, axis=(0, 2))
    # On the linear plant w is drawn in W; rounding of the reconstruction must not count.
    residuals = closed_loop.model_residuals(design, trajectory)
    in_w = np.all(np.abs(residuals) <= widths * (1 + 1e-9), axis=(0, 2))
    no_plan = trajectory.diagnostics.status != qp.SOLVED
    stopped = no_plan.any(axis=0)
    return {
        "runs": outside.size,
        "runs_outside_E": int(outside.sum()),
        "share_outside_E": float(outside.mean()),
        "runs_with_every_w_in_W": int(in_w.sum()),
        "runs_outside_E_with_every_w_in_W": int((outside & in_w).sum()),
        "infeasible_QPs": int((trajectory.diagnostics.status == qp.INFEASIBLE).sum()),
        "unsolved_QPs": int((trajectory.diagnostics.status == qp.UNSOLVED).sum()),
        "runs_with_infeasible_QP": int(stopped.sum()),
        "runs_with_infeasible_QP_and_every_w_in_W": int((stopped & in_w).sum()),
        "runs_recovered": int((stopped & ~no_plan[-1]).sum()),
        "longest_backup_steps": int(_longest(no_plan)),
        "share_of_steps_with_active_row": float(trajectory.diagnostics.active.mean()),
        "share_of_first_10_steps_with_active_row": float(trajectory.diagnostics.active[:10].mean()),
    }


def _longest(flags) -> int:
    """Return the length of the longest unbroken stretch of True along the first axis."""
    longest = length = np.zeros(flags.shape[1], int)
    for row in flags:
        length = np.where(row, length + 1, 0)
        longest = np.maximum(longest, length)
    return longest.max()
