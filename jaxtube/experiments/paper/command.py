"""`paper`: the paper's comparison from its data to its figures, over many realisations.

Design, all controllers on the reference, a noise-free lap of each, the scheme that never resets,
plans followed inside the tube, a design under stress; then the figures, the metrics and the table
of claims. Under stress is the design of the scenario itself; for the scenario `paper`, whose plans
need not stay feasible, it is that of `robust`.
"""

from __future__ import annotations

import dataclasses
from functools import partial
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from jaxtube.experiments.options import PaperOptions, title
from jaxtube.experiments.paper import stress
from jaxtube.experiments.paper.claims import claims, table
from jaxtube.experiments.paper.drawings import (
    DesignOfRun,
    Drawn,
    draw,
    find_stressed,
    make_drawings,
)
from jaxtube.experiments.paper.page import make_page
from jaxtube.experiments.paper.report import comparison, restart_note, say_verdict, stress_table
from jaxtube.experiments.run import folder as run_folder
from jaxtube.experiments.run import metrics
from jaxtube.experiments.run.conditions import condition_metrics
from jaxtube.experiments.run.design_report import report
from jaxtube.experiments.run.designing import make_design
from jaxtube.experiments.run.disturbance_line import disturbance_line
from jaxtube.experiments.run.exit_codes import exit_code
from jaxtube.experiments.run.folder import RunFolder
from jaxtube.experiments.run.limits import describe_pose
from jaxtube.experiments.run.side_by_side import run_side_by_side
from jaxtube.figures.stress import StressedCase, judge_case
from jaxtube.progress import announce, progress
from jaxtube.reporting import laps as kept_laps
from jaxtube.reporting.player import make_player
from jaxtube.scenario.tree import Scenario
from jaxtube.simulation import batches, components
from jaxtube.simulation.rollout import Trajectory
from jaxtube.synthesis.design import refuse_infeasible_start, refuse_start_outside_limits
from jaxtube.synthesis.feasible import spread_starts
from jaxtube.synthesis.parts import Design
from jaxtube.synthesis.problem import make_problem

STRESS_RUNS = 40
"""Runs of the stress cases for each realisation of the comparison: 10,240 for 256."""
NOISE_FREE = ("uncompensated", "compensated", "tube_mpc", "plain_mpc")


LAPS = "laps"
OTHER = "other"
"""Names of the laps among all runs, and of those that are reset otherwise."""


class PaperRuns(NamedTuple):
    """What the command simulates.

    Attributes:
        laps: of each controller.
        other_restart: laps of the tube-MPC that resets its nominal error where the scenario's does
            not, and the other way round.
        stressed: runs of the design under stress.
        deviations: from plans that were followed to their end.
    """

    laps: dict[str, Trajectory]
    other_restart: Trajectory
    stressed: stress.Stress
    deviations: Float[np.ndarray, "horizon samples 3"]


def run(scenario: Scenario, options: PaperOptions) -> int:
    """Run the command; returns 3 where a certificate is required and fails."""
    name = title(options.scenario)
    refuse_start_outside_limits(make_problem(scenario))
    announce("designing: sets, gains and certificate")
    design = make_design(scenario, options)
    refuse_infeasible_start(design)
    own = DesignOfRun(name, design)
    under_stress = find_stressed(own)
    stressed_name, stressed = under_stress
    announce("searching the edge of its feasible set")
    boundary = stress.find_starts(stressed, options.seed)
    folder = run_folder.create(scenario, options)
    simulated = simulate_laps(design, stressed, boundary, options)
    announce("driving noise-free laps, compiled first")
    _save_noise_free(design, folder)
    announce("saving all laps")
    drawn = Drawn(
        kept_laps.collect(design, simulated.laps),
        simulated.deviations,
        _judge_stress(stressed, simulated.stressed),
        simulated.stressed.boundary,
    )
    drawn.save(folder)
    announce("measuring what was simulated")
    measured = {
        **metrics.design_metrics(design),
        **_metrics(design, simulated),
        "stress": stress.metrics(stressed, simulated.stressed),
        "stress_certificate": condition_metrics(stressed.certificate),
        "stress_design": stressed_name,
    }
    rows = claims(measured)
    measured["claims"] = [row._asdict() for row in rows]
    folder.save_metrics(measured)
    parts = [
        say_verdict(rows, design),
        report(design),
        disturbance_line(design, measured["disturbance"], "the tube MPC"),
        comparison(measured),
        restart_note(measured),
        stress_table(measured),
        table(rows),
    ]
    folder.report("\n\n".join(parts))
    draw(make_drawings(own, under_stress, options.label, drawn), folder)
    player = make_player(drawn.kept, describe_pose(design.problem))
    folder.save_page(make_page(design, options.label, measured, rows, player))
    print(
        "\nreport.html, figures, metrics.json, laps.npz, noise_free.npz and manifest.json are in "
        f"{folder.path}/"
    )
    return exit_code(design.certificate, options.require_certificate)


def simulate_laps(
    design: Design,
    stressed: Design,
    boundary: Float[np.ndarray, "corners 3"],
    options: PaperOptions,
) -> PaperRuns:
    """Run all laps and stress runs.

    Args:
        design: of the scenario.
        stressed: the design under stress.
        boundary: corners of the set of its starts.
        options: of the command.
    """
    laps = options.realisations
    stress_runs = STRESS_RUNS * laps
    controllers = components.controllers(design)
    total = (len(controllers) + 1) * laps + 2 * len(stress.CASES) * stress_runs
    plant = components.slipping_robot(design)
    starts = np.tile(design.problem.initial_error, (laps, 1))
    tube_mpc = components.make_tube_mpc(design)
    other = dataclasses.replace(tube_mpc, restart=not tube_mpc.restart)
    stress_starts = spread_starts(boundary, stress_runs, options.seed)
    run = batches.run_realisations
    with progress(total, "simulating", "laps") as bar:

        def show(count: int) -> None:
            with bar.get_lock():
                bar.update(count)

        runs = {
            (LAPS, name): partial(run, controller, plant, starts, options.seed, show)
            for name, controller in (controllers | {OTHER: other}).items()
        }
        runs |= stress.make_runs(stressed, stress_starts, options.seed, show)
        found = run_side_by_side(runs)
    by_name = {name: found[LAPS, name] for name in controllers}
    under_stress = {
        case: {name: lap for (its_case, name), lap in found.items() if its_case == case}
        for case in stress.CASES
    }
    announce("following plans to their end, compiled first")
    deviations = batches.plan_deviations(design, tube_mpc, plant, by_name["tube_mpc"], options.seed)
    stress_found = stress.Stress(boundary, stress_starts, under_stress)
    return PaperRuns(by_name, found[LAPS, OTHER], stress_found, deviations)


def _metrics(design: Design, simulated: PaperRuns) -> dict:
    problem = design.problem
    laps = simulated.laps
    schedule = problem.schedule[: problem.reference.steps]
    disturbances = batches.model_disturbances(design, laps["tube_mpc"])
    return {
        "controllers": {
            name: metrics.controller_metrics(design, lap) for name, lap in laps.items()
        },
        "other_restart": {
            "restart": not problem.scenario.controller.restart,
            **metrics.controller_metrics(design, simulated.other_restart),
        },
        "reference_wheel_speed_mean_mps": float(schedule.mean()),
        "disturbance": metrics.disturbance_metrics(design, disturbances),
        "plan_deviations": metrics.deviation_metrics(design, simulated.deviations),
    }


def _save_noise_free(design: Design, folder: RunFolder) -> None:
    """Save e(k) of one lap of each controller with the slip known exactly and no noise."""
    controllers = components.controllers(design)
    plant = components.exact_robot(design)
    start = design.problem.initial_error[None]
    laps = {}
    for name in NOISE_FREE:
        laps[name] = batches.run_realisations(controllers[name], plant, start, 0).errors[:, 0]
    folder.save_arrays("noise_free", **laps)


def _judge_stress(design: Design, runs: stress.Stress) -> dict[str, StressedCase]:
    """Return the runs under stress as they are drawn, by case."""
    return {
        case: judge_case(
            stress.CASES[case],
            stress.limit_errors(design, case).problem.error_set.offsets[:3],
            {
                "plain": np.asarray(by_controller["plain_mpc"].errors),
                "tube": np.asarray(by_controller["tube_mpc"].errors),
            },
        )
        for case, by_controller in runs.runs.items()
    }
