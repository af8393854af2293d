"""Conditions on the end of a plan: the terminal set is invariant and admissible, and receives the
shifted plan."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from itertools import pairwise

import numpy as np
from jaxtyping import Float

from jaxtube.synthesis.certificate.escape import escape_margin, say_what_is_passed
from jaxtube.synthesis.certificate.stages import margins_along_reference
from jaxtube.synthesis.condense import Bounds, tube_bounds
from jaxtube.synthesis.gains import Gain
from jaxtube.synthesis.parts import Design
from jaxtube.synthesis.problem import Problem
from jaxtube.synthesis.terminal import Terminal, admissible_set, set_back_off
from jaxtube.synthesis.tightening import tighten
from jaxtube.synthesis.tubes import make_following_tube
from jaxtube.synthesis.windows import Windows, make_windows
from sets.certificate import ROUNDING, Condition, invariance_margin, judge, terminal_margins
from sets.polytope import Polytope

ANY_ORDER = "any_order_of_wheel_speeds"
"""The condition that frees a tube along the reference from the order of this path."""
RANDOM_STEPS = 12
"""Steps of random wheel speeds along which recursive feasibility is checked in any order."""
INCLUSIONS = {
    "admissible_errors": "E_{N-1}",
    "admissible_inputs": "U_{N-1}",
    "returns": "the terminal constraint",
}


def check_terminal(design: Design) -> Iterator[Condition]:
    """Yield the conditions on the terminal set, and that the shifted plan ends in it."""
    terminal = design.terminal
    settings = design.problem.scenario.controller
    label = "D" if settings.terminal_set_holds_reach else "W"
    if terminal.invariant is None:
        yield _judge_absence(design)
    else:
        margin = _find_invariance_margin(design, terminal.invariant)
        yield judge(
            "terminal_set_invariant",
            margin,
            f"The terminal set ({len(terminal.invariant.offsets)} facets) is invariant at every "
            f"vertex under {label}.",
            f"The terminal set is not invariant under {label}: some vertex leaves it by "
            f"{-margin:.3g}.",
        )
        margin = _admissible_set(design).containment_margin(terminal.invariant)
        yield judge(
            "terminal_set_admissible",
            margin,
            "The terminal set lies in the error constraints and its terminal inputs in the input "
            "constraints.",
            f"The terminal set or its inputs leave the constraints by {-margin:.3g}.",
        )
    yield _check_plan_stays_feasible(design)


def _find_invariance_margin(design: Design, omega: Polytope) -> float:
    """Return by how much every terminal loop maps the set into itself with what it must absorb: the
    W of every regime that lasts, or where the set holds the reach all that W has become at the end
    of a plan."""
    problem = design.problem
    loops = design.terminal.gains.loops
    if problem.scenario.controller.terminal_set_holds_reach:
        W = problem.disturbance_set.vertices()
        reached = _products(design.tube_gain, W, problem.horizon - 1)
        return invariance_margin(loops, reached, omega)
    lasting = problem.rule.lasting(problem.horizon)
    return min(
        invariance_margin(loops, problem.disturbances[regime].vertices(), omega)
        for regime in lasting
    )


def _admissible_set(design: Design) -> Polytope:
    """Return the errors from which the terminal gains may act: within E and U or, where the set
    holds the reach, within what the last stage of a plan leaves of them."""
    gains = design.terminal.gains
    if not design.problem.scenario.controller.terminal_set_holds_reach:
        return admissible_set(design.problem, gains)
    last = design.problem.horizon - 1
    errors = design.bounds.errors[:, last].min(axis=0)
    inputs = design.bounds.inputs[:, last].min(axis=0)
    return admissible_set(design.problem, gains, errors, inputs)


def _judge_absence(design: Design) -> Condition:
    """Say whether no invariant set exists, inside the constraints or only inside those that are
    backed off for the solver, or that none was found."""
    terminal = design.terminal
    escape = terminal.maximal.escape
    loops = terminal.loops
    disturbance = [section.vertices() for section in terminal.disturbances]
    margin = escape_margin(escape, loops, disturbance)
    sentence = "No invariant terminal set was found."
    if escape is not None and margin > -np.inf:
        back_off = set_back_off(design.problem)
        real_offset = escape.offset + back_off * (1 + np.linalg.norm(escape.normal))
        real = escape_margin(replace(escape, offset=float(real_offset)), loops, disturbance)
        steps = len(escape.loops) + 1
        what = say_what_is_passed(design.problem, terminal.gains, escape, -margin)
        passes = f"in {steps} steps from e = 0 {what}"
        if real > -np.inf:
            sentence = f"No invariant terminal set exists: {passes}."
        else:
            sentence = (
                "No invariant terminal set exists inside constraints backed off by "
                f"{back_off:.0e}: {passes}; inside those that are not, there may be one."
            )
    return judge(
        "terminal_set_invariant",
        margin,
        "",
        f"{sentence} The run uses E - R_N at the last stage instead.",
    )


def _check_plan_stays_feasible(design: Design) -> Condition:
    """Check the three terminal inclusions of the shifted plan on the sets used: along the reference
    from each step to the next where the tube follows it, else for every schedule in the regions."""
    margins = list(_terminal_margins(design))
    slack = design.solver_slack
    worst = {name: min(margin[name] for margin in margins) - slack for name in INCLUSIONS}
    failing = ", ".join(
        f"{INCLUSIONS[name]} by {-margin:.3g}" for name, margin in worst.items() if margin < 0
    )
    return judge(
        "plan_stays_feasible",
        min(worst.values()),
        "Shifted by a step and ended by the terminal gain, every plan is a plan again: "
        "feasibility is recursive.",
        "Shifted by a step and ended by the terminal gain, a plan may leave "
        f"{failing}: recursive feasibility is not shown.",
    )


def _terminal_margins(design: Design) -> Iterator[dict[str, float]]:
    """Yield the margins of the terminal inclusions, by name, at every step they are due at."""
    if not design.tube.follows_reference:
        yield _margins_in_any_order(design)
        return
    index = design.windows.index.tolist()
    # A run of one step is taken to go on in the window it has.
    for now, following in set(pairwise(index)) or {(index[0], index[0])}:
        yield _margins_along(
            design.problem, design.terminal, design.windows, design.bounds, now, following
        )


def has_any_order(design: Design) -> bool:
    """Whether recursive feasibility can be checked for other orders: the tube follows the reference
    with the terminal gain, and a terminal set is in use."""
    terminal = design.terminal
    settings = design.problem.scenario.controller
    return (
        settings.tube_has_terminal_gain
        and design.tube.follows_reference
        and terminal.invariant is not None
        and not terminal.fallback
    )


def check_any_order(design: Design) -> Condition:
    """Check recursive feasibility along wheel speeds in random order, as it follows from the
    invariance of Omega.

    With R_{N|k+1} + Psi W = Phi R_{N|k} + W, Psi the product of the N loops ahead, what is left of
    Omega once R_N is taken off is mapped into what is left one step later, whatever wheel speeds
    come next.
    """
    omega = design.terminal.invariant
    assert omega is not None
    gain = design.tube_gain
    elsewhere = _with_random_speeds(design.problem)
    windows = make_windows(elsewhere, gain)
    tube = make_following_tube(elsewhere, gain, windows)
    left = omega.offsets - tube.support(elsewhere.horizon, omega.normals)
    terminal = replace(design.terminal, constraint_normals=omega.normals, constraint_offsets=left)
    bounds = tube_bounds(elsewhere, tighten(elsewhere, tube, len(windows.schedules)), terminal)
    stages = margins_along_reference(elsewhere, windows, bounds)
    returns = [
        min(_margins_along(elsewhere, terminal, windows, bounds, now, following).values())
        for now, following in set(pairwise(windows.index.tolist()))
    ]
    margin = min(
        stages.reach + ROUNDING,
        stages.inclusion - design.solver_slack,
        min(returns) - design.solver_slack,
        left.min(),
    )
    return judge(
        ANY_ORDER,
        margin,
        "Feasibility is recursive in any order of the certified wheel speeds, because the terminal "
        f"set is invariant at every corner; checked along {RANDOM_STEPS} steps of random order.",
        "Along wheel speeds in random order a plan may miss its constraints one step later by "
        f"{-margin:.3g}.",
    )


def _with_random_speeds(problem: Problem) -> Problem:
    """Return the problem along wheel speeds drawn all over its regions, half of them at corners."""
    random = np.random.default_rng(0)
    count = RANDOM_STEPS + problem.horizon
    regions = problem.regions[random.integers(len(problem.regions), size=count)]
    corners = random.integers(0, 2, (count, 2))
    inside = random.random((count, 2))
    share = np.where(random.random((count, 1)) < 0.5, corners, inside)
    wheels = regions[:, 0] + share * (regions[:, 1] - regions[:, 0])
    reference = replace(problem.reference, wheels=wheels, steps=RANDOM_STEPS)
    return replace(problem, reference=reference)


def _margins_in_any_order(design: Design) -> dict[str, float]:
    """Return the margins of the terminal inclusions over all regions, from any window to any
    other."""
    problem = design.problem
    bounds = design.bounds
    gains = design.terminal.gains
    last = problem.horizon - 1
    last_reach = _products(design.tube_gain, problem.disturbance_set.vertices(), last)
    return terminal_margins(
        Polytope(bounds.terminal_normals, bounds.terminal.max(axis=0)),
        Polytope(bounds.terminal_normals, bounds.terminal.min(axis=0)),
        gains.loops,
        Polytope(problem.operating_set.normals, bounds.errors[:, last].min(axis=0)),
        *_unit_input_rows(
            problem,
            problem.input_rows.on_errors(gains.corner_gains),
            bounds.inputs[:, last].min(axis=0),
        ),
        last_reach,
    )


def _margins_along(
    problem: Problem,
    terminal: Terminal,
    windows: Windows,
    bounds: Bounds,
    now: int,
    following: int,
) -> dict[str, float]:
    """Return the margins of the terminal inclusions from the step that has window `now` ahead to
    the next one."""
    last = problem.horizon - 1
    schedule = windows.schedules[following, -1]
    points = problem.disturbances[int(windows.regimes[now, 0])].vertices()
    for loop in windows.loops[now, 1:]:
        points = points @ loop.T
    return terminal_margins(
        Polytope(bounds.terminal_normals, bounds.terminal[now]),
        Polytope(bounds.terminal_normals, bounds.terminal[following]),
        terminal.gains.loops_along(schedule)[None],
        Polytope(problem.operating_set.normals, bounds.errors[following, last]),
        *_unit_input_rows(
            problem,
            problem.input_rows.on_errors(terminal.gains.along(schedule))[None],
            bounds.inputs[following, last],
        ),
        points,
    )


def _unit_input_rows(
    problem: Problem, rows: Float[np.ndarray, "g k 3"], offsets: Float[np.ndarray, " k"]
) -> tuple[Float[np.ndarray, "g k 3"], Float[np.ndarray, " k"]]:
    """Return rows on the error and their offsets in the units of rows of U of norm one."""
    scale = np.linalg.norm(problem.input_rows.inputs, axis=1)
    return rows / scale[:, None], offsets / scale


def _products(gain: Gain, W: Float[np.ndarray, "w 3"], steps: int) -> Float[np.ndarray, "p 3"]:
    """Return the corners of the hull of Psi W over every product of `steps` loops, by enumeration
    of the products."""
    points = W
    for _ in range(steps):
        points = np.concatenate([points @ loop.T for loop in gain.loops])
        points = Polytope.from_vertices(points).vertices()
    return points
