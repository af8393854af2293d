"""Attacks: what everything bounded in a batch of closed loops does, and its steps along the
gradient of the usage.

    z+ = z + length (v - z),    v the vertex of the uncertainty's polytope that is best along the gradient

is the conditional gradient step. It never leaves the polytope and solves a linear problem at once
with length 1; the length is halved where the usage did not grow, and doubled again where it did.

Source: Frank and Wolfe, An algorithm for quadratic programming, Naval Research Logistics Quarterly
1956.
"""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Bool, Float, Int

from jaxtube.plant.protocol import SearchablePlant, Uncertainty
from jaxtube.simulation.usage import Limits, play, usages

Attack = dict[str, Array]
"""By name, time first: `start` (1, batch, 3) and the entries of a script."""


def find_uncertainties(
    plant: SearchablePlant, starts: Float[np.ndarray, "k 3"]
) -> dict[str, Uncertainty]:
    """Return everything bounded that a plant would draw, and the start in the hull of `starts`.

    Raises:
        ValueError: for a law of drawing that is not the box of its values.
    """
    start = {"start": Uncertainty(np.asarray(starts, float), 1)}
    return start | plant.uncertainties()


def mean_attack(sets: dict[str, Uncertainty], batch: int) -> Attack:
    """Return the attack in which everything is the mean of its vertices: no deviation, where sets
    are symmetric."""
    return {
        name: jnp.broadcast_to(
            jnp.asarray(each.vertices.mean(axis=0)), (each.times, batch, each.vertices.shape[1])
        )
        for name, each in sets.items()
    }


def vertex_attack(
    sets: dict[str, Uncertainty], batch: int, generator: np.random.Generator
) -> Attack:
    """Return an attack of random vertices."""
    return {
        name: jnp.asarray(
            each.vertices[generator.integers(len(each.vertices), size=(each.times, batch))]
        )
        for name, each in sets.items()
    }


def cells(controller, limits: Limits, seen: dict[str, Array]) -> Float[Array, "cells batch"]:
    """Return all usages in one column an instance, limits in the order of their names."""
    found = usages(controller, limits, seen)
    return jnp.concatenate(
        [found[name].reshape(-1, found[name].shape[2]) for name in sorted(found)]
    )


class Climb(NamedTuple):
    """A batch on its way: what is played next; the best so far with its vertex, usage and gain
    expected from the full step; the length of the next step."""

    candidate: Attack
    accepted: Attack
    vertex: Attack
    value: Float[Array, " batch"]
    gain: Float[Array, " batch"]
    length: Float[Array, " batch"]


def begun(attack: Attack) -> Climb:
    """Return a batch that has not been played."""
    one = attack["start"][0, :, 0]
    none = jnp.full_like(one, -jnp.inf)
    return Climb(attack, attack, attack, none, jnp.zeros_like(one), jnp.ones_like(one))


@jax.jit
def climb(
    controller, plant, limits: Limits, vertices: Attack, now: Climb, cell: Int[Array, " batch"]
):
    """Play the candidates, and take one step with each.

    Args:
        vertices: of each uncertainty, by name.
        cell: the target of each instance, a row of `cells`.

    Returns:
        (the batch one step on, greatest usage by cell, the instance that had it, greatest gain
        still expected).
    """

    def target(attack: Attack):
        """Return the sum of what each instance aims at, and all usages."""
        script = {name: values for name, values in attack.items() if name != "start"}
        found = cells(controller, limits, play(controller, plant, None, attack["start"][0], script))
        return jnp.sum(values := jnp.take_along_axis(found, cell[None], axis=0)[0]), (values, found)

    gradient, (values, found) = jax.grad(target, has_aux=True)(now.candidate)
    following = _step(now, values, gradient, vertices)
    # What is no number keeps no limit, and must not hide what the others did.
    found = jnp.where(jnp.isnan(found), jnp.inf, found)
    return (
        following,
        jnp.max(found, axis=1),
        jnp.argmax(found, axis=1),
        jnp.max(following.gain * following.length),
    )


def _step(now: Climb, values: Float[Array, " batch"], gradient: Attack, vertices: Attack) -> Climb:
    """Accept the candidates that are better, and go on from the best so far."""
    better = values > now.value
    accepted = _choose(better, now.candidate, now.accepted)
    best = {
        name: _best_vertex(vertices[name], gradient[name], now.candidate[name]) for name in gradient
    }
    gains = [
        jnp.sum(gradient[name] * (best[name] - now.candidate[name]), axis=(0, 2)) for name in best
    ]
    vertex, gain = (
        _choose(better, best, now.vertex),
        jnp.where(better, jnp.sum(jnp.stack(gains), axis=0), now.gain),
    )
    length = jnp.where(better, jnp.minimum(2.0 * now.length, 1.0), now.length / 2.0)
    candidate = {
        name: accepted[name] + length[:, None] * (vertex[name] - accepted[name]) for name in vertex
    }
    return Climb(candidate, accepted, vertex, jnp.maximum(values, now.value), gain, length)


def _best_vertex(vertices: Float[Array, "v n"], gradient: Float[Array, "times batch n"], value):
    """Return the vertex that is best along the gradient, and the value itself where none is better."""
    scores = gradient @ vertices.T
    gains = jnp.max(scores, axis=2) > jnp.sum(gradient * value, axis=2)
    return jnp.where(gains[:, :, None], vertices[jnp.argmax(scores, axis=2)], value)


def _choose(chosen: Bool[Array, " batch"], one: Attack, other: Attack) -> Attack:
    return {name: jnp.where(chosen[:, None], one[name], other[name]) for name in one}
