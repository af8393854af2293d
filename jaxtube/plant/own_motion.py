"""A motion of a user's own as a plant: x+ = f(x, u, th, d), d drawn in its box, or given.

The function is written for numbers of several kinds; here each coordinate is an array over the
realisations, wrapped so that functions of an angle are those of `jax.numpy`.
"""

from __future__ import annotations

import operator
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
from jax import Array
from jaxtyping import Float

from jaxtube.plant.input_driven import InputDrivenPlant
from jaxtube.plant.protocol import Advance

FUNCTIONS: dict[str, Callable[[Array], Array]] = {
    "sin": jnp.sin,
    "cos": jnp.cos,
    "tan": jnp.tan,
    "square": jnp.square,
    "reciprocal": jnp.reciprocal,
    "sinc": lambda x: jnp.sinc(x / jnp.pi),
}
"""Functions of numbers, by the names that they have over intervals."""


class Traced:
    """An array of JAX as a number that a motion is written for."""

    __slots__ = ("array",)

    def __init__(self, array: Any):
        self.array = array

    def apply(self, function: Callable[[Any], Any]) -> Traced:
        """Return what a function over intervals is of the array."""
        return Traced(FUNCTIONS[function.__name__](self.array))

    def __neg__(self) -> Traced:
        return Traced(-self.array)

    def __add__(self, other: Any) -> Traced:
        return _combine(operator.add, self, other)

    def __radd__(self, other: Any) -> Traced:
        return _combine(operator.add, other, self)

    def __sub__(self, other: Any) -> Traced:
        return _combine(operator.sub, self, other)

    def __rsub__(self, other: Any) -> Traced:
        return _combine(operator.sub, other, self)

    def __mul__(self, other: Any) -> Traced:
        return _combine(operator.mul, self, other)

    def __rmul__(self, other: Any) -> Traced:
        return _combine(operator.mul, other, self)

    def __truediv__(self, other: Any) -> Traced:
        return _combine(operator.truediv, self, other)

    def __rtruediv__(self, other: Any) -> Traced:
        return _combine(operator.truediv, other, self)


def _combine(operation: Callable[[Any, Any], Any], one: Any, other: Any) -> Traced:
    return Traced(operation(_unwrap(one), _unwrap(other)))


def _unwrap(number: Any) -> Any:
    return number.array if isinstance(number, Traced) else number


@partial(
    jax.tree_util.register_dataclass,
    data_fields=["reference_wheels", "disturbance_vertices"],
    meta_fields=["function"],
)
@dataclass(frozen=True)
class OwnMotion(InputDrivenPlant):
    """A motion f(x, u, th, d); w of an `InputDrivenPlant` is its d, in the hull of the corners of
    its box."""

    function: Callable[..., Any]

    def move(
        self,
        step,
        errors: Float[Array, "batch n"],
        inputs: Float[Array, "batch m"],
        disturbances: Float[Array, "batch q"],
    ) -> Advance:
        """Move through one period under given uncertainties."""
        x = [Traced(column) for column in jnp.unstack(errors, axis=1)]
        u = [Traced(column) for column in jnp.unstack(inputs, axis=1)]
        th = [Traced(weight) for weight in jnp.unstack(self.reference_wheels[step])]
        d = [Traced(column) for column in jnp.unstack(disturbances, axis=1)]
        moved = [_unwrap(part) for part in self.function(x, u, th, d)]
        columns = [jnp.broadcast_to(part, errors.shape[:1]) for part in moved]
        return Advance(jnp.stack(columns, axis=1), (), jnp.full_like(inputs, jnp.nan))
