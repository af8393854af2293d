"""Monte Carlo of a linear system, or of the motion it stands for: every period of every lap against
E, U and W, and nothing kept but counts and extremes.

    w(k) = x(k+1) - A(th_k) x(k) - B(th_k) u(k) in W,     x(k+1) in E,     u(k) in U,     QP solved

Lap i is a function of seed and i alone. NaN counts as outside.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Bool, Float, Int, Key

from jaxtube import qp
from jaxtube.columns import loop_by_columns
from jaxtube.control.laws import solves_qp, without_rounds
from jaxtube.control.protocol import Controller
from jaxtube.plant.protocol import Plant
from jaxtube.progress import show_progress
from jaxtube.qp.batched_ldl import matmul
from jaxtube.qp.regions import AnyArray
from jaxtube.simulation.choices import (
    ControllerChoice,
    PlantChoice,
    SlipChoice,
    choose_controller,
    choose_plant,
    choose_starts,
    name_choice,
    name_controller,
)
from jaxtube.simulation.promise import describe_certificate
from jaxtube.simulation.rollout import LoopState, PeriodOutcome, begin, realisation_keys, run_period
from jaxtube.statistics.intervals import share_interval
from jaxtube.statistics.share import Share
from jaxtube.synthesis.parts import LinearDesign
from sets.polytope import Polytope

BLOCK = 4096
"""Laps of a block."""

ROUNDING = 1e-12
"""Share of the sizes of E and U by which a point may be beyond a facet: rounding."""

EVENTS = {
    "w_outside_W": "w outside W",
    "x_outside_E": "x outside E",
    "u_outside_U": "u outside U",
    "qp_infeasible": "QP infeasible",
    "qp_unsolved": "QP unsolved",
    "row_active": "some row active",
    "backup": "backup in use",
    "not_finite": "not finite",
}
"""What laps are counted by, and its words."""

QP_EVENTS = ("qp_infeasible", "qp_unsolved", "row_active", "backup")
"""Events that need a controller with a QP."""

SETS = ("W", "E", "U")
"""Sets whose use is measured."""


class JudgedSet(NamedTuple):
    """Rows normals x <= offsets, and what is rounding for each."""

    normals: Float[AnyArray, "f n"]
    offsets: Float[AnyArray, " f"]
    rounding: Float[AnyArray, " f"]

    def is_outside(self, points: Float[Array, "batch n"]) -> Bool[Array, " batch"]:
        """Return which points lie outside."""
        excess = matmul(points, self.normals.T) - self.offsets
        return ~jnp.all(excess <= self.rounding, axis=1)

    def find_usage(self, points: Float[Array, "batch n"]) -> Float[Array, " batch"]:
        """Return the largest share of an offset that points use: 1 on a facet, more outside."""
        used = matmul(points, self.normals.T) / jnp.maximum(self.offsets, self.rounding)
        return jnp.max(used, axis=1)


class Judge(NamedTuple):
    """What a period is judged by."""

    transitions: Float[AnyArray, "steps n n"]
    input_matrices: Float[AnyArray, "steps n m"]
    W: JudgedSet
    E: JudgedSet
    U: JudgedSet


@dataclass(frozen=True, eq=False, repr=False)
class LinearMonteCarlo:
    """A Monte Carlo run of a linear system's design.

    Attributes:
        design: that it is a run of.
        controller, plant, starts: names of what laps were drawn from.
        seed: of every draw.
        laps: how many were run.
        counts: laps by event (`EVENTS`).
        usage: greatest use of W, E and U: 1 on a facet, more outside.
        solves_qp: whether the controller solves QPs.
    """

    design: LinearDesign
    controller: str
    plant: str
    starts: str
    seed: int
    laps: int
    counts: dict[str, int]
    usage: dict[str, float]
    solves_qp: bool

    def share(self, event: str) -> Share:
        """Return how often an event was seen: one of `counts`.

        Raises:
            ValueError: for an event that is unknown, or that a controller without a QP cannot have.
        """
        if event not in self.counts:
            known = "cannot occur in this run" if event in EVENTS else "is unknown"
            raise ValueError(f"event = {event!r}: {known}; choose one of {list(self.counts)}")
        low, high = share_interval(self.counts[event], self.laps)
        return Share(self.counts[event], self.laps, low, high)

    def __repr__(self) -> str:
        left_E = self.share("x_outside_E")
        left_W = self.share("w_outside_W")
        premise = "w stayed in W" if not left_W.laps else f"w left W in {left_W.laps:,} laps"
        used = ", ".join(f"{name} {share:.1%}" for name, share in self.usage.items())
        return (
            f"<LinearMonteCarlo: {left_E.laps:,} of {self.laps:,} laps left E (share at most "
            f"{left_E.high:.3g} at 95 % confidence), {self.share('u_outside_U').laps:,} U; "
            f"{premise}; used at most: {used}; {self.controller} on the {self.plant}; "
            f"{describe_certificate(self.design, self.controller)}>"
        )


def run_linear(
    design: LinearDesign,
    controller: ControllerChoice,
    plant: PlantChoice,
    *,
    laps: int,
    starts: str,
    slip: SlipChoice,
    seed: int,
) -> LinearMonteCarlo:
    """Run laps of a linear system's design, see `montecarlo`."""
    acting = choose_controller(design, controller)
    moving = choose_plant(design, plant, slip)
    law = choose_starts(design, starts)
    judge = make_judge(design)
    short = without_rounds(acting)
    counts = np.zeros(len(EVENTS), int)
    usage = np.zeros(len(SETS))
    with show_progress(laps, "simulating", "laps") as bar:
        for first in range(0, laps, BLOCK):
            count = min(BLOCK, laps - first)
            keys = realisation_keys(seed, first, BLOCK)
            errors = law.draw(keys)
            seen = _run_block(short, moving, judge, keys, errors, jnp.asarray(count))
            if int(seen[0][list(EVENTS).index("qp_unsolved")]) and short is not acting:
                seen = _run_block(acting, moving, judge, keys, errors, jnp.asarray(count))
            counts += np.asarray(seen[0])
            usage = np.maximum(usage, seen[1])
            bar.update(count)
    plans = solves_qp(acting)
    counted = dict(zip(EVENTS, counts.tolist(), strict=True))
    return LinearMonteCarlo(
        design,
        name_controller(controller),
        name_choice(plant),
        starts,
        seed,
        laps,
        {name: n for name, n in counted.items() if plans or name not in QP_EVENTS},
        dict(zip(SETS, usage.tolist(), strict=True)),
        plans,
    )


def make_judge(design: LinearDesign) -> Judge:
    """Return what every period of a design's laps is judged by."""
    problem = design.problem
    schedule = problem.schedule[: problem.reference.steps]
    transitions, input_matrices = problem.model.matrices(schedule)
    sizes = problem.operating_set.support(np.eye(design.system.states))
    strengths = problem.input_set.support(np.eye(design.system.inputs))
    # Of w the rounding is that of the terms it is the difference of.
    of_states = np.abs(transitions).max(axis=0) @ sizes
    of_inputs = np.abs(input_matrices).max(axis=0) @ strengths
    made = Judge(
        transitions,
        input_matrices,
        _make_set(problem.disturbance_set, of_states + of_inputs + sizes),
        _make_set(problem.error_set, sizes),
        _make_set(problem.input_set, strengths),
    )
    return jax.tree.map(jnp.asarray, made)


def _make_set(polytope: Polytope, sizes: Float[np.ndarray, " n"]) -> JudgedSet:
    unit = polytope.with_unit_normals()
    return JudgedSet(unit.normals, unit.offsets, ROUNDING * np.abs(unit.normals) @ sizes)


@jax.jit
def _run_block(
    controller: Controller,
    plant: Plant,
    judge: Judge,
    keys: Key[Array, " batch"],
    errors: Float[Array, "batch n"],
    count: Int[Array, ""],
) -> tuple[Int[Array, " events"], Float[Array, " sets"]]:
    """Return how many of the first `count` laps had each event, and the greatest uses of sets."""

    def period(step, carry):
        state, had, used = carry
        after, happened = run_period(controller, plant, keys, step, state)
        events, usage = judge_period(judge, step, state, happened, after)
        return after, had | events, jnp.maximum(used, usage)

    batch = len(errors)
    had = jnp.zeros((len(EVENTS), batch), bool)
    used = jnp.zeros((len(SETS), batch), errors.dtype)
    start = (begin(controller, plant, keys, errors), had, used)
    steps = len(judge.transitions)
    _, had, used = loop_by_columns(0, steps, period, start)
    counted = jnp.arange(batch) < count
    # What is not finite uses more than any share.
    used = jnp.where(jnp.isfinite(used), used, jnp.inf)
    return (
        jnp.sum(had & counted, axis=1, dtype=jnp.int32),
        jnp.max(jnp.where(counted, used, 0.0), axis=1),
    )


def judge_period(
    judge: Judge, step, before: LoopState, happened: PeriodOutcome, after: LoopState
) -> tuple[Bool[Array, "events batch"], Float[Array, "sets batch"]]:
    """Return which events a period had, and what it used of W, E and U."""
    x = before.errors
    u = happened.inputs
    expected = matmul(x, judge.transitions[step].T) + matmul(u, judge.input_matrices[step].T)
    w = after.errors - expected
    diagnostics = happened.diagnostics
    finite = jnp.isfinite(after.errors).all(axis=1) & jnp.isfinite(u).all(axis=1)
    events = [
        judge.W.is_outside(w),
        judge.E.is_outside(after.errors) | judge.E.is_outside(x),
        judge.U.is_outside(u),
        diagnostics.status == qp.INFEASIBLE,
        diagnostics.status == qp.UNSOLVED,
        diagnostics.active,
        diagnostics.backup,
        ~finite,
    ]
    uses = [judge.W.find_usage(w), judge.E.find_usage(after.errors), judge.U.find_usage(u)]
    return jnp.stack(events), jnp.stack(uses)
