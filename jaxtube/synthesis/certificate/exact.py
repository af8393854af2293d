"""Exact re-check of a design: the certificate once more, in rational arithmetic and from the floats
the design holds.

For designs with tracking gains k under the exact Jacobian, terminal set T-A and tubes along the
reference. With th any wheel speeds (each float stands for the binary rational it is), Phi(th) and
K(th) the exact loop and gain of the sampled model, W = {sigma (0, g_y, 1) : |sigma| <= yaw} + box,
and the sets of the design by their float rows and offsets:

    disturbance          W lies in the polytope that the float certificate used                    (up to ROUNDING)
    schedules            every window of the reference lies in one of the regions
    gains                loops and gains along the windows are Phi(th) and K(th)                    (up to ROUNDING)
    terminal invariant   Phi(th) Omega + W in Omega                                           for th in the regions
    terminal errors      Omega in E
    terminal inputs      D K(th) + C <= d over Omega                                          for th in the regions
    cost                 Phi(th)^T P Phi(th) + Q + K(th)^T R K(th) <= P                       for th in the regions
    nonempty, reach, shifted, returns      of the sets used on line, along the windows: `sets.robot.exact_tube`

What is proved, is proved of Phi(th) and K(th). On line the gain is a float and so are the matrices
of the prediction: `gains` says how close both are. The difference acts like a disturbance of some
1e-12, and the back-off of the constraints, 1e-7 a stage, leaves room for it and for the solver's
residual; this last step is not part of the proof. Nor is that the disturbances of the robot lie in
W, which `sets.robot.disturbance` bounds by intervals, nor that the wheel speeds of the reference
are those of the windows, which are rounded to 1e-12 m/s.
"""

from __future__ import annotations

from fractions import Fraction
from itertools import pairwise, product

import numpy as np
from jaxtyping import Float

from jaxtube.synthesis.design import Design
from jaxtube.synthesis.problem import Problem
from sets.certificate import ROUNDING
from sets.exact import (
    ExactReport,
    Matrix,
    Numbers,
    containment_margin,
    decrease_pivot,
    dot,
    exact_row,
    exact_rows,
    invariance_margin,
    mapped_rows,
)
from sets.polytope import Polytope
from sets.robot.exact_tube import (
    ScheduleBox,
    schedule_box,
    sequence_margins,
    vertex_feedbacks,
    vertex_loops,
    wheel_loops,
)


def recheck(design: Design) -> ExactReport:
    """Re-check every condition of a design in exact arithmetic.

    Returns:
        The margins by the names above, in the units of the offsets; those of `cost` are pivots.

    Raises:
        ValueError: for designs of another kind, or without a terminal set.
    """
    gains, omega = _gains(design), _invariant(design)
    problem, points = design.problem, disturbance_points(design.problem)
    rows, box, T, b = (
        problem.input_rows,
        problem.operating_set,
        problem.model.dt,
        problem.model.track_width,
    )
    loops = [wheel_loops(gains, lower, upper, T, b) for lower, upper in problem.regions]
    feedbacks = [
        _feedbacks(gains, schedule_box(lower, upper, T, b)) for lower, upper in problem.regions
    ]
    corners = list(dict.fromkeys(gain for region in feedbacks for gain in region))
    under, limits = (
        mapped_rows(rows.inputs, rows.errors, corners),
        np.tile(rows.offsets, len(corners)),
    )
    weights = problem.error_weight, problem.input_weight
    margins = {
        "disturbance": _held(problem.disturbance_set, points) + Fraction(ROUNDING),
        "schedules": _covered(design),
        "terminal invariant": invariance_margin(
            *omega, [loop for region in loops for loop in region], points
        ),
        "terminal errors": containment_margin(*omega, box.normals, box.offsets),
        "terminal inputs": containment_margin(*omega, under, limits),
        "cost": min(
            decrease_pivot(design.cost.cost, *pair, *weights)
            for pair in zip(loops, feedbacks, strict=True)
        ),
    }
    return ExactReport(margins | _along_windows(design, gains, omega, points))


def _gains(design: Design) -> tuple[float, ...]:
    settings = design.problem.scenario.controller
    for field, value, needed in (
        ("model", settings.model, "exact_jacobian"),
        ("terminal", settings.terminal, "T-A"),
        ("tube", settings.tube, "sequence"),
    ):
        if value != needed:
            raise ValueError(
                f'controller.{field}: "{value}" has no exact re-check; set controller.{field} = "{needed}"'
            )
    if not settings.tracking_gains:
        raise ValueError(
            "controller.tracking_gains: none, so there is no exact re-check; give three gains"
        )
    return settings.tracking_gains


def _invariant(
    design: Design,
) -> tuple[Float[np.ndarray, "facets 3"], Float[np.ndarray, " facets"]]:
    """Return rows and offsets of the terminal set."""
    found = design.terminal.invariant
    if found is None or design.terminal.fallback:
        raise ValueError(
            "terminal: the design has no terminal set to re-check; shrink [disturbance]"
        )
    return found.normals, found.offsets


def disturbance_points(problem: Problem) -> list[tuple[Fraction, ...]]:
    """Return at most twelve points whose hull is exactly W: segment + box where it is computed,
    else a box."""
    bound = problem.residual
    if bound is None:
        lower, upper = (
            -problem.disturbance_set.support(-np.eye(3)),
            problem.disturbance_set.support(np.eye(3)),
        )
        return [exact_row(point) for point in product(*zip(lower, upper, strict=True))]
    yaw, lateral_per_yaw = exact_row((bound.yaw, bound.lateral_per_yaw))
    kick, widths = (Fraction(0), lateral_per_yaw * yaw, yaw), exact_row(bound.box)
    along = 1 if lateral_per_yaw >= 0 else -1
    # A corner of the box that lies against the kick in both of its coordinates is no extreme point
    # of the sum.
    return [
        tuple(sign * k + side * width for k, side, width in zip(kick, sides, widths, strict=True))
        for sign, *sides in product((-1, 1), repeat=4)
        if not sides[1] * along == sides[2] == -sign
    ]


def _held(disturbance_set: Polytope, points) -> Fraction:
    """Return the least room of the points in a polytope."""
    rows = zip(exact_rows(disturbance_set.normals), exact_row(disturbance_set.offsets), strict=True)
    return min(offset - dot(normal, point) for normal, offset in rows for point in points)


def _covered(design: Design) -> Fraction:
    """Return by how much the least covered schedule of the windows lies inside a region."""
    regions = [[exact_row(ends) for ends in region] for region in design.problem.regions]
    return min(
        max(
            min(min(v - low, high - v) for low, v, high in zip(lower, wheels, upper, strict=True))
            for lower, upper in regions
        )
        for wheels in map(exact_row, np.unique(design.windows.schedules.reshape(-1, 2), axis=0))
    )


def _feedbacks(gains: Numbers, box: ScheduleBox) -> list[Matrix]:
    """Return the distinct gains at the ends of the yaw rates of a box."""
    return list(dict.fromkeys(vertex_feedbacks(gains, box)))


def _along_windows(design: Design, gains: Numbers, omega, points) -> dict[str, Fraction]:
    """Return the margins of the tubes along the windows of the reference, and of the loops and
    gains used there."""
    problem, windows = design.problem, design.windows
    T, rows, box = problem.model.dt, problem.input_rows, problem.operating_set
    known = {
        tuple(wheels): schedule_box(wheels, wheels, T, problem.model.track_width)
        for wheels in np.unique(windows.schedules.reshape(-1, 2), axis=0)
    }
    stages = [[known[tuple(wheels)] for wheels in window] for window in windows.schedules]
    sets = (box.normals, box.offsets), (rows.inputs, rows.errors, rows.offsets), omega
    margins = sequence_margins(
        stages, pairwise(windows.index.tolist()), gains, T, points, *sets, design.bounds
    )
    return {"gains": Fraction(ROUNDING) - _gap(design, gains, stages)} | margins


def _gap(design: Design, gains: Numbers, stages: list[list[ScheduleBox]]) -> Fraction:
    """Return the largest difference between an entry of a float loop or gain and the exact one."""
    exact = {
        box: (vertex_loops(gains, box, design.problem.model.dt), _feedbacks(gains, box))
        for row in stages
        for box in row
    }
    used = zip(
        (box for row in stages for box in row),
        design.windows.loops.reshape(-1, 3, 3),
        design.windows.gains.reshape(-1, 2, 3),
        strict=True,
    )
    return max(
        abs(a - Fraction(b))
        for box, *floats in used
        for matrices, found in zip(exact[box], floats, strict=True)
        for matrix in matrices
        for a, b in zip((a for row in matrix for a in row), found.ravel(), strict=True)
    )
