"""The dual active-set method for the pending instances of a batch, exact where it ends.

Instances need between one exchange and a few times as many as there are unknowns (`exchange`). A
processor works on a block of lanes, and an instance that waits takes the lane of one that is done;
an accelerator works on all instances at once.

What is found are rows and multipliers: which of the two bounds, and how hard it pushes. The caller
makes x of them and judges it. Source: as `exchange`.
"""

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import Array
from jaxtyping import Bool, Float, Int

from jaxtube.qp.blocks import Line, line_up, scatter
from jaxtube.qp.exchange import MET, NEXT, STUCK, Lanes, Program, exchange

MOST_SLOTS = 16
"""Active rows of an instance; one that needs more is not solved here."""
EXCHANGES = 4
"""By the number of unknowns, before an instance is given up."""
WAITING = 3
"""The share of lanes that are done, inverted, at which instances that wait are taken in."""


class Start(NamedTuple):
    """Where instances begin."""

    z: Float[Array, "n lanes"]
    bounds: Float[Array, "2m lanes"]
    tolerance: Float[Array, " lanes"]


class Found(NamedTuple):
    """What is known of each instance of a batch; places that are not used hold row -1."""

    multipliers: Float[Array, "batch a+1"]
    rows: Int[Array, "batch a+1"]  # below m an upper bound, from m on a lower one
    is_ray: Bool[Array, " batch"]  # the multipliers say, perhaps prove, that there is no answer


Load = Callable[[Int[Array, " lanes"]], Start]


class _Queue(NamedTuple):
    lanes: Lanes
    places: Int[Array, " lanes"]  # in the batch, of the instances in the lanes
    next: Int[Array, ""]  # in the line
    found: Found


def find_active_sets(
    program: Program, load: Load, pending: Bool[Array, " batch"], width: int
) -> Found:
    """Return the active sets of the pending instances.

    Args:
        program: what they share.
        load: returns instances by their places in the batch.
        pending: which to work on; their number decides the cost.
        width: lanes of a block.
    """
    width = min(width, len(pending))
    line = line_up(pending, width)
    n = program.rows.shape[1]
    slots = min(n, MOST_SLOTS)
    queue = _Queue(
        lanes=_empty_lanes(program, slots, width),
        places=jnp.full(width, len(pending), jnp.int32),
        next=jnp.int32(0),
        found=_nothing_found(len(pending), slots, program.rows.dtype),
    )

    def is_unfinished(queue):
        return (queue.next < line.count) | jnp.any(queue.places < len(pending))

    def work(queue):
        return _run(program, _refill(load, line, queue), line.count)

    return jax.lax.while_loop(is_unfinished, work, queue).found


def _empty_lanes(program: Program, slots: int, width: int) -> Lanes:
    m, n = program.rows.shape
    dtype = program.rows.dtype

    def zeros(*shape):
        return jnp.zeros((*shape, width), dtype)

    return Lanes(
        z=zeros(n),
        bounds=zeros(2 * m),
        tolerance=zeros(),
        normals=zeros(slots, n),
        inverse=zeros(slots, slots),
        multipliers=zeros(slots),
        rows=jnp.full((slots, width), -1, jnp.int32),
        adding=jnp.full(width, MET, jnp.int32),
        multiplier=zeros(),
        count=jnp.zeros(width, jnp.int32),
    )


def _nothing_found(batch: int, slots: int, dtype) -> Found:
    return Found(
        multipliers=jnp.zeros((batch, slots + 1), dtype),
        rows=jnp.full((batch, slots + 1), -1, jnp.int32),
        is_ray=jnp.zeros(batch, bool),
    )


def _run(program: Program, queue: _Queue, count: Int[Array, ""]) -> _Queue:
    """Take exchanges until many lanes are done that others wait for, or all are."""
    width = len(queue.places)
    most = EXCHANGES * program.rows.shape[1]

    def goes_on(lanes):
        done = jnp.sum(_is_done(lanes, most))
        return (done < width) & ((done * WAITING < width) | (queue.next >= count))

    lanes = jax.lax.while_loop(goes_on, lambda lanes: exchange(program, lanes), queue.lanes)
    return queue._replace(lanes=lanes)


def _is_done(lanes: Lanes, most: int) -> Bool[Array, " lanes"]:
    return (lanes.adding < NEXT) | (lanes.count >= most)


def _refill(load: Load, line: Line, queue: _Queue) -> _Queue:
    """Write down what lanes that are done have found, and give them the next of the line."""
    lanes = queue.lanes
    batch = len(queue.found.is_ray)
    done = _is_done(lanes, EXCHANGES * len(lanes.z))
    found = scatter(jnp.where(done, queue.places, batch), queue.found, _read(lanes))
    order = jnp.cumsum(done, dtype=jnp.int32)
    following = jnp.take(line.places, queue.next + order - 1, mode="clip")
    places = jnp.where(done, following, queue.places)
    fresh = _begin(lanes, load(places), places < batch)
    lanes = jax.tree.map(lambda new, old: jnp.where(done, new, old), fresh, lanes)
    return _Queue(lanes, places, queue.next + order[-1], found)


def _read(lanes: Lanes) -> Found:
    is_ray = lanes.adding <= STUCK
    last = jnp.where(is_ray, STUCK - lanes.adding, -1)
    multiplier = is_ray.astype(lanes.multipliers.dtype)
    return Found(
        multipliers=jnp.concatenate([lanes.multipliers, multiplier[None]]).T,
        rows=jnp.concatenate([lanes.rows, last[None]]).T,
        is_ray=is_ray,
    )


def _begin(lanes: Lanes, start: Start, is_used: Bool[Array, " lanes"]) -> Lanes:
    return Lanes(
        z=start.z,
        bounds=start.bounds,
        tolerance=start.tolerance,
        normals=jnp.zeros_like(lanes.normals),
        inverse=jnp.zeros_like(lanes.inverse),
        multipliers=jnp.zeros_like(lanes.multipliers),
        rows=jnp.full_like(lanes.rows, -1),
        adding=jnp.where(is_used, NEXT, MET),
        multiplier=jnp.zeros_like(lanes.multiplier),
        count=jnp.zeros_like(lanes.count),
    )
