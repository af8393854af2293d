"""Input maps: what the controller's virtual inputs mean, as speed and yaw rate commanded to the
robot.

    paper         v = V - u1
    cosine_free   v = V cos e_th - u1
    x_exact       T v sinc(a) = cos a e_x + sin a e_y + T V s cos psi - (e_x + T Om e_y + T u1)

and om = Om - u2 in all of them, with a = T om, A = T Om, s = sinc(A / 2) and psi = e_th + A / 2 -
a. Over a period without slip error `x_exact` gives e_x+ = e_x + T Om e_y + T u1 and e_th+ = e_th +
T u2 exactly: only the lateral error stays nonlinear,

    e_y+ = e_y - tan(a / 2) (e_x + e_x+) + T V s sin(e_th + T u2 / 2) / cos(a / 2).

Each map returns the paper's (V - v, Om - om), which `wheel_commands` turns into wheel speeds.

Source: Gonzalez, Fiacchini, Guzman, Alamo 2009, eqs. (5), (7)-(8) for `paper`; the others are new.
"""

from typing import NamedTuple

import jax.numpy as jnp
from jax import Array
from jaxtyping import Float

from jaxtube.plant.angles import sinc, sine_and_cosine
from jaxtube.plant.robot import body_velocity

LEAST_SINC = 0.1
"""Floor of sinc(a) where `x_exact` divides by it. The floor acts beyond a turn of 2.8 rad in one
period, where no map makes sense."""


class MapArguments(NamedTuple):
    """Arguments of an input map, of one shape."""

    u1: Float[Array, "..."]  # first virtual input, m/s
    u2: Float[Array, "..."]  # second virtual input, rad/s
    e_x: Float[Array, "..."]  # longitudinal error, m
    e_y: Float[Array, "..."]  # lateral error, m
    e_th: Float[Array, "..."]  # heading error, rad
    V: Float[Array, "..."]  # speed of the reference, m/s
    Om: Float[Array, "..."]  # yaw rate of the reference, rad/s
    T: float  # period, s


def acting_input(
    input_map: str,
    virtual_input: Float[Array, "... 2"],
    error: Float[Array, "... 3"],
    reference_wheels: Float[Array, "... 2"],
    track_width: float,
    dt: float,
) -> Float[Array, "... 2"]:
    """Return the deficits of speed and yaw rate that a controller's virtual input asks for.

    Args:
        input_map: a name of `INPUT_MAPS`.
        virtual_input: (u1 m/s, u2 rad/s) in the sense of the map.
        error: measured tracking error, (m, m, rad).
        reference_wheels: wheel speeds of the reference (right, left), m/s.
        track_width: m.
        dt: period, s.

    Returns:
        (V - v m/s, Om - om rad/s), to be passed to `wheel_commands`; finite for finite arguments.
    """
    reference = body_velocity(reference_wheels, 0.0, track_width)
    columns = jnp.broadcast_arrays(
        *jnp.unstack(virtual_input, axis=-1),
        *jnp.unstack(error, axis=-1),
        *jnp.unstack(reference, axis=-1),
    )
    arguments = MapArguments(*columns, T=dt)
    speed_deficit = INPUT_MAPS[input_map](arguments)
    return jnp.stack([speed_deficit, arguments.u2], axis=-1)


def _paper(arguments: MapArguments) -> Float[Array, "..."]:
    """Return V - v = u1."""
    return arguments.u1


def _cosine_free(arguments: MapArguments) -> Float[Array, "..."]:
    """Return V - v = u1 + V (1 - cos e_th)."""
    u1, _, _, _, e_th, V, _, _ = arguments
    half_sine, _ = sine_and_cosine(e_th / 2.0)
    # 2 sin^2(e_th / 2) is 1 - cos e_th without its cancellation near zero.
    return u1 + V * 2.0 * half_sine**2


def _x_exact(arguments: MapArguments) -> Float[Array, "..."]:
    """Return V - v of the map that makes the longitudinal row exact (module docstring)."""
    u1, u2, e_x, e_y, e_th, V, Om, T = arguments
    reference_turn = T * Om
    turn = T * (Om - u2)
    chord_direction = e_th + reference_turn / 2.0 - turn
    _, chord_cosine = sine_and_cosine(chord_direction)
    reference_travel = T * V * sinc(reference_turn / 2.0) * chord_cosine
    half_sine, half_cosine = sine_and_cosine(turn / 2.0)
    turn_sine = 2.0 * half_sine * half_cosine
    turn_cosine = 1.0 - 2.0 * half_sine**2
    # -2 sin^2(a / 2) is cos a - 1 without its cancellation near zero.
    from_e_x = -2.0 * half_sine**2 * e_x
    from_e_y = (turn_sine - reference_turn) * e_y
    travel = from_e_x + from_e_y + reference_travel
    return V - (travel / T - u1) / jnp.maximum(sinc(turn, (turn_sine, turn_cosine)), LEAST_SINC)


INPUT_MAPS = {"paper": _paper, "cosine_free": _cosine_free, "x_exact": _x_exact}
