"""Input maps: what the controller's virtual inputs mean, as speed and yaw rate commanded to the
robot.

    paper         v = V - u1                                                         om = Om - u2
    cosine_free   v = V cos e_th - u1                                                om = Om - u2
    x_exact       T v sinc(a) = cos a e_x + sin a e_y + T V s cos psi - (e_x + T Om e_y + T u1),   om = Om - u2

with a = T om, A = T Om, s = sinc(A / 2) and psi = e_th + A / 2 - a. Over a period without slip
error `x_exact` gives e_x+ = e_x + T Om e_y + T u1 and e_th+ = e_th + T u2 exactly: the lateral
error alone stays nonlinear,

    e_y+ = e_y - tan(a / 2) (e_x + e_x+) + T V s sin(e_th + T u2 / 2) / cos(a / 2).

Each map returns the paper's (V - v, Om - om), which `wheel_commands` turns into wheel speeds.

Source: Gonzalez, Fiacchini, Guzman, Alamo 2009, eqs. (5), (7)-(8) for `paper`; the others are new.
"""

import jax.numpy as jnp
from jax import Array
from jaxtyping import Float

from jaxtube.plant.error_dynamics import sinc
from jaxtube.plant.robot import body_velocity

LEAST_SINC = 0.1
"""Floor of sinc(a) where `x_exact` divides by it: met beyond 2.8 rad of turn a period, where no map
makes sense."""


def acting_input(
    input_map: str,
    virtual_input: Float[Array, "... 2"],
    error: Float[Array, "... 3"],
    reference_wheels: Float[Array, "... 2"],
    track_width: float,
    dt: float,
) -> Float[Array, "... 2"]:
    """Give the deficits of speed and yaw rate that a controller's virtual input asks for.

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
    columns = (
        array[..., i] for array in (virtual_input, error, reference) for i in range(array.shape[-1])
    )
    u1, u2, e_x, e_y, e_th, V, Om = jnp.broadcast_arrays(*columns)
    return jnp.stack([INPUT_MAPS[input_map](u1, u2, (e_x, e_y, e_th), V, Om, dt), u2], axis=-1)


def _paper(u1, u2, error, V, Om, dt):
    return u1


def _cosine_free(u1, u2, error, V, Om, dt):
    # 2 sin^2(e_th / 2) is 1 - cos e_th without its cancellation near zero.
    return u1 + V * 2.0 * jnp.sin(error[2] / 2.0) ** 2


def _x_exact(u1, u2, error, V, Om, dt):
    e_x, e_y, e_th = error
    A, a = dt * Om, dt * (Om - u2)
    along = e_th + A / 2.0 - a
    travelled = (
        -2.0 * jnp.sin(a / 2.0) ** 2 * e_x
        + (jnp.sin(a) - A) * e_y
        + dt * V * sinc(A / 2.0) * jnp.cos(along)
    )
    return V - (travelled / dt - u1) / jnp.maximum(sinc(a), LEAST_SINC)


INPUT_MAPS = {"paper": _paper, "cosine_free": _cosine_free, "x_exact": _x_exact}
