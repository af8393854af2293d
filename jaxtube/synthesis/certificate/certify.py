"""The certificate of a design, written by one author: every condition of its guarantee, checked on
the sets that the controller really uses."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from jaxtube.synthesis.banded_gain import BandedGain
from jaxtube.synthesis.certificate.assumptions import assumptions
from jaxtube.synthesis.certificate.bands import find_band_gap
from jaxtube.synthesis.certificate.exact import check_in_rationals
from jaxtube.synthesis.certificate.existence import say_what_exists
from jaxtube.synthesis.certificate.fill import check_widest_tube
from jaxtube.synthesis.certificate.program import check_program
from jaxtube.synthesis.certificate.robot import PREMISE, check_robot
from jaxtube.synthesis.certificate.stages import check_stages
from jaxtube.synthesis.certificate.terminal import (
    ANY_ORDER,
    check_any_order,
    check_terminal,
    has_any_order,
)
from jaxtube.synthesis.certificate.ultimate import check_ultimate_bound
from jaxtube.synthesis.gains import Gain, Region
from jaxtube.synthesis.parts import Design
from jaxtube.synthesis.tightening import find_back_off
from sets.certificate import ROUNDING, Certificate, Condition, decrease_margin, judge

GRID = 21
"""Wheel speeds, along each side of a region, at which loops are compared with mixtures of loops."""


def certify(design: Design) -> Certificate:
    """Re-check every condition of the guarantee; a certificate that the design has is not read."""
    conditions = tuple(_conditions(design))
    holding = {condition.name for condition in conditions if condition.holds}
    any_order = not design.tube.follows_reference or ANY_ORDER in holding
    return Certificate(conditions, assumptions(design.problem, any_order, PREMISE in holding))


def _conditions(design: Design) -> Iterator[Condition]:
    problem = design.problem
    slack = design.solver_slack
    back_off = find_back_off(problem)
    yield from check_stages(design)
    yield from check_terminal(design)
    if has_any_order(design):
        yield check_any_order(design)
    yield _check_decrease(design)
    yield _check_coverage(design)
    yield check_program(design)
    yield from check_robot(problem)
    yield judge(
        "solver_residual",
        back_off - slack,
        f"Constraints are backed off by {back_off:.0e} of each, more than the {slack:.0e} a solved "
        "QP may miss of them.",
        f"Constraints are backed off by {back_off:.0e} of each, less than the {slack:.0e} a solved "
        "QP may miss of them.",
    )
    yield check_in_rationals(design)
    yield from check_ultimate_bound(design)
    if len(problem.given_gains):
        yield check_widest_tube(problem, design.terminal.gains)
    else:
        yield from say_what_exists(design)


def _check_decrease(design: Design) -> Condition:
    problem = design.problem
    loops, gains = design.terminal.gains.pairs
    margin = decrease_margin(
        loops, gains, design.cost.cost, problem.error_weight, problem.input_weight
    )
    return judge(
        "terminal_cost_decrease",
        margin,
        "The terminal cost decreases by at least the stage cost at every vertex of the schedule "
        "box.",
        "The terminal cost does not decrease by the stage cost at some vertex.",
    )


def _check_coverage(design: Design) -> Condition:
    """Check that loops in the regions, the run's too, are mixtures of the corner loops: not so for
    zero-order hold."""
    windows = design.windows
    tube_gain = design.tube_gain
    wrong_gains = np.abs(tube_gain.along(windows.schedules) - windows.gains)
    wrong_loops = np.abs(tube_gain.loops_along(windows.schedules) - windows.loops)
    worst = max(float(wrong_gains.max()), float(wrong_loops.max()))
    for gain in (tube_gain, design.terminal.gains):
        worst = max(worst, _find_gap(design, gain))
    return judge(
        "vertices_cover_schedule",
        ROUNDING - worst,
        "Every loop along the run and, on a grid, in the certified wheel speeds is a mixture of "
        "the corner loops.",
        "Some loop within the certified wheel speeds differs from mixtures of the corner loops by "
        f"{worst:.3g} (zero-order hold, or the exact Jacobian without tracking gains).",
    )


def _find_gap(design: Design, gain: Gain) -> float:
    """Return by how much a loop of the gain misses the mixtures of corner loops, along the run and
    at certified wheel speeds."""
    windows = design.windows
    if isinstance(gain, BandedGain):
        return find_band_gap(gain, windows.schedules, windows.regimes)
    used = windows.schedules.reshape(-1, 2)
    regions = design.problem.regions
    gaps = [gain.coverage_gap(used, region) for region in regions]
    of_regions = [gain.coverage_gap(_grid(region), region).max() for region in regions]
    return max(float(np.min(gaps, axis=0).max()), *map(float, of_regions))


def _grid(region: Region) -> np.ndarray:
    """Return wheel speeds all over a region, (k, 2)."""
    right, left = np.linspace(region[0], region[1], GRID).T
    return np.stack(np.meshgrid(right, left), axis=-1).reshape(-1, 2)
