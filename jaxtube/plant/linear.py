"""The prediction model as a plant, e+ = A(th) e + B(th) u + w with w in W, drawn or given.

It is driven by the virtual inputs of a command and has no wheels. On it the guarantee of a
tube-MPC is a theorem: a single violation refutes the code.
"""

from __future__ import annotations

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


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class LinearPlant:
    """The prediction model with w drawn in W: a vertex in half of the periods, inside in the
    others."""

    reference_wheels: Float[Array, "steps 2"]
    transitions: Float[Array, "steps 3 3"]
    input_matrices: Float[Array, "steps 3 2"]
    disturbance_vertices: Float[Array, "v 3"] | Float[Array, "steps v 3"]  # where W differs by step

    has_wheels = False

    def initial(self, keys: Key[Array, " batch"], errors: Float[Array, "batch 3"]) -> tuple[()]:
        """Return no memory."""
        return ()

    def sense(
        self, keys: Key[Array, " batch"], step, memory: tuple[()], errors: Float[Array, "batch 3"]
    ) -> tuple[Measurement, tuple[()]]:
        """Measure the errors exactly; the model knows no slip."""
        return Measurement(errors, jnp.zeros_like(errors[:, :2])), memory

    def advance(
        self,
        keys: Key[Array, " batch"],
        step,
        memory: tuple[()],
        errors: Float[Array, "batch 3"],
        command: Command,
    ) -> Advance:
        """Move through one period with a disturbance drawn for it."""
        disturbances = jax.vmap(lambda key: self.disturbance(key, step))(keys)
        return self.move(step, errors, command.inputs, disturbances)

    def move(
        self,
        step,
        errors: Float[Array, "batch 3"],
        inputs: Float[Array, "batch 2"],
        disturbances: Float[Array, "batch 3"],
    ) -> Advance:
        """Move through one period under given disturbances."""
        A = self.transitions[step]
        B = self.input_matrices[step]
        following = errors @ A.T + inputs @ B.T + disturbances
        return Advance(following, (), jnp.full_like(inputs, jnp.nan))

    def disturbance(self, key: Key[Array, ""], step) -> Float[Array, "3"]:
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

    def under_script(self, script: Script) -> ScriptedLinearPlant:
        """Return the model under a given w (see `ScriptedLinearPlant`)."""
        return ScriptedLinearPlant(self, script)


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class ScriptedLinearPlant:
    """The prediction model under a given `disturbance`, (steps, batch, 3) in W; keys are
    ignored."""

    plant: LinearPlant
    script: Script

    @property
    def reference_wheels(self) -> Float[Array, "steps 2"]:
        """The reference, m/s."""
        return self.plant.reference_wheels

    def initial(self, keys, errors: Float[Array, "batch 3"]) -> tuple[()]:
        """Return no memory."""
        return ()

    def sense(
        self, keys, step, memory: tuple[()], errors: Float[Array, "batch 3"]
    ) -> tuple[Measurement, tuple[()]]:
        """Measure the errors exactly."""
        return self.plant.sense(keys, step, memory, errors)

    def advance(
        self, keys, step, memory: tuple[()], errors: Float[Array, "batch 3"], command: Command
    ) -> Advance:
        """Move through one period under the disturbance of the script."""
        disturbances = script_entry(self.script["disturbance"], step)
        return self.plant.move(step, errors, command.inputs, disturbances)
