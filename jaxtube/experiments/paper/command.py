"""`paper`: the paper's comparison from its data to its figures, over many realisations.

Design, all controllers on the reference, a noise-free lap of each, the scheme that never resets,
plans followed inside the tube, the design `robust` under stress; then the figures, the metrics and
the table of claims.
"""

from __future__ import annotations

import dataclasses

import numpy as np

from jaxtube.experiments.design.command import exit_code
from jaxtube.experiments.design.report import report
from jaxtube.experiments.design.seen import disturbance_line
from jaxtube.experiments.options import PaperOptions, title
from jaxtube.experiments.paper import stress
from jaxtube.experiments.paper.claims import claims, table
from jaxtube.experiments.run import folder as run_folder
from jaxtube.experiments.run import metrics
from jaxtube.experiments.run.folder import RunFolder
from jaxtube.experiments.run.progress import progress
from jaxtube.experiments.run.table import Column, format_table, left
from jaxtube.scenario import Scenario, load
from jaxtube.simulation import closed_loop
from jaxtube.simulation.rollout import Trajectory
from jaxtube.synthesis.design import Design, design, refuse_infeasible_start

STRESS_RUNS = 40
"""Runs of the stress cases for each realisation of the comparison: 10,240 for 256."""

NOISE_FREE = ("uncompensated", "compensated", "tube_mpc", "plain_mpc")


def run(scenario: Scenario, options: PaperOptions) -> int:
    """Run the command; returns 3 where a certificate is required and fails."""
    found = design(scenario)
    refuse_infeasible_start(found)
    folder = run_folder.create(scenario, options)
    robust = design(load("robust"))
    loops = closed_loop.controllers(found)
    stress_runs = STRESS_RUNS * options.realisations
    total = (len(loops) + 1) * options.realisations + 6 * stress_runs
    with progress(total, "simulating", "laps") as bar:
        starts = np.tile(found.problem.initial_error, (options.realisations, 1))
        plant = closed_loop.slipping_robot(found)
        laps = {
            name: closed_loop.run_realisations(loop, plant, starts, options.seed, bar.update)
            for name, loop in loops.items()
        }
        tube_mpc = closed_loop.make_tube_mpc(found)
        other = dataclasses.replace(tube_mpc, restart=not tube_mpc.restart)
        other_restart = closed_loop.run_realisations(other, plant, starts, options.seed, bar.update)
        stressed = stress.run(robust, stress_runs, options.seed, bar.update)
    deviations = closed_loop.plan_deviations(found, tube_mpc, plant, laps["tube_mpc"], options.seed)
    _save_noise_free(found, loops, folder)
    _save_laps(laps, folder)
    measured = _metrics(found, robust, laps, other_restart, stressed, deviations)
    measured = {**metrics.design_metrics(found), **measured}
    rows = claims(measured)
    measured["claims"] = [row._asdict() for row in rows]
    folder.save_metrics(measured)
    _save_figures(found, title(options.scenario), laps, robust, stressed, deviations, folder)
    parts = [
        report(found),
        disturbance_line(found, measured["disturbance"], "the tube MPC"),
        _comparison(measured),
        _restart_note(measured),
        _stress_table(measured),
    ]
    folder.report("\n\n".join([*parts, table(rows)]))
    print(
        f"\nfigures, metrics.json, laps.npz, noise_free.npz and manifest.json are in {folder.path}/"
    )
    return exit_code(found.certificate, options.require_certificate)


def _metrics(found: Design, robust: Design, laps, other_restart, stressed, deviations) -> dict:
    problem = found.problem
    return {
        "controllers": {name: metrics.controller_metrics(found, lap) for name, lap in laps.items()},
        "other_restart": {
            "restart": not problem.scenario.controller.restart,
            **metrics.controller_metrics(found, other_restart),
        },
        "reference_wheel_speed_mean_mps": float(problem.schedule[: problem.reference.steps].mean()),
        "disturbance": metrics.disturbance_metrics(
            found, closed_loop.model_residuals(found, laps["tube_mpc"])
        ),
        "plan_deviations": metrics.deviation_metrics(found, deviations),
        "stress": stress.metrics(robust, stressed),
        "stress_certificate": {
            name: {"holds": c.holds, "margin": c.margin, "scope": c.scope}
            for name, c in robust.certificate.conditions.items()
        },
    }


def _save_noise_free(found: Design, loops: dict, folder: RunFolder) -> None:
    """Save e(k) of one lap of each controller with the slip known exactly and no noise."""
    plant = closed_loop.exact_robot(found)
    start = found.problem.initial_error[None]
    laps = {
        name: closed_loop.run_realisations(loops[name], plant, start, 0).errors[:, 0]
        for name in NOISE_FREE
    }
    folder.save_arrays("noise_free", **laps)


def _save_laps(laps: dict[str, Trajectory], folder: RunFolder) -> None:
    """Save errors, inputs and wheel speeds of all laps of each controller, in single precision: the
    figures can be drawn again from them."""
    arrays = {}
    for name, lap in laps.items():
        arrays[f"{name}_errors"] = np.asarray(lap.errors, np.float32)
        arrays[f"{name}_inputs"] = np.asarray(lap.inputs, np.float32)
        arrays[f"{name}_wheels"] = np.asarray(lap.wheels, np.float32)
    folder.save_arrays("laps", **arrays)


def _save_figures(
    found: Design, name: str, laps, robust: Design, stressed, deviations, folder: RunFolder
) -> None:
    from jaxtube.figures import laps as lap_figures
    from jaxtube.figures import sets as set_figures
    from jaxtube.figures.paths import trajectories
    from jaxtube.figures.realisations import realisations_in_tube
    from jaxtube.figures.stress import stress as stress_figure
    from jaxtube.figures.tightened import tightened_sets

    problem = found.problem
    cases = _stress_cases(stressed)
    drawings = {
        "trajectories": lambda: trajectories(problem, laps),
        "errors": lambda: lap_figures.errors(problem, laps),
        "wheel_speeds": lambda: lap_figures.wheel_speeds(problem, laps),
        "margins": lambda: lap_figures.margins(problem, laps),
        "tube_sections": lambda: set_figures.tube_sections(found, name),
        "tightened_sets": lambda: tightened_sets(found, name),
        "terminal_set": lambda: set_figures.terminal_set(found, name),
        "realisations_in_tube": lambda: realisations_in_tube(found, deviations),
        "stress": lambda: stress_figure(robust.problem, cases, stressed.boundary),
        "stress_terminal_set": lambda: set_figures.terminal_set(robust, "robust"),
    }
    with progress(len(drawings), "drawing", "figures", starting="starting") as bar:
        for figure_name, draw in drawings.items():
            folder.save_figure(draw(), figure_name)
            bar.update()


def _stress_cases(stressed: stress.Stress) -> list[dict]:
    return [
        {
            "title": stress.CASES[case],
            "tube": runs["tube_mpc"].errors,
            "plain": runs["plain_mpc"].errors,
        }
        for case, runs in stressed.runs.items()
    ]


def _comparison(measured: dict) -> str:
    """Return the controllers side by side: medians over realisations."""
    errors = (("e_x", "m"), ("e_y", "m"), ("e_th", "deg"))
    columns = [
        left("controller"),
        Column("outside E"),
        *(Column(f"largest\n(median)\n{name}", unit) for name, unit in errors),
        *(Column(f"RMS\n(median)\n{name}", unit) for name, unit in errors),
        Column("active"),
        Column("wheel", "m/s"),
    ]
    rows = [_compared(name, numbers) for name, numbers in measured["controllers"].items()]
    inside = measured["plan_deviations"]
    shares = ", ".join(f"{share:.1%}" for share in inside["share_outside_by_stage"])
    note = (
        f"of {inside['plans']} plans followed to their end these shares leave R_1, R_2, ..: "
        f"{shares}"
    )
    return f"{format_table(columns, rows)}\n{note}"


def _compared(name: str, numbers: dict) -> list[str]:
    """Return the row of one controller."""
    largest = numbers["max_error"]["whole_run"]["median"].values()
    rms = numbers["rms_error"]["whole_run"]["median"].values()
    return [
        name,
        f"{numbers['violation_share']:.1%}",
        *(f"{value:.5f}" for value in largest),
        *(f"{value:.5f}" for value in rms),
        f"{numbers['active_share']:.2%}",
        f"{numbers['wheel_speed_max_mps']:.3f}",
    ]


def _stress_table(measured: dict) -> str:
    """Return the stress runs of the design `robust`, with and without tube."""
    columns = [
        left("plant"),
        left("controller"),
        Column("runs"),
        Column("outside E"),
        Column("infeasible QPs"),
        Column("recovered runs"),
        Column("every w in W"),
        Column("of these outside E"),
    ]
    rows = [
        _stressed(stress.CASES[case], name, numbers)
        for case, runs in measured["stress"].items()
        for name, numbers in runs.items()
    ]
    title = "design `robust`, starts all over the feasible set of the tube-MPC"
    return f"{title}\n{format_table(columns, rows)}"


def _stressed(case: str, controller: str, numbers: dict) -> list[str]:
    """Return the row of one controller in one case."""
    return [
        case,
        controller,
        str(numbers["runs"]),
        str(numbers["runs_outside_E"]),
        str(numbers["infeasible_QPs"]),
        f"{numbers['runs_recovered']}/{numbers['runs_with_infeasible_QP']}",
        str(numbers["runs_with_every_w_in_W"]),
        str(numbers["runs_outside_E_with_every_w_in_W"]),
    ]


def _restart_note(measured: dict) -> str:
    """Return one line on the scheme whose nominal error is (or is not) reset to the measured one."""
    other, usual = measured["other_restart"], measured["controllers"]["tube_mpc"]
    values = [
        f"{numbers['rms_error']['whole_run']['median']['lateral_m']:.5f} m"
        for numbers in (other, usual)
    ]
    return (
        f"with restart = {str(other['restart']).lower()}: lateral RMS {values[0]} against {values[1]}, outside E "
        f"{other['violation_share']:.1%}, QPs infeasible {other['qp_status']['infeasible']}"
    )
