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
from jaxtyping import Float

from jaxtube.control.mpc import AnyArray
from jaxtube.scenario import Scenario
from jaxtube.synthesis.problem import Problem
from jaxtube.tuning.loop import Weights

Tuned = Literal["both", "weights", "gains", "diagonal"]
"""What moves: Q, R and gains; Q and R; the gains; the diagonals of Q and R alone."""

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
    def vector(self) -> Float[np.ndarray, " free"]:
        """The start."""
        return self.start[np.array(self.moves)]

    @property
    def free_names(self) -> tuple[str, ...]:
        """Names of what moves."""
        return tuple(name for name, moves in zip(self.names, self.moves, strict=True) if moves)

    def beginning_at(self, vector: Float[np.ndarray, " free"]) -> Parameters:
        """Return the same parameters with another start."""
        start = np.array(self.start)
        start[np.array(self.moves)] = vector
        return replace(self, start=start)

    def weights(self, vector: Float[Array, " free"]) -> Weights:
        """Return Q, R and the gains' numbers; on the device, differentiable."""
        everything = jnp.asarray(self.start).at[np.flatnonzero(self.moves)].set(vector)
        error, inputs, gains = everything[:6], everything[6:9], everything[9:]
        kappa = gains * self.scales if len(self.scales) else jnp.exp(gains)
        return Weights(_product(error, 3), _product(inputs, 2), kappa)

    def scenario(self, scenario: Scenario, vector: Float[np.ndarray, " free"]) -> Scenario:
        """Return the scenario with these weights and gains, to the last bit."""
        error, inputs, kappa = (np.asarray(part) for part in self.weights(jnp.asarray(vector)))
        vertices = {"vertex_gains": _rows(kappa.reshape(4, 6))} if len(self.scales) else {}
        tracking = {} if len(self.scales) else {"tracking_gains": tuple(kappa.tolist())}
        changed = {
            "error_weight": _rows(error),
            "input_weight": _rows(inputs),
            **vertices,
            **tracking,
        }
        return msgspec.structs.replace(
            scenario, controller=msgspec.structs.replace(scenario.controller, **changed)
        )


def parameters(problem: Problem, tuned: Tuned = "both") -> Parameters:
    """Return the parameters of a problem whose scenario gives its gains.

    Raises:
        ValueError: where it gives none.
    """
    if tuned not in get_args(Tuned):
        raise ValueError(f"tuned: {tuned!r} is unknown; choose one of {', '.join(get_args(Tuned))}")
    kappa = problem.given_gains
    if not len(kappa):
        raise ValueError(
            "controller.tracking_gains and controller.vertex_gains are empty: no gains to tune; start from a copy of "
            "the scenario `untuned`, which has gains, caps and a computed W"
        )
    decoupled = len(kappa) == 3
    scales = np.empty(0) if decoupled else np.maximum(np.abs(kappa), 0.1 * np.abs(kappa).max())
    start = np.concatenate(
        [
            _factor(problem.error_weight),
            _factor(problem.input_weight),
            np.log(kappa) if decoupled else kappa / scales,
        ]
    )
    letters = (
        ["k1", "k2", "k3"]
        if decoupled
        else [f"K{v}_{i}{j}" for v in "1234" for i in "12" for j in "123"]
    )
    names = (*_entries("Q", 3), *_entries("R", 2), *letters)
    of_weights = np.arange(len(start)) < 9
    diagonal = np.isin(names, ["Q11", "Q22", "Q33", "R11", "R22"])
    free = {
        "both": of_weights | ~of_weights,
        "weights": of_weights,
        "gains": ~of_weights,
        "diagonal": diagonal,
    }[tuned]
    return Parameters(start, scales, names, tuple(free.tolist()))


def _product(entries: Float[Array, " k"], n: int) -> Float[Array, "n n"]:
    """Return L L^T from the rows of L, logarithms on its diagonal; symmetric to the last bit."""
    lower = jnp.zeros((n, n), entries.dtype).at[np.tril_indices(n)].set(entries)
    lower = jnp.tril(lower, -1) + jnp.diag(jnp.exp(jnp.diag(lower)))
    product = lower @ lower.T
    return (product + product.T) / 2


def _factor(weight: Float[np.ndarray, "n n"]) -> Float[np.ndarray, " k"]:
    missing = LEAST_PIVOT * np.abs(weight).max() - np.linalg.eigvalsh(weight)[0]
    lower = np.linalg.cholesky(weight + max(missing, 0.0) * np.eye(len(weight)))
    lower[np.diag_indices(len(weight))] = np.log(np.diag(lower))
    return lower[np.tril_indices(len(weight))]


def _entries(letter: str, n: int) -> list[str]:
    return [f"{letter}{i + 1}{j + 1}" for i, j in zip(*np.tril_indices(n), strict=True)]


def _rows(matrix: Float[np.ndarray, "m n"]) -> tuple[tuple[float, ...], ...]:
    return tuple(tuple(row) for row in matrix.tolist())
