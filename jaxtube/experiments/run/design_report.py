"""The report of a design: gains, tubes, W, terminal set, certificate, assumptions, verdict."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from jaxtyping import Float

from jaxtube.experiments.run import metrics
from jaxtube.experiments.run.limits import describe_error_set
from jaxtube.experiments.run.table import Column, format_table, left, wrap
from jaxtube.experiments.run.verdict import LONGEST, list_names
from jaxtube.synthesis.advice import say_what_helps, say_what_proves_w
from jaxtube.synthesis.bands import list_ends
from jaxtube.synthesis.certificate.robot import PREMISE
from jaxtube.synthesis.disturbance import kinematics, operation
from jaxtube.synthesis.parts import Design
from jaxtube.synthesis.problem import Problem
from sets.certificate import MARGINS
from sets.robot.disturbance import disturbance_parts

LABEL = 16
"""Width of the names at the beginning of lines."""
NOTHING = 1e-5
"""Share of the largest entry of a matrix below which an entry is left by a solver."""
LEGEND = (
    "W: proved half widths; found: the largest ones that were met. By cause: bilinear, products of "
    "inputs with errors and inputs; sine, the curves of sine and cosine of the heading error; "
    "sampling, what the model's time step or slip factors miss; slip, sideslip and noise, as "
    "[slip] and [noise] say; lag, that and delay of the wheels, as [robot] says. Each cause is "
    "bounded on its own, to 2 %, where it is worst, while causes may cancel in W: one alone may "
    "come out wider than W."
)
"""What the table of the disturbance set shows."""


def report(design: Design, ultimate: dict | None = None, nearest: Sequence[str] = ()) -> str:
    """Return the design as text, the verdict first.

    Args:
        design: with its certificate.
        ultimate: half widths (m, m, deg) that the law u = K e ends within, where they are known.
        nearest: sentences on what holds nearby, where that was searched.
    """
    settings = design.problem.scenario.controller
    certificate = design.certificate
    lines = [*_verdict_lines(design, nearest), "", *_weight_lines(design), *_gain_lines(design)]
    lines += [*_observer_lines(design.problem), ""]
    lines += [*_tube_lines(design), "", *_disturbance_lines(design), *_terminal_lines(design)]
    lines += ["", describe_error_set(design.problem)]
    lines += ["", f"certificate (terminal {settings.terminal}, tube {settings.tube})"]
    lines += wrap(f"  {MARGINS}", "  ")
    lines.append(certificate.table())
    if ultimate and certificate.holds_for_robot:
        lines += ["", *_ultimate_lines(ultimate)]
    lines += ["", "assumed"]
    for assumption in certificate.assumptions:
        lines += wrap(f"  * {assumption}", "    ")
    total = sum(design.seconds.values())
    parts = ", ".join(f"{name} {seconds:.2f}" for name, seconds in design.seconds.items())
    lines += ["", *wrap(f"designed in {total:.2f} s ({parts})", "  ")]
    return "\n".join(lines)


def say_verdict(design: Design) -> str:
    """Return one line: for what a design is certified, how much of a cap its tube fills, and what
    fails."""
    certificate = design.certificate
    if not certificate.holds_for_robot:
        whole = "NOT CERTIFIED"
        if certificate.holds_for_model:
            whole = "CERTIFIED for the linear model with w in W alone; NOT for the robot"
        return f"{whole}: {list_names(certificate.failing, LONGEST - len(whole) - 2)}"
    line = "CERTIFIED: every required condition holds"
    widest = certificate.conditions.get("widest_tube_fits")
    if widest is None or not widest.holds:
        return line
    return f"{line}; the tube fills at most {1.0 - widest.margin:.1%} of a cap"


def _verdict_lines(design: Design, nearest: Sequence[str]) -> list[str]:
    """Return the verdict, and what helps where it is not the wanted one."""
    certificate = design.certificate
    lines = [say_verdict(design)]
    if nearest:
        return lines + [line for each in nearest for line in wrap(each, "  ")]
    is_assumed = not design.problem.has_computed_bound
    if is_assumed and PREMISE in certificate.failing:
        lines += wrap(f"what helps the robot: {say_what_proves_w()}", "  ")
        if not certificate.holds_for_model:
            lines += wrap(f"what helps the model: {say_what_helps(design.problem)}", "  ")
    elif not certificate.holds_for_robot:
        lines += wrap(f"what helps: {say_what_helps(design.problem)}", "  ")
    return lines


def _ultimate_lines(ultimate: dict) -> list[str]:
    x, y, heading = ultimate.values()
    return wrap(
        "once in the terminal set, the law u = K e of the tube, without the MPC, brings the error "
        f"that the controller sees within {x:.4f} m, {y:.4f} m, {heading:.2f} deg; the MPC itself "
        "goes further, and no such bound is given for it"
    )


def _weight_lines(design: Design) -> list[str]:
    problem = design.problem
    weights = {"Q": problem.error_weight, "R": problem.input_weight}
    return [f"{f'weight {name}':<{LABEL}}{_matrix(weight)}" for name, weight in weights.items()]


def _gain_lines(design: Design) -> list[str]:
    """Return the gains in use: the numbers that the scenario gives, or the values at the centre."""
    if design.problem.scenario.operating.bands:
        return _band_lines(design.problem)
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


def _band_lines(problem: Problem) -> list[str]:
    """Return gains and W of every band."""
    columns = [
        left("mean speed [m/s]"),
        Column("k1", "1/s"),
        Column("k2", "rad/(m s)"),
        Column("k3", "1/s"),
        Column("W: yaw", "deg"),
        Column("x", "mm"),
        Column("y", "mm"),
    ]
    rows = []
    for (slowest, fastest), band in zip(
        pairwise(list_ends(problem.scenario)), problem.regimes, strict=True
    ):
        bound = band.disturbance_bound
        assert bound is not None
        gains = [f"{gain:.4g}" for gain in band.scenario.controller.tracking_gains]
        x, y, _ = 1e3 * bound.box
        widths = [f"{np.rad2deg(bound.yaw):.3f}", f"{x:.2f}", f"{y:.2f}"]
        rows.append([f"{slowest:g} to {fastest:g}", *gains, *widths])
    law = "tracking gains  u1 = -k1 e_x - Om e_y,  u2 = -k2 e_y - k3 e_th, by speed; W of one step"
    return [law, *format_table(columns, rows).splitlines()]


def _observer_lines(problem: Problem) -> list[str]:
    """Return the gain of the observer and the set S of its error, nothing without one."""
    if not problem.scenario.controller.has_observer:
        return []
    x, y, heading = problem.scenario.controller.observer_gain
    size = problem.estimate_error * [1e3, 1e3, np.rad2deg(1.0)]
    return wrap(
        f"{'observer gain':<{LABEL}}{x:g} e_x, {y:g} e_y, {heading:g} e_th of what the measurement "
        f"differs from the prediction; its estimate is off by at most {size[0]:.3g} mm, "
        f"{size[1]:.3g} mm, {size[2]:.3g} deg",
        " " * LABEL,
    )


def _matrix(matrix: np.ndarray) -> str:
    """Return a matrix in a line; entries that are nothing beside the largest one are 0."""
    shown = np.where(np.abs(matrix) < NOTHING * np.abs(matrix).max(), 0.0, matrix)
    rows = [" ".join(f"{entry:.6g}" for entry in row) for row in shown]
    return f"[{'; '.join(rows)}]"


def _tube_lines(design: Design) -> list[str]:
    head = f"half widths of R_{design.problem.horizon}"
    lines = [f"{head}        e_x [m]    e_y [m]    e_th [deg]   volume [m^2 rad]"]
    for name, tube in design.tubes.items():
        e_x, e_y, e_th = metrics.tube_half_widths(design, name)[-1]
        mark = "*" if tube is design.tube else " "
        volume = tube[-1].polytope().volume()
        lines.append(f"  {mark} {name:<18}{e_x:10.6f} {e_y:10.6f} {e_th:11.5f}   {volume:.4e}")
    lines.append("  * the tube in use")
    if design.problem.scenario.operating.bands:
        lines.append("  others: none, they know one gain and one W; operating.bands has several")
    elif "paper" not in design.tubes:
        lines.append("  paper: none, eq. (27) takes Euler steps and loops affine in wheel speeds")
    return lines


def find_causes(design: Design) -> dict[str, Float[np.ndarray, "4"]]:
    """Return half widths (yaw kick deg, e_x mm, e_y mm, e_th deg) of one step: of the computed W,
    of the largest disturbances "found", and of each cause alone; nothing where W is assumed."""
    bound = design.problem.disturbance_bound
    if bound is None:
        return {}
    parts = disturbance_parts(operation(design.problem), kinematics(design.problem))
    rows = {
        "W": np.array([bound.yaw, *bound.box]),
        "found": np.array([bound.found_yaw, *bound.found_box]),
    }
    rows |= {name: widths for name, widths in parts.items() if widths.any()}
    units = np.array([np.rad2deg(1.0), 1e3, 1e3, np.rad2deg(1.0)])
    return {name: widths * units for name, widths in rows.items()}


def _disturbance_lines(design: Design) -> list[str]:
    """Return the computed W and what each cause adds to it, nothing where W is assumed."""
    bound = design.problem.disturbance_bound
    if bound is None:
        return []
    lines = [
        f"disturbance set {'yaw kick [deg]':>21}{'e_x [mm]':>11}{'e_y [mm]':>11}{'e_th [deg]':>13}"
    ]
    for name, (yaw, x, y, heading) in find_causes(design).items():
        shown = name if name in ("W", "found") else f"  {name} alone"
        lines.append(f"  {shown:<18}{yaw:>17.4f}{x:>11.3f}{y:>11.3f}{heading:>13.4f}")
    shift = bound.lateral_per_yaw * 1e3 * np.deg2rad(1.0)
    return [
        *lines,
        *wrap(
            "  half widths of one step; a yaw kick is a turn by slip, or by lag and delay that are "
            f"not known, one of 1 deg also moves the robot sideways by {shift:.3f} mm",
            "  ",
        ),
        *wrap(f"  {LEGEND}", "  "),
        *_observed_lines(design.problem),
        "",
    ]


def _observed_lines(problem: Problem) -> list[str]:
    """Return what an observer makes of the causes of W, nothing without one."""
    if not problem.scenario.controller.has_observer:
        return []
    return wrap(
        "  Of slip, sideslip and noise the observer takes over its gain at once, the rest later: "
        "noise is its share of the next measurement's and of what its estimate is off by.",
        "  ",
    )


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
        *wrap(
            f"terminal set    maximal invariant set of {len(maximal.offsets)} facets; used: an "
            f"invariant one of {len(invariant.offsets)} facets, {terminal.volume_share:.1%} of its "
            "volume",
            " " * LABEL,
        ),
        f"                constraint on the last predicted error: {facets} facets",
    ]
    if terminal.fallback:
        lines.append(
            "                nothing is left of it once the tube is taken off: E - R_N is used "
            "instead"
        )
    return lines
