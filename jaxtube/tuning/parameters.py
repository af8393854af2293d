"""Weights and gains as an unconstrained vector.

    Q = L_Q L_Q^T,   R = L_R L_R^T,   L lower triangular with exp(.) on its diagonal

Decoupled gains k1, k2, k3 > 0 count by their logarithms, the entries of vertex gains in units of
their own size at the start. What is not tuned keeps its value: weights, gains, or all off the
diagonals.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial
from typing import Literal, get_args

import jax
import jax.numpy as jnp
import msgspec
import numpy as np
from jax import Array
from jaxtyping import Bool, Float

from jaxtube.qp.regions import AnyArray
from jaxtube.scenario.tree import Scenario
from jaxtube.synthesis.problem import Problem
from jaxtube.tuning.loop import Weights

Point = Float[np.ndarray, " free"]

Variables = Literal["both", "weights", "gains", "diagonal"]
"""What moves: Q, R and gains; Q and R; the gains; the diagonals of Q and R alone."""

WEIGHT_NAMES = ("Q11", "Q21", "Q22", "Q31", "Q32", "Q33", "R11", "R21", "R22")
DIAGONAL_NAMES = ("Q11", "Q22", "Q33", "R11", "R22")

LEAST_PIVOT = 1e-6
"""Share of its largest entry to which the eigenvalues of a weight are raised, so that a singular
one has a factor."""


@partial(
    jax.tree_util.register_dataclass,
    data_fields=["start", "scales"],
    meta_fields=["names", "moves"],
)
@dataclass(frozen=True, eq=False)
class Parameters:
    """A vector's meaning: all parameters of a start, and which of them move."""

    start: Float[AnyArray, " all"]
    scales: Float[AnyArray, " kappa"]  # of vertex gains; empty for decoupled ones
    names: tuple[str, ...]
    moves: tuple[bool, ...]

    @property
    def vector(self) -> Point:
        """The start."""
        return self.start[np.array(self.moves)]

    @property
    def free_names(self) -> tuple[str, ...]:
        """Names of what moves."""
        return tuple(name for name, moves in zip(self.names, self.moves, strict=True) if moves)

    def start_at(self, vector: Point) -> Parameters:
        """Return the same parameters with another start."""
        start = np.array(self.start)
        start[np.array(self.moves)] = vector
        return replace(self, start=start)

    def weights(self, vector: Float[Array, " free"]) -> Weights:
        """Return Q, R and the gains' numbers; on the device, differentiable."""
        numbers = jnp.asarray(self.start).at[np.flatnonzero(self.moves)].set(vector)
        gains = numbers[9:]
        kappa = gains * self.scales if len(self.scales) else jnp.exp(gains)
        return Weights(square_weight(numbers[:6], 3), square_weight(numbers[6:9], 2), kappa)

    def scenario(self, scenario: Scenario, vector: Point) -> Scenario:
        """Return the scenario with these weights and gains, to the last bit."""
        weights = jax.tree.map(np.asarray, self.weights(jnp.asarray(vector)))
        if len(self.scales):
            gains = {"vertex_gains": _rows(weights.kappa.reshape(4, 6))}
        else:
            gains = {"tracking_gains": tuple(weights.kappa.tolist())}
        controller = msgspec.structs.replace(
            scenario.controller,
            error_weight=_rows(weights.error_weight),
            input_weight=_rows(weights.input_weight),
            **gains,
        )
        return msgspec.structs.replace(scenario, controller=controller)


def make_parameters(problem: Problem, variables: Variables = "both") -> Parameters:
    """Return the parameters of a problem whose scenario gives its gains.

    Raises:
        ValueError: where it gives none, and for unknown variables.
    """
    if variables not in get_args(Variables):
        known = ", ".join(get_args(Variables))
        raise ValueError(f"variables: {variables!r} is unknown; choose one of {known}")
    kappa = problem.given_gains
    if not len(kappa):
        raise ValueError(
            "controller.tracking_gains and controller.vertex_gains are empty: no gains to tune; "
            "start from a copy of the scenario `untuned`, which has gains, caps and a computed W"
        )
    if len(kappa) == 3:
        scales = np.empty(0)
        gains = np.log(kappa)
        gain_names = ("k1", "k2", "k3")
    else:
        scales = np.maximum(np.abs(kappa), 0.1 * np.abs(kappa).max())
        gains = kappa / scales
        gain_names = tuple(f"K{v}_{i}{j}" for v in "1234" for i in "12" for j in "123")
    start = np.concatenate(
        [factor_weight(problem.error_weight), factor_weight(problem.input_weight), gains]
    )
    names = (*WEIGHT_NAMES, *gain_names)
    return Parameters(start, scales, names, tuple(_moves(names, variables).tolist()))


def _moves(names: tuple[str, ...], variables: Variables) -> Bool[np.ndarray, " all"]:
    """Return which parameters move."""
    is_weight = np.isin(names, WEIGHT_NAMES)
    match variables:
        case "both":
            return np.ones(len(names), bool)
        case "weights":
            return is_weight
        case "gains":
            return ~is_weight
        case "diagonal":
            return np.isin(names, DIAGONAL_NAMES)


def square_weight(entries: Float[Array, " k"], n: int) -> Float[Array, "n n"]:
    """Return L L^T from the rows of L, logarithms on its diagonal; symmetric to the last bit."""
    lower = jnp.zeros((n, n), entries.dtype).at[np.tril_indices(n)].set(entries)
    lower = jnp.tril(lower, -1) + jnp.diag(jnp.exp(jnp.diag(lower)))
    product = lower @ lower.T
    return (product + product.T) / 2


def factor_weight(weight: Float[np.ndarray, "n n"]) -> Float[np.ndarray, " k"]:
    """Return the rows of L, logarithms on its diagonal; eigenvalues are raised to LEAST_PIVOT."""
    n = len(weight)
    missing = LEAST_PIVOT * np.abs(weight).max() - np.linalg.eigvalsh(weight)[0]
    lower = np.linalg.cholesky(weight + max(missing, 0.0) * np.eye(n))
    lower[np.diag_indices(n)] = np.log(np.diag(lower))
    return lower[np.tril_indices(n)]


def _rows(matrix: Float[np.ndarray, "m n"]) -> tuple[tuple[float, ...], ...]:
    return tuple(tuple(row) for row in matrix.tolist())
