"""The terminal set as a function of the local gains, differentiable where it is the maximal
invariant one.

Every row of the maximal set is the predecessor, along a path of loops, of an error limit or of an
input limit under a gain: with r such a limit's row, d its offset and W widened,

    c e <= o,    c = r Phi_{i1} .. Phi_{im},    o = d - (1 + INFLATION) sum over l < m of h_W(r Phi_{i1} .. Phi_{il})

Paths are recorded by the design and held: the set is then smooth in the gains but where some
product of a row and a generator of W is zero, and is the design's own as long as no row comes or
goes, which is where it cuts nothing, and no two coincide; there the derivative is that of a side. A
set of fewer facets than the maximal one has no such history: its rows are held as they are.

Source: Gilbert and Tan 1991; Blanchini 1999.
"""

from __future__ import annotations

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Float, Int

from jaxtube.control.mpc import AnyArray
from jaxtube.synthesis.parts import Design
from jaxtube.synthesis.terminal import Terminal, set_back_off
from jaxtube.tuning.tube import rows_under, support
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


def terminal_rows(
    found: Design,
    normals: Float[np.ndarray, "facets 3"],
    offsets: Float[np.ndarray, " facets"],
) -> TerminalRows:
    """Return the history of a design's terminal rows, in their order.

    Args:
        found: the design.
        normals: of its constraint on e_N, spare rows behind.
        offsets: before the tube is taken off, infinite for spare rows.
    """
    problem, terminal, maximal = found.problem, found.terminal, found.terminal.maximal
    gains = terminal.gains.corner_gains
    of_errors, of_inputs = len(problem.operating_set.offsets), len(problem.input_rows.offsets)
    roots = of_errors + len(gains) * of_inputs + np.arange(len(normals))
    paths = np.full((len(normals), LONGEST), -1)
    followed = _followed(terminal)
    if followed is not None:
        # Sets are made of distinct gains and loops: the first of equal ones stands for all.
        corner = np.unique(gains, axis=0, return_index=True)[1]
        pair = np.unique(terminal.gains.pairs[0].reshape(-1, 9), axis=0, return_index=True)[1]
        where = {normal.tobytes(): at for at, normal in enumerate(followed.normals)}
        for row in np.flatnonzero(np.isfinite(offsets)):
            at = where[normals[row].tobytes()]
            root, path = maximal.roots[at], list(maximal.paths[at])
            if root >= of_errors:
                gain, limit = divmod(root - of_errors, of_inputs)
                root = of_errors + corner[gain] * of_inputs + limit
            roots[row], paths[row, : len(path)] = root, np.sort(pair)[path]
    return TerminalRows(roots, paths, normals, offsets, np.array(set_back_off(problem)))


def _followed(terminal: Terminal) -> Polytope | None:
    """Return the terminal set where it is the maximal one, in use, and its paths are not too long."""
    maximal = terminal.maximal
    if (
        terminal.fallback
        or terminal.invariant is not maximal.polytope
        or max(map(len, maximal.paths)) > LONGEST
    ):
        return None
    return maximal.polytope


def terminal_set(
    rows: TerminalRows,
    loops: Float[Array, "pairs 3 3"],
    gains: Float[Array, "corners 2 3"],
    generators: Float[Array, "g 3"],
    errors: tuple[Float[Array, "6 3"], Float[Array, " 6"]],
    inputs: tuple[Float[Array, "k 2"], Float[Array, "k 3"], Float[Array, " k"]],
) -> tuple[Float[Array, "facets 3"], Float[Array, " facets"]]:
    """Return normals and offsets of the terminal set, before the tube is taken off.

    Args:
        rows: their history.
        loops, gains: those of the vertex pairs, and the gains at the corners.
        generators: of W.
        errors: rows and offsets of E.
        inputs: rows  D u + C e <= offsets  of the inputs: D, C, offsets.
    """
    under = rows_under(*inputs[:2], gains)
    own = jnp.concatenate([errors[0], under.reshape(-1, 3)])
    limits = jnp.concatenate([errors[1], jnp.tile(inputs[2], len(gains))])
    limits = limits - rows.back_off * (1.0 + jnp.linalg.norm(own, axis=1))
    normals = jnp.concatenate([own, jnp.asarray(rows.held_normals)])[rows.roots]
    offsets = jnp.concatenate([limits, jnp.asarray(rows.held_offsets)])[rows.roots]
    for step in range(LONGEST):
        loop = jnp.asarray(rows.paths)[:, step]
        reach = support(generators, normals) + rows.back_off * jnp.linalg.norm(normals, axis=1)
        offsets = jnp.where(loop < 0, offsets, offsets - (1.0 + INFLATION) * reach)
        normals = jnp.where(
            loop[:, None] < 0, normals, jnp.einsum("fn,fnm->fm", normals, loops[loop])
        )
    size = jnp.where(rows.roots < len(own), offsets, 1.0)
    return normals / size[:, None], offsets / size
