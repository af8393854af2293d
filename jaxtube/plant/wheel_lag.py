"""A period of a robot whose wheels lag behind commands that change within it: exact in the heading,
by quadrature in the position.

    v' = (c(t) - v) / tau          travel of a wheel, c(t) = c_0, c_1, ... from t_1, ... on:

    x(t) = c_0 t + (v(0) - c_0) tau (1 - e^{-t / tau}) + sum_i (c_i - c_{i-1}) G(t - t_i)
    G(t) = t - tau (1 - e^{-t / tau})  for t > 0, else 0

Over ground a wheel travels (1 - slip) x. With the mean travel X of both, the heading phi and the
lateral velocity zeta X' - r phi' the body goes

    (1 + i zeta) int X' e^{i phi} dt - r (e^{i phi(T)} - 1).

The integral is taken by Gauss and Legendre between the times at which a command arrives, and 4 and
16 time constants after each: what is left of the command's jump then is below 2e-7 of it, and is
integrated, too.

Source: new; Davis, Rabinowitz 1984, Methods of Numerical Integration, for the error of the rule.
"""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Float

from jaxtube.plant.angles import sine_and_cosine
from jaxtube.plant.error_dynamics import Sideslip

NODES = 10
"""Nodes of the rule in each piece."""
LAYERS = (4.0, 16.0)
"""Time constants after a jump at which pieces end."""
LEAST_LAG = 1e-12
"""What a lag of 0 is taken for, s, so that no quotient is 0 / 0."""


class Wheels(NamedTuple):
    """What the wheels (right, left) of every robot do in a period.

    Attributes:
        speeds: at its start, m/s.
        commands: followed one after the other, m/s.
        arrivals: of the commands after the first, in order, s since the start of the period.
        lag: time constant of both, s.
    """

    speeds: Float[Array, "batch 2"]
    commands: Float[Array, "n batch 2"]
    arrivals: Float[Array, "n-1 batch"]
    lag: Float[Array, " batch"]


def drive(
    wheels: Wheels,
    grip: Float[Array, "batch 2"],
    sideslip: Sideslip | None,
    track_width,
    dt,
) -> tuple[Float[Array, "batch 3"], Float[Array, "batch 2"]]:
    """Drive through a period.

    Args:
        wheels: what they do.
        grip: 1 - slip of each.
        sideslip: of the body, None for none.
        track_width: m.
        dt: period, s.

    Returns:
        (motion of the body (m, m, rad), wheel speeds m/s at the end).
    """
    wheels = wheels._replace(lag=jnp.maximum(wheels.lag, LEAST_LAG))
    ends = _find_pieces(wheels, dt)
    nodes, weights = np.polynomial.legendre.leggauss(NODES)
    half = (ends[1:] - ends[:-1]) / 2.0
    middle = (ends[1:] + ends[:-1]) / 2.0
    nodes = jnp.asarray(nodes, half.dtype)[:, None, None]
    times = middle + half * nodes
    travel, speeds = _follow(wheels, times)
    heading = (travel[..., 0] * grip[:, 0] - travel[..., 1] * grip[:, 1]) / track_width
    speed = (speeds[..., 0] * grip[:, 0] + speeds[..., 1] * grip[:, 1]) / 2.0
    weighted = jnp.asarray(weights, half.dtype)[:, None, None] * half * speed
    sine, cosine = sine_and_cosine(heading)
    along = jnp.sum(weighted * cosine, axis=(0, 1))
    across = jnp.sum(weighted * sine, axis=(0, 1))
    whole, last = _follow(wheels, jnp.full_like(ends[-1], dt))
    turn = (whole[:, 0] * grip[:, 0] - whole[:, 1] * grip[:, 1]) / track_width
    if sideslip is not None:
        share = sideslip.share
        arm = sideslip.lever_arm
        half_sine, half_cosine = sine_and_cosine(turn / 2.0)
        sideways = along * share - arm * 2.0 * half_sine * half_cosine
        along = along - share * across + 2.0 * arm * half_sine**2
        across = across + sideways
    return jnp.stack([along, across, turn], axis=-1), last


def _find_pieces(wheels: Wheels, dt) -> Float[Array, "pieces+1 batch"]:
    """Return the ends of the pieces, in order."""
    start = jnp.zeros_like(wheels.lag)
    ends = [jnp.full_like(start, dt)]
    for jump in (start, *wheels.arrivals):
        ends += [jump, *(jump + layer * wheels.lag for layer in LAYERS)]
    return jnp.sort(jnp.clip(jnp.stack(ends), 0.0, dt), axis=0)


def _follow(
    wheels: Wheels, times: Float[Array, "... batch"]
) -> tuple[Float[Array, "... batch 2"], Float[Array, "... batch 2"]]:
    """Return (travel m, speeds m/s) of the wheels at times of the period, s."""
    lag = wheels.lag
    first = wheels.commands[0]
    gap = wheels.speeds - first
    closed = -jnp.expm1(-times / lag)
    travel = first * times[..., None] + gap * (lag * closed)[..., None]
    speeds = first + gap * (1.0 - closed)[..., None]
    steps = wheels.commands[1:] - wheels.commands[:-1]
    for step, arrival in zip(steps, wheels.arrivals, strict=True):
        after = jnp.maximum(times - arrival, 0.0)
        closed = -jnp.expm1(-after / lag)
        travel = travel + step * (after - lag * closed)[..., None]
        speeds = speeds + step * closed[..., None]
    return travel, speeds
