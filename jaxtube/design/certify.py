"""The certificate of a design: which conditions are asked of which sets, those the controller really uses."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from jaxtube.design.condense import Bounds
from jaxtube.design.fill import cap_shares
from jaxtube.design.problem import Problem, error_vector
from jaxtube.design.terminal import Terminal, admissible_set
from jaxtube.design.tightening import (
    BACK_OFF,
    LocalGain,
    Windows,
    coverage_gap,
    gains_at_corners,
    vertex_loops,
    vertex_pairs,
)
from sets import certificate as check
from sets.certificate import Certificate
from sets.disturbance import DisturbanceBound
from sets.invariant import MaximalRpi, maximal_rpi
from sets.lmi import TerminalCost, terminal_cost
from sets.polytope import Polytope

NEVER_RESET_STEPS = 8
INCLUSIONS = {
    "admissible_errors": "E_{N-1}",
    "admissible_inputs": "U_{N-1}",
    "returns": "the terminal constraint",
}
OBJECTIVES = ("trace_s", "trace_p", "logdet")


def certify(
    problem: Problem,
    tube_gain: LocalGain,
    cost: TerminalCost,
    windows: Windows,
    terminal: Terminal,
    bounds: Bounds,
    residual: float,
) -> Certificate:
    """Re-check every condition of the guarantee; the disturbance bound only where W was computed and not assumed.

    `residual` bounds by how much an accepted answer of the solver may miss a constraint from any error in E.
    """
    certificate = Certificate()
    _nonempty(certificate, problem, bounds)
    sequence = problem.scenario.controller.tube == "sequence"
    margins = (_sequence_margins if sequence else _tube_margins)(problem, tube_gain, windows, bounds)
    _reach_and_inclusion(certificate, *margins)
    if not problem.scenario.controller.restart:
        _never_reset(certificate, problem, tube_gain, bounds)
    _terminal(certificate, problem, tube_gain, terminal, windows, bounds)
    loops, gains = vertex_pairs(problem, terminal.gains)
    margin = check.decrease_margin(loops, gains, cost.cost, problem.error_weight, problem.input_weight)
    certificate.add(
        "terminal_cost_decrease",
        margin,
        "The terminal cost decreases by at least the stage cost at every vertex of the schedule box.",
        "The terminal cost does not decrease by the stage cost at some vertex.",
    )
    _coverage(certificate, problem, tube_gain, terminal, windows)
    room = float(np.min(error_vector(problem.scenario.constraints) - problem.error_set.support(np.eye(3))))
    certificate.add(
        "true_error_in_e",
        room + check.ROUNDING,
        "What the controller keeps of the measured error and the pose noise together lie in the error constraints.",
        f"With the pose noise the true error may leave the error constraints by {-room:.3g}.",
    )
    if problem.residual is not None:
        _disturbance(certificate, problem, problem.residual)
    certificate.add(
        "solver_residual",
        BACK_OFF - residual,
        f"Constraints are backed off by {BACK_OFF:.0e}, more than the {residual:.0e} a solved QP may miss them by.",
        f"Constraints are backed off by {BACK_OFF:.0e}, less than the {residual:.0e} a solved QP may miss them by.",
    )
    certificate.assumptions = assumptions(problem)
    if problem.scenario.controller.tracking_gains:
        _widest_tube(certificate, problem, terminal.gains)
    else:
        _existence(certificate, problem, tube_gain, terminal, cost)
    return certificate


def _disturbance(certificate: Certificate, problem: Problem, bound: DisturbanceBound) -> None:
    """Check that W is as wide as its bound, and that the wheels can do all that may be asked of them."""
    W = problem.disturbance_set
    margin = float(np.min(W.offsets - bound.support(W.normals)))
    found = np.array([bound.found_yaw / bound.yaw, *(bound.found_box / bound.box)])
    certificate.add(
        "disturbance_bound_proved",
        margin + check.ROUNDING,
        "W holds every disturbance of the slipping robot over everything certified, proved by interval arithmetic; "
        f"disturbances found reach {found.min():.1%} to {found.max():.1%} of it.",
        f"W is narrower than the proved bound by {-margin:.3g}.",
    )
    slip = problem.scenario.slip
    grip = 1 - np.array([slip.nominal_right, slip.nominal_left]) * (1 + slip.relative_error)
    least, greatest = bound.ground_speeds
    room = float(
        min(
            np.min(grip * problem.robot.wheel_speed_max - greatest),
            np.min(least - grip * problem.robot.wheel_speed_min),
        )
    )
    certificate.add(
        "wheel_limits",
        room,
        f"Ground speeds of {least.min():.3f} to {greatest.max():.3f} m/s may be asked for; under every slip the wheels "
        f"have {room:.3g} m/s to spare.",
        f"Ground speeds of {least.min():.3f} to {greatest.max():.3f} m/s may be asked for: {-room:.3g} m/s more than "
        "the wheels can do under the greatest slip.",
    )


def _widest_tube(certificate: Certificate, problem: Problem, gain: LocalGain) -> None:
    """Say, for information, how much of each cap the tube of the terminal gain fills, and which one binds."""
    shares = cap_shares(problem, gain)
    binding = max(shares, key=lambda name: shares[name])
    listed = ", ".join(f"{name} {share:.1%}" for name, share in shares.items())
    certificate.add(
        "widest_tube_fits",
        1 - shares[binding],
        f"The tube of the terminal gain fills at its widest {shares[binding]:.1%} of the {binding}, which "
        f"binds ({listed}).",
        f"The tube of the terminal gain may outgrow the caps; the {binding} binds ({listed}).",
        required=False,
    )


def assumptions(problem: Problem) -> tuple[str, ...]:
    """Return what the guarantee takes for granted, in words."""
    scenario, slip = problem.scenario, problem.scenario.slip
    which = {"true": "or measured", "measured": "or true", "both": "and, on its own, measured"}[slip.random]
    speeds = (
        f"wheel speeds between {problem.model.box[0][0]:g} and {problem.model.box[1][0]:g} m/s, in any order"
        if (scenario.reference.certified_for == "box")
        else f"the {len(problem.regions)} pairs of wheel speeds of the path, in any order"
    )
    return (
        f"slip {slip.random} {which} within {slip.relative_error:.0%} of its nominal value "
        f"({slip.nominal_right:g} right, {slip.nominal_left:g} left), in any sequence",
        f"pose measured within {scenario.noise.longitudinal_m:g} m, {scenario.noise.lateral_m:g} m, "
        f"{scenario.noise.heading_deg:g} deg",
        f"reference of {speeds}"
        + ("" if scenario.operating.bands else f", known {problem.horizon} periods of {problem.model.dt:g} s ahead"),
        "slip, wheel speeds and reference constant over each period; wheels obey at once; no sideways slip",
        ("the first error lies in the invariant set" if scenario.operating.bands else "the first error has a plan")
        + (", and no disturbance leaves W" if scenario.disturbance.bound == "assumed" else ""),
    )


def _tightened(problem: Problem, bounds: Bounds):
    """Yield the distinct tightened sets E_j (j = 1..N-1) and U_j (j = 0..N-1)."""
    for j in range(problem.horizon):
        for offsets in np.unique(bounds.errors[:, j], axis=0) if j else ():
            yield "E", Polytope(problem.operating_set.normals, offsets)
        for offsets in np.unique(bounds.inputs[:, j], axis=0):
            yield "U", Polytope(problem.input_rows.inputs, offsets)


def _nonempty(certificate: Certificate, problem: Problem, bounds: Bounds) -> None:
    sets = list(_tightened(problem, bounds))
    for kind, name in (("E", "error_sets_not_empty"), ("U", "input_sets_not_empty")):
        radius = check.nonempty_margin([polytope for k, polytope in sets if k == kind] or [problem.operating_set])
        certificate.add(
            name,
            radius,
            f"Every tightened set {kind}_j holds a ball of radius {radius:.4g}.",
            f"A tightened set {kind}_j is empty (radius {radius:.4g}).",
        )
    radius = check.nonempty_margin(
        Polytope(bounds.terminal_normals, offsets) for offsets in np.unique(bounds.terminal, axis=0)
    )
    certificate.add(
        "terminal_constraint_not_empty",
        radius,
        f"The constraint on the last predicted error holds a ball of radius {radius:.4g}.",
        f"The constraint on the last predicted error is empty (radius {radius:.4g}).",
    )


def _tube_margins(problem: Problem, gain: LocalGain, windows: Windows, bounds: Bounds):
    """Return the margins of reach and inclusion for a tube that holds for every schedule in the box."""
    N, loops = problem.horizon, vertex_loops(problem, gain)
    W = problem.disturbance_set.vertices()
    reach_margin = inclusion_margin = np.inf
    for directions, taken in (
        (problem.operating_set.normals[:, None], problem.operating_set.offsets - bounds.errors),
        (_rows_under_gains(problem, gain).swapaxes(0, 1), problem.input_rows.offsets - bounds.inputs),
    ):
        least, most = taken.min(axis=0), taken.max(axis=0)
        for row, along in enumerate(directions):
            along = along.reshape(-1, along.shape[-1])
            reach, last = np.max([check.reach_supports(loops, W, direction, N - 1) for direction in along], axis=0)
            reach_margin = min(reach_margin, np.min(least[:, row] - reach))
            growth = least[1:, row] - most[:-1, row] - last[:-1]
            inclusion_margin = min(inclusion_margin, np.min(growth, initial=np.inf))
    return reach_margin, inclusion_margin


def _sequence_margins(problem: Problem, gain: LocalGain, windows: Windows, bounds: Bounds):
    """Return the margins of reach and inclusion along the reference, from each step to the next."""
    N = problem.horizon
    W = problem.disturbance_set.vertices()
    taken_errors = problem.operating_set.offsets - bounds.errors
    taken_inputs = problem.input_rows.offsets - bounds.inputs
    reach_margin = inclusion_margin = np.inf
    for first, loops in enumerate(windows.loops):
        followers = np.unique(windows.index[1:][windows.index[:-1] == first])
        for j in range(N):
            for taken, rows in (
                (taken_errors, problem.operating_set.normals),
                (taken_inputs, problem.input_rows.under(windows.gains[first, j])),
            ):
                reach, last = check.sequence_reach(loops[: max(j, 1)], W, rows)
                reach_margin = min(reach_margin, np.min(taken[first, j] - reach[j]))
                if j:
                    growth = taken[first, j] - taken[followers, j - 1] - last[j - 1]
                    inclusion_margin = min(inclusion_margin, np.min(growth, initial=np.inf))
    return reach_margin, inclusion_margin


def _reach_and_inclusion(certificate: Certificate, reach_margin: float, inclusion_margin: float) -> None:
    certificate.add(
        "tightening_covers_reach",
        reach_margin + check.ROUNDING,
        "Every stage is tightened by at least what products of loops and disturbances in W can reach.",
        f"Some stage is tightened by {-reach_margin:.3g} less than products of loops and disturbances in W can reach.",
    )
    certificate.add(
        "shifted_plan_inclusion",
        inclusion_margin + check.ROUNDING,
        "R_{j+1} contains R_j + Psi_j W on every facet used: the shifted plan meets the tightened constraints.",
        f"R_(j+1) misses R_j + Psi_j W by {-inclusion_margin:.3g} on some facet: the shifted plan may be inadmissible.",
    )


def _never_reset(certificate: Certificate, problem: Problem, gain: LocalGain, bounds: Bounds) -> None:
    """Compare what the first stage is tightened by with what a deviation that is never reset can reach."""
    loops, W = vertex_loops(problem, gain), problem.disturbance_set.vertices()
    first = min(1, problem.horizon - 1)
    taken = (problem.operating_set.offsets - bounds.errors[:, first]).min(axis=0)
    reach = [check.reach_supports(loops, W, row, NEVER_RESET_STEPS)[0][-1] for row in problem.operating_set.normals]
    margin = float(np.min(taken - reach))
    certificate.add(
        "nominal_error_never_reset",
        margin,
        f"The first stage is tightened by more than {NEVER_RESET_STEPS} steps of disturbances can reach.",
        f"The nominal error is never reset, but the first stage is tightened for one step only: in {NEVER_RESET_STEPS} "
        f"steps the deviation reaches {-margin:.3g} further.",
    )


def _terminal(certificate, problem: Problem, tube_gain: LocalGain, terminal: Terminal, windows, bounds: Bounds) -> None:
    W, D = problem.disturbance_set.vertices(), terminal.disturbance.vertices()
    label, loops = {"T-B": "D"}.get(terminal.kind, "W"), vertex_loops(problem, terminal.gains)
    if terminal.invariant is None:
        _empty_terminal(certificate, terminal, loops, D)
    else:
        margin = check.invariance_margin(loops, D, terminal.invariant)
        certificate.add(
            "terminal_set_invariant",
            margin,
            f"The terminal set ({len(terminal.invariant.offsets)} facets) is invariant at every vertex under {label}.",
            f"The terminal set is not invariant under {label}: some vertex leaves it by {-margin:.3g}.",
        )
        margin = terminal.admissible.containment_margin(terminal.invariant)
        certificate.add(
            "terminal_set_admissible",
            margin,
            "The terminal set lies in the error constraints and its terminal inputs in the input constraints.",
            f"The terminal set or its inputs leave the constraints by {-margin:.3g}.",
        )
    _plan_stays_feasible(certificate, problem, tube_gain, terminal, windows, bounds, W)


def _empty_terminal(certificate: Certificate, terminal: Terminal, loops, disturbance) -> None:
    margin = _escape_margin(terminal.maximal, loops, disturbance)
    sentence = "No invariant terminal set was found."
    if terminal.maximal.escape is not None and margin > -np.inf:
        steps = len(terminal.maximal.escape.loops) + 1
        sentence = (
            f"No invariant terminal set exists: in {steps} steps the origin goes {-margin:.3g} past a constraint."
        )
    certificate.add("terminal_set_invariant", margin, "", f"{sentence} The run uses E - R_N at the last stage instead.")


def _escape_margin(found: MaximalRpi, loops, disturbance) -> float:
    """Return minus what the escape passes its constraint by, -inf where none does: then nothing is proved."""
    if found.escape is None:
        return -np.inf
    excess, _ = check.escape_excess(loops, disturbance, found.escape.normal, found.escape.offset, found.escape.loops)
    return -excess if excess > 0 else -np.inf


def _plan_stays_feasible(certificate, problem: Problem, tube_gain, terminal: Terminal, windows, bounds, W) -> None:
    """Check the three terminal inclusions of the shifted plan on the sets used.

    With the tube `sequence` from each step of the run to the next, else for every schedule in the box.
    """
    if problem.scenario.controller.tube == "sequence":
        pairs = set(pairwise(windows.index)) or {(windows.index[0], windows.index[0])}
        margins = [_margins_along(problem, terminal, windows, bounds, W, *pair) for pair in pairs]
    else:
        last_reach = _products(vertex_loops(problem, tube_gain), W, problem.horizon - 1)
        margins = [_margins_anywhere(problem, terminal, bounds, last_reach)]
    worst = {key: min(margin[key] for margin in margins) for key in margins[0]}
    failing = ", ".join(f"{INCLUSIONS[key]} by {-value:.3g}" for key, value in worst.items() if value < 0)
    certificate.add(
        "plan_stays_feasible",
        min(worst.values()),
        "Shifted by a step and ended by the terminal gain, every plan is a plan again: feasibility is recursive.",
        f"Shifted by a step and ended by the terminal gain, a plan may leave {failing}: recursive feasibility is not "
        "shown.",
    )


def _margins_anywhere(problem: Problem, terminal: Terminal, bounds: Bounds, last_reach: Polytope) -> dict[str, float]:
    """Return the margins of the terminal inclusions over the whole schedule box, from any window to any other."""
    last = problem.horizon - 1
    return check.terminal_margins(
        Polytope(bounds.terminal_normals, bounds.terminal.max(axis=0)),
        Polytope(bounds.terminal_normals, bounds.terminal.min(axis=0)),
        vertex_loops(problem, terminal.gains),
        Polytope(problem.operating_set.normals, bounds.errors[:, last].min(axis=0)),
        *_unit_input_rows(problem, _rows_under_gains(problem, terminal.gains), bounds.inputs[:, last].min(axis=0)),
        last_reach,
    )


def _margins_along(
    problem, terminal: Terminal, windows: Windows, bounds: Bounds, W, now, following
) -> dict[str, float]:
    """Return the margins of the terminal inclusions from the step that has window `now` ahead to the next one."""
    last, schedule = problem.horizon - 1, windows.schedules[following, -1]
    transition, inputs = problem.model.matrices(schedule)
    gain = terminal.gains.at(problem.model.weights(schedule))
    points = W
    for loop in windows.loops[now, 1:]:
        points = points @ loop.T
    return check.terminal_margins(
        Polytope(bounds.terminal_normals, bounds.terminal[now]),
        Polytope(bounds.terminal_normals, bounds.terminal[following]),
        (transition + inputs @ gain)[None],
        Polytope(problem.operating_set.normals, bounds.errors[following, last]),
        *_unit_input_rows(problem, problem.input_rows.under(gain)[None], bounds.inputs[following, last]),
        Polytope.from_vertices(points),
    )


def _rows_under_gains(problem: Problem, gain: LocalGain):
    """Return the input rows as rows on the error, one stack a gain at a corner of the regions."""
    return problem.input_rows.under(gains_at_corners(problem, gain))


def _unit_input_rows(problem: Problem, rows, offsets):
    """Return rows on the error and their offsets in the units of rows of U of norm one."""
    scale = np.linalg.norm(problem.input_rows.inputs, axis=1)
    return rows / scale[:, None], offsets / scale


def _products(loops, W, steps: int) -> Polytope:
    """Return the hull of Psi W over every product of `steps` loops, by enumeration of the products."""
    points = W
    for _ in range(steps):
        points = np.concatenate([points @ loop.T for loop in loops])
        points = Polytope.from_vertices(points).vertices()
    return Polytope.from_vertices(points)


def _coverage(certificate, problem: Problem, tube_gain: LocalGain, terminal: Terminal, windows: Windows) -> None:
    """Check that loops in the regions, the run's too, are mixtures of the corner loops: not so for zero-order hold."""
    transitions, inputs = problem.model.matrices(windows.schedules)
    gains = tube_gain.at(problem.model.weights(windows.schedules))
    run = gains - windows.gains, transitions + inputs @ gains - windows.loops
    worst = max(float(np.max(np.abs(difference))) for difference in run)
    for gain in (tube_gain, terminal.gains):
        used = windows.schedules.reshape(-1, 2)
        gaps = [coverage_gap(problem, gain, used, region) for region in problem.regions]
        worst = max(worst, float(np.min(gaps, axis=0).max()))
        for region in problem.regions:
            grid = np.stack(np.meshgrid(*np.linspace(region[0], region[1], 21).T), axis=-1).reshape(-1, 2)
            worst = max(worst, float(coverage_gap(problem, gain, grid, region).max()))
    certificate.add(
        "vertices_cover_schedule",
        check.ROUNDING - worst,
        "Every loop along the run and, on a grid, in the certified wheel speeds is a mixture of the corner loops.",
        f"Some loop within the certified wheel speeds differs from mixtures of the corner loops by {worst:.3g} "
        "(zero-order hold, or the exact Jacobian without tracking gains).",
    )


def _existence(certificate: Certificate, problem: Problem, tube_gain: LocalGain, terminal: Terminal, cost) -> None:
    """Say, for information, for which gains an invariant set inside E and U exists at all over the whole box."""
    _exists(certificate, "invariant_set_for_tube_gain", "the tube gain", problem, tube_gain)
    vertices = problem.model.matrices(problem.model.vertices)
    for objective in OBJECTIVES:
        name, gain = f"terminal_set_for_{objective}", terminal.gains
        if objective != cost.objective:
            try:
                gains = terminal_cost(*vertices, problem.error_weight, problem.input_weight, objective).gains
            except RuntimeError as error:
                certificate.add(name, -np.inf, "", f"No LMI gains for {objective}: {error}", required=False)
                continue
            gain = LocalGain(gains.mean(axis=0), gains)
        _exists(certificate, name, f"the LMI gains of {objective}", problem, gain)


def _exists(certificate: Certificate, name: str, label: str, problem: Problem, gain: LocalGain) -> None:
    loops, W = vertex_loops(problem, gain), problem.disturbance_set
    admissible = admissible_set(problem, gain)
    found = maximal_rpi(loops, admissible, W.support)
    if found.polytope is not None:
        margin = check.invariance_margin(loops, W.vertices(), found.polytope)
        margin = min(margin, admissible.containment_margin(found.polytope) + check.ROUNDING)
    else:
        margin = _escape_margin(found, loops, W.vertices())
    facets = 0 if found.polytope is None else len(found.polytope.offsets)
    certificate.add(
        name,
        margin,
        f"With {label} an invariant set ({facets} facets) inside the constraints exists at all four vertices.",
        f"With {label} neither an invariant set nor a proof that there is none was found."
        if margin == -np.inf
        else f"With {label} no invariant set fits the constraints over the whole box: within {found.iterations + 1} "
        f"steps the reach of the origin passes a constraint by {-margin:.3g}.",
        required=False,
    )
