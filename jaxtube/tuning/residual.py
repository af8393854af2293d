"""The disturbance set W as a function of the caps, differentiable: greatest residuals at corners of
the operating set.

    w = e_m+ - A(th) e_m - B(th) u = kappa (0, g_y, 1) + rest        kappa = T (g_r d_r - g_l d_l) / b
    W = {sigma (0, g_y, 1) : |sigma| <= max |kappa|} + box           box = (max |rest|, 0) + noise (1, 1, 2)

Measured errors e_m, inputs u, schedules th, wheel errors d and pose noise n run through the corners
of their sets and some points between. The residual of the exact sampled robot comes from
`error_dynamics` and `input_maps`. An estimate from within: a design computes and certifies a
rigorous bound.

Source: as `sets.robot.disturbance`, whose bound is proved by intervals.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Float

from jaxtube.plant.error_dynamics import advance
from jaxtube.plant.input_maps import acting_input
from jaxtube.plant.robot import wheel_commands
from jaxtube.synthesis.disturbance import operation
from jaxtube.synthesis.problem import Problem
from jaxtube.tuning.tube import largest

HEADINGS, EDGE = 5, 5
"""Heading errors of the grid, and points along each edge that the coupling cuts."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Caps:
    """Half widths of the measured error (m, m, rad) and of the inputs, and the coupling.

    Attributes:
        errors: longitudinal m, lateral m, heading rad.
        speeds: speed deficits -speeds[0] <= u1 <= speeds[1], m/s, both positive.
        turning: |u2| <= turning, rad/s.
        coupling: (a m, b rad/s) where |e_x| / a + |u2| / b <= 1 holds as well, else None.
    """

    errors: Float[Array, "3"]
    speeds: Float[Array, "2"]
    turning: Float[Array, ""]
    coupling: Float[Array, "2"] | None = None


@partial(
    jax.tree_util.register_dataclass,
    data_fields=["schedules", "transitions", "inputs", "wheel_error", "noise"],
    meta_fields=["input_map", "dt", "track_width", "lateral_per_yaw"],
)
@dataclass(frozen=True)
class Corners:
    """What the caps leave as it is: robot, slip errors, noise, and the model at the corners of the
    schedule.

    Attributes:
        schedules: reference wheel speeds (right, left), m/s.
        transitions, inputs: A and B there.
        wheel_error: largest |d| (right, left).
        noise: largest pose noise (m, m, rad).
        input_map: a name of `INPUT_MAPS`.
        dt, track_width, lateral_per_yaw: s, m and g_y, m/rad.
    """

    schedules: Float[Array, "s 2"]
    transitions: Float[Array, "s 3 3"]
    inputs: Float[Array, "s 3 2"]
    wheel_error: Float[Array, "2"]
    noise: Float[Array, "3"]
    input_map: str
    dt: float
    track_width: float
    lateral_per_yaw: float


def corners(problem: Problem) -> Corners:
    """Return what the caps of a design leave as it is."""
    where, schedules = operation(problem), np.unique(problem.corners, axis=0)
    transitions, inputs = problem.model.matrices(schedules)
    return Corners(
        schedules=jnp.asarray(schedules),
        transitions=jnp.asarray(transitions),
        inputs=jnp.asarray(inputs),
        wheel_error=jnp.asarray(where.wheel_error),
        noise=jnp.asarray(where.noise),
        input_map=problem.scenario.controller.input_map,
        dt=where.dt,
        track_width=where.track_width,
        lateral_per_yaw=where.period.lateral_per_yaw,
    )


def caps(problem: Problem) -> Caps:
    """Return the caps of a design."""
    where = operation(problem)
    lower, upper = where.inputs
    coupling = None if where.coupling is None else jnp.asarray(where.coupling)
    speeds = jnp.asarray([-lower[0], upper[0]])
    return Caps(
        jnp.asarray(where.errors[1]), speeds, jnp.asarray(max(-lower[1], upper[1])), coupling
    )


def input_caps(gains: Float[Array, "v 2 3"], errors: Float[Array, "3"]) -> Float[Array, "2"]:
    """Return the reach of u = K e over |e| <= errors and all gains, (m/s, rad/s)."""
    return largest(jnp.abs(gains) @ errors)


def residual_generators(corners: Corners, caps: Caps) -> Float[Array, "4 3"]:
    """Return the generators of W: the yaw kick (0, g_y, 1), and the half widths of the box."""
    kick, rest = residual_bound(corners, caps)
    box = jnp.append(rest + corners.noise[:2], 2.0 * corners.noise[2])
    direction = jnp.asarray([0.0, corners.lateral_per_yaw, 1.0], dtype=box.dtype)
    return jnp.vstack([kick * direction, jnp.diag(box)])


def residual_bound(corners: Corners, caps: Caps) -> tuple[Float[Array, ""], Float[Array, "2"]]:
    """Return the greatest yaw kick, rad, and the greatest rest in the plane (m, m), at the corners."""
    errors, inputs, schedule, slip, noise = _grid(corners, caps)
    T, b, wheels = corners.dt, corners.track_width, corners.schedules[schedule]
    deficits = acting_input(corners.input_map, inputs, errors, wheels, b, T)
    ground = wheel_commands(deficits, wheels, 0.0, b)
    kick = T / b * (ground[:, 0] * slip[:, 0] - ground[:, 1] * slip[:, 1])
    after = advance(errors - noise, ground, slip, wheels, b, T)
    predicted = jnp.einsum("pnm,pm->pn", corners.transitions[schedule], errors)
    predicted = predicted + jnp.einsum("pnm,pm->pn", corners.inputs[schedule], inputs)
    rest = after - predicted
    sideways = rest[:, 1] - corners.lateral_per_yaw * kick
    return largest(jnp.abs(kick)), largest(jnp.abs(jnp.stack([rest[:, 0], sideways], axis=1)))


def _grid(corners: Corners, caps: Caps):
    """Return errors, inputs, which schedule, wheel errors and noise at every point."""
    coupled, ends = _coupled_corners(caps), jnp.asarray([-1.0, 1.0], dtype=caps.errors.dtype)
    sizes = len(coupled), 2, HEADINGS, 2, len(corners.schedules), 2, 2, 2
    at, lateral, heading, speed, schedule, right, left, side = np.indices(sizes).reshape(
        len(sizes), -1
    )
    headings = jnp.linspace(-1.0, 1.0, HEADINGS, dtype=caps.errors.dtype) * caps.errors[2]
    errors = [coupled[at, 0], ends[lateral] * caps.errors[1], headings[heading]]
    inputs = [(ends * caps.speeds)[speed], coupled[at, 1]]
    slip = jnp.stack([ends[right], ends[left]], axis=1) * corners.wheel_error
    noise = ends[side][:, None] * corners.noise
    return jnp.stack(errors, axis=1), jnp.stack(inputs, axis=1), schedule, slip, noise


def _coupled_corners(caps: Caps) -> Float[Array, "points 2"]:
    """Return corners of the set of (e_x, u2), and points along the edges that the coupling cuts."""
    x, turning, dtype = caps.errors[0], caps.turning, caps.errors.dtype
    signs = jnp.asarray(list(itertools.product((-1.0, 1.0), repeat=2)), dtype=dtype)
    if caps.coupling is None:
        return signs * jnp.stack([x, turning])
    a, b = caps.coupling
    first = jnp.stack([jnp.clip(a * (1.0 - turning / b), 0.0, x), jnp.minimum(turning, b)])
    last = jnp.stack([jnp.minimum(x, a), jnp.clip(b * (1.0 - x / a), 0.0, turning)])
    along = jnp.linspace(0.0, 1.0, EDGE, dtype=dtype)[:, None]
    return (((1.0 - along) * first + along * last) * signs[:, None]).reshape(-1, 2)
