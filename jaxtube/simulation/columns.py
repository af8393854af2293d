"""Loops that carry coordinates apart: a matrix (laps, n), n small, as n arrays (laps).

Arrays of laps lie row by row, the coordinates of a lap together. What makes the coordinates one by
one and joins them is then a kernel that makes one number at a time, with all that it needs made
anew for each. Apart they are made by kernels that run over neighbouring numbers, several at once: a
closed loop takes less than half the time.

Source: new.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
from jax import Array
from jaxtyping import Int

MOST = 4
"""Coordinates that are carried apart, of matrices with that many at most."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Columns:
    """The columns of a matrix."""

    arrays: tuple[Array, ...]


def loop_by_columns(
    first: Int[Array, ""] | int,
    last: Int[Array, ""] | int,
    body: Callable[[Array, Any], Any],
    carry: Any,
) -> Any:
    """Return `jax.lax.fori_loop(first, last, body, carry)`."""

    def turn(step, columns):
        return split(body(step, join(columns)))

    return join(jax.lax.fori_loop(first, last, turn, split(carry)))


def scan_by_columns(
    body: Callable[[Any, Any], tuple[Any, Any]], carry: Any, entries: Any
) -> tuple[Any, Any]:
    """Return `jax.lax.scan(body, carry, entries)`."""

    def turn(columns, entry):
        return split(body(join(columns), entry))

    return join(jax.lax.scan(turn, split(carry), entries))


def split(tree: Any) -> Any:
    """Return a tree with the columns of narrow matrices taken apart."""
    return jax.tree.map(_split_array, tree)


def join(tree: Any) -> Any:
    """Return the tree that was split."""
    return jax.tree.map(_join_array, tree, is_leaf=_is_split)


def _split_array(array: Array) -> Array | Columns:
    if array.ndim != 2 or not 0 < array.shape[-1] <= MOST:
        return array
    # Its transpose stacks columns, where that of indexing adds up matrices that are zero elsewhere.
    return Columns(tuple(jnp.unstack(array, axis=1)))


def _join_array(leaf: Array | Columns) -> Array:
    return jnp.stack(leaf.arrays, axis=-1) if isinstance(leaf, Columns) else leaf


def _is_split(leaf: object) -> bool:
    return isinstance(leaf, Columns)
