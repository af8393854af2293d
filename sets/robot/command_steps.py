"""How far what the wheels are told changes from one period to the next.

Over ground wheel j is told  s_j = V_j - (u1 +- (b/2) u2) - N,  N = V - v - u1 being what the input
map adds. Over a box of z = (e, u, V_r, V_l) that holds both periods, with |dN/dz_i| <= G_i there,
the mean value theorem gives for the differences D between them

    |D s_j| <= |D V_j| + max(|D u1 + l D u2|, |D u1 - l D u2|) + G_u1 |D u1|
               + sum_e G_i |D e_i| + sum_V G_i |D V_i|,              l = b / 2 + G_u2

for the lever of u2 lies between -l and l, and the bound is convex in it. The errors change by
D e = (A - I) e + B u + w.

Source: new.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from sets.interval import Dual, Interval
from sets.robot.operation import Operation
from sets.robot.plant import Kinematics, plane_rows, split_disturbance

PIECES = (3, 4, 4, 2, 8, 2, 2)
"""Parts into which the ranges of errors, inputs and reference wheel speeds are cut for slopes."""
OUTWARDS = 1 + 1e-12
"""Factor that covers the rounding of sums of a few terms."""


class MapSlopes(NamedTuple):
    """Greatest |dN/dz_i|: by errors (1/s, 1/s, m/s per rad), inputs (1, m), and reference wheel
    speeds (1, 1)."""

    errors: Float[np.ndarray, "3"]
    inputs: Float[np.ndarray, "2"]
    wheels: Float[np.ndarray, "2"]


class ModelRange(NamedTuple):
    """Where [A B] lies over all reference wheel speeds: within a radius of a middle, by entry."""

    middle: Float[np.ndarray, "3 5"]
    radius: Float[np.ndarray, "3 5"]


def bound_map_slopes(operation: Operation, kinematics: Kinematics) -> MapSlopes:
    """Bound the slopes of what the input map adds, over a box around the whole operation.

    Raises:
        ValueError: where an angle may leave a quarter turn.
    """
    count = len(PIECES)
    lower, upper = operation.box[:, :count]
    width = (upper - lower) / PIECES
    number = np.indices(PIECES).reshape(count, -1)
    low = lower[:, None] + width[:, None] * number
    # The next piece begins where this one ends, to the last bit.
    high = lower[:, None] + width[:, None] * (number + 1)
    high = np.where(number + 1 == np.array(PIECES)[:, None], upper[:, None], high)
    seeds = np.broadcast_to(np.eye(count)[:, :, None], (count, *low.shape))
    cells = zip(low, high, seeds, strict=True)
    variables = [Dual(Interval(*ends), Interval(seed, seed)) for *ends, seed in cells]
    still = Dual(Interval(0 * low[0], 0 * low[0]), Interval(0 * low, 0 * low))
    without_ground = operation.box.shape[1] - count
    parts = split_disturbance(kinematics, operation.period, variables + [still] * without_ground)
    _, _, _, u1, _, right, left = variables
    added = (right + left - parts.right - parts.left) * 0.5 - u1
    _, largest = added.gradient.magnitudes
    slopes = largest.max(axis=1)
    return MapSlopes(slopes[:3], slopes[3:5], slopes[5:])


def enclose_model(operation: Operation, kinematics: Kinematics) -> ModelRange:
    """Enclose A and B of the model over all reference wheel speeds of the operation."""
    lower, upper = operation.box[:, 5:7]
    V_r = Interval(lower[0], upper[0])
    V_l = Interval(lower[1], upper[1])
    length = (V_r + V_l) * (0.5 * operation.dt)
    units = (1.0, 1.0, length, 1.0, length)
    # An entry may be a number; added to an interval that is 0 it is one.
    rows = [
        [(0.0 * length + entry) * unit for entry, unit in zip(row, units, strict=True)]
        for row in plane_rows(kinematics, operation.period, V_r, V_l)
    ]
    low = np.array([[entry.lower for entry in row] for row in rows] + [[0, 0, 1, 0, operation.dt]])
    high = np.array([[entry.upper for entry in row] for row in rows] + [[0, 0, 1, 0, operation.dt]])
    middle = (low + high) / 2
    radius = np.maximum(high - middle, middle - low) * OUTWARDS
    return ModelRange(middle, radius + (OUTWARDS - 1) * np.abs(middle))


def bound_error_steps(
    operation: Operation, model: ModelRange, disturbance: Float[np.ndarray, "3"]
) -> Float[np.ndarray, "3"]:
    """Bound |D e| (m, m, rad) from one period to the next, w within half widths."""
    largest = np.abs(operation.box[:, :5]).max(axis=0)
    moved = model.middle - np.eye(3, 5)
    return OUTWARDS * ((np.abs(moved) + model.radius) @ largest + disturbance)


def bound_mapped_steps(
    slopes: MapSlopes,
    operation: Operation,
    error_steps: Float[np.ndarray, "3"],
    reference_steps: Float[np.ndarray, "2"],
) -> float:
    """Bound what the input map adds to the change of a command over ground, m/s, beside the lever
    that it gives u2."""
    braking = np.ptp(operation.inputs[:, 0])
    of_inputs = slopes.inputs[0] * braking + slopes.wheels @ reference_steps
    return float(OUTWARDS * (slopes.errors @ error_steps + of_inputs))
