"""Frank-Wolfe attacks on closed loops: bounded uncertainties moved along the gradient of a limit's
utilisation.

    z+ = z + length (v - z)

with the vertex v of the uncertainty's polytope that is best along the gradient is the conditional
gradient step. It never leaves the polytope and solves a linear problem at once
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

from jaxtube.falsification.cells import stack_cells
from jaxtube.plant.protocol import SearchablePlant, Uncertainty
from jaxtube.plant.random_keys import make_key
from jaxtube.simulation.usage import JudgedLoop, play_limits

Attack = dict[str, Float[Array, "times batch n"]]
"""The values of every uncertainty, by name: `start` (1, batch, 3) and the entries of a script."""


def find_uncertainties(
    plant: SearchablePlant, starts: Float[np.ndarray, "k 3"]
) -> dict[str, Uncertainty]:
    """Return everything bounded that a plant would draw, and the start in the hull of `starts`.

    Raises:
        ValueError: for a law of drawing that is not the box of its values.
    """
    start = Uncertainty(np.asarray(starts, float), 1)
    return {"start": start} | plant.uncertainties()


def make_mean_attack(uncertainties: dict[str, Uncertainty], batch: int) -> Attack:
    """Return the attack in which everything is the mean of its vertices: no deviation, where sets
    are symmetric."""
    attack = {}
    for name, uncertainty in uncertainties.items():
        mean = uncertainty.by_time.mean(axis=1)
        attack[name] = jnp.repeat(jnp.asarray(mean)[:, None], batch, axis=1)
    return attack


def draw_vertex_attack(
    uncertainties: dict[str, Uncertainty], batch: int, generator: np.random.Generator
) -> Attack:
    """Return an attack of random vertices."""
    attack = {}
    for name, uncertainty in uncertainties.items():
        vertices = uncertainty.by_time
        choice = generator.integers(vertices.shape[1], size=(uncertainty.times, batch))
        attack[name] = jax.device_put(np.take_along_axis(vertices, choice[..., None], axis=1))
    return attack


class Ascent(NamedTuple):
    """A batch of attacks on its way up."""

    candidate: Attack  # to be played next
    accepted: Attack  # the best so far
    vertex: Attack  # best along the gradient at the best so far
    usage: Float[Array, " batch"]  # of the best so far
    gain: Float[Array, " batch"]  # that the whole step to the vertex promises
    length: Float[Array, " batch"]  # of the next step


class CellAim(NamedTuple):
    """What each instance of a batch aims at."""

    cell: Int[Array, " batch"]  # number of its cell (`cells.UsageCells`)
    when: Int[Array, " batch"]  # step of the plan that is followed, for the limit `tube`


class Sweep(NamedTuple):
    """One gradient step of a batch and the laps that were played for it."""

    ascent: Ascent  # one step on
    best: Float[Array, " cells"]  # greatest usage of every cell
    member: Int[Array, " cells"]  # the instance that had it
    gain: Float[Array, ""]  # the most that any instance still expects


def start_ascent(attack: Attack) -> Ascent:
    """Return a batch that has not been played."""
    zero = jnp.zeros_like(attack["start"][0, :, 0])
    return Ascent(attack, attack, attack, zero - jnp.inf, zero, zero + 1.0)


@jax.jit
def ascend(
    loop: JudgedLoop,
    vertices: dict[str, Float[Array, "*times v n"]],
    ascent: Ascent,
    aim: CellAim,
) -> Sweep:
    """Play the candidates of a batch and take one step with each.

    Args:
        loop: whose plant's draws give way to the attack; all limits are judged in every lap.
        vertices: of each uncertainty, by name; of every time, or of all.
        ascent: the batch.
        aim: of each instance.
    """

    def compute_total_usage(attack: Attack):
        """Return the sum of the usages aimed at; beside it these usages and those of all cells."""
        script = {name: values for name, values in attack.items() if name != "start"}
        starts = attack["start"][0]
        keys = jax.random.split(make_key(0), len(starts))  # a script draws nothing
        usages = play_limits(loop, keys, starts, aim.when, script)
        cells = stack_cells(usages)
        aimed = jnp.take_along_axis(cells, aim.cell[None], axis=0)[0]
        return jnp.sum(aimed), (aimed, cells)

    differentiate = jax.grad(compute_total_usage, has_aux=True)
    gradient, (aimed, cells) = differentiate(ascent.candidate)
    following = _step(ascent, aimed, gradient, vertices)
    # NaN violates every limit; it does not mask the other laps.
    cells = jnp.where(jnp.isnan(cells), jnp.inf, cells)
    return Sweep(
        ascent=following,
        best=jnp.max(cells, axis=1),
        member=jnp.argmax(cells, axis=1),
        gain=jnp.max(following.gain * following.length),
    )


def _step(
    ascent: Ascent,
    usage: Float[Array, " batch"],
    gradient: Attack,
    vertices: dict[str, Float[Array, "*times v n"]],
) -> Ascent:
    """Accept the candidates that are better, and go on from the best so far."""
    candidate = ascent.candidate
    is_better = usage > ascent.usage
    accepted = _choose(is_better, candidate, ascent.accepted)
    best = {
        name: _find_best_vertex(vertices[name], gradient[name], candidate[name])
        for name in gradient
    }
    gains = [
        jnp.sum(gradient[name] * (best[name] - candidate[name]), axis=(0, 2)) for name in gradient
    ]
    gain = jnp.where(is_better, jnp.sum(jnp.stack(gains), axis=0), ascent.gain)
    vertex = _choose(is_better, best, ascent.vertex)
    longer = jnp.minimum(2.0 * ascent.length, 1.0)
    length = jnp.where(is_better, longer, ascent.length / 2.0)
    following = {
        name: accepted[name] + length[:, None] * (vertex[name] - accepted[name]) for name in vertex
    }
    return Ascent(following, accepted, vertex, jnp.maximum(usage, ascent.usage), gain, length)


def _find_best_vertex(
    vertices: Float[Array, "*times v n"],
    gradient: Float[Array, "times batch n"],
    values: Float[Array, "times batch n"],
) -> Float[Array, "times batch n"]:
    """Return the vertices that are best along the gradient; values where none is better."""
    scores = gradient @ jnp.swapaxes(vertices, -1, -2)
    gains = jnp.max(scores, axis=2) > jnp.sum(gradient * values, axis=2)
    best = jnp.argmax(scores, axis=2)
    by_time = jnp.broadcast_to(vertices, (len(best), *vertices.shape[-2:]))
    chosen = jnp.take_along_axis(by_time, best[:, :, None], axis=1)
    return jnp.where(gains[:, :, None], chosen, values)


def _choose(is_first: Bool[Array, " batch"], first: Attack, second: Attack) -> Attack:
    return {name: jnp.where(is_first[:, None], first[name], second[name]) for name in first}
