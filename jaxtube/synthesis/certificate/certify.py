"""The certificate of a design: which conditions are asked of which sets, those the controller
really uses."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np

from jaxtube.synthesis.certificate.existence import escape_margin, say_what_exists
from jaxtube.synthesis.certificate.robot import certify_robot, widest_tube_fits
from jaxtube.synthesis.condense import Bounds, tube_bounds
from jaxtube.synthesis.problem import Problem
from jaxtube.synthesis.terminal import Terminal, tube_support
from jaxtube.synthesis.tightening import (
    BACK_OFF,
    LocalGain,
    Windows,
    coverage_gap,
    gains_at_corners,
    make_windows,
    tighten,
    vertex_loops,
    vertex_pairs,
)
from sets import certificate as check
from sets.certificate import Certificate
from sets.lmi import TerminalCost
from sets.polytope import Polytope

NEVER_RESET_STEPS = 8
RANDOM_STEPS = 12
INCLUSIONS = {
    "admissible_errors": "E_{N-1}",
    "admissible_inputs": "U_{N-1}",
    "returns": "the terminal constraint",
}


def certify(
    problem: Problem,
    tube_gain: LocalGain,
    cost: TerminalCost,
    windows: Windows,
    terminal: Terminal,
    bounds: Bounds,
    residual: float,
) -> Certificate:
    """Re-check every condition of the guarantee; the disturbance bound only where W was computed
    and not assumed.

    `residual` bounds by how much an accepted answer of the solver may miss a constraint from any
    error in E.
    """
    certificate = Certificate()
    _nonempty(certificate, problem, bounds)
    sequence = problem.scenario.controller.tube == "sequence"
    margins = (_sequence_margins if sequence else _tube_margins)(
        problem, tube_gain, windows, bounds
    )
    _reach_and_inclusion(certificate, *margins, residual)
    if not problem.scenario.controller.restart:
        _never_reset(certificate, problem, tube_gain, bounds)
    _terminal(certificate, problem, tube_gain, terminal, windows, bounds, residual)
    if (
        terminal.kind == "T-A"
        and sequence
        and terminal.invariant is not None
        and not terminal.fallback
    ):
        _any_order(certificate, problem, tube_gain, terminal, terminal.invariant, residual)
    loops, gains = vertex_pairs(problem, terminal.gains)
    margin = check.decrease_margin(
        loops, gains, cost.cost, problem.error_weight, problem.input_weight
    )
    certificate.add(
        "terminal_cost_decrease",
        margin,
        "The terminal cost decreases by at least the stage cost at every vertex of the schedule box.",
        "The terminal cost does not decrease by the stage cost at some vertex.",
    )
    _coverage(certificate, problem, tube_gain, terminal, windows)
    certify_robot(certificate, problem)
    certificate.add(
        "solver_residual",
        BACK_OFF - residual,
        f"Constraints are backed off by {BACK_OFF:.0e}, more than the {residual:.0e} a solved QP may miss them by.",
        f"Constraints are backed off by {BACK_OFF:.0e}, less than the {residual:.0e} a solved QP may miss them by.",
    )
    if len(problem.given_gains):
        widest_tube_fits(certificate, problem, terminal.gains)
    else:
        say_what_exists(certificate, problem, tube_gain, terminal, cost)
    return certificate


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
        radius = check.nonempty_margin(
            [polytope for k, polytope in sets if k == kind] or [problem.operating_set]
        )
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
    """Return the margins of reach and inclusion for a tube that holds for every schedule in the
    box."""
    N, loops = problem.horizon, vertex_loops(problem, gain)
    W = problem.disturbance_set.vertices()
    reach_margin = inclusion_margin = np.inf
    for directions, taken in (
        (problem.operating_set.normals[:, None], problem.operating_set.offsets - bounds.errors),
        (
            _rows_under_gains(problem, gain).swapaxes(0, 1),
            problem.input_rows.offsets - bounds.inputs,
        ),
    ):
        least, most = taken.min(axis=0), taken.max(axis=0)
        for row, along in enumerate(directions):
            along = along.reshape(-1, along.shape[-1])
            reach, last = np.max(
                [check.reach_supports(loops, W, direction, N - 1) for direction in along], axis=0
            )
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


def _reach_and_inclusion(
    certificate: Certificate, reach_margin: float, inclusion: float, residual: float
) -> None:
    inclusion_margin = inclusion - residual
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


def _never_reset(
    certificate: Certificate, problem: Problem, gain: LocalGain, bounds: Bounds
) -> None:
    """Compare what the first stage is tightened by with what a deviation that is never reset can
    reach."""
    loops, W = vertex_loops(problem, gain), problem.disturbance_set.vertices()
    first = min(1, problem.horizon - 1)
    taken = (problem.operating_set.offsets - bounds.errors[:, first]).min(axis=0)
    reach = [
        check.reach_supports(loops, W, row, NEVER_RESET_STEPS)[0][-1]
        for row in problem.operating_set.normals
    ]
    margin = float(np.min(taken - reach))
    certificate.add(
        "nominal_error_never_reset",
        margin,
        f"The first stage is tightened by more than {NEVER_RESET_STEPS} steps of disturbances can reach.",
        f"The nominal error is never reset, but the first stage is tightened for one step only: in {NEVER_RESET_STEPS} "
        f"steps the deviation reaches {-margin:.3g} further.",
    )


def _terminal(
    certificate, problem: Problem, tube_gain, terminal: Terminal, windows, bounds, residual: float
) -> None:
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
    _plan_stays_feasible(certificate, problem, tube_gain, terminal, windows, bounds, W, residual)


def _empty_terminal(certificate: Certificate, terminal: Terminal, loops, disturbance) -> None:
    margin = escape_margin(terminal.maximal, loops, disturbance)
    sentence = "No invariant terminal set was found."
    if terminal.maximal.escape is not None and margin > -np.inf:
        steps = len(terminal.maximal.escape.loops) + 1
        sentence = f"No invariant terminal set exists: in {steps} steps the origin goes {-margin:.3g} past a constraint."
    certificate.add(
        "terminal_set_invariant",
        margin,
        "",
        f"{sentence} The run uses E - R_N at the last stage instead.",
    )


def _plan_stays_feasible(
    certificate, problem: Problem, tube_gain, terminal, windows, bounds, W, residual
) -> None:
    """Check the three terminal inclusions of the shifted plan on the sets used.

    With the tube `sequence` from each step of the run to the next, else for every schedule in the
    box.
    """
    if problem.scenario.controller.tube == "sequence":
        pairs = set(pairwise(windows.index)) or {(windows.index[0], windows.index[0])}
        margins = [_margins_along(problem, terminal, windows, bounds, W, *pair) for pair in pairs]
    else:
        last_reach = _products(vertex_loops(problem, tube_gain), W, problem.horizon - 1)
        margins = [_margins_anywhere(problem, terminal, bounds, last_reach)]
    worst = {key: min(margin[key] for margin in margins) - residual for key in margins[0]}
    failing = ", ".join(
        f"{INCLUSIONS[key]} by {-value:.3g}" for key, value in worst.items() if value < 0
    )
    certificate.add(
        "plan_stays_feasible",
        min(worst.values()),
        "Shifted by a step and ended by the terminal gain, every plan is a plan again: feasibility is recursive.",
        f"Shifted by a step and ended by the terminal gain, a plan may leave {failing}: recursive feasibility is not "
        "shown.",
    )


def _any_order(
    certificate, problem: Problem, gain: LocalGain, terminal: Terminal, omega: Polytope, residual
) -> None:
    """Check recursive feasibility along wheel speeds in random order, as it follows from the
    invariance of Omega.

    With R_{N|k+1} + Psi W = Phi R_{N|k} + W, Psi the product of the N loops ahead, what is left of
    Omega once R_N is taken off is mapped into what is left one step later, whatever wheel speeds
    come next.
    """
    random = np.random.default_rng(0)
    chosen = problem.regions[
        random.integers(len(problem.regions), size=RANDOM_STEPS + problem.horizon)
    ]
    corners, inside = random.integers(0, 2, (len(chosen), 2)), random.random((len(chosen), 2))
    share = np.where(random.random((len(chosen), 1)) < 0.5, corners, inside)
    wheels = chosen[:, 0] + share * (chosen[:, 1] - chosen[:, 0])
    elsewhere = replace(
        problem, reference=replace(problem.reference, wheels=wheels, steps=RANDOM_STEPS)
    )
    windows = make_windows(elsewhere, gain)
    tightening = tighten(elsewhere, gain, windows, [], "sequence")
    left = omega.offsets - tube_support(elsewhere, windows, tightening, omega.normals)
    terminal = replace(terminal, constraint_normals=omega.normals, constraint_offsets=left)
    bounds, W = tube_bounds(elsewhere, tightening, terminal), problem.disturbance_set.vertices()
    reach, inclusion = _sequence_margins(elsewhere, gain, windows, bounds)
    pairs = set(pairwise(windows.index))
    returns = min(
        min(_margins_along(elsewhere, terminal, windows, bounds, W, *pair).values())
        for pair in pairs
    )
    margin = min(reach + check.ROUNDING, inclusion - residual, returns - residual, left.min())
    certificate.add(
        "any_order_of_wheel_speeds",
        margin,
        "Feasibility is recursive in any order of the certified wheel speeds, because the terminal set is invariant at "
        f"every corner; checked along {RANDOM_STEPS} steps of random order.",
        f"Along wheel speeds in random order a plan may miss its constraints one step later by {-margin:.3g}.",
    )


def _margins_anywhere(
    problem: Problem, terminal: Terminal, bounds: Bounds, last_reach
) -> dict[str, float]:
    """Return the margins of the terminal inclusions over the whole schedule box, from any window to
    any other."""
    last = problem.horizon - 1
    return check.terminal_margins(
        Polytope(bounds.terminal_normals, bounds.terminal.max(axis=0)),
        Polytope(bounds.terminal_normals, bounds.terminal.min(axis=0)),
        vertex_loops(problem, terminal.gains),
        Polytope(problem.operating_set.normals, bounds.errors[:, last].min(axis=0)),
        *_unit_input_rows(
            problem, _rows_under_gains(problem, terminal.gains), bounds.inputs[:, last].min(axis=0)
        ),
        last_reach,
    )


def _margins_along(
    problem, terminal: Terminal, windows: Windows, bounds: Bounds, W, now, following
) -> dict[str, float]:
    """Return the margins of the terminal inclusions from the step that has window `now` ahead to
    the next one."""
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
        *_unit_input_rows(
            problem, problem.input_rows.under(gain)[None], bounds.inputs[following, last]
        ),
        points,
    )


def _rows_under_gains(problem: Problem, gain: LocalGain):
    """Return the input rows as rows on the error, one stack a gain at a corner of the regions."""
    return problem.input_rows.under(gains_at_corners(problem, gain))


def _unit_input_rows(problem: Problem, rows, offsets):
    """Return rows on the error and their offsets in the units of rows of U of norm one."""
    scale = np.linalg.norm(problem.input_rows.inputs, axis=1)
    return rows / scale[:, None], offsets / scale


def _products(loops, W, steps: int) -> np.ndarray:
    """Return the corners of the hull of Psi W over every product of `steps` loops, by enumeration
    of the products."""
    points = W
    for _ in range(steps):
        points = np.concatenate([points @ loop.T for loop in loops])
        points = Polytope.from_vertices(points).vertices()
    return points


def _coverage(
    certificate, problem: Problem, tube_gain: LocalGain, terminal: Terminal, windows: Windows
) -> None:
    """Check that loops in the regions, the run's too, are mixtures of the corner loops: not so for
    zero-order hold."""
    transitions, inputs = problem.model.matrices(windows.schedules)
    gains = tube_gain.at(problem.model.weights(windows.schedules))
    run = gains - windows.gains, transitions + inputs @ gains - windows.loops
    worst = max(float(np.max(np.abs(difference))) for difference in run)
    for gain in (tube_gain, terminal.gains):
        used = windows.schedules.reshape(-1, 2)
        gaps = [coverage_gap(problem, gain, used, region) for region in problem.regions]
        worst = max(worst, float(np.min(gaps, axis=0).max()))
        for region in problem.regions:
            grid = np.stack(np.meshgrid(*np.linspace(region[0], region[1], 21).T), axis=-1).reshape(
                -1, 2
            )
            worst = max(worst, float(coverage_gap(problem, gain, grid, region).max()))
    certificate.add(
        "vertices_cover_schedule",
        check.ROUNDING - worst,
        "Every loop along the run and, on a grid, in the certified wheel speeds is a mixture of the corner loops.",
        f"Some loop within the certified wheel speeds differs from mixtures of the corner loops by {worst:.3g} "
        "(zero-order hold, or the exact Jacobian without tracking gains).",
    )
