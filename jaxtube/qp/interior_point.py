"""Primal-dual interior point method for a batch of small convex quadratic programs.

    minimise over x   1/2 x' P x + q' x   subject to   G x + s = h,  s >= 0

P and G are shared by the batch, q and h are not; an infinite h drops its row. Each iteration
(1) takes the affine direction, towards s y = 0,
(2) sets the centring from the step that this direction allows,
(3) corrects for its second-order term,
(4) moves by one step length for x, s and y; `Caution` bounds all three.

Notation: y >= 0 multipliers, mu = s'y / rows. The batch is the last axis. Source: Mehrotra, On the
implementation of a primal-dual interior point method, SIAM J. Optimization 1992; Cartis 2009
(Optimization Methods and Software 24, 35-62) shows that without such bounds it can cycle; programs
of this project's controllers made it cycle.
"""

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import Array
from jaxtyping import Bool, Float

from jaxtube.qp import batched_ldl
from jaxtube.qp.batched_ldl import matmul


class Caution(NamedTuple):
    """How far a step goes towards the boundary, the least centring, and the largest second-order
    term by mu."""

    step: Float[Array, "*runs"] | float
    centring: Float[Array, "*runs"] | float
    correction: Float[Array, "*runs"] | float


BOLD = Caution(0.995, 0.0, 1e9)
"""Mehrotra's steps: few, but where more rows meet than there are unknowns they may run into the
boundary and cycle."""
CAUTIOUS = Caution(0.9, 0.1, 1.0)
"""Steps that do not cycle and need more iterations."""


class Program(NamedTuple):
    """What the batch shares: P, G, and the packed forms of P and of the pairs of columns of G."""

    hessian: Float[Array, "n n"]
    rows: Float[Array, "m n"]
    packed_hessian: Float[Array, " pairs"]
    pair_products: Float[Array, "pairs m"]


class State(NamedTuple):
    """Primal, slack and multipliers of every instance, and whether it still moves."""

    x: Float[Array, "n batch"]
    s: Float[Array, "m batch"]
    y: Float[Array, "m batch"]
    moves: Bool[Array, " batch"]


def program(hessian: Float[Array, "n n"], rows: Float[Array, "m n"]) -> Program:
    """Return the shared data of min 1/2 x'Px + q'x s.t. Gx <= h, P being `hessian` and G `rows`."""
    return Program(hessian, rows, batched_ldl.pack(hessian), batched_ldl.pair_products(rows))


def solve(
    shared: Program,
    q: Float[Array, "n batch"],
    h: Float[Array, "m batch"],
    start: Float[Array, "n batch"],
    iterations: int,
    caution: Caution = BOLD,
) -> tuple[Float[Array, "n batch"], Float[Array, "m batch"]]:
    """Take at most `iterations` steps from x = start; return x and y >= 0, zero on dropped rows.

    No status: the caller checks the residual. An instance without a solution ends with large y,
    most often a proof.
    """
    kept = jnp.isfinite(h)
    h = jnp.where(kept, h, 0.0)
    slack = jnp.where(kept, jnp.maximum(h - matmul(shared.rows, start), 1.0), 1.0)
    multipliers = jnp.where(kept, 1.0 / len(h), 0.0)
    begin = State(start, slack, multipliers, jnp.ones(h.shape[1], bool))

    def is_unfinished(carry):
        count, state = carry
        return (count < iterations) & jnp.any(state.moves)

    def body(carry):
        count, state = carry
        return count + 1, iterate(shared, q, h, kept, state, caution)

    _, end = jax.lax.while_loop(is_unfinished, body, (0, begin))
    return end.x, end.y


def iterate(
    shared: Program,
    q: Float[Array, "n batch"],
    h: Float[Array, "m batch"],
    kept: Bool[Array, "m batch"],
    state: State,
    caution: Caution,
) -> State:
    """Take one predictor-corrector step; an instance that is done, or whose numbers leave the
    floats, stays."""
    x, s, y, _ = state
    count = jnp.maximum(jnp.sum(kept, axis=0), 1).astype(x.dtype)
    find_direction = partial(solve_newton, make_newton_system(shared, q, h, kept, state), shared)
    _, ds, dy = find_direction(s * y)  # (1)
    step = longest_step(state, ds, dy, caution.step)
    mu = jnp.sum(jnp.where(kept, s * y, 0.0), axis=0) / count
    affine_products = (s + step * ds) * (y + step * dy)
    affine_mu = jnp.sum(jnp.where(kept, affine_products, 0.0), axis=0) / count
    target = mu * jnp.clip((affine_mu / mu) ** 3, caution.centring, 1.0)  # (2)
    most = caution.correction * mu
    second_order = jnp.clip(ds * dy, -most, most)
    dx, ds, dy = find_direction(s * y + second_order - target)  # (3)
    step = longest_step(state, ds, dy, caution.step)  # (4)
    return move(state, x + step * dx, s + step * ds, y + step * dy, mu)


class NewtonSystem(NamedTuple):
    """The linear equations of one iteration, factorised."""

    s: Float[Array, "m batch"]
    y: Float[Array, "m batch"]
    kept: Bool[Array, "m batch"]
    weights: Float[Array, "m batch"]  # y / s, zero on dropped rows
    ldl: batched_ldl.LDL
    dual_residual: Float[Array, "n batch"]
    primal_residual: Float[Array, "m batch"]


def make_newton_system(
    shared: Program,
    q: Float[Array, "n batch"],
    h: Float[Array, "m batch"],
    kept: Bool[Array, "m batch"],
    state: State,
) -> NewtonSystem:
    """Factorise the equations of an iteration at its state."""
    x, s, y, _ = state
    P = shared.hessian
    G = shared.rows
    weights = jnp.where(kept, y / s, 0.0)
    system = shared.packed_hessian[:, None] + matmul(shared.pair_products, weights)
    ldl = batched_ldl.factorise(system)
    dual_residual = matmul(P, x) + q + matmul(G.T, y)
    primal_residual = matmul(G, x) + s - h
    return NewtonSystem(s, y, kept, weights, ldl, dual_residual, primal_residual)


def solve_newton(
    system: NewtonSystem, shared: Program, complementarity: Float[Array, "m batch"]
) -> tuple[Float[Array, "n batch"], Float[Array, "m batch"], Float[Array, "m batch"]]:
    """Return the directions (dx, ds, dy) that remove both residuals and, to first order, the
    complementarity."""
    s, y, kept, weights, ldl, dual_residual, primal_residual = system
    G = shared.rows
    shift = weights * primal_residual - jnp.where(kept, complementarity / s, 0.0)
    dx = batched_ldl.solve(ldl, -dual_residual - matmul(G.T, shift))
    ds = jnp.where(kept, -primal_residual - matmul(G, dx), 0.0)
    dy = jnp.where(kept, -(complementarity + y * ds) / s, 0.0)
    return dx, ds, dy


def move(
    state: State,
    x: Float[Array, "n batch"],
    s: Float[Array, "m batch"],
    y: Float[Array, "m batch"],
    mu: Float[Array, " batch"],
) -> State:
    """Return the state at x, s, y, or as it was where an instance is done or leaves the floats."""
    # Beyond this mu the weights y / s differ by more than the floats resolve, and iterating on
    # loses what was found.
    moves = state.moves & (mu > jnp.finfo(x.dtype).eps ** 0.75)
    moves &= jnp.all(jnp.isfinite(x), axis=0)
    moves &= jnp.all(s > 0, axis=0) & jnp.all(y >= 0, axis=0)
    moved = State(x, s, y, moves)
    return jax.tree.map(lambda new, old: jnp.where(moves, new, old), moved, state)


def longest_step(
    state: State, ds: Float[Array, "m batch"], dy: Float[Array, "m batch"], share
) -> Float[Array, " batch"]:
    """Return the step, at most 1, that goes at most a share of the way to where some s or y would
    be zero."""
    shrink_s = jnp.max(-ds / state.s, axis=0)
    shrink_y = jnp.max(jnp.where(dy < 0, -dy / state.y, 0.0), axis=0)
    return share / jnp.maximum(jnp.maximum(shrink_s, shrink_y), share)
