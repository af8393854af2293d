"""Motions of the plane: poses seen from poses, joined and undone.

A motion (x m, y m, heading rad) leads from a pose to another one, seen from the first. So a
tracking error is the motion from the robot to its reference, and

    error of q = m^-1 + error of p      where m leads from p to q.

Source: Murray, Li, Sastry 1994, A Mathematical Introduction to Robotic Manipulation, chapter 2, for
the group SE(2).
"""

import jax.numpy as jnp
from jax import Array
from jaxtyping import Float

from jaxtube.plant.angles import sinc, sine_and_cosine

Motion = Float[Array, "... 3"]


def join(first: Motion, second: Motion) -> Motion:
    """Return the motion that makes one and then the other."""
    place = first[..., :2] + _rotate(second[..., :2], first[..., 2])
    heading = first[..., 2] + second[..., 2]
    return jnp.concatenate([place, heading[..., None]], axis=-1)


def undo(motion: Motion) -> Motion:
    """Return the motion back."""
    place = -_rotate(motion[..., :2], -motion[..., 2])
    return jnp.concatenate([place, -motion[..., 2:]], axis=-1)


def arc_of_travel(travel: Float[Array, "... 2"], track_width) -> Motion:
    """Return the motion along an arc on which the wheels (right, left) travel so far, m."""
    right = travel[..., 0]
    left = travel[..., 1]
    turn = (right - left) / track_width
    sine, cosine = sine_and_cosine(turn / 2.0)
    chord = (right + left) / 2.0 * sinc(turn / 2.0, (sine, cosine))
    return jnp.stack([chord * cosine, chord * sine, turn], axis=-1)


def _rotate(vector: Float[Array, "... 2"], angle: Float[Array, "..."]) -> Float[Array, "... 2"]:
    sine, cosine = sine_and_cosine(angle)
    x = vector[..., 0]
    y = vector[..., 1]
    return jnp.stack([cosine * x - sine * y, sine * x + cosine * y], axis=-1)
