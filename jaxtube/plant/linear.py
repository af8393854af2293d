"""The prediction model as a plant, e+ = A(th) e + B(th) u + w with w in W, drawn or given.

It is driven by the virtual inputs of a command and has no wheels. On it the guarantee of a
tube-MPC is a theorem: a single violation refutes the code.
"""

from __future__ import annotations

from dataclasses import dataclass

import jax
import jax.numpy as jnp
from jax import Array
from jaxtyping import Float

from jaxtube.plant.input_driven import InputDrivenPlant
from jaxtube.plant.protocol import Advance


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class LinearPlant(InputDrivenPlant):
    """The prediction model with w drawn in W."""

    transitions: Float[Array, "steps n n"]
    input_matrices: Float[Array, "steps n m"]

    def move(
        self,
        step,
        errors: Float[Array, "batch n"],
        inputs: Float[Array, "batch m"],
        disturbances: Float[Array, "batch n"],
    ) -> Advance:
        """Move through one period under given disturbances."""
        A = self.transitions[step]
        B = self.input_matrices[step]
        following = errors @ A.T + inputs @ B.T + disturbances
        return Advance(following, (), jnp.full_like(inputs, jnp.nan))
