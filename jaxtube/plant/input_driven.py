"""Plants that inputs drive, x+ = f(x, u, w), with w drawn in the hull of some vertices, or given.

They have no wheels: of a command they understand the inputs alone. Their schedule takes the place
of wheel speeds.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass

import jax
import jax.numpy as jnp
from jax import Array
from jaxtyping import Float, Key

from jaxtube.plant.protocol import (
    Advance,
    Command,
    Measurement,
    Script,
    Uncertainty,
    script_entry,
)
from jaxtube.plant.streams import Stream


@dataclass(frozen=True)
class InputDrivenPlant(ABC):
    """A plant with w drawn in the hull of its vertices: a vertex in half of the periods, inside in
    the others.

    Attributes:
        reference_wheels: the schedule of every period.
        disturbance_vertices: whose hull w lies in, the same in every period or by period.
    """

    reference_wheels: Float[Array, "steps p"]
    disturbance_vertices: Float[Array, "v q"] | Float[Array, "steps v q"]

    has_wheels = False

    def initial(self, keys: Key[Array, " batch"], errors: Float[Array, "batch n"]) -> tuple[()]:
        """Return no memory."""
        return ()

    def sense(
        self, keys: Key[Array, " batch"], step, memory: tuple[()], errors: Float[Array, "batch n"]
    ) -> tuple[Measurement, tuple[()]]:
        """Measure the errors exactly; there is no slip."""
        return Measurement(errors, jnp.zeros_like(errors[:, :2])), memory

    def advance(
        self,
        keys: Key[Array, " batch"],
        step,
        memory: tuple[()],
        errors: Float[Array, "batch n"],
        command: Command,
    ) -> Advance:
        """Move through one period with a disturbance drawn for it."""
        disturbances = jax.vmap(lambda key: self.disturbance(key, step))(keys)
        return self.move(step, errors, command.inputs, disturbances)

    @abstractmethod
    def move(
        self,
        step,
        errors: Float[Array, "batch n"],
        inputs: Float[Array, "batch m"],
        disturbances: Float[Array, "batch q"],
    ) -> Advance:
        """Move through one period under given disturbances."""

    def disturbance(self, key: Key[Array, ""], step) -> Float[Array, " q"]:
        """Draw one w: a vertex, or weights that are uniform on the simplex of the vertices."""
        stream = jax.random.fold_in(jax.random.fold_in(key, Stream.DISTURBANCE), step)
        side, inside = jax.random.split(stream)
        differs = self.disturbance_vertices.ndim == 3
        vertices = self.disturbance_vertices[step] if differs else self.disturbance_vertices
        count = vertices.shape[0]
        dtype = vertices.dtype
        index = jax.random.randint(side, (), 0, 2 * count)
        mixed = jax.random.exponential(inside, (count,), dtype)
        corner = (jnp.arange(count) == index).astype(dtype)
        weights = jnp.where(index < count, corner, mixed / jnp.sum(mixed))
        return weights @ vertices

    def uncertainties(self) -> dict[str, Uncertainty]:
        """Return the disturbance w of every period."""
        steps = len(self.reference_wheels)
        return {"disturbance": Uncertainty(self.disturbance_vertices, steps)}

    def under_script(self, script: Script) -> ScriptedPlant:
        """Return the plant under a given w (see `ScriptedPlant`)."""
        return ScriptedPlant(self, script)


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class ScriptedPlant:
    """A plant under a given `disturbance`, (steps, batch, q) in its hull; keys are ignored."""

    plant: InputDrivenPlant
    script: Script

    @property
    def reference_wheels(self) -> Float[Array, "steps p"]:
        """The schedule."""
        return self.plant.reference_wheels

    def initial(self, keys, errors: Float[Array, "batch n"]) -> tuple[()]:
        """Return no memory."""
        return ()

    def sense(
        self, keys, step, memory: tuple[()], errors: Float[Array, "batch n"]
    ) -> tuple[Measurement, tuple[()]]:
        """Measure the errors exactly."""
        return self.plant.sense(keys, step, memory, errors)

    def advance(
        self, keys, step, memory: tuple[()], errors: Float[Array, "batch n"], command: Command
    ) -> Advance:
        """Move through one period under the disturbance of the script."""
        disturbances = script_entry(self.script["disturbance"], step)
        return self.plant.move(step, errors, command.inputs, disturbances)
