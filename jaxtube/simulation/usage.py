"""Utilisation of the limits of a closed loop, on laps that are drawn, scripted, or replayed.

    usage = n (x - c) / (h - n c)        1 on the facet n x = h, above 1 outside, 0 at the centre c

Limits have names: `error` true tracking errors (m, m, rad), `input` virtual inputs (m/s, rad/s)
with the measured errors (m, m, rad) that a cap couples them to, `wheels` speeds asked for before
saturation (right, left) m/s, `acceleration` how far these are from those of the period before, m/s,
and `tube` deviations from a plan that is followed to its end. Following a plan is another closed
loop, so `tube` stands alone.
"""

from __future__ import annotations

import operator
from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Float, Int, Key

from jaxtube import qp
from jaxtube.columns import by_columns, join, loop_by_columns, split, use_twice
from jaxtube.control import mpc, planning
from jaxtube.control.follow import PlanFollower
from jaxtube.control.laws import TubeMpc, planner_of
from jaxtube.control.protocol import Controller
from jaxtube.plant.once import make_once
from jaxtube.plant.protocol import Memory, Plant, Script, SearchablePlant
from jaxtube.simulation.rollout import (
    LoopState,
    PeriodOutcome,
    Trajectory,
    advance_period,
    begin,
    follow_plan,
    realisation_keys,
    rollout,
    run_period,
)


class Limit(NamedTuple):
    """Facets normals x <= offsets about a centre: the same at every step (one stage), those of each
    step, or R_1 .. R_N of a tube."""

    normals: Float[Array, "stages facets n"]
    offsets: Float[Array, "stages facets"]
    centre: Float[Array, " n"]

    def at_step(
        self, step: int
    ) -> tuple[Float[np.ndarray, "facets n"], Float[np.ndarray, " facets"]]:
        """Return the facets at a step, of a limit that is none of a tube."""
        stage = min(step, len(self.offsets) - 1)
        return np.asarray(self.normals[stage]), np.asarray(self.offsets[stage])


KEPT = jax.checkpoint_policies.save_only_these_names(mpc.ACTED)
"""What reverse mode keeps of a period."""

Limits = dict[str, Limit]
"""Limits by name; see the module."""

Observe = Callable[[LoopState, PeriodOutcome, LoopState], dict[str, Array]]
"""Returns what is recorded of a period from the state before it, its outcome and the state
after it."""


def make_limit(normals, offsets, centre=None) -> Limit:
    """Return the limit of one set {x : normals x <= offsets}.

    Args:
        normals: (facets, n).
        offsets: (facets,).
        centre: a point strictly inside, the origin unless given.

    Raises:
        ValueError: where the centre lies outside.
    """
    rows = np.asarray(normals, float)
    bounds = np.asarray(offsets, float)
    point = np.zeros(rows.shape[1]) if centre is None else np.asarray(centre, float)
    if not np.all(bounds > rows @ point):
        raise ValueError(
            f"centre = {point.tolist()}: lies outside the limit; give a point inside every facet"
        )
    return Limit(jnp.asarray(rows[None]), jnp.asarray(bounds[None]), jnp.asarray(point))


def make_tube_limit(sections: list[tuple[np.ndarray, np.ndarray]]) -> Limit:
    """Return the limit on deviations from a plan.

    Args:
        sections: (normals, offsets) of R_1 .. R_N; shorter ones are padded with facets 0 x <= 1.
    """
    facets = max(len(offsets) for _, offsets in sections)
    dimension = sections[0][0].shape[1]
    normals = np.zeros((len(sections), facets, dimension))
    offsets = np.ones((len(sections), facets))
    for stage, (rows, bounds) in enumerate(sections):
        normals[stage, : len(rows)] = rows
        offsets[stage, : len(rows)] = bounds
    return Limit(jnp.asarray(normals), jnp.asarray(offsets), jnp.zeros(dimension))


def play(
    controller: Controller,
    plant: SearchablePlant,
    keys: Key[Array, " batch"],
    errors: Float[Array, "batch 3"],
    script: Script | None = None,
) -> dict[str, Float[Array, "steps batch n"]]:
    """Run laps and return the quantities that have limits, period by period.

    With a script its values take the place of draws. Reverse mode keeps the state and the answers
    of each period, and computes the rest again.

    Returns:
        `error` after each period; `input`, `wheels`, `acceleration`, 0 in the first, and `backup`,
        (steps, batch), where there was no plan, during it.
    """

    def observe(
        before: LoopState, happened: PeriodOutcome, following: LoopState
    ) -> dict[str, Array]:
        return {
            "error": following.errors,
            "input": jnp.concatenate([happened.inputs, before.measured], axis=1),
            "wheels": happened.demanded,
            "backup": happened.diagnostics.backup,
        }

    seen = _scan_periods(controller, plant, keys, errors, script, observe)
    return seen | {"acceleration": find_changes(seen["wheels"])}


def find_changes(wheels: Float[Array, "steps *n"]) -> Float[Array, "steps *n"]:
    """Return how far speeds are from those of the period before, none in the first."""
    return jnp.diff(wheels, axis=0, prepend=wheels[:1])


def play_plans(
    follower: PlanFollower,
    plant: SearchablePlant,
    keys: Key[Array, " batch"],
    errors: Float[Array, "batch 3"],
    horizon: int,
    script: Script | None = None,
) -> Float[Array, "horizon batch 3"]:
    """Run laps and return the deviations from their followed plans after 1 .. `horizon` steps, zero
    where there was no plan; otherwise as `play`."""

    def observe(
        before: LoopState, happened: PeriodOutcome, following: LoopState
    ) -> dict[str, Array]:
        return {"tube": following.memory.deviation(following.measured)}

    deviations = _scan_periods(follower, plant, keys, errors, script, observe)["tube"]
    stages = jnp.arange(horizon, dtype=follower.when.dtype)
    periods = follower.when + stages[:, None]
    return jnp.take_along_axis(deviations, periods[:, :, None], axis=0, mode="clip")


def add_up_periods(
    controller: Controller,
    plant: Plant,
    keys: Key[Array, " batch"],
    errors: Float[Array, "batch 3"],
    observe: Callable[[Array, Float[Array, "batch 3"], PeriodOutcome], dict[str, Array]],
) -> dict[str, Float[Array, " batch"]]:
    """Run laps and return the sums over their periods of what is observed of each, (batch,): of
    `observe(step, errors after the period, outcome)`.

    Reverse mode keeps the errors and the answers of each period, and computes the rest again, the
    draws too: to keep these takes more memory, and more time.
    """

    def period(state: tuple[Array, Memory, Memory], step):
        errors, memory, plant_memory = state
        for_sensor, for_motion = use_twice(errors)
        # What is measured is no part of the state, and not kept.
        drawn = make_once(step, plant.sense(keys, step, plant_memory, for_sensor))
        measurement, plant_memory = drawn
        before = LoopState(for_motion, measurement, memory, plant_memory)
        errors, memory, plant_memory, happened = advance_period(
            controller, plant, keys, step, before
        )
        carried, for_record = use_twice(errors)
        return (carried, memory, plant_memory), observe(step, for_record, happened)

    turn = jax.checkpoint(by_columns(period), policy=KEPT)

    def add(carry, step):
        state, sums = carry
        state, observed = turn(state, step)
        return (state, jax.tree.map(operator.add, sums, observed)), None

    memory = begin(controller, plant, keys, errors).memory
    start = split((errors, memory, plant.initial(keys, errors)))
    steps = jnp.arange(len(plant.reference_wheels))
    _, observed = jax.eval_shape(turn, start, steps[0])
    nothing = jax.tree.map(lambda shape: jnp.zeros(shape.shape, shape.dtype), observed)
    (_, sums), _ = jax.lax.scan(add, (start, nothing), steps)
    return sums


def _scan_periods(
    controller: Controller,
    plant: SearchablePlant,
    keys: Key[Array, " batch"],
    errors: Float[Array, "batch 3"],
    script: Script | None,
    observe: Observe,
) -> dict[str, Array]:
    """Run laps and stack what is observed of each period."""
    steps = len(plant.reference_wheels)
    entries = {name: _read_periods(values, steps, name) for name, values in (script or {}).items()}

    def choose_plant(values: Script) -> Plant:
        return plant if script is None else plant.under_script(values)

    def period(state: LoopState, now):
        step, of_period = now
        acting = choose_plant({name: values[None] for name, values in of_period.items()})
        following, happened = run_period(controller, acting, keys, step, state)
        carried, for_record = use_twice(following)
        return carried, observe(state, happened, for_record)

    start = begin(controller, choose_plant(script or {}), keys, errors)
    # By columns already where reverse mode keeps what a period begins with.
    turn = jax.checkpoint(by_columns(period), policy=KEPT)
    _, seen = jax.lax.scan(turn, split(start), (jnp.arange(steps), entries))
    return join(seen)


def _read_periods(
    values: Float[Array, "times batch n"], steps: int, name: str
) -> Float[Array, "steps batch n"]:
    """Return what a script says in the course of every period.

    A period ends with the measurement of the next instant: its noise and the slips that begin.
    """
    if name == "disturbance":
        return jnp.broadcast_to(values, (steps, *values.shape[1:]))
    instants = jnp.minimum(jnp.arange(1, steps + 1), len(values) - 1)
    return values[instants]


class JudgedLoop(NamedTuple):
    """A closed loop and the limits that its laps are judged by.

    Attributes:
        controller: any; for the limit `tube` one whose plans restart at the measured error.
        plant: the slipping robot, the linear plant, or another one that says what bounds its draws.
        limits: some of `error`, `input`, `wheels` and `acceleration`, or `tube` alone.
        plan_steps: at which a plan that is followed may begin; all unless given.
    """

    controller: Controller
    plant: SearchablePlant
    limits: Limits
    plan_steps: Int[np.ndarray, " k"] | None = None

    def list_plan_steps(self) -> Int[np.ndarray, " k"]:
        """Return the steps at which a followed plan may begin, 0 where none is followed."""
        if "tube" not in self.limits:
            return np.zeros(1, int)
        if self.plan_steps is not None:
            return self.plan_steps
        horizon = len(self.limits["tube"].offsets)
        return np.arange(len(self.plant.reference_wheels) - horizon + 1)


def play_limits(
    loop: JudgedLoop,
    keys: Key[Array, " batch"],
    errors: Float[Array, "batch 3"],
    when: Int[Array, " batch"],
    script: Script | None = None,
) -> dict[str, Float[Array, "stages facets batch"]]:
    """Run laps and return the usage of every limit: of `tube` at every stage of the plan made at
    step `when`, of the others at every step.

    Raises:
        ValueError: for the limit `tube` and a controller without plans that can be followed.
    """
    limits = loop.limits
    if "tube" not in limits:
        return compute_usages(limits, play(loop.controller, loop.plant, keys, errors, script))
    follower = PlanFollower(_find_planner(loop.controller), when)
    horizon = len(limits["tube"].offsets)
    deviations = play_plans(follower, loop.plant, keys, errors, horizon, script)
    return compute_usages(limits, {"tube": deviations})


def compute_usages(
    limits: Limits, seen: dict[str, Float[Array, "stages batch n"]]
) -> dict[str, Float[Array, "stages facets batch"]]:
    """Return the usage of every facet at every step, or at every stage of a followed plan."""
    return {name: _compute_usage(limit, seen[name]) for name, limit in limits.items()}


def _compute_usage(
    limit: Limit, values: Float[Array, "stages batch n"]
) -> Float[Array, "stages facets batch"]:
    away = values - limit.centre
    room = limit.offsets - jnp.sum(limit.normals * limit.centre, axis=2)
    terms = [limit.normals[:, :, i, None] * away[:, None, :, i] for i in range(away.shape[2])]
    return sum(terms[1:], start=terms[0]) / room[:, :, None]


def _find_planner(controller: Controller) -> TubeMpc:
    planner = planner_of(controller)
    if planner is None:
        raise ValueError(
            "limits = `tube`: the controller has no plans that restart at the measured error; give "
            "a TubeMpc with restart = True, or other limits"
        )
    return planner


class Replay(NamedTuple):
    """One lap under a script, and for `tube` the deviations from its plan after 1 .. N steps."""

    trajectory: Trajectory
    deviations: Float[np.ndarray, "horizon 3"] | None


def replay(
    controller: Controller,
    plant: SearchablePlant,
    attack: dict[str, np.ndarray],
    name: str,
    when: int = 0,
) -> Replay:
    """Run one lap by `rollout`, and for the limit `tube` the plan of its step `when` by
    `follow_plan`.

    Up to the plan the lap is that of the followed plan; from there on it is another future.

    Args:
        controller: any; for `tube` one whose plans restart at the measured error.
        plant: any whose uncertainties are known.
        attack: by name, time first: `start` (1, 3) and the entries of a script, of one lap.
        name: of the limit.
        when: step at which the plan is made.
    """
    script = {key: jnp.asarray(values)[:, None] for key, values in attack.items() if key != "start"}
    acting = plant.under_script(script)
    keys = realisation_keys(0, 0, 1)  # a script draws nothing
    lap = rollout(controller, acting, keys, jnp.asarray(attack["start"]))
    trajectory = jax.tree.map(np.asarray, lap)
    if name != "tube":
        return Replay(trajectory, None)
    planner = _find_planner(controller)
    step = jnp.asarray(when)
    state = _run_until(planner, acting, keys, jnp.asarray(attack["start"]), step)
    plan = _make_plan(planner, step, state.measured)
    if int(plan.status[0]) != qp.SOLVED:
        nothing = np.zeros((plan.inputs.shape[1], state.measured.shape[1]))
        return Replay(trajectory, nothing)
    deviations = follow_plan(planner, acting, keys, state, step, plan)
    return Replay(trajectory, np.asarray(deviations[:, 0]))


@jax.jit
def _run_until(
    controller: Controller, plant: Plant, keys: Key[Array, " batch"], errors, step
) -> LoopState:
    """Return the closed loop at a step, with what the plant remembers until then."""

    def period(now, state: LoopState) -> LoopState:
        return run_period(controller, plant, keys, now, state)[0]

    return loop_by_columns(0, step, period, begin(controller, plant, keys, errors))


@jax.jit
def _make_plan(planner: TubeMpc, step, measured: Float[Array, "1 3"]) -> planning.Plan:
    return planning.plan(planner.condensed_qp(step), measured)


def read_values(name: str, played: Replay) -> Float[np.ndarray, "steps n"]:
    """Return the quantity that a limit bounds: errors at every instant, inputs (with the measured
    errors at the start) and wheels in every period, deviations from a plan at every stage from
    0."""
    lap = played.trajectory
    if name == "tube":
        assert played.deviations is not None
        return np.concatenate([np.zeros_like(played.deviations[:1]), played.deviations])
    if name == "input":
        return np.concatenate([lap.inputs[:, 0], lap.measured[:-1, 0]], axis=1)
    if name == "acceleration":
        return np.asarray(find_changes(lap.demanded[:, 0]))
    values = {"error": lap.errors, "wheels": lap.demanded}[name]
    return np.asarray(values)[:, 0]
