"""A user's own controller in a closed loop: a function, or an object with `initial` and `act`."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import Any, cast

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Float

from jaxtube.control.mpc import Diagnostics
from jaxtube.control.protocol import Controller, Feedback, Law, WheelMap
from jaxtube.plant.protocol import Command, Measurement, Memory

BATCH = 7
"""Realisations of the trial: a number that no other axis has."""


@partial(jax.tree_util.register_dataclass, data_fields=[], meta_fields=["controller"])
@dataclass(frozen=True)
class Unregistered:
    """A controller that is no pytree: to JAX it is a constant, and its arrays are compiled in."""

    controller: Controller

    def initial(self, errors: Float[Array, "batch 3"]) -> Memory:
        """Return the memory before the first period."""
        return self.controller.initial(errors)

    def act(
        self, step, memory: Memory, measurement: Measurement, reference_wheels: Float[Array, "2"]
    ) -> tuple[Command, Memory, Diagnostics]:
        """Return what the controller returns."""
        return self.controller.act(step, memory, measurement, reference_wheels)


def adapt_controller(controller: Controller | Law, wheel_map: WheelMap) -> Controller:
    """Return what a closed loop can run of a user's own controller.

    Args:
        controller: a `Controller`, pytree or not, or a law u = f(errors, reference_wheels) on
            measured errors (batch, 3) in (m, m, rad) and wheel speeds (2,) in m/s that returns
            virtual inputs (batch, 2) in (m/s, rad/s).
        wheel_map: how the virtual inputs of a law become wheel speeds.

    Raises:
        ValueError: one line, for anything else, or where what it returns has other shapes.
    """
    adapted = _adapt(controller, wheel_map)
    _check_shapes(adapted)
    return adapted


def _adapt(controller: Any, wheel_map: WheelMap) -> Controller:
    if not hasattr(controller, "act"):
        if not callable(controller):
            raise ValueError(
                f"controller = {controller!r}: is neither a law u = f(errors, reference_wheels) "
                "nor an object with `initial` and `act`; give one of them"
            )
        return Feedback(cast(Law, controller), wheel_map)
    is_pytree = not jax.tree_util.all_leaves([controller])
    return controller if is_pytree else Unregistered(controller)


def _check_shapes(controller: Controller) -> None:
    """Trace one period of a controller, and refuse commands of another shape."""

    def act(errors, slip, reference_wheels):
        memory = controller.initial(errors)
        measurement = Measurement(errors, slip)
        return controller.act(jnp.asarray(0), memory, measurement, reference_wheels)

    floats = partial(jax.ShapeDtypeStruct, dtype=jnp.zeros(0).dtype)
    command, memory, _ = jax.eval_shape(act, floats((BATCH, 3)), floats((BATCH, 2)), floats((2,)))
    shapes = [getattr(array, "shape", None) for array in command]
    if shapes != [(BATCH, 2)] * 2:
        told = str(shapes[0]).replace(str(BATCH), "batch")
        raise ValueError(
            f"controller: returns inputs of shape {told} for errors (batch, 3); return (batch, 2), "
            "u1 in m/s and u2 in rad/s"
        )
    before = jax.eval_shape(controller.initial, floats((BATCH, 3)))
    if jax.tree.map(_describe, before) != jax.tree.map(_describe, memory):
        raise ValueError(
            "controller: `act` returns a memory of another structure, shape or dtype than "
            "`initial`; return the same"
        )


def _describe(array: jax.ShapeDtypeStruct) -> tuple[tuple[int, ...], np.dtype]:
    return array.shape, array.dtype
