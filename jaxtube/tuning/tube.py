"""Support numbers of the tube's sections as differentiable functions of the local gains.

    W = {sum_i s_i g_i : |s_i| <= 1}    h_W(c) = sum_i |c g_i|    deviation+ = Phi deviation + w
    h_{R_j}(c) = sum over m = 1..j of h_W(c Phi_{j-1} ... Phi_m), the factor being I at m = j

W is symmetric, so is every section, and support numbers along rows are all that E and U lose: what
`sets.tubes` computes by vertices. Every function follows the dtype of its arguments and works under
`jit`. Its derivative is unique except where a product c g_i changes its sign or two maxima are
equal; there it is one-sided.

Source: Gonzalez, Fiacchini, Guzman, Alamo 2009, eq. (26); Chisci, Rossiter, Zappa 2001.
"""

from __future__ import annotations

import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Float

from jaxtube.synthesis.problem import Problem


def disturbance_generators(problem: Problem) -> Float[np.ndarray, "g 3"]:
    """Return the generators of a design's W (m, m, rad): the three half widths of its box, after
    the yaw kick (0, g_y, 1) where W is computed."""
    bound = problem.disturbance_bound
    if bound is None:
        return np.diag(problem.disturbance_set.support(np.eye(3)))
    kick = bound.yaw * np.array([0.0, bound.lateral_per_yaw, 1.0])
    return np.vstack([kick, np.diag(bound.box)])


def support(generators: Float[Array, "g 3"], rows: Float[Array, "... 3"]) -> Float[Array, "..."]:
    """Return the support numbers of W along the rows."""
    return jnp.sum(jnp.abs(rows @ generators.T), axis=-1)


def largest(values: Float[Array, "n *k"]) -> Float[Array, "*k"]:
    """Return the largest values along the first axis, each with the derivative of one entry that
    attains it.

    `jnp.max` shares the derivative among the entries that it counts as equal, and mirror images
    always are equal: a compiled program that computes them twice, rounded in two ways, can find one
    maximum and count two.
    """
    attained = jnp.argmax(values, axis=0)[None]
    return jnp.take_along_axis(values, attained, axis=0)[0]


def reach_along(
    loops: Float[Array, "windows horizon 3 3"],
    generators: Float[Array, "g 3"],
    rows: Float[Array, "windows k 3"],
    steps: int,
) -> Float[Array, "windows k"]:
    """Return the support numbers of the section R_steps of many windows.

    Args:
        loops: A + B K along each window's schedule.
        generators: of W.
        rows: directions, by window.
        steps: static, at most the horizon.
    """
    total = jnp.zeros_like(rows[..., 0])
    for m in range(steps, 0, -1):
        total = total + support(generators, rows)
        rows = rows @ loops[:, m - 1]
    return total


def sequence_reaches(
    loops: Float[Array, "windows horizon 3 3"],
    generators: Float[Array, "g 3"],
    rows: Float[Array, "windows stages k 3"],
) -> Float[Array, "windows stages k"]:
    """Return the support numbers of the sections R_0 .. R_{stages-1}, each along its own rows.

    Args:
        loops: A + B K along each window's schedule.
        generators: of W.
        rows: those of E for every stage, or the input rows under each stage's gain
            (`closed_loop_rows`).
    """
    stages = range(rows.shape[1])
    return jnp.stack([reach_along(loops, generators, rows[:, j], j) for j in stages], axis=1)


def closed_loop_rows(
    inputs: Float[Array, "k 2"], errors: Float[Array, "k 3"], gains: Float[Array, "... 2 3"]
) -> Float[Array, "... k 3"]:
    """Return the rows  inputs u + errors e  on the error alone, where u = K e."""
    return inputs @ gains + errors
