"""The terminal set as a function of the local gains, differentiable where it is the maximal
invariant one.

Every row of the maximal set is the predecessor, along a path of loops, of an error limit or of an
input limit under a gain: with r such a limit's row, d its offset and W widened,

    c e <= o,    c = r Phi_{i1} .. Phi_{im}
    o = d - (1 + INFLATION) sum over l < m of h_W(r Phi_{i1} .. Phi_{il})

The design records these paths, and tuning holds them. The set is then smooth in the gains except
where the product of a row and a generator of W is zero. It is the design's own as long as no row
appears or vanishes, which happens where the row cuts nothing, and no two rows coincide; there the
derivative is one-sided. A set of fewer facets than the maximal one has no such history: its rows
are held as they are.

Source: Gilbert and Tan 1991; Blanchini 1999.
"""

from __future__ import annotations

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Float, Int

from jaxtube.qp.regions import AnyArray
from jaxtube.synthesis.parts import Design
from jaxtube.synthesis.terminal import Terminal, set_back_off
from jaxtube.tuning.caps import CapLimits
from jaxtube.tuning.tube import closed_loop_rows, support
from sets.invariant import INFLATION
from sets.polytope import Polytope

LONGEST = 20
"""Loops on the longest path that is followed; a set with a longer one is held."""


class TerminalRows(NamedTuple):
    """Where the terminal rows come from.

    `roots` counts the rows of E, those of the inputs under the gains at all corners, then the held
    ones; `paths` are loops among the vertex pairs, -1 where a path has ended.
    """

    roots: Int[AnyArray, " facets"]
    paths: Int[AnyArray, "facets longest"]
    held_normals: Float[AnyArray, "facets 3"]
    held_offsets: Float[AnyArray, " facets"]
    back_off: Float[AnyArray, ""]


def trace_terminal_rows(
    design: Design,
    normals: Float[np.ndarray, "facets 3"],
    offsets: Float[np.ndarray, " facets"],
) -> TerminalRows:
    """Return the history of a design's terminal rows, in their order.

    Args:
        design: whose rows they are.
        normals: of its constraint on e_N, spare rows behind.
        offsets: before the tube is taken off, infinite for spare rows.
    """
    problem = design.problem
    maximal = design.terminal.maximal
    gains = design.terminal.gains.corner_gains
    error_count = len(problem.operating_set.offsets)
    input_count = len(problem.input_rows.offsets)
    roots = error_count + len(gains) * input_count + np.arange(len(normals))
    paths = np.full((len(normals), LONGEST), -1)
    polytope = _traceable_polytope(design.terminal)
    if polytope is not None:
        # The set is made of distinct gains and loops: the first of equal ones stands for all.
        loops, _ = design.terminal.gains.pairs
        first_gain = _first_of_equals(gains)
        first_loop = np.sort(_first_of_equals(loops.reshape(-1, 9)))
        place = {normal.tobytes(): at for at, normal in enumerate(polytope.normals)}
        for row in np.flatnonzero(np.isfinite(offsets)):
            at = place[normals[row].tobytes()]
            root = maximal.roots[at]
            path = list(maximal.paths[at])
            if root >= error_count:
                gain, limit = divmod(root - error_count, input_count)
                root = error_count + first_gain[gain] * input_count + limit
            roots[row] = root
            paths[row, : len(path)] = first_loop[path]
    return TerminalRows(roots, paths, normals, offsets, np.array(set_back_off(problem)))


def _first_of_equals(arrays: Float[np.ndarray, "n ..."]) -> Int[np.ndarray, " distinct"]:
    """Return the index of the first of each group of equal entries, in the entries' own order."""
    return np.unique(arrays, axis=0, return_index=True)[1]


def _traceable_polytope(terminal: Terminal) -> Polytope | None:
    """Return the terminal set where it is the maximal one, in use, and its paths are short
    enough."""
    maximal = terminal.maximal
    is_maximal = not terminal.fallback and terminal.invariant is maximal.polytope
    if not is_maximal or max(map(len, maximal.paths)) > LONGEST:
        return None
    return maximal.polytope


def compute_terminal_set(
    rows: TerminalRows,
    loops: Float[Array, "pairs 3 3"],
    gains: Float[Array, "corners 2 3"],
    generators: Float[Array, "g 3"],
    errors: tuple[Float[Array, "6 3"], Float[Array, " 6"]],
    limits: CapLimits,
) -> tuple[Float[Array, "facets 3"], Float[Array, " facets"]]:
    """Return normals and offsets of the terminal set, before the tube is taken off.

    Args:
        rows: their history.
        loops: those of the vertex pairs.
        gains: those at the corners.
        generators: of W.
        errors: rows and offsets of E.
        limits: of the inputs.
    """
    error_rows, error_offsets = errors
    input_rows = closed_loop_rows(limits.inputs, limits.errors, gains).reshape(-1, 3)
    own = jnp.concatenate([error_rows, input_rows])
    bounds = jnp.concatenate([error_offsets, jnp.tile(limits.offsets, len(gains))])
    widths = error_offsets[:3]
    bounds = bounds - rows.back_off * (bounds + jnp.abs(own) @ widths)
    normals = jnp.concatenate([own, jnp.asarray(rows.held_normals)])[rows.roots]
    offsets = jnp.concatenate([bounds, jnp.asarray(rows.held_offsets)])[rows.roots]
    for step in range(LONGEST):
        loop = jnp.asarray(rows.paths)[:, step]
        ended = loop < 0
        reach = support(generators, normals) + rows.back_off * (jnp.abs(normals) @ widths)
        before = jnp.einsum("fn,fnm->fm", normals, loops[loop])
        offsets = jnp.where(ended, offsets, offsets - (1.0 + INFLATION) * reach)
        normals = jnp.where(ended[:, None], normals, before)
    size = jnp.where(rows.roots < len(own), offsets, 1.0)
    return normals / size[:, None], offsets / size
