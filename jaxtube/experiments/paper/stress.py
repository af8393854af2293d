"""Runs in which the tube matters: starts spread over the feasible set, w in W on the linear plant,
slip that persists.

On the linear plant with w in W the guarantee of a certified design is a theorem, so a single run
outside E or one QP without a plan refutes the code. On the nonlinear plant it holds for the runs in
which every w stayed in W; these are counted.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np
from jaxtyping import Bool, Float

from jaxtube import qp
from jaxtube.simulation import batches, components
from jaxtube.simulation.promise import limit_true_errors
from jaxtube.simulation.rollout import Trajectory
from jaxtube.synthesis.feasible import true_starts
from jaxtube.synthesis.parts import Design

LINEAR = "linear_w_in_W"
CASES = {
    LINEAR: "linear plant, w in W",
    "slip_constant": "slip constant per run",
    "slip_patches": "patches of ground",
}


@dataclass(frozen=True, eq=False)
class Stress:
    """Starts, the corners of the set they were drawn from, and the runs by case and controller."""

    boundary: Float[np.ndarray, "corners 3"]
    starts: Float[np.ndarray, "runs 3"]
    runs: dict[str, dict[str, Trajectory]]


def find_starts(design: Design, seed: int) -> Float[np.ndarray, "corners 3"]:
    """Return corners of a set of true errors from which there is a plan.

    Raises:
        ScenarioError: where no error has a plan.
    """
    return true_starts(design.tube_qps, design.first_window, design.problem, seed=seed)


def make_runs(
    design: Design,
    starts: Float[np.ndarray, "runs 3"],
    seed: int,
    on_progress: Callable[[int], object],
) -> dict[tuple[str, str], Callable[[], Trajectory]]:
    """Return what runs tube-MPC and MPC without tube from the same starts, by case and controller.

    Args:
        design: under stress.
        starts: of every case.
        seed: of every draw.
        on_progress: called with the number of runs of each block that has been run.
    """
    plants = {
        LINEAR: components.linear_plant(design),
        "slip_constant": components.slipping_robot(design, "constant"),
        "slip_patches": components.slipping_robot(design, "patches"),
    }
    controllers = {
        "tube_mpc": components.make_tube_mpc(design),
        "plain_mpc": components.make_plain_mpc(design),
    }
    run = batches.run_realisations
    return {
        (case, name): partial(run, controller, plant, starts, seed, on_progress)
        # Both controllers of a case share one compiled program: the second comes when it is there.
        for name, controller in controllers.items()
        for case, plant in plants.items()
    }


def metrics(design: Design, stress: Stress) -> dict:
    """Return, by case and controller, what left E, what turned infeasible and how it came back."""
    found = {}
    for case, controllers in stress.runs.items():
        judged = limit_errors(design, case)
        found[case] = {
            name: _metrics(judged, trajectory) for name, trajectory in controllers.items()
        }
    return found


def limit_errors(design: Design, case: str) -> Design:
    """Return the design with the E that its tube-MPC promises in a case."""
    return limit_true_errors(design, "linear" if case == LINEAR else "robot")


def _metrics(design: Design, trajectory: Trajectory) -> dict:
    limits = design.problem.error_set.offsets[:3]
    widths = design.problem.disturbance_set.support(np.eye(3))
    disturbances = batches.model_disturbances(design, trajectory)
    diagnostics = trajectory.diagnostics
    outside = ~np.all(np.abs(trajectory.errors) <= limits, axis=(0, 2))
    # On the linear plant w is drawn in W; rounding of the reconstruction must not count.
    in_w = np.all(np.abs(disturbances) <= widths * (1 + 1e-9), axis=(0, 2))
    no_plan = np.asarray(diagnostics.status) != qp.SOLVED
    stopped = no_plan.any(axis=0)
    return {
        "runs": outside.size,
        "runs_outside_E": int(outside.sum()),
        "share_outside_E": float(outside.mean()),
        "runs_with_every_w_in_W": int(in_w.sum()),
        "runs_outside_E_with_every_w_in_W": int((outside & in_w).sum()),
        "infeasible_QPs": int((diagnostics.status == qp.INFEASIBLE).sum()),
        "unsolved_QPs": int((diagnostics.status == qp.UNSOLVED).sum()),
        "runs_with_infeasible_QP": int(stopped.sum()),
        "runs_with_infeasible_QP_and_every_w_in_W": int((stopped & in_w).sum()),
        "runs_recovered": int((stopped & ~no_plan[-1]).sum()),
        "longest_backup_steps": _longest(no_plan),
        "share_of_steps_with_active_row": float(diagnostics.active.mean()),
        "share_of_first_10_steps_with_active_row": float(diagnostics.active[:10].mean()),
    }


def _longest(flags: Bool[np.ndarray, "steps runs"]) -> int:
    """Return the length of the longest unbroken stretch of True in any run."""
    length = np.zeros(flags.shape[1], int)
    longest = length
    for row in flags:
        length = np.where(row, length + 1, 0)
        longest = np.maximum(longest, length)
    return int(longest.max())
