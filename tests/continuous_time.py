"""The tracking error in continuous time: an oracle for the exact periods and the models."""

import jax.numpy as jnp


def error_rate(error, wheels, slip, reference_wheels, track_width):
    """Return the time derivative of the tracking error, eq. (4), of (m, m, rad)."""
    right, left = jnp.moveaxis(wheels * (1.0 - slip), -1, 0)
    reference_right, reference_left = jnp.moveaxis(reference_wheels, -1, 0)
    v = (right + left) / 2.0
    w = (right - left) / track_width
    V = (reference_right + reference_left) / 2.0
    Om = (reference_right - reference_left) / track_width
    e_x, e_y, e_th = jnp.moveaxis(error, -1, 0)
    longitudinal = w * e_y + V * jnp.cos(e_th) - v
    lateral = -w * e_x + V * jnp.sin(e_th)
    return jnp.stack(jnp.broadcast_arrays(longitudinal, lateral, Om - w), axis=-1)
