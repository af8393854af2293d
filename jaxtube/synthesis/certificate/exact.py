"""Exact re-check of a design: the certificate once more, in rational arithmetic and from the floats
the design holds.

For designs with tracking gains k under the exact Jacobian, by speed or not, terminal set T-A and
tubes along the reference; of several regimes each has its own k, W and rows on the input. With th
any wheel speeds (each float stands for the binary rational it is), Phi(th) and K(th) the exact loop
and gain of the sampled model, W = {sigma (0, g_y, 1) : |sigma| <= yaw} + box,
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
  constraints, 1e-7 of each a stage at least, leaves room for it and for the solver's slack;
* that w lies in W, which `sets.robot.disturbance` bounds by intervals; `motions` proves it again;
* the wheel limits;
* that the wheel speeds of the reference are those of the windows: they differ by at most 1e-12 m/s.
"""

from __future__ import annotations

from fractions import Fraction
from itertools import pairwise

import numpy as np
from jaxtyping import Float

from jaxtube.synthesis.advice import say_what_helps
from jaxtube.synthesis.certificate.exact_regimes import ExactRegime, make_exact_regimes
from jaxtube.synthesis.parts import Design
from sets.certificate import ROUNDING, Condition, judge
from sets.exact import (
    ExactReport,
    Matrix,
    decrease_pivot,
    dot,
    exact_containment_margin,
    exact_invariance_margin,
    exact_row,
    exact_rows,
    mapped_rows,
)
from sets.robot.exact_tube import (
    ScheduleBox,
    TubeRegime,
    exact_vertex_feedbacks,
    exact_vertex_loops,
    schedule_box,
    sequence_margins,
)

Halfspace = tuple[Float[np.ndarray, "k 3"], Float[np.ndarray, " k"]]
"""Rows and offsets of a set."""

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
    _refuse_other_kinds(design)
    omega = _invariant_rows(design)
    problem = design.problem
    limits = problem.operating_set
    regimes = make_exact_regimes(problem)
    lasting = [regimes[number] for number in problem.rule.lasting(problem.horizon)]
    pivots = [
        decrease_pivot(design.cost.cost, *part, problem.error_weight, problem.input_weight)
        for regime in regimes
        for part in zip(regime.loops, regime.feedbacks, strict=True)
    ]
    margins = {
        "disturbance": min(map(_room_of_w, regimes)) + Fraction(ROUNDING),
        "schedules": _least_covered(design, regimes) + Fraction(ROUNDING),
        "terminal invariant": min(
            exact_invariance_margin(*omega, regime.every_loop, regime.points) for regime in lasting
        ),
        "terminal errors": exact_containment_margin(*omega, limits.normals, limits.offsets),
        "terminal inputs": min(_room_of_inputs(omega, regime) for regime in regimes),
        "cost": min(pivots),
    }
    return ExactReport(margins | _check_along_windows(design, regimes, omega))


def _room_of_inputs(omega: Halfspace, regime: ExactRegime) -> Fraction:
    """Return the room that the terminal inputs of a regime leave."""
    rows = regime.problem.input_rows
    feedbacks = regime.every_feedback
    on_errors = mapped_rows(rows.inputs, rows.errors, feedbacks)
    return exact_containment_margin(*omega, on_errors, np.tile(rows.offsets, len(feedbacks)))


def _refuse_other_kinds(design: Design) -> None:
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
    if not (settings.tracking_gains or design.problem.scenario.operating.bands):
        raise ValueError(
            "controller.tracking_gains: none, so there is no exact re-check; give three gains"
        )


def _invariant_rows(design: Design) -> Halfspace:
    """Return rows and offsets of the terminal set."""
    omega = design.terminal.invariant
    if omega is None or design.terminal.fallback:
        raise ValueError(
            "terminal: the design has no terminal set to re-check; "
            f"{say_what_helps(design.problem)}"
        )
    return omega.normals, omega.offsets


def _room_of_w(regime: ExactRegime) -> Fraction:
    """Return the least room of the points whose hull is W in the polytope of the design."""
    W = regime.problem.disturbance_set
    rows = zip(exact_rows(W.normals), exact_row(W.offsets), strict=True)
    return min(offset - dot(normal, point) for normal, offset in rows for point in regime.points)


def _least_covered(design: Design, regimes: list[ExactRegime]) -> Fraction:
    """Return by how much the least covered schedule of the windows lies inside its regime."""
    windows = design.windows
    stages = np.column_stack([windows.schedules.reshape(-1, 2), windows.regimes.ravel()])
    return min(
        regimes[int(number)].room_of(exact_row(wheels))
        for *wheels, number in np.unique(stages, axis=0)
    )


def _check_along_windows(
    design: Design, regimes: list[ExactRegime], omega: Halfspace
) -> dict[str, Fraction]:
    """Return the margins of the tubes along the windows of the reference, and of the loops and
    gains used there."""
    problem = design.problem
    windows = design.windows
    T = problem.model.dt
    boxes = {
        tuple(wheels): schedule_box(wheels, wheels, T, problem.model.track_width)
        for wheels in np.unique(windows.schedules.reshape(-1, 2), axis=0)
    }
    stages = [[boxes[tuple(wheels)] for wheels in window] for window in windows.schedules]
    margins = sequence_margins(
        stages,
        pairwise(windows.index.tolist()),
        T,
        [_of_tube(regime) for regime in regimes],
        (problem.operating_set.normals, problem.operating_set.offsets),
        omega,
        design.bounds,
        windows.regimes.tolist(),
    )
    return {"gains": Fraction(ROUNDING) - _largest_gap(design, regimes, stages)} | margins


def _of_tube(regime: ExactRegime) -> TubeRegime:
    """Return what the tubes take from a regime."""
    rows = regime.problem.input_rows
    return TubeRegime(regime.gains, regime.points, (rows.inputs, rows.errors, rows.offsets))


def _largest_gap(
    design: Design, regimes: list[ExactRegime], boxes: list[list[ScheduleBox]]
) -> Fraction:
    """Return the largest difference between an entry of a float loop or gain and the exact one."""
    windows = design.windows
    of_stages = zip(
        [box for window in boxes for box in window],
        windows.regimes.ravel().tolist(),
        windows.loops.reshape(-1, 3, 3),
        windows.gains.reshape(-1, 2, 3),
        strict=True,
    )
    gaps = []
    for box, number, loop, gain in of_stages:
        gains = regimes[number].gains
        gaps.append(_gap(exact_vertex_loops(gains, box, design.problem.model.dt), loop))
        gaps.append(_gap(exact_vertex_feedbacks(gains, box), gain))
    return max(gaps)


def _gap(matrices: list[Matrix], floats: Float[np.ndarray, "m n"]) -> Fraction:
    """Return the largest difference between an entry of the matrices and the float one."""
    entries = exact_row(floats.ravel())
    return max(
        abs(exact - entry)
        for matrix in matrices
        for exact, entry in zip((a for row in matrix for a in row), entries, strict=True)
    )
