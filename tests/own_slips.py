"""A slip process as a user would write it."""

from dataclasses import dataclass

import jax.numpy as jnp


@dataclass(frozen=True)
class Worst:
    """Slips at their greatest error, all the time."""

    opposed = False

    def initial(self, key, dtype):
        return ()

    def draw(self, key, step, memory, situation):
        return jnp.ones(2, situation.errors.dtype), memory
