"""Exact re-check of a design: the certificate once more, in rational arithmetic and from the floats
the design holds.

For designs with tracking gains k under the exact Jacobian, terminal set T-A and tubes along the
reference. With th any wheel speeds (each float stands for the binary rational it is), Phi(th) and
K(th) the exact loop and gain of the sampled model, W = {sigma (0, g_y, 1) : |sigma| <= yaw} + box,
and the sets of the design by their float rows and offsets:

    disturbance          the proved bound on w lies in W                          (up to ROUNDING)
    schedules            every window of the reference lies in one region         (up to ROUNDING)
    gains                loops and gains along the windows are Phi(th) and K(th)  (up to ROUNDING)
    terminal invariant   Phi(th) Omega + W in Omega                        for th in the regions
    terminal errors      Omega in E
    terminal inputs      D K(th) + C <= d over Omega                       for th in the regions
    cost                 Phi(th)^T P Phi(th) + Q + K(th)^T R K(th) <= P    for th in the regions
    nonempty, reach,     of the sets used on line, along the windows: `sets.robot.exact_tube`
    shifted, returns

The proof is about Phi(th) and K(th). Not proved here:

* the gain and the matrices of the prediction used on line, which are floats: `gains` says how close
  they are. The difference acts like a disturbance of some 1e-12, and the back-off of the
  constraints, 1e-7 a stage, leaves room for it and for the solver's slack;
* that w lies in W, which `sets.robot.disturbance` bounds by intervals; `motions` proves it again;
* the wheel limits;
* that the wheel speeds of the reference are those of the windows: they differ by at most 1e-12 m/s.
"""

from __future__ import annotations

from fractions import Fraction
from itertools import pairwise, product

import numpy as np
from jaxtyping import Float

from jaxtube.synthesis.advice import say_what_helps
from jaxtube.synthesis.disturbance import prove_bound
from jaxtube.synthesis.parts import Design
from jaxtube.synthesis.problem import Problem
from sets.certificate import ROUNDING, Condition, judge
from sets.exact import (
    ExactReport,
    Matrix,
    Numbers,
    Row,
    decrease_pivot,
    dot,
    exact_containment_margin,
    exact_invariance_margin,
    exact_row,
    exact_rows,
    mapped_rows,
)
from sets.polytope import Polytope
from sets.robot.exact_tube import (
    ScheduleBox,
    exact_vertex_feedbacks,
    exact_vertex_loops,
    exact_wheel_loops,
    schedule_box,
    sequence_margins,
)

UP_TO_ROUNDING = ("schedules", "gains", "disturbance")
"""Margins that compare floats with the rationals they stand for: no room of the design."""


def check_in_rationals(design: Design) -> Condition:
    """Check a design a second time, by separate code in rational arithmetic; say, for information,
    where that does not apply."""
    name = "checked_in_rationals"
    try:
        report = recheck(design)
    except ValueError as error:
        sentence = f"Not checked a second time: {error}."
        return Condition(name, -np.inf, sentence, "information")
    of_sets = {
        part: margin for part, margin in report.margins.items() if part not in UP_TO_ROUNDING
    }
    tightest = min(of_sets, key=lambda part: of_sets[part])
    margin = of_sets[tightest] if report.holds else min(report.margins.values())
    return judge(
        name,
        float(margin),
        f"Separate code in exact rational arithmetic proves {len(report.margins)} conditions once "
        f"more, for the same W, regions and sets; the tightest is {tightest}.",
        f"Exact rational arithmetic does not confirm: {', '.join(report.failing)}.",
    )


def recheck(design: Design) -> ExactReport:
    """Re-check every condition of a design in exact arithmetic.

    Returns:
        The margins by the names above, in the units of the offsets; those of `cost` are pivots.

    Raises:
        ValueError: for designs of another kind, or without a terminal set.
    """
    gains = _tracking_gains(design)
    omega = _invariant_rows(design)
    problem = design.problem
    points = [disturbance_points(regime) for regime in problem.every_regime]
    lasting = [points[regime] for regime in problem.rule.lasting(problem.horizon)]
    rows = problem.input_rows
    limits = problem.operating_set
    T = problem.model.dt
    b = problem.model.track_width
    loops = [exact_wheel_loops(gains, lower, upper, T, b) for lower, upper in problem.regions]
    feedbacks = [
        _distinct_feedbacks(gains, schedule_box(lower, upper, T, b))
        for lower, upper in problem.regions
    ]
    every_loop = [loop for region in loops for loop in region]
    every_feedback = list(dict.fromkeys(gain for region in feedbacks for gain in region))
    input_rows = mapped_rows(rows.inputs, rows.errors, every_feedback)
    input_limits = np.tile(rows.offsets, len(every_feedback))
    pivots = [
        decrease_pivot(design.cost.cost, *of_region, problem.error_weight, problem.input_weight)
        for of_region in zip(loops, feedbacks, strict=True)
    ]
    margins = {
        "disturbance": min(map(_least_room, problem.disturbances.sets, points))
        + Fraction(ROUNDING),
        "schedules": _least_covered(design) + Fraction(ROUNDING),
        "terminal invariant": min(
            exact_invariance_margin(*omega, every_loop, of_regime) for of_regime in lasting
        ),
        "terminal errors": exact_containment_margin(*omega, limits.normals, limits.offsets),
        "terminal inputs": exact_containment_margin(*omega, input_rows, input_limits),
        "cost": min(pivots),
    }
    return ExactReport(margins | _check_along_windows(design, gains, omega, points))


def _tracking_gains(design: Design) -> tuple[float, ...]:
    settings = design.problem.scenario.controller
    for field, value, needed in (
        ("model", settings.model, "exact_jacobian"),
        ("terminal", settings.terminal, "T-A"),
        ("tube", settings.tube, "sequence"),
    ):
        if value != needed:
            raise ValueError(
                f'controller.{field}: "{value}" has no exact re-check; set controller.{field} = '
                f'"{needed}"'
            )
    if not settings.tracking_gains:
        raise ValueError(
            "controller.tracking_gains: none, so there is no exact re-check; give three gains"
        )
    return settings.tracking_gains


def _invariant_rows(
    design: Design,
) -> tuple[Float[np.ndarray, "facets 3"], Float[np.ndarray, " facets"]]:
    """Return rows and offsets of the terminal set."""
    omega = design.terminal.invariant
    if omega is None or design.terminal.fallback:
        raise ValueError(
            "terminal: the design has no terminal set to re-check; "
            f"{say_what_helps(design.problem)}"
        )
    return omega.normals, omega.offsets


def disturbance_points(problem: Problem) -> list[Row]:
    """Return at most twelve points whose hull is exactly W: segment + box where it is computed,
    else a box."""
    if problem.disturbance_bound is None:
        lower = -problem.disturbance_set.support(-np.eye(3))
        upper = problem.disturbance_set.support(np.eye(3))
        return [exact_row(point) for point in product(*zip(lower, upper, strict=True))]
    bound = prove_bound(problem)
    yaw, lateral_per_yaw = exact_row((bound.yaw, bound.lateral_per_yaw))
    kick = (Fraction(0), lateral_per_yaw * yaw, yaw)
    widths = exact_row(bound.box)
    along = 1 if lateral_per_yaw >= 0 else -1
    points = []
    for sign, *sides in product((-1, 1), repeat=4):
        # A corner of the box that lies against the kick in both of its coordinates is no extreme
        # point of the sum.
        if not sides[1] * along == sides[2] == -sign:
            corner = [side * width for side, width in zip(sides, widths, strict=True)]
            points.append(tuple(sign * k + c for k, c in zip(kick, corner, strict=True)))
    return points


def _least_room(disturbance_set: Polytope, points: list[Row]) -> Fraction:
    """Return the least room of the points in a polytope."""
    rows = zip(exact_rows(disturbance_set.normals), exact_row(disturbance_set.offsets), strict=True)
    return min(offset - dot(normal, point) for normal, offset in rows for point in points)


def _least_covered(design: Design) -> Fraction:
    """Return by how much the least covered schedule of the windows lies inside a region."""
    regions = [[exact_row(ends) for ends in region] for region in design.problem.regions]
    schedules = np.unique(design.windows.schedules.reshape(-1, 2), axis=0)
    return min(
        max(_room_in_region(exact_row(wheels), lower, upper) for lower, upper in regions)
        for wheels in schedules
    )


def _room_in_region(wheels: Row, lower: Row, upper: Row) -> Fraction:
    """Return by how much wheel speeds lie inside a box of them."""
    above = [speed - least for speed, least in zip(wheels, lower, strict=True)]
    below = [most - speed for speed, most in zip(wheels, upper, strict=True)]
    return min(*above, *below)


def _distinct_feedbacks(gains: Numbers, box: ScheduleBox) -> list[Matrix]:
    """Return the distinct gains at the ends of the yaw rates of a box."""
    return list(dict.fromkeys(exact_vertex_feedbacks(gains, box)))


def _check_along_windows(
    design: Design, gains: Numbers, omega, points: list[list[Row]]
) -> dict[str, Fraction]:
    """Return the margins of the tubes along the windows of the reference, and of the loops and
    gains used there."""
    problem = design.problem
    windows = design.windows
    T = problem.model.dt
    rows = problem.input_rows
    boxes = {
        tuple(wheels): schedule_box(wheels, wheels, T, problem.model.track_width)
        for wheels in np.unique(windows.schedules.reshape(-1, 2), axis=0)
    }
    stages = [[boxes[tuple(wheels)] for wheels in window] for window in windows.schedules]
    margins = sequence_margins(
        stages,
        pairwise(windows.index.tolist()),
        gains,
        T,
        points,
        (problem.operating_set.normals, problem.operating_set.offsets),
        (rows.inputs, rows.errors, rows.offsets),
        omega,
        design.bounds,
        windows.regimes.tolist(),
    )
    return {"gains": Fraction(ROUNDING) - _largest_gap(design, gains, stages)} | margins


def _largest_gap(design: Design, gains: Numbers, stages: list[list[ScheduleBox]]) -> Fraction:
    """Return the largest difference between an entry of a float loop or gain and the exact one."""
    boxes = [box for window in stages for box in window]
    exact_loops = {box: exact_vertex_loops(gains, box, design.problem.model.dt) for box in boxes}
    exact_gains = {box: _distinct_feedbacks(gains, box) for box in boxes}
    loops = design.windows.loops.reshape(-1, 3, 3)
    used_gains = design.windows.gains.reshape(-1, 2, 3)
    gaps = [_gap(exact_loops[box], loop) for box, loop in zip(boxes, loops, strict=True)]
    gaps += [_gap(exact_gains[box], gain) for box, gain in zip(boxes, used_gains, strict=True)]
    return max(gaps)


def _gap(matrices: list[Matrix], floats: Float[np.ndarray, "m n"]) -> Fraction:
    """Return the largest difference between an entry of the matrices and the float one."""
    entries = exact_row(floats.ravel())
    return max(
        abs(exact - entry)
        for matrix in matrices
        for exact, entry in zip((a for row in matrix for a in row), entries, strict=True)
    )
