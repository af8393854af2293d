"""The report of a design: gains, tubes, W, terminal set, certificate, assumptions, verdict."""

from __future__ import annotations

import numpy as np

from jaxtube.experiments.run import metrics
from jaxtube.synthesis.advice import say_what_helps
from jaxtube.synthesis.disturbance import kinematics, operation
from jaxtube.synthesis.parts import Design
from sets.robot.disturbance import disturbance_parts

LABEL = 16
"""Width of the names at the beginning of lines."""


def report(design: Design, ultimate: dict | None = None) -> str:
    """Return the design as text.

    Args:
        design: with its certificate.
        ultimate: half widths (m, m, deg) that the law u = K e ends within, where they are known.
    """
    settings = design.problem.scenario.controller
    certificate = design.certificate
    lines = [*_weight_lines(design), *_gain_lines(design), "", *_tube_lines(design), ""]
    lines += [*_disturbance_lines(design), *_terminal_lines(design)]
    lines += ["", f"certificate (terminal {settings.terminal}, tube {settings.tube})"]
    lines.append(certificate.table())
    if ultimate and certificate.holds_for_robot:
        x, y, heading = ultimate.values()
        lines += [
            "",
            "once in the terminal set, the law u = K e of the tube, without the MPC, brings what "
            f"is measured within {x:.4f} m, {y:.4f} m,",
            f"{heading:.2f} deg; the MPC itself goes further, and no such bound is given for it",
        ]
    lines += ["", "assumed", *(f"  * {line}" for line in certificate.assumptions)]
    lines += ["", certificate.verdict]
    if not certificate.holds_for_model:
        lines.append(f"what helps: {say_what_helps(design.problem)}")
    total = sum(design.seconds.values())
    parts = ", ".join(f"{name} {seconds:.2f}" for name, seconds in design.seconds.items())
    lines += ["", f"designed in {total:.2f} s ({parts})"]
    return "\n".join(lines)


def _weight_lines(design: Design) -> list[str]:
    problem = design.problem
    weights = {"Q": problem.error_weight, "R": problem.input_weight}
    return [f"{f'weight {name}':<{LABEL}}{_matrix(weight)}" for name, weight in weights.items()]


def _gain_lines(design: Design) -> list[str]:
    """Return the gains in use: the numbers that the scenario gives, or the values at the centre."""
    numbers = design.problem.scenario.controller.tracking_gains
    if numbers:
        k1, k2, k3 = numbers
        law = f"u1 = -{k1:g} e_x - Om e_y,  u2 = -{k2:g} e_y - {k3:g} e_th"
        return [f"{'tracking gains':<{LABEL}}{law}"]
    lines = [f"{'tube gain K':<{LABEL}}{_matrix(design.tube_gain.nominal)} at the centre"]
    if design.terminal.gains is not design.tube_gain:
        terminal = _matrix(design.terminal.gains.nominal)
        lines.append(f"{'terminal gain':<{LABEL}}{terminal} at the centre")
    return lines


def _matrix(matrix: np.ndarray) -> str:
    return np.array2string(matrix, precision=6, suppress_small=True).replace("\n", "")


def _tube_lines(design: Design) -> list[str]:
    head = f"half widths of R_{design.problem.horizon}"
    lines = [f"{head}        e_x [m]    e_y [m]    e_th [deg]   volume [m^2 rad]"]
    for name, tube in design.tubes.items():
        e_x, e_y, e_th = metrics.tube_half_widths(design, name)[-1]
        mark = "*" if tube is design.tube else " "
        volume = tube[-1].polytope().volume()
        lines.append(f"  {mark} {name:<18}{e_x:10.6f} {e_y:10.6f} {e_th:11.5f}   {volume:.4e}")
    return [*lines, "  * the tube in use"]


def _disturbance_lines(design: Design) -> list[str]:
    """Return the computed W and what each cause adds to it, nothing where W is assumed."""
    bound = design.problem.disturbance_bound
    if bound is None:
        return []
    parts = disturbance_parts(operation(design.problem), kinematics(design.problem))
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


def _terminal_lines(design: Design) -> list[str]:
    terminal = design.terminal
    maximal = terminal.maximal.polytope
    invariant = terminal.invariant
    if maximal is None or invariant is None:
        return [
            "terminal set    none is invariant: the last predicted error is kept in E - R_N instead"
        ]
    facets = len(terminal.constraint_normals)
    lines = [
        f"terminal set    maximal invariant set of {len(maximal.offsets)} facets; used: an "
        f"invariant one of {len(invariant.offsets)} facets, {terminal.volume_share:.1%} of its "
        "volume",
        f"                constraint on the last predicted error: {facets} facets",
    ]
    if terminal.fallback:
        lines.append(
            "                nothing is left of it once the tube is taken off: E - R_N is used "
            "instead"
        )
    return lines
