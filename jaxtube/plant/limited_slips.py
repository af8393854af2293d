"""Slip processes whose deviations change by no more than so much from one period to the next.

`Limited` lets any other process say where the slips are to go, and lets them go there at most a
step a period. What is drawn afresh is drawn again only once it is reached, so that slips ramp from
one value to the next, from extreme to extreme under "vertex"; the ground and an adversary are
followed as they change.

Source: new.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import jax.numpy as jnp
from jax import Array
from jax.typing import DTypeLike
from jaxtyping import Bool, Float, Key

from jaxtube.plant.protocol import Memory
from jaxtube.plant.slip import SlipProcess
from jaxtube.plant.slip_processes import Iid, Vertex, Walk

DRAWN_AFRESH = (Iid, Vertex, Walk)
"""Processes whose draws are waited for."""


class LimitedMemory(NamedTuple):
    """Deviations (right, left) of one slip: where it is, where it goes, and whether it began."""

    process: Memory
    xi: Float[Array, "2"]
    target: Float[Array, "2"]
    has_begun: Bool[Array, ""]


@dataclass(frozen=True)
class Limited:
    """A process that follows another one (see the module).

    Attributes:
        process: where deviations go.
        steps: greatest changes a period (right, left), in units of xi.
    """

    process: SlipProcess
    steps: tuple[float, float]

    @property
    def opposed(self) -> bool:
        """Whether the process acts against the robot."""
        return self.process.opposed

    def initial(self, key: Key[Array, ""], dtype: DTypeLike) -> LimitedMemory:
        """Return the memory before the first step, whose deviations are the process's own."""
        none = jnp.zeros(2, dtype)
        return LimitedMemory(self.process.initial(key, dtype), none, none, jnp.asarray(False))

    def draw(self, key, step, memory, situation):
        """Return deviations a step nearer to those drawn."""
        drawn, following = self.process.draw(key, step, memory.process, situation)
        target = drawn
        if isinstance(self.process, DRAWN_AFRESH):
            waits = memory.has_begun & (memory.xi != memory.target)
            target = jnp.where(waits, memory.target, drawn)
        most = jnp.asarray(self.steps, drawn.dtype)
        near = approach(memory.xi, target, most)
        xi = jnp.where(memory.has_begun, near, drawn)
        return xi, LimitedMemory(following, xi, target, jnp.asarray(True))


def approach(
    now: Float[Array, "... 2"], target: Float[Array, "... 2"], most: Float[Array, "2"]
) -> Float[Array, "... 2"]:
    """Return values at most a step nearer to a target, those within reach of it on it."""
    gap = target - now
    return jnp.where(jnp.abs(gap) <= most, target, now + jnp.clip(gap, -most, most))
