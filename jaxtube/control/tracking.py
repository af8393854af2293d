"""The two controllers the paper compares with: one linear law, with and without slip compensation.

    u1 = -k1 e_x        u2 = -k2 e_y - k3 e_th
    k1 = k3 = 2 zeta a        k2 = (a^2 - Om^2) / V

The linearised tracking error with V and Om frozen then has the poles of (s + 2 zeta a)(s^2 + 2 zeta
a s + a^2). Slip is compensated or not by the slip handed to `robot.wheel_commands`: the measured
one, or 0.0.

zeta is the damping, a the bandwidth in rad/s, V and Om the reference's speed and yaw rate.

Source: Gonzalez, Fiacchini, Guzman, Alamo 2009, section IV and its references [1] and [15], with
zeta = 1 and a = 0.6 rad/s. The paper does not print the gains; these place the poles above.
"""

import jax.numpy as jnp
from jax import Array
from jaxtyping import Float

from jaxtube.plant.robot import body_velocity

DAMPING = 1.0
"""zeta, without unit."""

BANDWIDTH = 0.6
"""a, rad/s."""

SLOWEST_REFERENCE = 0.01
"""Speed in m/s below which k2 stops growing: a reference that stands cannot steer its lateral error
away."""


def tracking_input(
    error: Float[Array, "... 3"],
    reference_wheels: Float[Array, "... 2"],
    track_width: float,
) -> Float[Array, "... 2"]:
    """Return the virtual input of the linear tracking law.

    Args:
        error: measured (longitudinal m, lateral m, heading rad) in the robot frame.
        reference_wheels: wheel speeds of the reference (right, left), m/s.
        track_width: m.

    Returns:
        (speed deficit m/s, yaw rate deficit rad/s); finite for every finite input.
    """
    velocity = body_velocity(reference_wheels, 0.0, track_width)
    V = velocity[..., 0]
    Om = velocity[..., 1]
    backwards = jnp.minimum(V, -SLOWEST_REFERENCE)
    forwards = jnp.maximum(V, SLOWEST_REFERENCE)
    steering_speed = jnp.where(V < 0.0, backwards, forwards)
    k1 = 2.0 * DAMPING * BANDWIDTH
    k2 = (BANDWIDTH**2 - Om**2) / steering_speed
    k3 = k1
    u1 = -k1 * error[..., 0]
    u2 = -k2 * error[..., 1] - k3 * error[..., 2]
    return jnp.stack(jnp.broadcast_arrays(u1, u2), axis=-1)
