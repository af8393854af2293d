"""Tube-MPC on line: one condensed QP per instance, with matrices shared along the reference, and a
backup where it has no solution.

    min_g  sum_{j<N} e_j^T Q e_j + g_j^T R g_j + e_N^T P e_N
    s.t.   e_{j+1} = A(th_{k+j}) e_j + B g_j,   e_j in E_j,   g_j in U_j,   e_N in Omega_N

With `restart` the prediction starts at the measured error and u(k) = g_0: growing tubes R_j with
R_0 = {0} are valid only then (Chisci, Rossiter, Zappa 2001). Without it the nominal error is never
reset, e_nominal+ = A e_nominal + B g_0, and u = g_0 + K(th) (e - e_nominal) (Gonzalez, Fiacchini,
Guzman, Alamo 2009, eqs. (12)-(15), (31)).

Where the QP has no solution the last feasible plan goes on, u = g_j + K(th) (e - e_j), and after
its end the terminal gain, u = Gamma(th) e: nothing raises, and every step says what it did.

`planning` makes the plans.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Bool, Float, Int

from jaxtube import qp
from jaxtube.columns import by_columns, join, name_columns, split
from jaxtube.control import planning
from jaxtube.qp.parametric import (
    find_nothing,
    find_rows,
    recall,
)

ACTED = "acted"
"""Name under which reverse mode keeps what `act` returns, and which rows were active, a few bytes
for each instance: no step is solved again."""


class MpcState(NamedTuple):
    """Memory of the controller: the last plan, its stage that is due, and the error that the plan
    predicts."""

    inputs: Float[Array, "batch horizon 2"]
    stage: Int[Array, " batch"]  # of the plan's input that is due; the horizon where none is left
    nominal: Float[Array, "batch 3"]


class Diagnostics(NamedTuple):
    """What one step of a controller reports; every controller fills all fields."""

    status: Int[Array, " batch"]  # qp.SOLVED, qp.INFEASIBLE or qp.UNSOLVED
    residual: Float[Array, " batch"]  # KKT residual of the QP
    active: Bool[Array, " batch"]  # some row of the QP is active
    backup: Bool[Array, " batch"]  # the QP gave no plan: the input is the backup's


def initial_state(errors: Float[Array, "batch 3"], horizon: int, inputs: int) -> MpcState:
    """Return the memory before the first step: no plan, nominal error = measured error."""
    batch = len(errors)
    no_inputs = jnp.zeros((batch, horizon, inputs), errors.dtype)
    at_the_end = jnp.full(batch, horizon, jnp.int32)
    return MpcState(no_inputs, at_the_end, errors)


Action = tuple[Float[Array, "batch 2"], MpcState, Diagnostics]
"""Virtual inputs, next memory and diagnostics of a step."""


@partial(jax.custom_vjp, nondiff_argnums=(4,))
def act(
    qps: planning.CondensedQp,
    index: Int[Array, ""],
    state: MpcState,
    errors: Float[Array, "batch 3"],
    restart: bool,
) -> Action:
    """Return the virtual input of one step of the tube-MPC.

    Args:
        qps: one for each window of the reference.
        index: of the window that lies ahead.
        state: memory.
        errors: measured tracking errors, (m, m, rad).
        restart: start the prediction at the measured error (True) or at the nominal one.

    Returns:
        (inputs (speed deficit m/s, yaw rate deficit rad/s), next memory, diagnostics). Reverse mode
        gives the derivative of inputs and memory on the active rows; that of diagnostics is zero.
    """

    def constrained(condensed, state, errors):
        start = _choose_start(state, errors, restart)
        return _follow(condensed, state, errors, start, planning.constrained_plan(condensed, start))

    freely = partial(act_freely, restart=restart)
    _, action = _branch(freely, constrained, qps, index, state, errors, restart)
    return action


def _branch(
    freely: Callable[..., Any],
    constrained: Callable[..., Any],
    qps: planning.CondensedQp,
    index: Int[Array, ""],
    state: MpcState,
    errors: Float[Array, "batch 3"],
    restart: bool,
) -> tuple[Bool[Array, ""], Any]:
    """Return whether every plan is free, and what one function or the other makes of the QP of the
    window, the memory and the errors."""

    def of_window(function):
        @by_columns
        def call(qps, state, errors):
            return function(planning.take_qp(qps, index), state, errors)

        return call

    start = _choose_start(state, errors, restart)
    all_free = planning.are_all_free(planning.take_qp(qps, index), start)
    columns = split((state, errors))
    outcome = jax.lax.cond(all_free, of_window(freely), of_window(constrained), qps, *columns)
    return all_free, join(outcome)


def _act_and_remember(qps, index, state, errors, restart: bool) -> tuple[Action, tuple]:
    """Act; return the step and what its derivative needs, all of it under ACTED."""
    batch = len(errors)

    def freely(condensed, state, errors):
        found = find_nothing(condensed.factors, batch)
        return act_freely(condensed, state, errors, restart), (jnp.ones(batch, bool), found)

    def constrained(condensed, state, errors):
        start = _choose_start(state, errors, restart)
        free = planning.is_free(condensed, start)
        solution = planning.solve_some(condensed, start, ~free)
        found = find_rows(condensed.factors, condensed.parametric, start, solution)
        # As the derivative takes them, and more exact where active rows are nearly parallel.
        recalled = recall(condensed.factors, condensed.parametric, start, found)
        solution = solution._replace(x=recalled.x, multipliers=recalled.multipliers)
        plan = planning.choose_plan(condensed, start, free, solution)
        return _follow(condensed, state, errors, start, plan), (free, found)

    outcome = _branch(freely, constrained, qps, index, state, errors, restart)
    all_free, (action, found) = name_columns(outcome, ACTED)
    return action, (qps, index, state, errors, all_free, found)


def _pull_step_back(restart: bool, saved: tuple, cotangent: Action) -> tuple:
    """Return the cotangents of QPs, memory and errors, on the active rows that were found."""
    qps, index, state, errors, all_free, (free, found) = saved
    whole = qps._replace(regions=None, free_region=None)
    columns_bar = split(cotangent)

    def pull_back(act_again: Callable[..., Action], qps, state, errors):
        condensed = planning.take_qp(qps, index)
        numbers = condensed._replace(regions=None, free_region=None)

        def act_on_numbers(numbers, inputs, nominal, errors):
            known = numbers._replace(regions=condensed.regions, free_region=condensed.free_region)
            return act_again(known, state._replace(inputs=inputs, nominal=nominal), errors)

        _, pull = jax.vjp(act_on_numbers, numbers, state.inputs, state.nominal, errors)
        return pull(join(columns_bar))

    def recall_step(condensed, state, errors) -> Action:
        start = _choose_start(state, errors, restart)
        # Which plans were free is not asked again: in another program the test may round otherwise.
        solution = recall(condensed.factors, condensed.parametric, start, found)
        plan = planning.choose_plan(condensed, start, free, solution)
        return _follow(condensed, state, errors, start, plan)

    freely = by_columns(partial(pull_back, partial(act_freely, restart=restart)))
    constrained = by_columns(partial(pull_back, recall_step))
    columns = split((state, errors))
    of_window, inputs, nominal, of_errors = join(
        jax.lax.cond(all_free, freely, constrained, qps, *columns)
    )
    of_qps = jax.tree.map(
        lambda stack, part: jnp.zeros_like(stack).at[index].set(part), whole, of_window
    )
    of_qps = of_qps._replace(
        regions=_no_cotangent(qps.regions), free_region=_no_cotangent(qps.free_region)
    )
    return of_qps, None, MpcState(inputs, _no_cotangent(state.stage), nominal), of_errors


def _no_cotangent(tree: Any) -> Any:
    """Return the cotangent zero of a tree."""

    def make_zero(array):
        is_real = jnp.issubdtype(array.dtype, jnp.floating)
        return jnp.zeros_like(array) if is_real else np.zeros(array.shape, jax.dtypes.float0)

    return jax.tree.map(make_zero, tree)


act.defvjp(_act_and_remember, _pull_step_back)


def act_as_known(
    condensed: planning.CondensedQp, state: MpcState, errors: Float[Array, "batch 3"], restart: bool
) -> Action:
    """Act where no instance needs the solver: no status is then UNSOLVED."""
    start = _choose_start(state, errors, restart)
    return _follow(condensed, state, errors, start, planning.known_plan(condensed, start))


def act_freely(
    condensed: planning.CondensedQp, state: MpcState, errors: Float[Array, "batch 3"], restart: bool
) -> Action:
    """Act where every instance has just made a free plan."""
    start = _choose_start(state, errors, restart)
    plan = planning.free_plan(condensed, start)
    due = planning.image(condensed.free_inputs[: condensed.inputs], start)
    command = due if restart else due + planning.image(condensed.tube_gain, errors - start)
    nominal = planning.predict(condensed, start, due)
    following = MpcState(plan.inputs, jnp.ones_like(state.stage), nominal)
    return command, following, _diagnose(plan)


def _follow(
    condensed: planning.CondensedQp,
    state: MpcState,
    errors: Float[Array, "batch 3"],
    start: Float[Array, "batch 3"],
    plan: planning.Plan,
) -> Action:
    """Act by plans that have just been made, and by the backup where there is none."""
    fresh = MpcState(plan.inputs, jnp.zeros_like(state.stage), start)
    now = planning.select(plan.status == qp.SOLVED, fresh, state)
    horizon = now.inputs.shape[1]
    deviation = errors - now.nominal
    due = jnp.take_along_axis(now.inputs, now.stage[:, None, None], axis=1, mode="clip")[:, 0]
    planned = (due, planning.image(condensed.tube_gain, deviation))
    at_the_end = (
        planning.image(condensed.terminal_gain, now.nominal),
        planning.image(condensed.terminal_gain, deviation),
    )
    due, feedback = planning.select(now.stage < horizon, planned, at_the_end)
    nominal = planning.predict(condensed, now.nominal, due)
    following = MpcState(now.inputs, jnp.minimum(now.stage + 1, horizon), nominal)
    return due + feedback, following, _diagnose(plan)


def _choose_start(
    state: MpcState, errors: Float[Array, "batch 3"], restart: bool
) -> Float[Array, "batch 3"]:
    """Return the errors from which plans are made."""
    return errors if restart else state.nominal


def _diagnose(plan: planning.Plan) -> Diagnostics:
    residual = jax.lax.stop_gradient(plan.residual)
    return Diagnostics(plan.status, residual, plan.active, plan.status != qp.SOLVED)


def no_diagnostics(errors: Float[Array, "batch 3"]) -> Diagnostics:
    """Return the diagnostics of a controller that solves no QP."""
    batch = len(errors)
    solved = jnp.full(batch, qp.SOLVED)
    never = jnp.zeros(batch, bool)
    return Diagnostics(solved, jnp.zeros_like(errors[:, 0]), never, never)
