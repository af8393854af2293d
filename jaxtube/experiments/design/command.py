"""`design`: compute tubes, gains and terminal set of a scenario, re-check them, and print the
certificate."""

from __future__ import annotations

import time

import msgspec
import numpy as np
from jaxtyping import Bool

from jaxtube.experiments.design import banded
from jaxtube.experiments.options import Design as DesignOptions
from jaxtube.experiments.run import folder as run_folder
from jaxtube.experiments.run import metrics
from jaxtube.experiments.run.conditions import condition_lines
from jaxtube.experiments.run.progress import progress
from jaxtube.scenario import Scenario, ScenarioError
from jaxtube.simulation import closed_loop
from jaxtube.simulation.rollout import Trajectory
from jaxtube.synthesis.certificate.exact import recheck
from jaxtube.synthesis.design import Design, design, refuse_infeasible_start
from jaxtube.synthesis.disturbance import kinematics, operation
from jaxtube.synthesis.optimise import STARTS, optimise
from jaxtube.synthesis.problem import make_problem
from sets.certificate import Certificate
from sets.robot.disturbance import disturbance_parts

CERTIFICATE_FAILED = 3


def run(scenario: Scenario, options: DesignOptions) -> int:
    """Run the command; returns 3 where a certificate is required and fails."""
    if scenario.operating.bands and options.optimise:
        raise ScenarioError(
            "scenario: operating.bands: --optimise finds one set of caps, not bands; leave out one of them"
        )
    if scenario.operating.bands:
        return banded.run(scenario, options)
    if options.optimise:
        scenario = optimised(scenario)
    found = design(scenario)
    refuse_infeasible_start(found)
    folder = run_folder.create(scenario, options)
    if scenario.controller.tracking_gains and found.terminal.invariant is not None:
        add_exact_condition(found)
    starts = np.tile(found.problem.initial_error, (closed_loop.BLOCK, 1))
    loop = closed_loop.controllers(found)["local_gain"]
    trajectory = closed_loop.simulate(loop, closed_loop.slipping_robot(found), starts, options.seed)
    residuals = closed_loop.model_residuals(found, trajectory)
    if found.problem.residual is not None:
        residuals = residuals[within_caps(found, trajectory)][:, None]
    disturbance = metrics.disturbance_metrics(found, residuals)
    add_disturbance_condition(found.certificate, disturbance, "the local gain")
    numbers = metrics.design_metrics(found)
    print(report(found, numbers.get("ultimate_bound")))
    folder.save_metrics({**numbers, "disturbance": disturbance})
    print(f"\nwritten to {folder.path}/")
    return exit_code(found, options.require_certificate)


def optimised(scenario: Scenario) -> Scenario:
    """Return the scenario with the caps and gains the optimiser finds, and print them as lines of a
    scenario file."""
    started = time.perf_counter()
    try:
        with progress(len(STARTS), "optimising", "starts") as bar:
            best = optimise(make_problem(scenario), lambda ratio: _show(bar, ratio))
    except ValueError as error:
        raise ScenarioError(f"scenario: {error}") from None
    caps = msgspec.structs.asdict(best.scenario.operating)
    lines = [
        "[operating]",
        *(f"{name} = {value}" for name, value in caps.items() if value is not None),
    ]
    lines += [
        "",
        "[controller]",
        f"tracking_gains = {list(best.scenario.controller.tracking_gains)}",
    ]
    print("\n".join(lines))
    seconds = time.perf_counter() - started
    print(
        f"\nfound in {seconds:.1f} s; the tube fills about {best.ratio:.1%} of the caps at most\n"
    )
    return best.scenario


def _show(bar, ratio: float) -> None:
    bar.set_postfix_str(f"largest share {ratio:.3f}", refresh=False)
    bar.update()


def add_exact_condition(found: Design) -> None:
    """Add the certificate's second check, by separate code in rational arithmetic."""
    try:
        report = recheck(found)
    except ValueError as error:
        found.certificate.add(
            "checked_in_rationals",
            -np.inf,
            "",
            f"Not checked a second time: {error}.",
            required=False,
        )
        return
    sets = {
        name: margin
        for name, margin in report.margins.items()
        if name not in ("schedules", "gains", "disturbance")
    }
    name, margin = min(sets.items(), key=lambda item: item[1])
    found.certificate.add(
        "checked_in_rationals",
        float(margin) if report.holds else float(min(report.margins.values())),
        f"Separate code in exact rational arithmetic proves {len(report.margins)} conditions once more; the "
        f"tightest is {name}.",
        f"Exact rational arithmetic does not confirm: {', '.join(report.failing)}.",
    )


def within_caps(found: Design, trajectory: Trajectory) -> Bool[np.ndarray, "steps runs"]:
    """Return where measured error and input lie in what W was computed for."""
    problem, rows, errors = (
        found.problem,
        found.problem.input_rows,
        np.asarray(trajectory.measured)[:-1],
    )
    inputs = np.asarray(trajectory.inputs) @ rows.inputs.T + errors @ rows.errors.T <= rows.offsets
    return np.all(inputs, axis=2) & (problem.operating_set.margin(errors) >= 0)


def exit_code(found: Design, required: bool) -> int:
    """Return 0, or 3 where a certificate is required and does not hold."""
    return CERTIFICATE_FAILED if required and not found.certificate.holds else 0


def add_disturbance_condition(certificate: Certificate, disturbance: dict, loop: str) -> None:
    """Add what simulated laps say of w(k) in W: they can refute it, never prove it. A W that is
    assumed is no bound."""
    share, steps = disturbance["share_of_steps_outside"], disturbance["steps"]
    parts = []
    for name, outside in disturbance["share_of_steps_outside_by_coordinate"].items():
        coordinate, unit = name.rsplit("_", 1)
        largest, allowed = (disturbance[key][name] for key in ("largest", "allowed"))
        parts.append(
            f"{coordinate} {outside:.1%}, up to {largest:.3g} {unit} where W allows {allowed:.3g}"
        )
    certificate.add(
        "disturbance_in_w",
        disturbance["margin"],
        f"In {steps} simulated steps of {loop} no w left W: not refuted, which proves nothing.",
        f"w lies outside W in {share:.1%} of {steps} simulated steps of {loop} ({'; '.join(parts)}).",
    )
    if "disturbance_bound_proved" not in certificate.conditions:
        certificate.add(
            "disturbance_bound_proved",
            -np.inf,
            "",
            "W is the scenario's assumption: no bound on w of the slipping robot was computed, so the guarantee is one "
            'for the linear model with w in W (disturbance.bound = "computed" computes it).',
        )


def report(found: Design, ultimate: dict | None = None) -> str:
    """Return the design as text: gains, tubes, W, terminal set, certificate, and what the tube's
    gain ends within."""
    terminal, N = found.terminal, found.problem.horizon
    lines = [
        f"LQR gain K^n   {np.array2string(found.lqr_gain, precision=6, suppress_small=True).replace(chr(10), '')}"
    ]
    lines += [
        "",
        f"half widths of R_{N}        e_x [m]    e_y [m]    e_th [deg]   volume [m^2 rad]",
    ]
    for name, sections in found.tubes.items():
        e_x, e_y, e_th = metrics.tube_half_widths(found, name)[-1]
        mark = "*" if name == found.problem.scenario.controller.tube else " "
        lines.append(
            f"  {mark} {name:<18}{e_x:10.6f} {e_y:10.6f} {e_th:11.5f}   {sections[-1].polytope().volume():.4e}"
        )
    lines += ["  * the tube in use", "", *_disturbance_lines(found), *_terminal_lines(found)]
    lines += [
        "",
        f"certificate (terminal {terminal.kind}, tube {found.problem.scenario.controller.tube})",
    ]
    lines += condition_lines(found.certificate, required=True)
    lines += ["", "for information"]
    lines += condition_lines(found.certificate, required=False)
    if ultimate and found.certificate.holds:
        x, y, heading = ultimate.values()
        lines += [
            "",
            f"once in the terminal set, u = K e brings what is measured within {x:.4f} m, {y:.4f} m, {heading:.2f} deg",
        ]
    lines += ["", "assumed", *(f"  * {line}" for line in found.certificate.assumptions)]
    failing = ", ".join(found.certificate.failing)
    lines += [
        "",
        f"NOT CERTIFIED: {failing}" if failing else "CERTIFIED: every required condition holds",
    ]
    total = sum(found.seconds.values())
    parts = ", ".join(f"{name} {seconds:.2f}" for name, seconds in found.seconds.items())
    lines += ["", f"designed in {total:.2f} s ({parts})"]
    return "\n".join(lines)


def _disturbance_lines(found: Design) -> list[str]:
    """Return the computed W and what each cause adds to it, nothing where W is assumed."""
    bound = found.problem.residual
    if bound is None:
        return []
    parts = disturbance_parts(operation(found.problem), kinematics(found.problem))
    rows = {
        "W": np.array([bound.yaw, *bound.box]),
        "really found": np.array([bound.found_yaw, *bound.found_box]),
    }
    rows |= {f"  {name} alone": widths for name, widths in parts.items()}
    units = np.array([np.rad2deg(1.0), 1e3, 1e3, np.rad2deg(1.0)])
    lines = [
        f"disturbance set {'yaw kick [deg]':>21}{'e_x [mm]':>11}{'e_y [mm]':>11}{'e_th [deg]':>13}"
    ]
    for name, widths in rows.items():
        yaw, x, y, heading = widths * units
        lines.append(f"  {name:<18}{yaw:>17.4f}{x:>11.3f}{y:>11.3f}{heading:>13.4f}")
    shift = bound.lateral_per_yaw * 1e3 * np.deg2rad(1.0)
    return [
        *lines,
        f"  half widths; a yaw kick of 1 deg also moves the robot sideways by {shift:.3f} mm",
        "",
    ]


def _terminal_lines(found: Design) -> list[str]:
    terminal = found.terminal
    maximal, invariant = terminal.maximal.polytope, terminal.invariant
    if maximal is None or invariant is None:
        return [
            "terminal set    none is invariant: the last predicted error is kept in E - R_N instead"
        ]
    lines = [
        f"terminal set    maximal invariant set of {len(maximal.offsets)} facets; used: an invariant one of "
        f"{len(invariant.offsets)} facets, {terminal.volume_share:.1%} of its volume",
        f"                constraint on the last predicted error: {len(terminal.constraint_normals)} facets",
    ]
    if terminal.fallback:
        lines.append(
            "                nothing is left of it once the tube is taken off: E - R_N is used instead"
        )
    return lines
