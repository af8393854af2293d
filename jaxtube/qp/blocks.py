"""Work on the pending instances of a batch alone, a block of fixed size at a time, under jit."""

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import Array
from jaxtyping import Bool, Int, PyTree

MANY = 2048
"""Instances of a batch from which on blocks are larger."""

_assumed = False


def assume_accelerator() -> None:
    """Let programs that this process traces from now on be those of an accelerator, whatever they
    run on."""
    global _assumed
    _assumed = True
    jax.clear_caches()


def on_accelerator() -> bool:
    """Return whether programs are traced for an accelerator: it pays for every kernel that is
    started, a processor for every number."""
    return _assumed or jax.default_backend() != "cpu"


def block_sizes(batch: int) -> tuple[int, int]:
    """Return how many instances of a batch make a block, and how many where few are expected or
    much is kept for each."""
    if on_accelerator():
        # It pays for every block, and moves the matrices of some 10,000 instances while it starts a
        # kernel.
        return 16384, 8192
    # A processor pays for every instance, for every kernel of a block, and where caches overflow.
    return (128, 64) if batch >= MANY else (64, 32)


class Line(NamedTuple):
    """The pending instances of a batch, in order, and how many they are."""

    places: Int[Array, " batch+block"]  # in the batch; its length where no instance is left
    count: Int[Array, ""]


def line_up(pending: Bool[Array, " batch"], block: int) -> Line:
    """Return the line of the pending instances, long enough for blocks of a size."""
    batch = len(pending)
    rank = jnp.cumsum(pending, dtype=jnp.int32)
    if not on_accelerator():
        # A processor scatters number by number.
        numbers = jnp.arange(1, batch + block + 1, dtype=jnp.int32)
        return Line(jnp.searchsorted(rank, numbers).astype(jnp.int32), rank[-1])
    empty = jnp.full(batch + block, batch, jnp.int32)
    place = jnp.where(pending, rank - 1, batch + block)
    return Line(empty.at[place].set(jnp.arange(batch, dtype=jnp.int32), mode="drop"), rank[-1])


def gather(index: Int[Array, " block"], data: PyTree) -> PyTree:
    """Return the rows of arrays at places in the batch, those of the last instance beyond it."""
    return jax.tree.map(lambda array: jnp.take(array, index, axis=0, mode="clip"), data)


def scatter(index: Int[Array, " block"], answers: PyTree, block: PyTree) -> PyTree:
    """Return arrays with a block in the rows at places in the batch, and none beyond it."""

    def put(array, rows):
        return array.at[index].set(rows, mode="drop")

    return jax.tree.map(put, answers, block)


def update_in_blocks(
    method: Callable[[PyTree, PyTree], PyTree],
    size: int,
    pending: Bool[Array, " batch"],
    data: PyTree,
    answers: PyTree,
) -> PyTree:
    """Replace the answers of the pending instances by method(data, answers) of these instances.

    Args:
        method: called on `size` instances at once; the last block is filled up with copies of the
            last instance of the batch.
        size: of a block.
        pending: the instances to work on; their number decides the cost.
        data: arrays with the batch as their leading axis.
        answers: the same, of the shapes and types that `method` returns.
    """
    size = min(size, len(pending))
    line = line_up(pending, size)

    def is_unfinished(carry):
        first, _ = carry
        return first < line.count

    def update(carry):
        first, answers = carry
        index = jax.lax.dynamic_slice(line.places, (first,), (size,))
        block = method(gather(index, data), gather(index, answers))
        return first + size, scatter(index, answers, block)

    _, answers = jax.lax.while_loop(is_unfinished, update, (jnp.int32(0), answers))
    return answers
