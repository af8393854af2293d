"""One exchange of the dual active-set method, for a block of quadratic programs at once.

    minimise over z   1/2 z' z - z_0' z   subject to   g_i z <= h_i

is the program of `solver` in z = S'^-1 x (see `factors`), each row once for its upper bound and
once, turned, for its lower one. The rows of the active set have normals N and multipliers y >= 0;
z = z_0 - N' y. With C = (N N')^-1 an exchange

(1) takes the row p that is missed most, unless one is on its way;
(2) finds r = C N g_p, at which the other multipliers shrink while that of p grows, and d = g_p -
    N' r, the way of z;
(3) goes along: z -= t d, y -= t r, y_p += t. At t = (g_p z - h_p) / d'd row p is met, at t = min
    y_i / r_i over r_i > 0 another multiplier is zero; the smaller is taken;
(4) lets p join at the first, the other leave at the second: C changes by a product of rank one.

Where d = 0 and no r_i > 0 there is no step, and g_p - r' N = 0 with r <= 0 proves that no z meets
these rows. The dual cost rises with each t > 0, so that no active set returns. Steps of length zero
might repeat: whoever calls counts.

A block is several times faster where every result that is read often is computed once: see `keep`.
The batch is the last axis. Source: Goldfarb and Idnani, A numerically stable dual method for
solving strictly convex quadratic programs, Mathematical Programming 1983, algorithm 2; C in place
of a factor of N is new.
"""

import functools
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Float, Int

from jaxtube.qp.batched_ldl import add_up, product
from jaxtube.qp.blocks import on_accelerator
from jaxtube.qp.tags import as_integer, read_tag, tag, untag

NEXT = -1
"""Of `adding`: no row is on its way."""
MET = -2
"""No row is missed."""
STUCK = -3
"""At and below it: row STUCK - adding has no step, or no slot is left for it."""
DEPENDENT = 0.625
"""Power of eps, by the square of a row, below which d'd counts as zero."""
UNMOVED = 0.75
"""Power of eps below which r counts as zero."""


class Program(NamedTuple):
    """What the batch shares."""

    rows: Float[Array, "m n"]  # `whitened`
    signed: Float[Array, "2m n"]  # g: the rows, and the rows turned
    one: Float[Array, ""]  # which the compiler does not know


class Lanes(NamedTuple):
    """The instances of a block; the active set stands in slots."""

    z: Float[Array, "n lanes"]
    bounds: Float[Array, "2m lanes"]  # h
    tolerance: Float[Array, " lanes"]  # by which a row may be missed
    normals: Float[Array, "a n lanes"]  # N
    inverse: Float[Array, "a a lanes"]  # C, zero where a slot is empty
    multipliers: Float[Array, "a lanes"]  # y; -r where there is no step
    rows: Int[Array, "a lanes"]  # of the slots, -1 where empty
    adding: Int[Array, " lanes"]  # p, or a mark
    multiplier: Float[Array, " lanes"]  # y_p; it stands for 1 where there is no step
    count: Int[Array, " lanes"]  # of exchanges


class Missed(NamedTuple):
    """The row p of every lane."""

    row: Int[Array, " lanes"]  # or a mark
    normal: Float[Array, "n lanes"]  # g_p
    by: Float[Array, " lanes"]  # g_p z - h_p


class Way(NamedTuple):
    """Where the multipliers and z go."""

    r: Float[Array, "a lanes"]
    d: Float[Array, "n lanes"]
    square: Float[Array, " lanes"]  # d'd, infinite where it counts as zero


class Step(NamedTuple):
    """How far they go, and whether p joins (1) or another row leaves (0)."""

    length: Float[Array, " lanes"]  # t
    joins: Float[Array, " lanes"]
    slot: Int[Array, " lanes"]  # of what joins or leaves; the number of slots where there is none


def make_program(whitened: Float[Array, "m n"]) -> Program:
    """Return what a batch shares."""
    one = jnp.where(jnp.isnan(whitened[0, 0]), 2.0, 1.0).astype(whitened.dtype)
    return Program(whitened, jnp.concatenate([whitened, -whitened]), one)


def keep(program: Program, array: Array) -> Array:
    """Return an array that is computed once.

    A processor's compiler computes what is cheap, such as a sum of products, again in each of its
    uses, and again for each entry there; not so a quotient. An accelerator's does better.
    """
    return array if on_accelerator() else array / program.one


def exchange(program: Program, lanes: Lanes) -> Lanes:
    """Take one exchange in every lane that is not at its end."""
    missed = choose_row(program, lanes)
    way = find_way(program, lanes, missed)
    step = find_step(program, lanes, missed, way)
    moves = step.slot < len(lanes.rows)
    is_stuck = (missed.row >= 0) & ~moves
    ended = jnp.where(is_stuck, STUCK - missed.row, missed.row)
    begun = jnp.where(lanes.adding >= 0, lanes.multiplier, 0.0) + step.length
    changed = change_rows(program, lanes, missed, way, step, begun)
    return changed._replace(
        z=lanes.z - jnp.where(jnp.isfinite(way.square), step.length, 0.0) * way.d,
        multipliers=jnp.where(is_stuck, jnp.maximum(-way.r, 0.0), changed.multipliers),
        adding=jnp.where(moves & (step.joins > 0), NEXT, ended),
        multiplier=begun,
        count=lanes.count + 1,
    )


def choose_row(program: Program, lanes: Lanes) -> Missed:
    """Return p, (1)."""
    m = len(program.rows)
    values = product(program.rows, lanes.z)
    index = jnp.arange(m)[:, None]
    above = tag(values - lanes.bounds[:m], index, 2 * m)
    below = tag(-values - lanes.bounds[m:], index + m, 2 * m)
    worst = jnp.max(jnp.maximum(above, below), axis=0)
    found = jnp.where(untag(worst, values.dtype) > lanes.tolerance, read_tag(worst, 2 * m), MET)
    row = jnp.where(lanes.adding == NEXT, found, lanes.adding)
    place = jnp.maximum(row, 0)
    normal = keep(program, jnp.take(program.signed, place, axis=0, mode="clip").T)
    bound = jnp.take_along_axis(lanes.bounds, place[None], axis=0, mode="clip")[0]
    return Missed(row, normal, jnp.sum(normal * lanes.z, axis=0) - bound)


def find_way(program: Program, lanes: Lanes, missed: Missed) -> Way:
    """Return r and d, (2)."""
    slots, n, _ = lanes.normals.shape
    normal = missed.normal
    products = keep(program, add_up([lanes.normals[:, j] * normal[j] for j in range(n)]))
    r = keep(program, add_up([lanes.inverse[:, i] * products[i] for i in range(slots)]))
    d = keep(program, normal - add_up([lanes.normals[i] * r[i] for i in range(slots)]))
    square = jnp.sum(d * normal, axis=0)
    is_zero = square <= jnp.finfo(d.dtype).eps ** DEPENDENT * jnp.sum(normal * normal, axis=0)
    return Way(r, d, keep(program, jnp.where(is_zero, jnp.inf, square)))


def find_step(program: Program, lanes: Lanes, missed: Missed, way: Way) -> Step:
    """Return t, (3), and what it does to the active set."""
    slots = len(lanes.rows)
    dtype = way.r.dtype
    far = np.finfo(dtype).max ** 0.5
    by = jnp.maximum(missed.by, 0.0)
    full = jnp.where(jnp.isfinite(way.square), by / way.square, jnp.inf)
    least = untag(functools.reduce(jnp.minimum, ratios(lanes, way)), dtype)
    part = keep(program, least)
    joins = full <= part
    length = jnp.minimum(full, part)
    empty = [jnp.where(lanes.rows[i] < 0, i, slots) for i in range(slots)]
    slot = jnp.where(joins, functools.reduce(jnp.minimum, empty), read_tag(as_integer(part), slots))
    moves = (missed.row >= 0) & (length < far)
    return Step(
        length=keep(program, jnp.where(moves, length, 0.0)),
        joins=keep(program, jnp.where(moves & joins, 1.0, 0.0).astype(dtype)),
        slot=jnp.where(moves, slot, slots),
    )


def ratios(lanes: Lanes, way: Way) -> list[Int[Array, " lanes"]]:
    """Return, tagged by their slots, the t at which multipliers are zero; the least normal number
    stands for zero, whose tag would be lost where subnormal ones are flushed."""
    slots = len(lanes.rows)
    eps = jnp.finfo(way.r.dtype).eps
    least = np.finfo(way.r.dtype).tiny
    largest = np.finfo(way.r.dtype).max

    def ratio(i):
        shrinks = way.r[i] > eps**UNMOVED
        t = jnp.where(shrinks, lanes.multipliers[i], largest) / jnp.where(shrinks, way.r[i], 1.0)
        return tag(jnp.clip(t, least, largest), i, slots)

    return [ratio(i) for i in range(slots)]


def change_rows(
    program: Program,
    lanes: Lanes,
    missed: Missed,
    way: Way,
    step: Step,
    multiplier: Float[Array, " lanes"],
) -> Lanes:
    """Return lanes whose active sets p has joined or another row has left, (4)."""
    slots = len(lanes.rows)
    is_slot = jnp.arange(slots, dtype=jnp.int32)[:, None] == step.slot
    one_hot = keep(program, is_slot.astype(way.r.dtype))
    joins = keep(program, one_hot * step.joins)
    stays = keep(program, 1 - one_hot)
    place = jnp.minimum(step.slot, slots - 1)[None]
    column = jnp.take_along_axis(lanes.inverse, place[None], axis=0, mode="clip")[0]
    pivot = jnp.take_along_axis(column, place, axis=0, mode="clip")[0]
    vector = keep(program, step.joins * (way.r - one_hot) + (1 - step.joins) * column)
    divisor = jnp.where(step.joins > 0, way.square, -pivot)
    scale = keep(program, jnp.where(step.slot < slots, 1 / divisor, 0.0))
    present = keep(program, stays + joins)
    inverse = (lanes.inverse + scale * vector[:, None] * vector) * present[:, None] * present
    taken = jnp.maximum(lanes.multipliers - step.length * way.r, 0.0)
    return lanes._replace(
        normals=lanes.normals * stays[:, None] + joins[:, None] * missed.normal,
        inverse=inverse,
        multipliers=stays * taken + joins * multiplier,
        rows=jnp.where(is_slot, jnp.where(step.joins > 0, missed.row, -1), lanes.rows),
    )
