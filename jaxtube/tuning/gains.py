"""Gains and loops as affine functions of the tuned numbers, and the terminal cost that follows
them.

    K(th) = K_0(th) + sum_i kappa_i K_i(th),     Phi = A + B K likewise

kappa are (k1, k2, k3) of a decoupled gain, or all entries of the four vertex gains. The terminal
cost P(kappa, Q, R) is the centred one of `sets.lyapunov`: where its slope F(P; kappa, Q, R)
vanishes. By the implicit function theorem one Newton step from the answer, its curvature held
fixed, has the answer's value and its derivative.
"""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Float

from jaxtube.qp.regions import AnyArray
from jaxtube.synthesis.gains import given_gain
from jaxtube.synthesis.problem import Problem
from sets import lyapunov
from sets.semidefinite import symmetric_basis


class Affine(NamedTuple):
    """constant + kappa slopes."""

    constant: Float[AnyArray, "..."]
    slopes: Float[AnyArray, "kappa ..."]

    def at(self, kappa: Float[Array, " kappa"]) -> Float[Array, "..."]:
        """Return the value for the tuned numbers."""
        return self.constant + jnp.tensordot(kappa, self.slopes, axes=1)


class GainMaps(NamedTuple):
    """All gains and loops of a design: along its windows, at the corners of its regions, and in
    pairs as vertices."""

    window_gains: Affine  # (windows, horizon, 2, 3)
    window_loops: Affine  # (windows, horizon, 3, 3)
    corner_gains: Affine  # (corners, 2, 3)
    vertex_loops: Affine  # (pairs, 3, 3)
    vertex_gains: Affine  # (pairs, 2, 3)


class GainValues(NamedTuple):
    """The values of `GainMaps` for given numbers, in the same order."""

    window_gains: Float[np.ndarray, "windows horizon 2 3"]
    window_loops: Float[np.ndarray, "windows horizon 3 3"]
    corner_gains: Float[np.ndarray, "corners 2 3"]
    vertex_loops: Float[np.ndarray, "pairs 3 3"]
    vertex_gains: Float[np.ndarray, "pairs 2 3"]


def make_gain_maps(problem: Problem, schedules: Float[np.ndarray, "windows horizon 2"]) -> GainMaps:
    """Read the maps off the gains themselves, which are affine in the tuned numbers."""
    size = len(problem.given_gains)
    constants = _gains_and_loops(problem, schedules, np.zeros(size))
    units = [_gains_and_loops(problem, schedules, unit) for unit in np.eye(size)]
    maps = []
    for i, constant in enumerate(constants):
        values = np.stack([unit[i] for unit in units])
        maps.append(Affine(constant, values - constant))
    return GainMaps(*maps)


def _gains_and_loops(
    problem: Problem,
    schedules: Float[np.ndarray, "windows horizon 2"],
    kappa: Float[np.ndarray, " kappa"],
) -> GainValues:
    """Return the values of all maps for the tuned numbers."""
    gain = given_gain(problem, kappa)
    transitions, inputs = problem.model.matrices(schedules)
    window_gains = gain.at(problem.model.weights(schedules))
    window_loops = transitions + inputs @ window_gains
    vertex_loops, vertex_gains = gain.pairs
    return GainValues(window_gains, window_loops, gain.corner_gains, vertex_loops, vertex_gains)


def differentiate_terminal_cost(
    cost: Float[AnyArray, "3 3"],
    loops: Float[Array, "v 3 3"],
    gains: Float[Array, "v 2 3"],
    error_weight: Float[Array, "3 3"],
    input_weight: Float[Array, "2 2"],
) -> Float[Array, "3 3"]:
    """Return `cost`, the centred terminal cost of these very loops, gains and weights, with its
    derivative with respect to them."""
    answer = jnp.asarray(cost)
    stage = error_weight + jnp.swapaxes(gains, 1, 2) @ input_weight @ gains
    slope, curvature = lyapunov.centring(answer, loops, stage, jnp)
    step = jnp.linalg.solve(jax.lax.stop_gradient(curvature), slope)
    return answer - jnp.tensordot(step, symmetric_basis(len(cost)), axes=1)
