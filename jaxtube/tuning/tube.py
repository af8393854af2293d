"""Reach of the tubes as a function of the local gains, differentiable: what `sets.tubes` computes
by vertices.

    W = {sum_i s_i g_i : |s_i| <= 1}        h_W(c) = sum_i |c g_i|        deviation+ = Phi deviation + w,  w in W
    sequence   h_{R_j}(c) = sum over m = 1..j of h_W(c Phi_{j-1} ... Phi_m), the factor being I at m = j
    summed     h_{R_j}(c) = sum over m < j of max h_W(c Psi_m) over the products Psi_m of m vertex loops

W is symmetric, so is every section, and support numbers along rows are all that E and U lose. Every
function follows the dtype of its arguments, works under `jit`, and has one derivative except where
a product c g_i changes its sign or two maxima are equal; there it is that of a side.

Source: Gonzalez, Fiacchini, Guzman, Alamo 2009, eqs. (26)-(29); Chisci, Rossiter, Zappa 2001.
"""

import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Float

from jaxtube.synthesis.problem import Problem


def disturbance_generators(problem: Problem) -> Float[np.ndarray, "g 3"]:
    """Return the generators of a design's W: its three half widths, and a computed W's yaw kick (0,
    g_y, 1) first."""
    bound = problem.disturbance_bound
    if bound is None:
        return np.diag(problem.disturbance_set.support(np.eye(3)))
    return np.vstack([bound.yaw * np.array([0.0, bound.lateral_per_yaw, 1.0]), np.diag(bound.box)])


def support(generators: Float[Array, "g 3"], rows: Float[Array, "... 3"]) -> Float[Array, "..."]:
    """Return the support numbers of W along the rows."""
    return jnp.sum(jnp.abs(rows @ generators.T), axis=-1)


def largest(values: Float[Array, "n *k"]) -> Float[Array, "*k"]:
    """Return the largest values along the first axis, each with the derivative of one entry that
    attains it.

    That of `jnp.max` counts the entries that are equal, and mirror images always are: where a
    compiled program computes them twice, rounded in two ways, it can find one and count two.
    """
    return jnp.take_along_axis(values, jnp.argmax(values, axis=0)[None], axis=0)[0]


def sequence_reach(
    loops: Float[Array, "windows horizon 3 3"],
    generators: Float[Array, "g 3"],
    rows: Float[Array, "windows k 3"],
    steps: int,
) -> Float[Array, "windows k"]:
    """Return the support numbers of the `sequence` section R_steps of many windows.

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
    """Return the support numbers of the `sequence` sections R_0 .. R_{stages-1}, each along its own
    rows.

    Args:
        loops: A + B K along each window's schedule.
        generators: of W.
        rows: those of E for every stage, or the input rows under each stage's gain (`rows_under`).
    """
    return jnp.stack(
        [sequence_reach(loops, generators, rows[:, j], j) for j in range(rows.shape[1])], axis=1
    )


def summed_reach(
    loops: Float[Array, "v 3 3"],
    generators: Float[Array, "g 3"],
    rows: Float[Array, "k 3"],
    horizon: int,
) -> Float[Array, "horizon+1 k"]:
    """Return the support numbers of the `summed` sections R_0 .. R_horizon along the rows.

    Runs through all v^(horizon-1) products of vertex loops.
    """
    products, reach = rows[None], [jnp.zeros_like(rows[:, 0])]
    for j in range(horizon):
        if j > 0:
            products = (products[None] @ loops[:, None]).reshape(-1, *rows.shape)
        reach.append(reach[-1] + largest(support(generators, products)))
    return jnp.stack(reach)


def summed_input_reach(
    loops: Float[Array, "v 3 3"],
    generators: Float[Array, "g 3"],
    rows: Float[Array, "gains k 3"],
    horizon: int,
) -> Float[Array, "horizon+1 k"]:
    """Return the support numbers of co u_i K_i R_0 .. co u_i K_i R_horizon along the input rows
    under K_1, K_2, ..."""
    reach = summed_reach(loops, generators, rows.reshape(-1, 3), horizon)
    return largest(jnp.moveaxis(reach.reshape(horizon + 1, *rows.shape[:2]), 1, 0))


def rows_under(
    inputs: Float[Array, "k 2"], errors: Float[Array, "k 3"], gains: Float[Array, "... 2 3"]
) -> Float[Array, "... k 3"]:
    """Return the rows  inputs u + errors e  on the error under u = K e."""
    return inputs @ gains + errors
