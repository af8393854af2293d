"""The certificate of a linear system's design: every condition on its model, with w in W."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from jaxtube.synthesis.certificate.program import check_program
from jaxtube.synthesis.certificate.stages import check_stages
from jaxtube.synthesis.certificate.terminal import (
    ANY_ORDER,
    check_any_order,
    check_terminal,
    has_any_order,
)
from jaxtube.synthesis.parts import LinearDesign
from jaxtube.synthesis.tightening import find_back_off
from sets.certificate import ROUNDING, Certificate, Condition, decrease_margin, judge

SAMPLES = 200
"""Schedules at which loops are compared with mixtures of loops."""


def certify_linear(design: LinearDesign) -> Certificate:
    """Re-check every condition of the guarantee of a linear system; a certificate that the design
    has is not read."""
    conditions = tuple(_conditions(design))
    holding = {condition.name for condition in conditions if condition.holds}
    any_order = not design.tube.follows_reference or ANY_ORDER in holding
    return Certificate(conditions, _list_assumptions(design, any_order))


def _conditions(design: LinearDesign) -> Iterator[Condition]:
    yield from check_stages(design)
    yield from check_terminal(design)
    if has_any_order(design):
        yield check_any_order(design)
    yield _check_decrease(design)
    yield _check_mixtures(design)
    yield check_program(design)
    slack = design.solver_slack
    back_off = find_back_off(design.problem)
    comparison = "more" if back_off >= slack else "less"
    yield Condition(
        "solver_residual",
        back_off - slack,
        f"Constraints are backed off by {back_off:.0e}, {comparison} than the {slack:.0e} a solved "
        "QP may miss them by.",
    )


def _check_decrease(design: LinearDesign) -> Condition:
    loops, gains = design.terminal.gains.pairs
    problem = design.problem
    margin = decrease_margin(
        loops, gains, design.cost.cost, problem.error_weight, problem.input_weight
    )
    return judge(
        "terminal_cost_decrease",
        margin,
        "The terminal cost decreases by at least the stage cost under every loop whose mixtures "
        "occur.",
        "The terminal cost does not decrease by the stage cost under some loop.",
    )


def _check_mixtures(design: LinearDesign) -> Condition:
    """Compare loops at schedules with the mixture that they are by algebra."""
    gain = design.tube_gain
    model = gain.model
    generator = np.random.default_rng(0)
    weights = generator.dirichlet(np.ones(len(model.A)), SAMPLES)
    weights = np.concatenate([weights, design.windows.schedules.reshape(-1, len(model.A))])
    crossed = np.einsum("ki,kj->kij", weights, weights)
    mixed = np.einsum("kij,jmn->kimn", crossed, gain.vertices)
    loops = np.einsum("ki,inm->knm", weights, model.A) + np.einsum(
        "inm,kimp->knp", model.B, mixed
    )
    worst = float(np.max(np.abs(gain.loops_along(weights) - loops)))
    windows = design.windows
    worst = max(worst, float(np.abs(gain.along(windows.schedules) - windows.gains).max()))
    worst = max(worst, -float(weights.min()), float(np.abs(weights.sum(axis=1) - 1).max()))
    size = max(1.0, float(np.abs(loops).max()))
    return judge(
        "vertices_cover_schedule",
        ROUNDING * size - worst,
        "Every loop along the run and at sampled schedules is a mixture of the loops of the "
        "vertices.",
        f"Some loop differs from the mixtures of the loops of the vertices by {worst:.3g}.",
    )


def _list_assumptions(design: LinearDesign, any_order: bool) -> tuple[str, ...]:
    """Return what the guarantee takes for granted, in words."""
    system = design.system
    motion = "x+ = A x + B u + w, with w in W in every period"
    if len(system.A) > 1:
        order = "in any order" if any_order else "in the order of this run alone"
        motion = (
            f"x+ = A(th) x + B(th) u + w, with w in W in every period; th a mixture of "
            f"{len(system.A)} vertices, {order}, known {system.horizon} periods ahead"
        )
    return (
        motion,
        "the state is measured exactly, without delay, and the input is held as commanded",
        "what is promised holds at the ends of periods, nothing between them; controllers in 64 "
        "bits",
        "the first state has a plan",
    )
