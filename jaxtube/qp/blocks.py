"""Work on the pending instances of a batch alone, a block of fixed size at a time, under jit."""

from collections.abc import Callable
from functools import partial

import jax
import jax.numpy as jnp
from jax import Array
from jaxtyping import Bool, PyTree

_assumed = False


def assume_accelerator() -> None:
    """Let programs that this process traces from now on be those of an accelerator, whatever they
    run on."""
    global _assumed
    _assumed = True


def on_accelerator() -> bool:
    """Return whether programs are traced for an accelerator: it pays for every kernel that is
    started, a processor for every number."""
    return _assumed or jax.default_backend() != "cpu"


def block_sizes() -> tuple[int, int]:
    """Return how many instances make a block, and how many where few are expected."""
    # A processor's caches hold 64 instances and it pays for every one; an accelerator pays for
    # every block, and moves the matrices of some 10,000 instances while it starts a kernel.
    return (16384, 8192) if on_accelerator() else (64, 32)


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
    batch = len(pending)
    size = min(size, batch)

    def is_unfinished(carry):
        pending, _ = carry
        return jnp.any(pending)

    update = partial(update_block, method, size, data)
    _, answers = jax.lax.while_loop(is_unfinished, update, (pending, answers))
    return answers


def update_block(
    method: Callable[[PyTree, PyTree], PyTree],
    size: int,
    data: PyTree,
    carry: tuple[Bool[Array, " batch"], PyTree],
) -> tuple[Bool[Array, " batch"], PyTree]:
    """Replace the answers of the first `size` pending instances, which are then pending no more."""
    pending, answers = carry
    index = jnp.nonzero(pending, size=size, fill_value=len(pending))[0]

    def gather(array):
        return jnp.take(array, index, axis=0, mode="clip")

    def scatter(array, block):
        return array.at[index].set(block, mode="drop")

    block = method(jax.tree.map(gather, data), jax.tree.map(gather, answers))
    return scatter(pending, False), jax.tree.map(scatter, answers, block)
