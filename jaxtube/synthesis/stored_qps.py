"""Condensed QPs as arrays by name, and back to the bit."""

from __future__ import annotations

from collections.abc import Mapping

import jax
import numpy as np

from jaxtube.control.planning import CondensedQp
from jaxtube.storage import flatten


def list_qp_arrays(qps: CondensedQp) -> dict[str, np.ndarray]:
    """Return the arrays of QPs by their place there, such as `factors/hessian`."""
    leaves, _ = jax.tree_util.tree_flatten_with_path(qps)
    return {_name(place): np.asarray(value) for place, value in leaves}


def read_qp_arrays(like: CondensedQp, nested: Mapping) -> CondensedQp:
    """Return QPs of the same parts as others, with the arrays that `list_qp_arrays` gave, nested by
    their names.

    Raises:
        KeyError: for a part without an array.
    """
    arrays = flatten(nested)
    places, tree = jax.tree_util.tree_flatten_with_path(like)
    return jax.tree_util.tree_unflatten(tree, [arrays[_name(place)] for place, _ in places])


def _name(place: tuple) -> str:
    return jax.tree_util.keystr(place, simple=True, separator="/")
