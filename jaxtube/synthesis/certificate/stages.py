"""Conditions on the stages of a plan: tightened sets are not empty, hold the reach, and receive the
shifted plan.

With a tube for every order of wheel speeds the margins hold over products of vertex loops, with one
along the reference from each window to those that follow it.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from jaxtube.synthesis.condense import Bounds
from jaxtube.synthesis.gains import Gain
from jaxtube.synthesis.parts import Design
from jaxtube.synthesis.problem import Problem
from jaxtube.synthesis.windows import Windows
from sets.certificate import (
    ROUNDING,
    Condition,
    judge,
    nonempty_margin,
    reach_supports,
    sequence_reach,
)
from sets.polytope import Polytope

NEVER_RESET_STEPS = 8
"""Steps that a deviation which is never reset is followed."""


class StageMargins(NamedTuple):
    """By how much stages are tightened beyond the reach, and beyond the stage before and what one
    disturbance adds to it."""

    reach: float
    inclusion: float


def check_stages(design: Design) -> Iterator[Condition]:
    """Yield the conditions on the tightened sets E_j and U_j."""
    yield from _check_not_empty(design.problem, design.bounds)
    margins = stage_margins(design)
    yield judge(
        "tightening_covers_reach",
        margins.reach + ROUNDING,
        "Every stage is tightened by at least what products of loops and disturbances in W can "
        "reach.",
        f"Some stage is tightened by {-margins.reach:.3g} less than products of loops and "
        "disturbances in W can reach.",
    )
    inclusion = margins.inclusion - design.solver_slack
    yield judge(
        "shifted_plan_inclusion",
        inclusion + ROUNDING,
        "R_{j+1} contains R_j + Psi_j W on every facet used: the shifted plan meets the tightened "
        "constraints.",
        f"R_(j+1) misses R_j + Psi_j W by {-inclusion:.3g} on some facet: the shifted plan may be "
        "inadmissible.",
    )
    if not design.problem.scenario.controller.restart:
        yield _check_never_reset(design)


def stage_margins(design: Design) -> StageMargins:
    """Return the margins of reach and inclusion, for the tube's own order of wheel speeds."""
    if design.tube.follows_reference:
        return margins_along_reference(design.problem, design.windows, design.bounds)
    return _margins_in_any_order(design.problem, design.tube_gain, design.bounds)


def margins_along_reference(problem: Problem, windows: Windows, bounds: Bounds) -> StageMargins:
    """Return the margins of reach and inclusion along the reference, from each step to the next."""
    error_rows = problem.operating_set.normals
    taken_errors = problem.operating_set.offsets - bounds.errors
    taken_inputs = problem.input_rows.offsets - bounds.inputs
    reach_margin = np.inf
    inclusion_margin = np.inf
    for window, loops in enumerate(windows.loops):
        followers = windows.followers(window)
        every_w = problem.disturbances.vertices_of_periods(windows.regimes[window])
        for j in range(problem.horizon):
            input_rows = problem.input_rows.on_errors(windows.gains[window, j])
            for taken, rows in ((taken_errors, error_rows), (taken_inputs, input_rows)):
                ahead = max(j, 1)
                reach, last = sequence_reach(loops[:ahead], every_w[:ahead], rows)
                reach_margin = min(reach_margin, np.min(taken[window, j] - reach[j]))
                if j > 0:
                    growth = taken[window, j] - taken[followers, j - 1] - last[j - 1]
                    inclusion_margin = min(inclusion_margin, np.min(growth, initial=np.inf))
    return StageMargins(float(reach_margin), float(inclusion_margin))


def _margins_in_any_order(problem: Problem, gain: Gain, bounds: Bounds) -> StageMargins:
    """Return the margins of reach and inclusion for a tube that holds in every order."""
    W = problem.disturbance_set.vertices()
    last_stage = problem.horizon - 1
    error_rows = problem.operating_set.normals[:, None]
    input_rows = problem.input_rows.on_errors(gain.corner_gains).swapaxes(0, 1)
    taken_errors = problem.operating_set.offsets - bounds.errors
    taken_inputs = problem.input_rows.offsets - bounds.inputs
    reach_margin = np.inf
    inclusion_margin = np.inf
    for rows, taken in ((error_rows, taken_errors), (input_rows, taken_inputs)):
        least = taken.min(axis=0)
        most = taken.max(axis=0)
        for row, directions in enumerate(rows):
            reach, last = _largest_reach(gain, W, directions, last_stage)
            reach_margin = min(reach_margin, np.min(least[:, row] - reach))
            growth = least[1:, row] - most[:-1, row] - last[:-1]
            inclusion_margin = min(inclusion_margin, np.min(growth, initial=np.inf))
    return StageMargins(float(reach_margin), float(inclusion_margin))


def _largest_reach(
    gain: Gain,
    W: Float[np.ndarray, "w 3"],
    directions: Float[np.ndarray, "k 3"],
    steps: int,
) -> tuple[Float[np.ndarray, " steps+1"], Float[np.ndarray, " steps+1"]]:
    """Return the largest reach along directions by step, and what the first disturbance adds."""
    by_direction = [reach_supports(gain.loops, W, direction, steps) for direction in directions]
    reach, last = np.max(by_direction, axis=0)
    return reach, last


def _check_not_empty(problem: Problem, bounds: Bounds) -> Iterator[Condition]:
    E = problem.operating_set
    error_sets = _smallest_sets(E.normals, bounds.errors[:, 1:]) or [E]
    input_sets = _smallest_sets(problem.input_rows.inputs, bounds.inputs)
    for name, letter, polytopes in (
        ("error_sets_not_empty", "E", error_sets),
        ("input_sets_not_empty", "U", input_sets),
    ):
        radius = nonempty_margin(polytopes)
        yield judge(
            name,
            radius,
            f"Every tightened set {letter}_j holds a ball of radius {radius:.4g}.",
            f"A tightened set {letter}_j is empty (radius {radius:.4g}).",
        )
    radius = nonempty_margin(
        _smallest_sets(bounds.terminal_normals, np.asarray(bounds.terminal)[:, None])
    )
    yield judge(
        "terminal_constraint_not_empty",
        radius,
        f"The constraint on the last predicted error holds a ball of radius {radius:.4g}.",
        f"The constraint on the last predicted error is empty (radius {radius:.4g}).",
    )


def _smallest_sets(
    normals: Float[np.ndarray, "k n"], offsets: Float[np.ndarray, "windows stages k"]
) -> list[Polytope]:
    """Return the sets {normals x <= offsets} over windows and stages whose offsets bound those of
    no other from above: every other set contains one of these, with its largest ball."""
    rows = np.unique(np.asarray(offsets).reshape(-1, len(normals)), axis=0)
    smallest = [row for row in rows if np.sum(np.all(rows <= row, axis=1)) <= 1]
    return [Polytope(normals, row) for row in smallest]


def _check_never_reset(design: Design) -> Condition:
    """Compare what the first stage is tightened by with what a deviation that is never reset can
    reach."""
    problem = design.problem
    W = problem.disturbance_set.vertices()
    first = min(1, problem.horizon - 1)
    taken = (problem.operating_set.offsets - design.bounds.errors[:, first]).min(axis=0)
    reach = [
        reach_supports(design.tube_gain.loops, W, row, NEVER_RESET_STEPS)[0][-1]
        for row in problem.operating_set.normals
    ]
    margin = float(np.min(taken - reach))
    return judge(
        "nominal_error_never_reset",
        margin,
        f"The first stage is tightened by more than {NEVER_RESET_STEPS} steps of disturbances can "
        "reach.",
        "The nominal error is never reset, but the first stage is tightened for one step only: in "
        f"{NEVER_RESET_STEPS} steps the deviation reaches {-margin:.3g} further.",
    )
