"""Gains and loops as affine functions of the numbers that are tuned, and the terminal cost that
follows them.

    K(th) = K_0(th) + sum_i kappa_i K_i(th),     Phi = A + B K likewise

kappa are (k1, k2, k3) of a decoupled gain, or all entries of the four vertex gains. The terminal
cost P(kappa, Q, R) is the centred one of `sets.lyapunov`: where its slope F(P; kappa, Q, R)
vanishes, so that by the implicit function theorem one Newton step from the answer, its curvature
held fixed, has the answer's value and its derivative.
"""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Float

from jaxtube.control.mpc import AnyArray
from jaxtube.synthesis.gains import given_gain
from jaxtube.synthesis.problem import Problem
from sets import lyapunov


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


def gain_maps(problem: Problem, schedules: Float[np.ndarray, "windows horizon 2"]) -> GainMaps:
    """Read the maps off the gains themselves, which are affine in what the scenario gives of them."""
    transitions, inputs = problem.model.matrices(schedules)
    weights = problem.model.weights(schedules)

    def everything(kappa) -> tuple[np.ndarray, ...]:
        gain = given_gain(problem, kappa)
        loops, gains = gain.pairs
        along = gain.at(weights)
        return along, transitions + inputs @ along, gain.corner_gains, loops, gains

    size = len(problem.given_gains)
    constants, units = everything(np.zeros(size)), [everything(unit) for unit in np.eye(size)]
    return GainMaps(
        *(
            Affine(constant, np.stack([unit[i] for unit in units]) - constant)
            for i, constant in enumerate(constants)
        )
    )


def terminal_cost(
    found: Float[AnyArray, "3 3"],
    loops: Float[Array, "v 3 3"],
    gains: Float[Array, "v 2 3"],
    error_weight: Float[Array, "3 3"],
    input_weight: Float[Array, "2 2"],
) -> Float[Array, "3 3"]:
    """Return `found`, the centred terminal cost of these very data, with its derivative with
    respect to them."""
    stage = error_weight + jnp.swapaxes(gains, 1, 2) @ input_weight @ gains
    slope, curvature = lyapunov.centring(jnp.asarray(found), loops, stage, jnp)
    step = jnp.linalg.solve(jax.lax.stop_gradient(curvature), slope)
    return jnp.asarray(found) - jnp.tensordot(step, lyapunov.symmetric_basis(len(found)), axes=1)
