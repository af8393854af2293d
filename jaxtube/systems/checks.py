"""How parts of a linear system are read and refused: one line, `system: FIELD = VALUE: what is
wrong; cure`."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from jaxtyping import Float

from jaxtube.arguments import find_whole
from jaxtube.scenario.refusal import ScenarioError, refusal
from sets.polytope import Polytope

SUM = 1e-9
"""By how much the weights of a period may miss 1: rounding."""
SYMMETRIC = 1e-12
"""Relative difference from its transpose that is rounding."""


def refuse(name: str, value: Any, problem: str, cure: str) -> ScenarioError:
    """Return the refusal of a field."""
    shown = value.tolist() if isinstance(value, np.ndarray) else value
    return refusal("system", name, shown, problem, cure)


def read_matrices(A: Any, B: Any) -> tuple[Float[np.ndarray, "v n n"], Float[np.ndarray, "v n m"]]:
    """Return A and B of all vertices.

    Raises:
        ScenarioError: where their shapes do not go together, or a number is not finite.
    """
    transitions = _read_stack("A", A)
    inputs = _read_stack("B", B)
    states = transitions.shape[1]
    if transitions.shape[2] != states:
        raise refuse("A", transitions.shape[1:], "is no square shape", "give (states, states)")
    if inputs.shape[1] != states:
        raise refuse(
            "B", inputs.shape[1:], f"has {inputs.shape[1]} rows, A {states}", f"give {states} rows"
        )
    counts = {len(transitions), len(inputs)} - {1}
    if len(counts) > 1:
        raise refuse(
            "B",
            inputs.shape,
            f"has {len(inputs)} vertices, A {len(transitions)}",
            "give as many of both, or one matrix for all",
        )
    count = max(len(transitions), len(inputs))
    return (
        np.broadcast_to(transitions, (count, *transitions.shape[1:])),
        np.broadcast_to(inputs, (count, *inputs.shape[1:])),
    )


def _read_stack(name: str, value: Any) -> Float[np.ndarray, "v a b"]:
    try:
        matrices = np.asarray(value, float)
    except (TypeError, ValueError):
        raise refuse(
            name, type(value).__name__, "is no array", "give numbers of one shape"
        ) from None
    if matrices.ndim == 2:
        matrices = matrices[None]
    if matrices.ndim != 3 or not matrices.size:
        raise refuse(
            name, matrices.shape, "is no shape of matrices", "give (vertices, rows, columns)"
        )
    _check_finite(name, matrices)
    return matrices


def _check_finite(name: str, values: np.ndarray) -> None:
    if not np.all(np.isfinite(values)):
        wrong = float(values[~np.isfinite(values)][0])
        raise refuse(name, wrong, "is not finite", "give finite numbers")


def read_vector(name: str, value: Any, size: int) -> Float[np.ndarray, " n"]:
    """Return a vector of so many finite numbers."""
    vector = np.asarray(value, float)
    if vector.shape != (size,):
        raise refuse(name, vector.shape, "is another shape", f"give ({size},)")
    _check_finite(name, vector)
    return vector


def read_set(name: str, value: Any, dimension: int) -> Polytope:
    """Return a set that is given as a polytope, or by the half widths of a box."""
    if not isinstance(value, Polytope):
        half = read_vector(name, value, dimension)
        if np.any(half < 0):
            raise refuse(name, half, "has a half width below 0", "give half widths of 0 or more")
        return Polytope.box(-half, half)
    if value.dimension != dimension:
        raise refuse(
            name, value.dimension, f"is its dimension, not {dimension}", f"give one in {dimension}"
        )
    return value


def check_bounded_around_origin(name: str, polytope: Polytope) -> None:
    """Refuse a set that is unbounded, or has the origin outside or on its boundary."""
    _check_bounded(name, polytope)
    if np.min(polytope.with_unit_normals().offsets) <= 0:
        raise refuse(
            name,
            polytope.offsets,
            "does not hold the origin in its interior",
            "shift states and inputs so that the set point is the origin",
        )


def check_holds_origin(name: str, polytope: Polytope) -> None:
    """Refuse a set that is unbounded, or does not hold the origin."""
    _check_bounded(name, polytope)
    if np.min(polytope.offsets, initial=0.0) < 0:
        raise refuse(
            name,
            polytope.offsets,
            "does not hold the origin, the case of no disturbance",
            "move its mean into the model or widen the set",
        )


def _check_bounded(name: str, polytope: Polytope) -> None:
    if polytope.is_empty():
        raise refuse(name, polytope.offsets, "is empty", "give a set with points")
    if not polytope.is_bounded():
        raise refuse(name, polytope.offsets, "is not bounded", "add the rows that are missing")


def check_weights(name: str, value: Any, size: int) -> Float[np.ndarray, "n n"]:
    """Return a symmetric weight: R positive definite, Q semidefinite and not zero."""
    weight = np.asarray(value, float)
    if weight.shape != (size, size):
        raise refuse(name, weight.shape, "is another shape", f"give ({size}, {size})")
    _check_finite(name, weight)
    most = np.abs(weight).max()
    if np.abs(weight - weight.T).max() > SYMMETRIC * most:
        raise refuse(name, weight, "is not symmetric", "give (Q + Q.T) / 2")
    least = float(np.linalg.eigvalsh(weight)[0])
    if name == "R" and least <= 0:
        raise refuse(name, weight, f"has an eigenvalue of {least:.3g}", "make it positive definite")
    if least < -SYMMETRIC * most or most == 0:
        raise refuse(
            name, weight, f"has an eigenvalue of {least:.3g}", "make it semidefinite and not zero"
        )
    return weight


def check_count(name: str, value: Any, least: int) -> None:
    """Refuse what is no whole number of at least so much."""
    count = find_whole(value)
    if count is None or count < least:
        raise refuse(name, value, "is too small or no whole number", f"give {least} or more")


def check_choice(name: str, value: Any, choices: Sequence[str]) -> None:
    """Refuse what is none of the choices."""
    if value not in choices:
        raise refuse(name, value, "is unknown", f"choose one of {', '.join(choices)}")


def read_schedule(value: Any, vertices: int, periods: int) -> Float[np.ndarray, "periods v"]:
    """Return the weights of the vertices in every period.

    Raises:
        ScenarioError: where they are missing, of another shape, negative, or do not add up to 1.
    """
    if value is None:
        if vertices > 1:
            raise refuse(
                "schedule",
                "none",
                f"{vertices} vertices need weights in every period",
                "give (periods, vertices), or call without_schedule() where nobody knows them",
            )
        return np.ones((periods, 1))
    weights = np.asarray(value, float)
    if weights.ndim != 2 or weights.shape[1] != vertices or not len(weights):
        raise refuse("schedule", weights.shape, "is another shape", f"give (periods, {vertices})")
    _check_finite("schedule", weights)
    if np.min(weights) < 0 or np.max(np.abs(weights.sum(axis=1) - 1)) > SUM:
        row = int(np.argmax(np.abs(weights.sum(axis=1) - 1) - np.minimum(weights.min(axis=1), 0)))
        raise refuse(
            f"schedule[{row}]", weights[row], "is no mixture", "give weights >= 0 whose sum is 1"
        )
    return weights / weights.sum(axis=1, keepdims=True)
