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
from jaxtube.experiments.options import Paper, title
from jaxtube.experiments.paper import stress
from jaxtube.experiments.paper.claims import claims, table
from jaxtube.experiments.run import folder as run_folder
from jaxtube.experiments.run import metrics
from jaxtube.experiments.run.folder import RunFolder
from jaxtube.experiments.run.progress import progress
from jaxtube.scenario import Scenario, load
from jaxtube.simulation import closed_loop
from jaxtube.synthesis.design import Design, design, refuse_infeasible_start

STRESS_RUNS = 40
"""Runs of the stress cases for each realisation of the comparison: 10,240 for 256."""

NOISE_FREE = ("uncompensated", "compensated", "tube_mpc", "plain_mpc")


def run(scenario: Scenario, options: Paper) -> int:
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
    print(*parts, table(rows), sep="\n\n")
    print(f"\nfigures, metrics.json, noise_free.npz and manifest.json are in {folder.path}/")
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


def _save_figures(
    found: Design, name: str, laps, robust: Design, stressed, deviations, folder: RunFolder
) -> None:
    from jaxtube.experiments.figures import laps as lap_figures
    from jaxtube.experiments.figures import sets as set_figures
    from jaxtube.experiments.figures.paths import trajectories
    from jaxtube.experiments.figures.realisations import realisations_in_tube
    from jaxtube.experiments.figures.stress import stress as stress_figure
    from jaxtube.experiments.figures.tightened import tightened_sets

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
    with progress(len(drawings), "drawing", "figures") as bar:
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
    head = f"{'':<15}{'':>9}{'largest (median)':>36}{'RMS (median)':>36}"
    units = f"{'e_x [m]':>12}{'e_y [m]':>12}{'e_th [deg]':>12}"
    lines = [
        head,
        f"{'controller':<15}{'outside E':>9}{units}{units}{'active':>9}{'wheel [m/s]':>13}",
    ]
    for name, numbers in measured["controllers"].items():
        largest, rms = (
            numbers[kind]["whole_run"]["median"].values() for kind in ("max_error", "rms_error")
        )
        errors = "".join(f"{value:12.5f}" for value in (*largest, *rms))
        share, wheel = numbers["active_share"], numbers["wheel_speed_max_mps"]
        lines.append(
            f"{name:<15}{numbers['violation_share']:9.1%}{errors}{share:9.2%}{wheel:13.3f}"
        )
    inside = measured["plan_deviations"]
    shares = ", ".join(f"{share:.1%}" for share in inside["share_outside_by_stage"])
    lines.append(
        f"of {inside['plans']} plans followed to their end these shares leave R_1, R_2, ..: {shares}"
    )
    return "\n".join(lines)


def _stress_table(measured: dict) -> str:
    """Return the stress runs of the design `robust`, with and without tube."""
    columns = (
        "runs",
        "outside E",
        "infeasible QPs",
        "recovered runs",
        "every w in W",
        "of these outside E",
    )
    lines = [
        "design `robust`, starts all over the feasible set of the tube-MPC",
        f"{'plant':<24}{'controller':<10}"
        + "".join(f"{name:>{len(name) + 2}}" for name in columns),
    ]
    for case, runs in measured["stress"].items():
        for name, numbers in runs.items():
            recovered = f"{numbers['runs_recovered']}/{numbers['runs_with_infeasible_QP']}"
            values = (
                numbers["runs"],
                numbers["runs_outside_E"],
                numbers["infeasible_QPs"],
                recovered,
                numbers["runs_with_every_w_in_W"],
                numbers["runs_outside_E_with_every_w_in_W"],
            )
            cells = "".join(
                f"{value:>{len(head) + 2}}" for head, value in zip(columns, values, strict=True)
            )
            lines.append(f"{stress.CASES[case]:<24}{name:<10}{cells}")
    return "\n".join(lines)


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
