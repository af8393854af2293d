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

from jaxtube.control.planning import CondensedQp
from jaxtube.qp.regions import AnyArray
from jaxtube.synthesis.condense import Bounds, Cost, Gains, row_bounds, weigh, widths
from jaxtube.synthesis.parts import Design
from jaxtube.synthesis.prediction import Prediction, predict, with_terminal_rows
from jaxtube.synthesis.terminal_cost import in_shares
from jaxtube.synthesis.tightening import find_back_off
from jaxtube.tuning.caps import CapLimits, make_limits
from jaxtube.tuning.gains import GainMaps, differentiate_terminal_cost, make_gain_maps
from jaxtube.tuning.terminal import TerminalRows, compute_terminal_set, trace_terminal_rows
from jaxtube.tuning.tube import (
    closed_loop_rows,
    disturbance_generators,
    reach_along,
    sequence_reaches,
)

ROOM = 0.02
"""Least share of a row's limit that the tube leaves where there is no plan; a design that has a
plan leaves far more."""


class Weights(NamedTuple):
    """What is tuned: Q, R and the numbers of the gains."""

    error_weight: Float[AnyArray, "3 3"]
    input_weight: Float[AnyArray, "2 2"]
    kappa: Float[AnyArray, " kappa"]


class DesignConstants(NamedTuple):
    """What a design holds fixed while weights and gains move; the designs of a scenario have two
    sets of shapes at most."""

    maps: GainMaps
    ahead: Prediction
    generators: Float[AnyArray, "g 3"]  # of W
    error_rows: Float[AnyArray, "6 3"]
    error_offsets: Float[AnyArray, " 6"]
    limits: CapLimits
    terminal_rows: TerminalRows
    terminal_cost: Float[AnyArray, "3 3"]
    widths: Float[AnyArray, "3"]
    back_off: Float[AnyArray, ""]
    index: Int[AnyArray, " steps"]


def make_design_constants(design: Design) -> DesignConstants:
    """Take from a design (terminal T-A, tube `sequence`) what stays constant.

    Raises:
        ValueError: where no input reaches a terminal row, so that it is no row of the plan.
    """
    problem = design.problem
    windows = design.windows
    generators = disturbance_generators(problem)
    normals, offsets = _padded_terminal_constraint(design, generators)
    ahead = predict(problem, windows, normals)
    count = len(ahead.reached) + len(ahead.unreached)
    if np.any(ahead.unreached >= count - len(normals)):
        raise ValueError("controller.horizon: no input reaches a terminal row; lengthen it")
    return DesignConstants(
        maps=make_gain_maps(problem, windows.schedules),
        ahead=ahead,
        generators=generators,
        error_rows=problem.operating_set.normals,
        error_offsets=problem.operating_set.offsets,
        limits=make_limits(problem),
        terminal_rows=trace_terminal_rows(design, normals, offsets),
        terminal_cost=design.cost.cost,
        widths=widths(problem),
        back_off=np.array(find_back_off(problem)),
        index=windows.index,
    )


def _padded_terminal_constraint(
    design: Design, generators: Float[np.ndarray, "g 3"]
) -> tuple[Float[np.ndarray, "facets 3"], Float[np.ndarray, " facets"]]:
    """Return normals and offsets of the terminal set before the tube is taken off, filled up to a
    multiple of `terminal_facets` with copies of the first row that bound nothing."""
    normals = design.terminal.constraint_normals
    reach = reach_along(
        jnp.asarray(design.windows.loops[:1]),
        jnp.asarray(generators),
        jnp.asarray(normals)[None],
        design.problem.horizon,
    )
    offsets = design.terminal.constraint_offsets[0] + np.asarray(reach)[0]
    spare = -len(normals) % design.problem.scenario.controller.terminal_facets
    spare_normals = np.repeat(normals[:1], spare, axis=0)
    spare_offsets = np.full(spare, np.inf)
    return (
        np.concatenate([normals, spare_normals]),
        np.concatenate([offsets, spare_offsets]),
    )


def terminal_set_at(
    constants: DesignConstants, kappa: Float[Array, " kappa"]
) -> tuple[Float[Array, "facets 3"], Float[Array, " facets"]]:
    """Return normals and offsets of the terminal set, before the tube is taken off."""
    return compute_terminal_set(
        constants.terminal_rows,
        constants.maps.vertex_loops.at(kappa),
        constants.maps.corner_gains.at(kappa),
        constants.generators,
        (constants.error_rows, constants.error_offsets),
        constants.limits,
    )


def tightened_bounds(constants: DesignConstants, kappa: Float[Array, " kappa"]) -> Bounds:
    """Return E_j, U_j and the terminal constraint as `condense.tube_bounds` does, with ROOM of each
    limit left at least."""
    gains = constants.maps.window_gains.at(kappa)
    loops = constants.maps.window_loops.at(kappa)
    count, horizon = loops.shape[:2]
    error_rows = jnp.broadcast_to(
        constants.error_rows, (count, horizon, *constants.error_rows.shape)
    )
    input_rows = closed_loop_rows(constants.limits.inputs, constants.limits.errors, gains)
    errors = sequence_reaches(loops, constants.generators, error_rows)
    inputs = sequence_reaches(loops, constants.generators, input_rows)
    normals, offsets = terminal_set_at(constants, kappa)
    terminal_rows = jnp.broadcast_to(normals, (count, *normals.shape))
    last = reach_along(loops, constants.generators, terminal_rows, horizon)
    back_off = constants.back_off * jnp.arange(1.0, horizon + 1)[:, None]
    reach = jnp.abs(normals) @ constants.widths
    last_back_off = (horizon + 1) * constants.back_off * reach

    def subtract(offsets, taken):
        return jnp.maximum(offsets - taken, ROOM * offsets)

    return Bounds(
        errors=subtract(constants.error_offsets, errors + back_off * constants.error_offsets),
        inputs=subtract(constants.limits.offsets, inputs + back_off * constants.limits.offsets),
        terminal_normals=normals,
        terminal=subtract(offsets, last + last_back_off),
    )


def terminal_weight(constants: DesignConstants, weights: Weights) -> Float[Array, "3 3"]:
    """Return P, which follows Q, R and the gains."""
    limits = jnp.asarray(constants.widths)
    units = limits * limits[:, None]
    of_shares = in_shares(
        constants.maps.vertex_loops.at(weights.kappa),
        constants.maps.vertex_gains.at(weights.kappa),
        weights.error_weight,
        limits,
    )
    cost = constants.terminal_cost * units
    return differentiate_terminal_cost(cost, *of_shares, weights.input_weight) / units


def condense_windows(constants: DesignConstants, weights: Weights) -> CondensedQp:
    """Return the condensed QPs along the reference."""
    gains = constants.maps.window_gains.at(weights.kappa)[:, 0]
    cost = Cost(weights.error_weight, weights.input_weight, terminal_weight(constants, weights))
    bounds = tightened_bounds(constants, weights.kappa)
    ahead = with_terminal_rows(constants.ahead, bounds.terminal_normals)
    return weigh(ahead, row_bounds(bounds, ahead), Gains(gains, gains), cost, constants.widths)
