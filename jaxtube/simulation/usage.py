"""How far closed loops use their limits: laps that are drawn, given by a script, or played again
one by one.

    usage = n (x - c) / (h - n c)        1 on the facet n x = h, above 1 outside, 0 at the centre c

Limits have names: `error` true tracking errors (m, m, rad), `input` virtual inputs (m/s, rad/s),
`wheels` speeds asked for before saturation (right, left) m/s, and `tube` deviations from a plan
that is followed to its end.
"""

from __future__ import annotations

import time
from dataclasses import dataclass
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Float, Int

from jaxtube import qp
from jaxtube.control import mpc
from jaxtube.control.follow import PlanFollower
from jaxtube.plant.protocol import Script
from jaxtube.plant.slipping import DRAWN
from jaxtube.simulation.rollout import (
    LoopState,
    begin,
    follow_plan,
    realisation_keys,
    rollout,
    run_period,
)


class Limit(NamedTuple):
    """Facets normals x <= offsets about a centre: the same at every step (one stage), or R_1 .. R_N
    of a tube."""

    normals: Float[Array, "stages facets n"]
    offsets: Float[Array, "stages facets"]
    centre: Float[Array, " n"]


def limit(normals, offsets, centre=None) -> Limit:
    """Return the limit of one set {x : normals x <= offsets}; its centre, the origin unless given,
    lies inside."""
    normals, offsets = (
        np.atleast_3d(np.asarray(normals, float)[None]),
        np.asarray(offsets, float)[None],
    )
    centre = np.zeros(normals.shape[-1]) if centre is None else np.asarray(centre, float)
    if not np.all(offsets > normals @ centre):
        raise ValueError(
            f"centre = {centre.tolist()}: lies outside the limit; give a point inside every facet"
        )
    return Limit(jnp.asarray(normals), jnp.asarray(offsets), jnp.asarray(centre))


def tube_limit(sections: list[tuple[np.ndarray, np.ndarray]]) -> Limit:
    """Return the limit on deviations from a plan from (normals, offsets) of R_1 .. R_N, padded to
    equal length."""
    facets = max(len(offsets) for _, offsets in sections)
    normals, offsets = np.zeros((len(sections), facets, 3)), np.ones((len(sections), facets))
    for j, (rows, bounds) in enumerate(sections):
        normals[j, : len(rows)], offsets[j, : len(rows)] = rows, bounds
    return Limit(jnp.asarray(normals), jnp.asarray(offsets), jnp.zeros(3))


Limits = dict[str, Limit]


def play(
    controller, plant, keys, errors: Float[Array, "batch 3"], script: Script | None = None
) -> dict[str, Array]:
    """Run all realisations and return what limits look at, (steps, batch, n): after each period, or
    during it.

    `error` true tracking errors, `input` virtual inputs, `wheels` speeds asked for, `tube`
    deviations from a followed plan; `backup` (steps, batch) says where there was no plan. With a
    script its values take the place of draws. Reverse mode keeps the state, the draws and the
    answers of each period, and computes the rest again.
    """
    steps = len(plant.reference_wheels)
    script = script or {}
    of_period = {name: _read_period(values, steps, name) for name, values in script.items()}

    @partial(jax.checkpoint, policy=jax.checkpoint_policies.save_only_these_names(DRAWN, mpc.ACTED))
    def period(state: LoopState, now):
        step, values = now
        now_plant = plant
        if script:
            now_plant = plant.under_script({name: value[None] for name, value in values.items()})
        following, happened = run_period(controller, now_plant, keys, step, state)
        seen = {"error": following.errors, "input": happened.inputs, "wheels": happened.demanded}
        seen["backup"] = happened.diagnostics.backup
        if isinstance(controller, PlanFollower):
            seen["tube"] = following.memory.deviation(following.measured)
        return following, seen

    state = begin(controller, plant.under_script(script) if script else plant, keys, errors)
    return jax.lax.scan(period, state, (jnp.arange(steps), of_period))[1]


def _read_period(
    values: Float[Array, "times batch n"], steps: int, name: str
) -> Float[Array, "steps batch n"]:
    """Return what a script says in the course of every period.

    A period ends with the measurement of the next instant: its noise and the slips that begin.
    """
    if name == "disturbance":
        return jnp.broadcast_to(values, (steps, *values.shape[1:]))
    instants = jnp.minimum(jnp.arange(1, steps + 1), len(values) - 1)
    return values[instants]


def usages(
    controller, limits: Limits, seen: dict[str, Array]
) -> dict[str, Float[Array, "stages facets batch"]]:
    """Return the usage of every facet at every step, or at every stage of the followed plan."""
    found = {}
    for name, each in limits.items():
        values = seen[name]
        if name == "tube":
            stages = (
                controller.when
                + jnp.arange(len(each.offsets), dtype=controller.when.dtype)[:, None]
            )
            values = jnp.take_along_axis(values, stages[:, :, None], axis=0, mode="clip")
        away = values - each.centre
        room = each.offsets - jnp.sum(each.normals * each.centre, axis=2)
        reach = sum(each.normals[:, :, i, None] * away[:, None, :, i] for i in range(away.shape[2]))
        found[name] = reach / room[:, :, None]
    return found


class Replay(NamedTuple):
    """One attack played on its own: the lap, and for the tube the deviations from its plan after 1
    .. N steps."""

    trajectory: Any
    deviations: Float[np.ndarray, "horizon 3"] | None


def replay(controller, plant, attack: dict[str, np.ndarray], name: str, when: int = 0) -> Replay:
    """Play one attack by `rollout`, and for the limit `tube` by `follow_plan` from its step on.

    The lap of a tube's attack is that of the controller up to the plan; what follows it there is
    another future.
    """
    script = {key: jnp.asarray(values)[:, None] for key, values in attack.items() if key != "start"}
    acting = plant.under_script(script)
    trajectory = jax.tree.map(
        np.asarray, rollout(controller, acting, None, jnp.asarray(attack["start"]))
    )
    if name != "tube":
        return Replay(trajectory, None)
    step = jnp.asarray(when)
    keys = realisation_keys(0, 0, 1)  # a script draws nothing
    state = begin(controller, acting, keys, jnp.asarray(trajectory.errors[when]), step)
    found = _plan(controller, step, state.measured)
    if int(found.status[0]) != qp.SOLVED:
        return Replay(trajectory, np.zeros((found.inputs.shape[1], 3)))
    deviations = follow_plan(controller, acting, keys, state, step, found)
    return Replay(trajectory, np.asarray(deviations[:, 0]))


@jax.jit
def _plan(controller, step, measured):
    return mpc.plan(controller.window(step), measured)


def values_of(name: str, found: Replay) -> Float[np.ndarray, "steps n"]:
    """Return what a limit looks at, entry k after period k; of inputs and wheels during it, of a
    tube at stage k."""
    lap = found.trajectory
    if name == "tube":
        assert found.deviations is not None
        return np.concatenate([np.zeros((1, 3)), found.deviations])
    return {"error": lap.errors, "input": lap.inputs, "wheels": lap.demanded}[name][:, 0]


@dataclass(frozen=True)
class Sampled:
    """The worst of many drawn laps: greatest usage by step and facet, how many laps, and the
    seconds they took."""

    reach: dict[str, Float[np.ndarray, "stages facets"]]
    laps: int
    seconds: float

    def usage(self, name: str) -> float:
        """Return the greatest usage of a limit."""
        return float(np.max(self.reach[name]))


@jax.jit
def _extremes(controller, plant, limits: Limits, key, starts):
    keys = jax.random.split(key, len(starts))
    found = usages(controller, limits, play(controller, plant, keys, starts))
    return {name: jnp.max(each, axis=2) for name, each in found.items()}


def sample(
    controller,
    plant,
    limits: Limits,
    starts: Float[np.ndarray, "k 3"],
    *,
    windows: Int[np.ndarray, " windows"] | None = None,
    seconds: float = 60.0,
    seed: int = 0,
    batch: int = 256,
    laps: int | None = None,
) -> Sampled:
    """Draw laps by the plant's own law and keep the extremes alone: what a search has to beat in
    the same time.

    Args:
        starts: a pool of initial errors from which each lap draws its own.
        laps: after which it ends if the time is not up before; others as for `falsify`.
    """
    generator, key, pool = (
        np.random.default_rng(seed),
        jax.random.key(seed),
        jnp.asarray(starts, float),
    )
    windows = np.zeros(1, int) if windows is None else np.asarray(windows)

    def draw(index):
        when = jnp.asarray(generator.choice(windows, batch), jnp.int32)
        acting = PlanFollower(controller, when) if "tube" in limits else controller
        chosen = pool[generator.integers(len(pool), size=batch)]
        return _extremes(acting, plant, limits, jax.random.fold_in(key, index), chosen)

    reach = {name: np.asarray(value) for name, value in draw(0).items()}  # compiles
    begun, count = time.perf_counter(), 0
    while time.perf_counter() - begun < seconds and (laps is None or count < laps):
        count += batch
        reach = {
            name: np.maximum(reach[name], value) for name, value in draw(count // batch).items()
        }
    return Sampled(reach, count, time.perf_counter() - begun)
