"""A robot on two driven wheels (or tracks) that slip: wheel commands, body velocity and virtual
inputs.

    v = (v_r (1 - i_r) + v_l (1 - i_l)) / 2        w = (v_r (1 - i_r) - v_l (1 - i_l)) / b
    u1 = V - v                                     u2 = Om - w

Wheels are (right v_r, left v_l) in m/s. Slips are (right i_r, left i_l), fractions of the wheel's
travel: at 0.2 a fifth of it is lost. b is the track width in m; V, Om are speed and yaw rate of the
reference. All arrays end in the coordinate and broadcast over leading axes.

Source: Gonzalez, Fiacchini, Guzman, Alamo 2009, eqs. (1)-(2), (5), (7)-(8).
"""

from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Bool, Float

from jaxtube.columns import each_coordinate
from jaxtube.plant.angles import sine_and_cosine

SAME = 16
"""Speeds, m/s, closer than so many units of rounding are the same."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Robot:
    """The robot's geometry and its actuators' limits.

    Attributes:
        track_width: distance between the two wheels' contact points, or the one that the robot
            turns as if it had, m, positive.
        wheel_speed_min: least wheel speed, m/s (negative: backwards).
        wheel_speed_max: greatest wheel speed, m/s.
        lever_arm: how far the point that does not move sideways lies ahead of the tracked one, m.
    """

    track_width: float
    wheel_speed_min: float
    wheel_speed_max: float
    lever_arm: float = 0.0

    @property
    def wheel_speed_middle(self) -> float:
        """Middle of the range of wheel speeds, m/s."""
        return (self.wheel_speed_max + self.wheel_speed_min) / 2

    @property
    def wheel_speed_half_range(self) -> float:
        """Half of the range of wheel speeds, m/s."""
        return (self.wheel_speed_max - self.wheel_speed_min) / 2


def body_velocity(
    wheels: Float[Array, "... 2"],
    slip: Float[Array | np.ndarray, "... 2"] | float,
    track_width: float,
) -> Float[Array, "... 2"]:
    """Return the speed and yaw rate of the body, eqs. (1)-(2).

    Args:
        wheels: wheel speeds (right, left), m/s.
        slip: longitudinal slips (right, left); 0.0 for rolling.
        track_width: m.

    Returns:
        (speed m/s, forwards positive; yaw rate rad/s, left positive).
    """
    return jnp.stack(body_motion(wheels, slip, track_width), axis=-1)


def body_motion(
    wheels: Float[Array, "... 2"],
    slip: Float[Array | np.ndarray, "... 2"] | float,
    track_width: float,
) -> tuple[Float[Array, "..."], Float[Array, "..."]]:
    """Return speed and yaw rate of `body_velocity` apart."""
    right_slip, left_slip = _split(slip)
    right_wheel, left_wheel = jnp.unstack(wheels, axis=-1)
    right = right_wheel * (1.0 - right_slip)
    left = left_wheel * (1.0 - left_slip)
    speed = (right + left) / 2.0
    yaw_rate = (right - left) / track_width
    return speed, yaw_rate


def wheel_commands(
    virtual_input: Float[Array, "... 2"],
    reference_wheels: Float[Array, "... 2"],
    measured_slip: Float[Array | np.ndarray, "... 2"] | float,
    track_width: float,
) -> Float[Array, "... 2"]:
    """Return the wheel speeds that realise a virtual input under the measured slip, eqs. (7)-(8).

    Args:
        virtual_input: (speed deficit m/s, yaw rate deficit rad/s).
        reference_wheels: wheel speeds of the reference (right, left), m/s.
        measured_slip: slips (right, left) the controller believes in, below 1; 0.0 for no
            compensation.
        track_width: m.

    Returns:
        Wheel speeds (right, left), m/s, not saturated.
    """
    speed_deficit, yaw_rate_deficit = jnp.unstack(virtual_input, axis=-1)
    turning = track_width / 2.0 * yaw_rate_deficit
    right_deficit = speed_deficit + turning
    left_deficit = speed_deficit - turning
    right_slip, left_slip = _split(measured_slip)
    right = (reference_wheels[..., 0] - right_deficit) / (1.0 - right_slip)
    left = (reference_wheels[..., 1] - left_deficit) / (1.0 - left_slip)
    return jnp.stack([right, left], axis=-1)


def saturate(wheels: Float[Array, "... 2"], robot: Robot) -> Float[Array, "... 2"]:
    """Clip wheel speeds to the actuators' limits.

    Args:
        wheels: wheel speeds (right, left), m/s.
        robot: the limits.

    Returns:
        The nearest wheel speeds within the limits, each wheel on its own.
    """

    def clip(speed):
        return jnp.clip(speed, robot.wheel_speed_min, robot.wheel_speed_max)

    return each_coordinate(clip, wheels)


def is_saturated(
    demanded: Float[Array | np.ndarray, "... 2"], wheels: Float[Array | np.ndarray, "... 2"]
) -> Bool[Array | np.ndarray, "..."]:
    """Return whether some wheel could not be given the speed that was asked of it; rounding is no
    difference, since compiled programs may make a number twice. NaN counts as given.

    Args:
        demanded: wheel speeds (right, left) before saturation, m/s.
        wheels: after it, m/s.
    """
    rounding = SAME * np.finfo(demanded.dtype).eps * (1 + abs(wheels))
    return (abs(demanded - wheels) > rounding).any(axis=-1)


def _split(
    slips: Float[Array | np.ndarray, "... 2"] | float,
) -> tuple[Float[Array, "..."], Float[Array, "..."]]:
    """Return the slips of the right and of the left wheel: apart, laps next to each other make
    kernels that compute several at once."""
    pair = jnp.broadcast_to(slips, (*jnp.shape(slips)[:-1], 2))
    right, left = jnp.unstack(pair, axis=-1)
    return right, left


def wheel_positions(pose: Float[Array, "... 3"], track_width: float) -> Float[Array, "... 2 2"]:
    """Return the points where the two wheels touch the ground.

    Args:
        pose: (x m, y m, heading rad) of the robot in the world frame.
        track_width: m.

    Returns:
        Points (right, left) in the last axis but one, each (x m, y m) in the world frame.
    """
    x = pose[..., 0]
    y = pose[..., 1]
    heading = pose[..., 2]
    sine, cosine = sine_and_cosine(heading)
    offset_x = track_width / 2.0 * sine
    offset_y = track_width / 2.0 * cosine
    right = jnp.stack([x + offset_x, y - offset_y], axis=-1)
    left = jnp.stack([x - offset_x, y + offset_y], axis=-1)
    return jnp.stack([right, left], axis=-2)
