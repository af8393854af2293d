"""Tube-MPC on line: one condensed QP per instance, shared matrices along the reference, a backup
for infeasible ones.

    min_g  sum_{j<N} e_j^T Q e_j + g_j^T R g_j + e_N^T P e_N
    s.t.   e_{j+1} = A(th_{k+j}) e_j + B g_j,   e_j in E_j,   g_j in U_j,   e_N in Omega_N

With `restart` the prediction starts at the measured error and u(k) = g_0: growing tubes R_j with
R_0 = {0} are valid only then (Chisci, Rossiter, Zappa 2001). Without it the nominal error is never
reset, e_nominal+ = A e_nominal + B g_0, and u = g_0 + K(th) (e - e_nominal) (Gonzalez, Fiacchini,
Guzman, Alamo 2009, eqs. (12)-(15), (31)).

Where the QP has no solution the last feasible plan goes on, u = g_j + K(th) (e - e_j), and after
its end the terminal gain, u = Gamma(th) e: nothing raises, and every step says what it did.

While no row is active the optimum is linear, g = G e, and so is what the rows see of it: a batch
that meets all its bounds this way is answered without a solver. Only the others go to `qp.solve`.
"""

from __future__ import annotations

import functools
import operator
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import Array
from jax.ad_checkpoint import checkpoint_name
from jaxtyping import Bool, Float, Int

from jaxtube import qp
from jaxtube.qp.batched_ldl import matmul

AnyArray = Any  # a design holds numpy, a controller jax arrays

ACTED = "acted"
"""Name of what `act` returns, for reverse mode to keep: else a step is solved again."""


class Window(NamedTuple):
    """What the controller knows of the reference ahead, condensed; arrays carry a leading axis over
    distinct windows.

    Rows that no input reaches are kept apart as `check_*`: they only say whether the present error
    is admissible.
    """

    factors: qp.Factors
    linear: Float[AnyArray, "n 3"]  # q = linear e
    cost_unit: Float[AnyArray, ""]  # what the QP's cost is divided by
    row_errors: Float[AnyArray, "m 3"]  # lower <= row_errors e + rows g <= upper
    lower: Float[AnyArray, " m"]
    upper: Float[AnyArray, " m"]
    check_errors: Float[AnyArray, "c 3"]
    check_lower: Float[AnyArray, " c"]
    check_upper: Float[AnyArray, " c"]
    free_inputs: Float[AnyArray, "n 3"]  # G: without constraints g = G e
    free_rows: Float[AnyArray, "m 3"]  # row_errors + rows G
    free_scale: Float[
        AnyArray, ""
    ]  # |H| |G| + |F|, row sum: what rounding in H G e + F e is proportional to
    tube_gain: Float[AnyArray, "2 3"]  # K(th_k)
    terminal_gain: Float[AnyArray, "2 3"]  # Gamma(th_k)
    transition: Float[AnyArray, "3 3"]  # A(th_k)
    input_matrix: Float[AnyArray, "3 2"]  # B(th_k)


class MpcState(NamedTuple):
    """Memory of the controller: the last plan, how much of it lies behind, and where the plan
    expects the error."""

    inputs: Float[Array, "batch horizon 2"]
    stage: Int[Array, " batch"]  # of the plan's input that is due; the horizon: nothing is left
    nominal: Float[Array, "batch 3"]


class Plan(NamedTuple):
    """Inputs g_0 .. g_{N-1} of every instance, and what its QP came to."""

    inputs: Float[Array, "batch horizon 2"]
    status: Int[Array, " batch"]  # qp.SOLVED where there is a plan
    residual: Float[Array, " batch"]
    active: Bool[Array, " batch"]


class Diagnostics(NamedTuple):
    """What one step of a controller reports; every controller fills all fields."""

    status: Int[Array, " batch"]  # qp.SOLVED, qp.INFEASIBLE or qp.UNSOLVED
    residual: Float[Array, " batch"]  # KKT residual of the QP
    active: Bool[Array, " batch"]  # some row of the QP is active
    backup: Bool[Array, " batch"]  # the QP gave no plan: the input is the backup's


def initial_state(errors: Float[Array, "batch 3"], horizon: int) -> MpcState:
    """Return the memory before the first step: no plan, nominal error = measured error."""
    batch = errors.shape[0]
    return MpcState(
        jnp.zeros((batch, horizon, 2), errors.dtype), jnp.full(batch, horizon, jnp.int32), errors
    )


def plan(window: Window, errors: Float[Array, "batch 3"]) -> Plan:
    """Solve the QP of every instance from its own error.

    Args:
        window: one window (no leading axis).
        errors: start of each prediction, (m, m, rad).

    Returns:
        The plans. An instance has one where it is solved and the rows that no input reaches hold to
        the solver's tolerance. Its `residual` is that of the optimality conditions, or a bound on
        it.
    """
    return jax.lax.cond(_all_free(window, errors), free_plan, constrained_plan, window, errors)


def _all_free(window: Window, errors: Float[Array, "batch 3"]) -> Bool[Array, ""]:
    """Return whether every instance meets all its rows without constraints, from the extremes of
    each row."""
    slack, values = _slack(errors), matmul(window.free_rows, errors.T)
    checks = matmul(window.check_errors, errors.T)
    rows = jnp.all(window.lower <= values.min(axis=1)) & jnp.all(values.max(axis=1) <= window.upper)
    lower, upper = window.check_lower - slack, window.check_upper + slack
    return rows & jnp.all(lower <= checks.min(axis=1)) & jnp.all(checks.max(axis=1) <= upper)


def _free(window: Window, errors: Float[Array, "batch 3"]) -> Bool[Array, " batch"]:
    return _within(window.lower, window.free_rows, errors, window.upper)


def _admissible(window: Window, errors: Float[Array, "batch 3"]) -> Bool[Array, " batch"]:
    slack = _slack(errors)
    return _within(
        window.check_lower - slack, window.check_errors, errors, window.check_upper + slack
    )


def _slack(errors) -> float:
    # As exact as the rows of the QP: what an admissible plan meets with equality, it meets to
    # rounding when shifted.
    return qp.TOLERANCE[errors.dtype.itemsize]


def _within(
    lower, rows: Float[AnyArray, "m 3"], errors: Float[Array, "batch 3"], upper
) -> Bool[Array, " batch"]:
    values = _image(rows, errors)
    return jnp.all((lower <= values) & (values <= upper), axis=1)


def _image(
    matrix: Float[AnyArray, "m n"], vectors: Float[Array, "batch n"]
) -> Float[Array, "batch m"]:
    """Return matrix @ vector of every instance as a sum over few columns, which fuses with what is
    done to it next."""
    return functools.reduce(
        operator.add, (vectors[:, i, None] * matrix[:, i] for i in range(matrix.shape[1]))
    )


def free_plan(window: Window, errors: Float[Array, "batch 3"]) -> Plan:
    """Return the plans without constraints: the answer of every instance that meets all of them
    this way."""
    batch, inputs = len(errors), _image(window.free_inputs, errors)
    rounding = (inputs.shape[1] + 5) * jnp.finfo(errors.dtype).eps * window.free_scale
    residual = rounding * jnp.max(jnp.abs(errors), axis=1)
    solved = jnp.full(batch, qp.SOLVED, jnp.int32)
    return Plan(inputs.reshape(batch, -1, 2), solved, residual, jnp.zeros(batch, bool))


def constrained_plan(window: Window, errors: Float[Array, "batch 3"]) -> Plan:
    """Return the plans of a batch of which some instance does not meet its constraints freely."""
    shift = _image(window.row_errors, errors)
    solution = qp.solve(
        window.factors, _image(window.linear, errors), window.lower - shift, window.upper - shift
    )
    admissible = _admissible(window, errors)
    # Data that are not numbers are no proof of anything; their residual is infinite.
    excluded = ~admissible & jnp.isfinite(solution.residual)
    status = jnp.where(excluded, qp.INFEASIBLE, solution.status)
    active = (status == qp.SOLVED) & jnp.any(jnp.abs(solution.multipliers) > 0, axis=1)
    solved = Plan(solution.x.reshape(len(errors), -1, 2), status, solution.residual, active)
    # Not the solver's answer where there is a free one: no instance may depend on what others need.
    free = admissible & _free(window, errors)
    return _where(free, free_plan(window, errors), solved)


def _where(chosen: Bool[Array, " batch"], one, other):
    """Choose between two pytrees, instance by instance."""
    return jax.tree.map(
        lambda a, b: jnp.where(jnp.expand_dims(chosen, tuple(range(1, a.ndim))), a, b), one, other
    )


def act(
    window: Window, state: MpcState, errors: Float[Array, "batch 3"], restart: bool
) -> tuple[Float[Array, "batch 2"], MpcState, Diagnostics]:
    """Return the virtual input of one step of the tube-MPC.

    Args:
        window: the reference ahead.
        state: memory.
        errors: measured tracking errors, (m, m, rad).
        restart: start the prediction at the measured error (True) or at the nominal one.

    Returns:
        (inputs (speed deficit m/s, yaw rate deficit rad/s), next memory, diagnostics).
    """
    start = errors if restart else state.nominal
    # The derivative of a conditional keeps what any branch does: the rows of every instance, even
    # if none is active.
    constrained = jax.checkpoint(_act_constrained)
    found = jax.lax.cond(
        _all_free(window, start), _act_freely, constrained, window, state, start, errors
    )
    return jax.tree.map(functools.partial(checkpoint_name, name=ACTED), found)


def _act_freely(window: Window, state: MpcState, start, errors):
    """Act where every instance has just made a free plan."""
    found = free_plan(window, start)
    due = found.inputs[:, 0]
    command = due + _image(window.tube_gain, errors - start)
    following = MpcState(found.inputs, jnp.ones_like(state.stage), _expected(window, start, due))
    return command, following, _diagnostics(found)


def _act_constrained(window: Window, state: MpcState, start, errors):
    """Act where some instance needs the solver, or its backup."""
    found = constrained_plan(window, start)
    fresh = MpcState(found.inputs, jnp.zeros_like(state.stage), start)
    now = _where(found.status == qp.SOLVED, fresh, state)
    horizon, deviation = now.inputs.shape[1], errors - now.nominal
    due = jnp.take_along_axis(now.inputs, now.stage[:, None, None], axis=1, mode="clip")[:, 0]
    planned = due, _image(window.tube_gain, deviation)
    at_the_end = _image(window.terminal_gain, now.nominal), _image(window.terminal_gain, deviation)
    due, feedback = _where(now.stage < horizon, planned, at_the_end)
    following = MpcState(
        now.inputs, jnp.minimum(now.stage + 1, horizon), _expected(window, now.nominal, due)
    )
    return due + feedback, following, _diagnostics(found)


def _expected(window: Window, nominal: Float[Array, "batch 3"], inputs: Float[Array, "batch 2"]):
    return _image(window.transition, nominal) + _image(window.input_matrix, inputs)


def _diagnostics(found: Plan) -> Diagnostics:
    return Diagnostics(found.status, found.residual, found.active, found.status != qp.SOLVED)


def no_diagnostics(errors: Float[Array, "batch 3"]) -> Diagnostics:
    """Return the diagnostics of a controller that solves no QP."""
    none = jnp.zeros(errors.shape[0], bool)
    return Diagnostics(
        jnp.full(errors.shape[0], qp.SOLVED), jnp.zeros_like(errors[:, 0]), none, none
    )


def take_window(windows: Window, index: Int[Array, ""]) -> Window:
    """Return one window of a stack."""
    return jax.tree.map(lambda array: array[index], windows)
