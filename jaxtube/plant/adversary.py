"""An adversary that sets the slips to their extremes so that the tracking error moves furthest
along a direction.

    q_1 = e_x,  q_2 = e_y + tau e_th;    j = 1 where weight |q_1| > |q_2|, else 2;    n = +-grad q_j

By eq. (4) the rate n e' holds -n_x v - t w with t = n_th + n_y e_x - n_x e_y. Ground speed that the
right wheel loses thus adds n_x / 2 + t / b to it, and the left wheel n_x / 2 - t / b: each wheel
has a best extreme of its own.

Feedback alone is short-sighted, and no single scheme is the worst of all loops. So each realisation
draws its own. A third of the schemes push e_x only, a third the lateral error only, and a third
whichever is larger by a drawn weight. Independently, a third push outwards, a third keep one sign,
and a third alternate it with a period of 2 to 120 steps, which excites resonances of the loop.

Source: Gonzalez, Fiacchini, Guzman, Alamo 2009, eqs. (1)-(2) and (4); the schemes are new.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import Array
from jax.typing import DTypeLike
from jaxtyping import Bool, Float, Int, Key

LONGEST_HALF_PERIOD = 60
"""Longest half period of the square wave, steps."""

ALWAYS = 1e6
"""A weight by which e_x is always the larger error."""

FOREVER = 2**30
"""A half period in steps that outlasts every reference: the wave keeps its sign."""


class Scheme(NamedTuple):
    """How the adversary of one realisation acts: which error it pushes, and which way."""

    lead: Float[Array, ""]  # tau, m
    speed_weight: Float[Array, ""]  # of e_x against e_y + tau e_th
    outward: Bool[Array, ""]  # away from zero; else as a square wave
    sign: Float[Array, ""]  # of the square wave in its first half, -1 or 1
    half_period: Int[Array, ""]  # of the square wave, steps
    offset: Int[Array, ""]  # steps of the square wave that lie before step 0


def draw_scheme(key: Key[Array, ""], dtype: DTypeLike = float) -> Scheme:
    """Draw the scheme of one realisation.

    Args:
        key: of the realisation.
        dtype: of the scheme's real numbers.

    Returns:
        A scheme with lead and drawn weights between 1/4 and 4, uniform in their logarithm.
    """
    # One draw for all: a generator of its own for each would take most of a rollout's compilation.
    target, timing, lead, weight, half_period, offset, side = jax.random.uniform(key, (7,), dtype)
    speed_weight = jnp.select(
        [target < 1 / 3, target < 2 / 3],
        [jnp.zeros_like(weight), jnp.full_like(weight, ALWAYS)],
        _log_uniform(weight),
    )
    keeps_sign = timing > 2 / 3
    return Scheme(
        lead=_log_uniform(lead),
        speed_weight=speed_weight,
        outward=timing < 1 / 3,
        sign=_sign(side - 0.5),
        half_period=jnp.where(keeps_sign, FOREVER, _count_steps(half_period)),
        offset=_count_steps(offset),
    )


def pushed_direction(
    scheme: Scheme, step: Array | int, errors: Float[Array, "3"]
) -> Float[Array, "3"]:
    """Return the direction n along which the adversary pushes the tracking error at one step.

    Args:
        scheme: of the realisation.
        step: number of the step, from 0.
        errors: true tracking error, (m, m, rad).

    Returns:
        The gradient of e_x or of e_y + lead e_th, or its negative.
    """
    lateral = errors[1] + scheme.lead * errors[2]
    pushes_speed = scheme.speed_weight * jnp.abs(errors[0]) > jnp.abs(lateral)
    half_periods = (jnp.asarray(step, jnp.int32) + scheme.offset) // scheme.half_period
    wave = jnp.where(half_periods % 2 == 0, scheme.sign, -scheme.sign)
    pushed_error = jnp.where(pushes_speed, errors[0], lateral)
    sign = jnp.where(scheme.outward, _sign(pushed_error), wave)
    n_x = jnp.where(pushes_speed, sign, 0.0)
    n_y = jnp.where(pushes_speed, 0.0, sign)
    return jnp.stack([n_x, n_y, scheme.lead * n_y])


def worst_vertex(
    direction: Float[Array, "3"], errors: Float[Array, "3"], track_width: Float[Array, ""] | float
) -> Float[Array, "2"]:
    """Return the extreme deviation of the true slip that drives the tracking error furthest along a
    direction.

    Args:
        direction: n, of any length.
        errors: true tracking error, (m, m, rad).
        track_width: m.

    Returns:
        xi (right, left) in {-1, 1}; while both wheels roll forwards, no other in [-1, 1] makes n e'
        greater. Where the measured slip deviates instead, -xi does this.
    """
    n_x, n_y, n_th = direction
    e_x, e_y, _ = errors
    slower = track_width / 2.0 * n_x
    turning = n_th + n_y * e_x - n_x * e_y
    return _sign(jnp.stack([slower + turning, slower - turning]))


def _log_uniform(share: Float[Array, ""]) -> Float[Array, ""]:
    """Map [0, 1] to [1/4, 4], evenly in the logarithm."""
    return 4.0 ** (2.0 * share - 1.0)


def _count_steps(share: Float[Array, ""]) -> Int[Array, ""]:
    """Map [0, 1) to 1 .. LONGEST_HALF_PERIOD steps, evenly."""
    return 1 + (LONGEST_HALF_PERIOD * share).astype(jnp.int32)


def _sign(numbers: Float[Array, "..."]) -> Float[Array, "..."]:
    """Return -1 or 1; the sign of 0 is 1."""
    return jnp.where(numbers < 0.0, -jnp.ones_like(numbers), jnp.ones_like(numbers))
