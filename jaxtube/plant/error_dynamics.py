"""The tracking error of a slipping robot, in continuous time and exactly over one sampling period.

    e   = Rot(phi)^T (p_ref - p),  e_th = phi_ref - phi
    e_x' = w e_y + V cos e_th - v        e_y' = -w e_x + V sin e_th        e_th' = Om - w

With wheels, slips and reference held over a period T both robot and reference run along circular
arcs: each moves by a chord of length T v sinc(T w / 2) in the direction T w / 2 ahead of its
heading, so that

    e+ = Rot(-T w) [ e + Rot(e_th) chord(V, Om) - chord(v, w) ],   e_th+ = e_th + T (Om - w).

A body that slips sideways, at v_y = zeta v - lever_arm w to the left, has x' = v cos phi - v_y sin
phi, y' = v sin phi + v_y cos phi: to each chord comes another one, turned to the left.

(x, y, phi) is a pose in the world frame, v, w the body's and V, Om the reference's speed and yaw
rate.

Source: Gonzalez, Fiacchini, Guzman, Alamo 2009, eqs. (3)-(4); the arcs are the exact solution of
eqs. (2) and (4). Sideslip and lever arm are new.
"""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Float

from jaxtube.plant.angles import sinc, sine_and_cosine
from jaxtube.plant.robot import body_motion


class Sideslip(NamedTuple):
    """How a body slips sideways over a period: v_y = share v - lever_arm w, positive to the
    left."""

    share: Float[Array, "..."]
    lever_arm: Float[Array, ""] | float  # m


def tracking_error(
    pose: Float[Array, "... 3"], reference_pose: Float[Array, "... 3"]
) -> Float[Array, "... 3"]:
    """Return the tracking error, eq. (3).

    Args:
        pose: (x m, y m, heading rad) of the robot in the world frame.
        reference_pose: the same of the reference.

    Returns:
        (longitudinal m, lateral m, heading rad) of the reference as seen from the robot: positive
        when the reference is ahead, to the left, turned to the left. The heading error is not
        wrapped.
    """
    x, y, heading = jnp.unstack(pose, axis=-1)
    reference_x, reference_y, reference_heading = jnp.unstack(reference_pose, axis=-1)
    longitudinal, lateral = _rotate(reference_x - x, reference_y - y, -heading)
    return jnp.stack([longitudinal, lateral, reference_heading - heading], axis=-1)


def world_pose(
    error: Float[Array, "... 3"], reference_pose: Float[Array, "... 3"]
) -> Float[Array, "... 3"]:
    """Return the robot's pose from its tracking error: the exact inverse of `tracking_error`.

    Args:
        error: (longitudinal m, lateral m, heading rad) in the robot frame.
        reference_pose: (x m, y m, heading rad) of the reference in the world frame.

    Returns:
        (x m, y m, heading rad) of the robot in the world frame.
    """
    ahead, aside, turn = jnp.unstack(error, axis=-1)
    heading = reference_pose[..., 2] - turn
    ahead_x, ahead_y = _rotate(ahead, aside, heading)
    x = reference_pose[..., 0] - ahead_x
    y = reference_pose[..., 1] - ahead_y
    return jnp.stack([x, y, heading], axis=-1)


def advance(
    error: Float[Array, "... 3"],
    wheels: Float[Array, "... 2"],
    slip: Float[Array | np.ndarray, "... 2"] | float,
    reference_wheels: Float[Array, "... 2"],
    track_width: float,
    dt: float,
    sideslip: Sideslip | None = None,
) -> Float[Array, "... 3"]:
    """Return the tracking error one period later, with wheels, slip and reference held.

    The arcs are exact: there is no integration error.

    Args:
        error: (longitudinal m, lateral m, heading rad) in the robot frame.
        wheels: wheel speeds (right, left), m/s.
        slip: true longitudinal slips (right, left).
        reference_wheels: wheel speeds of the reference, which does not slip, m/s.
        track_width: m.
        dt: length of the period, s.
        sideslip: of the body, None for none.

    Returns:
        The error in the robot's frame at the end of the period; smooth in every argument, also on
        straight lines.
    """
    v, w = body_motion(wheels, slip, track_width)
    V, Om = body_motion(reference_wheels, 0.0, track_width)
    ahead, aside, heading = jnp.unstack(error, axis=-1)
    reference_x, reference_y = _rotate(*_chord(V, Om, dt), heading)
    half_turn = dt * w / 2.0
    sine, cosine = sine_and_cosine(half_turn)
    shortening = dt * sinc(half_turn, (sine, cosine))
    along = shortening * v * cosine
    across = shortening * v * sine
    if sideslip is not None:
        sideways = shortening * (sideslip.share * v - sideslip.lever_arm * w)
        along = along - sideways * sine
        across = across + sideways * cosine
    x = ahead + reference_x - along
    y = aside + reference_y - across
    # The frame turns by twice the half turn, whose sine and cosine are known.
    turn_cosine = 1.0 - 2.0 * sine * sine
    turn_sine = 2.0 * sine * cosine
    longitudinal = turn_cosine * x + turn_sine * y
    lateral = turn_cosine * y - turn_sine * x
    return jnp.stack([longitudinal, lateral, heading + dt * (Om - w)], axis=-1)


def _chord(
    speed: Float[Array, "..."], yaw_rate: Float[Array, "..."], dt: float
) -> tuple[Float[Array, "..."], Float[Array, "..."]]:
    """Return the displacement along an arc, in the frame at its start, m."""
    half_turn = dt * yaw_rate / 2.0
    sine, cosine = sine_and_cosine(half_turn)
    length = dt * speed * sinc(half_turn, (sine, cosine))
    return length * cosine, length * sine


def _rotate(
    x: Float[Array, "..."], y: Float[Array, "..."], angle: Float[Array, "..."]
) -> tuple[Float[Array, "..."], Float[Array, "..."]]:
    """Rotate plane vectors to the left by an angle in rad."""
    sine, cosine = sine_and_cosine(angle)
    return cosine * x - sine * y, sine * x + cosine * y
