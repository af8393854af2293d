"""The certificate of a linear system's design: every condition on its model, with w in W."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from jaxtube.synthesis.certificate.program import check_program
from jaxtube.synthesis.certificate.stages import check_stages
from jaxtube.synthesis.certificate.terminal import (
    check_any_order,
    check_terminal,
    has_any_order,
)
from jaxtube.synthesis.parts import LinearDesign
from jaxtube.synthesis.tightening import find_back_off
from jaxtube.systems.proof import Proof
from jaxtube.systems.system import LinearSystem
from sets.certificate import ROUNDING, Certificate, Condition, decrease_margin, judge
from sets.polytope import Polytope

ANY_ORDER_OF_WEIGHTS = "any_order_of_weights"
"""The condition that frees a tube along the schedule from the order of this run."""
SAMPLES = 200
"""Schedules at which loops are compared with mixtures of loops."""


@dataclass(frozen=True, repr=False)
class LinearCertificate(Certificate):
    """The certificate of a linear system and, where W is proved, of the motion it stands for."""

    @property
    def verdict(self) -> str:
        """One line: for what the design is certified, and what fails."""
        if self.holds_for_robot:
            return "CERTIFIED for the motion itself: every required condition holds"
        if self.holds_for_model:
            missing = ", ".join(self.failing)
            if not missing:
                return "CERTIFIED for the linear system with w in W: every required condition holds"
            return (
                "CERTIFIED for the linear system with w in W alone; NOT CERTIFIED for the motion: "
                f"{missing}"
            )
        return f"NOT CERTIFIED: {', '.join(self.failing) or 'nothing was checked'}"


def certify_linear(design: LinearDesign) -> LinearCertificate:
    """Re-check every condition of the guarantee of a linear system; a certificate that the design
    has is not read."""
    conditions = tuple(_conditions(design))
    holding = {condition.name for condition in conditions if condition.holds}
    any_order = not design.tube.follows_reference or ANY_ORDER_OF_WEIGHTS in holding
    return LinearCertificate(conditions, _list_assumptions(design, any_order))


def _conditions(design: LinearDesign) -> Iterator[Condition]:
    yield from check_stages(design)
    yield from check_terminal(design)
    if has_any_order(design):
        yield replace(check_any_order(design), name=ANY_ORDER_OF_WEIGHTS)
    yield _check_decrease(design)
    yield _check_mixtures(design)
    yield check_program(design)
    if design.system.proof is not None:
        yield _check_disturbance_set(design.system, design.system.proof)
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
    loops = np.einsum("ki,inm->knm", weights, model.A) + np.einsum("inm,kimp->knp", model.B, mixed)
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


def _check_disturbance_set(system: LinearSystem, proof: Proof) -> Condition:
    """Compare W with what is proved of the motion, in shares of the half widths of E: a margin
    without a unit, whatever the states are."""
    sizes = system.E.support(np.eye(system.states))
    W = system.disturbance_set
    proved = proof.disturbance_set
    margin = 0.0
    if W is not proved:
        scaled = Polytope(W.normals * sizes, W.offsets)
        margin = scaled.containment_margin(Polytope(proved.normals * sizes, proved.offsets))
    return judge(
        "disturbance_set_proved",
        margin,
        "W holds all that the motion adds to the model over E and U, as intervals prove.",
        f"W misses what the motion may add to the model by {-margin:.3g} of E.",
        "robot",
    )


def _list_assumptions(design: LinearDesign, any_order: bool) -> tuple[str, ...]:
    """Return what the guarantee takes for granted, in words."""
    system = design.system
    if system.motion is None:
        motion = "x+ = A(th) x + B(th) u + w, with w in W in every period"
    else:
        sizes = ", ".join(f"{half:.4g}" for half in system.motion.uncertainty)
        motion = (
            "x+ = f(x, u, th, d), the function given, with |d| at most "
            f"{sizes} in every period, in any sequence"
        )
    if len(system.A) > 1:
        order = "in any order" if any_order else "in the order of this run alone"
        motion += (
            f"; th a mixture of {len(system.A)} vertices, {order}, known {system.horizon} periods "
            "ahead"
        )
    return (
        motion,
        "the state is measured exactly, without delay, and the input is held as commanded",
        "what is promised holds at the ends of periods, nothing between them; controllers in 64 "
        "bits",
        "the first state has a plan",
    )
