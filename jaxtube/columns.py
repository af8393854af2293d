"""Loops that carry coordinates apart: a matrix (laps, n), n small, as n arrays (laps).

Arrays of laps lie row by row, the coordinates of a lap together. What makes the coordinates one by
one and joins them is then a kernel that makes one number at a time, with all that it needs made
anew for each. Apart they are made by kernels that run over neighbouring numbers, several at once: a
closed loop takes less than half the time.

Source: new.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
from jax import Array
from jax.ad_checkpoint import checkpoint_name
from jaxtyping import Float, Int

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

    return join(jax.lax.scan(by_columns(body), split(carry), entries))


def by_columns(function: Callable[..., Any]) -> Callable[..., Any]:
    """Return a function of split trees that returns what `function` does, split."""

    @functools.wraps(function)
    def split_function(*trees):
        return split(function(*join(trees)))

    return split_function


def name_columns(tree: Any, name: str) -> Any:
    """Return a tree whose columns reverse mode may keep under a name."""
    return join(checkpoint_name(split(tree), name))


def use_twice(tree: Any) -> tuple[Any, Any]:
    """Return a tree once for each of two uses, whose cotangents are then added up column by
    column."""
    columns = split(tree)
    return join(columns), join(columns)


def each_coordinate(function: Callable[..., Array], *points: Float[Array, "... n"]) -> Array:
    """Return a function of points that takes each coordinate by itself."""
    columns = [jnp.unstack(jnp.asarray(point), axis=-1) for point in points]
    return jnp.stack([function(*of_points) for of_points in zip(*columns, strict=True)], axis=-1)


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
