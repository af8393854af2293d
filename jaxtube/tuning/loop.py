"""The closed loop as a function of weights and gains: designed on the host, differentiated on the
device.

    (Q, R, kappa)  ->  gains, loops, P  ->  tube, margins  ->  condensed QPs  ->  laps

A design fixes what no derivative passes through: the reference, the history of the terminal set,
and the answer P about which the terminal cost is differentiated. All else is computed again from
(Q, R, kappa) on the device, equal to the design's own.
"""

from __future__ import annotations

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Float, Int

from jaxtube.control.mpc import AnyArray, Window
from jaxtube.synthesis.condense import (
    Bounds,
    Cost,
    Gains,
    Prediction,
    predict,
    row_bounds,
    weigh,
    widths,
    with_terminal_rows,
)
from jaxtube.synthesis.parts import Design
from jaxtube.synthesis.tightening import BACK_OFF
from jaxtube.tuning.gains import GainMaps, gain_maps, terminal_cost
from jaxtube.tuning.terminal import TerminalRows, terminal_rows, terminal_set
from jaxtube.tuning.tube import disturbance_generators, rows_under, sequence_reach, sequence_reaches

ROOM = 0.02
"""Share of a row's limit that the tube leaves at least where there is no plan; a design that has
one is far from it."""


class Weights(NamedTuple):
    """What is tuned: Q, R and the numbers of the gains."""

    error_weight: Float[AnyArray, "3 3"]
    input_weight: Float[AnyArray, "2 2"]
    kappa: Float[AnyArray, " kappa"]


class Fixed(NamedTuple):
    """What a design holds fixed while weights and gains move; of two shapes at most for all designs
    of a scenario."""

    maps: GainMaps
    ahead: Prediction
    generators: Float[AnyArray, "g 3"]  # of W
    error_rows: Float[AnyArray, "6 3"]
    error_offsets: Float[AnyArray, " 6"]
    input_rows: Float[AnyArray, "k 2"]
    input_error_rows: Float[AnyArray, "k 3"]
    input_offsets: Float[AnyArray, " k"]
    terminal_rows: TerminalRows
    terminal_cost: Float[AnyArray, "3 3"]
    widths: Float[AnyArray, "3"]
    index: Int[AnyArray, " steps"]


def fix(design: Design) -> Fixed:
    """Take from a design (terminal T-A, tube `sequence`) what stays fixed; unused terminal rows are
    unbounded.

    Raises:
        ValueError: where no input reaches a terminal row, so that it is no row of the plan.
    """
    problem, windows, terminal, rows = (
        design.problem,
        design.windows,
        design.terminal,
        design.problem.input_rows,
    )
    normals, offsets = terminal.constraint_normals, terminal.constraint_offsets[0]
    generators = disturbance_generators(problem)
    taken = sequence_reach(
        jnp.asarray(windows.loops[:1]),
        jnp.asarray(generators),
        jnp.asarray(normals)[None],
        problem.horizon,
    )
    spare = -len(normals) % problem.scenario.controller.terminal_facets
    normals = np.concatenate([normals, np.repeat(normals[:1], spare, axis=0)])
    offsets = np.concatenate([offsets + np.asarray(taken)[0], np.full(spare, np.inf)])
    ahead = predict(problem, windows, normals)
    count = len(ahead.reached) + len(ahead.unreached)
    if np.any(ahead.unreached >= count - len(normals)):
        raise ValueError("controller.horizon: no input reaches a terminal row; lengthen it")
    return Fixed(
        maps=gain_maps(problem, windows.schedules),
        ahead=ahead,
        generators=generators,
        error_rows=problem.operating_set.normals,
        error_offsets=problem.operating_set.offsets,
        input_rows=rows.inputs,
        input_error_rows=rows.errors,
        input_offsets=rows.offsets,
        terminal_rows=terminal_rows(design, normals, offsets),
        terminal_cost=design.cost.cost,
        widths=widths(problem),
        index=windows.index,
    )


def terminal_set_of(
    fixed: Fixed, kappa: Float[Array, " kappa"]
) -> tuple[Float[Array, "facets 3"], Float[Array, " facets"]]:
    """Return normals and offsets of the terminal set, before the tube is taken off."""
    return terminal_set(
        fixed.terminal_rows,
        fixed.maps.vertex_loops.at(kappa),
        fixed.maps.corner_gains.at(kappa),
        fixed.generators,
        (fixed.error_rows, fixed.error_offsets),
        (fixed.input_rows, fixed.input_error_rows, fixed.input_offsets),
    )


def tightened(fixed: Fixed, kappa: Float[Array, " kappa"]) -> Bounds:
    """Return E_j, U_j and the terminal constraint as `condense.tube_bounds` does, at least ROOM of
    each limit left."""
    gains, loops = fixed.maps.window_gains.at(kappa), fixed.maps.window_loops.at(kappa)
    count, N = loops.shape[:2]
    back_off = BACK_OFF * jnp.arange(1.0, N + 1)[:, None]
    errors = sequence_reaches(
        loops,
        fixed.generators,
        jnp.broadcast_to(fixed.error_rows, (count, N, *fixed.error_rows.shape)),
    )
    under = rows_under(fixed.input_rows, fixed.input_error_rows, gains)
    inputs = sequence_reaches(loops, fixed.generators, under)
    normals, offsets = terminal_set_of(fixed, kappa)
    last = sequence_reach(
        loops, fixed.generators, jnp.broadcast_to(normals, (count, *normals.shape)), N
    )
    last = last + (N + 1) * BACK_OFF * jnp.linalg.norm(normals, axis=1)

    def left(offsets, taken):
        return jnp.maximum(offsets - taken, ROOM * offsets)

    return Bounds(
        left(fixed.error_offsets, errors + back_off),
        left(fixed.input_offsets, inputs + back_off),
        normals,
        left(offsets, last),
    )


def terminal_weight(fixed: Fixed, weights: Weights) -> Float[Array, "3 3"]:
    """Return P, which follows Q, R and the gains."""
    loops, gains = (
        fixed.maps.vertex_loops.at(weights.kappa),
        fixed.maps.vertex_gains.at(weights.kappa),
    )
    return terminal_cost(
        fixed.terminal_cost, loops, gains, weights.error_weight, weights.input_weight
    )


def windows_of(fixed: Fixed, weights: Weights) -> Window:
    """Return the condensed QPs along the reference."""
    gains = fixed.maps.window_gains.at(weights.kappa)[:, 0]
    cost = Cost(weights.error_weight, weights.input_weight, terminal_weight(fixed, weights))
    bounds = tightened(fixed, weights.kappa)
    ahead = with_terminal_rows(fixed.ahead, bounds.terminal_normals)
    return weigh(ahead, row_bounds(bounds, ahead), Gains(gains, gains), cost, fixed.widths)
