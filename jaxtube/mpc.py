"""Tube-MPC on line: one condensed QP per instance, shared matrices along the reference, a backup for infeasible ones.

    min_g  sum_{j<N} e_j^T Q e_j + g_j^T R g_j + e_N^T P e_N
    s.t.   e_{j+1} = A(th_{k+j}) e_j + B g_j,   e_j in E_j,   g_j in U_j,   e_N in Omega_N

With `restart` the prediction starts at the measured error and u(k) = g_0: growing tubes R_j with R_0 = {0} are valid
only then (Chisci, Rossiter, Zappa 2001). Without it the nominal error is never reset, e_nominal+ = A e_nominal + B g_0,
and u = g_0 + K(th) (e - e_nominal) (Gonzalez, Fiacchini, Guzman, Alamo 2009, eqs. (12)-(15), (31)).

Where the QP has no solution the last feasible plan goes on, u = g_j + K(th) (e - e_j), and after its end the terminal
gain, u = Gamma(th) e: nothing raises, and every step says what it did.
"""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Bool, Float, Int

from jaxtube import qp

AnyArray = Array | np.ndarray  # a design holds numpy, a controller jax arrays


class Window(NamedTuple):
    """What the controller knows of the reference ahead, condensed; arrays carry a leading axis over distinct windows.

    Rows that no input reaches are kept apart as `check_*`: they only say whether the present error is admissible.
    """

    factors: qp.Factors
    linear: Float[AnyArray, "n 3"]  # q = linear e
    row_errors: Float[AnyArray, "m 3"]  # lower <= row_errors e + rows g <= upper
    lower: Float[AnyArray, " m"]
    upper: Float[AnyArray, " m"]
    check_errors: Float[AnyArray, "c 3"]
    check_lower: Float[AnyArray, " c"]
    check_upper: Float[AnyArray, " c"]
    plan_errors: Float[AnyArray, "horizon 3 3"]  # e_j = plan_errors e + plan_inputs g, j = 0..N-1
    plan_inputs: Float[AnyArray, "horizon 3 n"]
    tube_gain: Float[AnyArray, "2 3"]  # K(th_k)
    terminal_gain: Float[AnyArray, "2 3"]  # Gamma(th_k)
    transition: Float[AnyArray, "3 3"]  # A(th_k)
    input_matrix: Float[AnyArray, "3 2"]  # B(th_k)


class MpcState(NamedTuple):
    """Memory of the controller: the last feasible plan, shifted to the present, and the nominal error."""

    inputs: Float[Array, "batch horizon 2"]
    errors: Float[Array, "batch horizon 3"]
    left: Int[Array, " batch"]  # stages of the plan still ahead
    nominal: Float[Array, "batch 3"]


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
        jnp.zeros((batch, horizon, 2), errors.dtype),
        jnp.zeros((batch, horizon, 3), errors.dtype),
        jnp.zeros(batch, jnp.int32),
        errors,
    )


def plan(window: Window, errors: Float[Array, "batch 3"]) -> tuple[qp.Solution, Bool[Array, " batch"]]:
    """Solve the QP of every instance from its own error.

    Args:
        window: one window (no leading axis).
        errors: start of each prediction, (m, m, rad).

    Returns:
        (solution, whether it is a plan): solved, and the rows that no input reaches hold to the solver's tolerance.
    """
    shift = errors @ window.row_errors.T
    solution = qp.solve(
        window.factors, errors @ window.linear.T, jnp.asarray(window.lower) - shift, jnp.asarray(window.upper) - shift
    )
    checks = errors @ window.check_errors.T
    # As exact as the rows of the QP: what an admissible plan meets with equality, it meets to rounding when shifted.
    slack = qp.TOLERANCE[errors.dtype.itemsize]
    missed = jnp.any((checks < window.check_lower - slack) | (checks > window.check_upper + slack), axis=1)
    status = jnp.where(missed, qp.INFEASIBLE, solution.status)
    return solution._replace(status=status), status == qp.SOLVED


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
    solution, planned = plan(window, start)
    horizon = state.inputs.shape[1]
    inputs = solution.x.reshape(-1, horizon, 2)
    predicted = jnp.einsum("jxe,be->bjx", window.plan_errors, start)
    predicted = predicted + jnp.einsum("jxn,bn->bjx", window.plan_inputs, solution.x)
    inputs = jnp.where(planned[:, None, None], inputs, state.inputs)
    predicted = jnp.where(planned[:, None, None], predicted, state.errors)
    left = jnp.where(planned, horizon, state.left)

    followed = inputs[:, 0] + (errors - predicted[:, 0]) @ window.tube_gain.T
    command = jnp.where((left > 0)[:, None], followed, errors @ window.terminal_gain.T)
    planned_input = jnp.where((left > 0)[:, None], inputs[:, 0], start @ window.terminal_gain.T)
    nominal = start @ window.transition.T + planned_input @ window.input_matrix.T
    following = MpcState(
        jnp.roll(inputs, -1, axis=1),
        jnp.roll(predicted, -1, axis=1),
        jnp.maximum(left - 1, 0),
        nominal,
    )
    active = planned & jnp.any(jnp.abs(solution.multipliers) > 0, axis=1)
    return command, following, Diagnostics(solution.status, solution.residual, active, ~planned)


def no_diagnostics(errors: Float[Array, "batch 3"]) -> Diagnostics:
    """Return the diagnostics of a controller that solves no QP."""
    none = jnp.zeros(errors.shape[0], bool)
    return Diagnostics(jnp.full(errors.shape[0], qp.SOLVED), jnp.zeros_like(errors[:, 0]), none, none)


def take_window(windows: Window, index: Int[Array, ""]) -> Window:
    """Return one window of a stack."""
    return jax.tree.map(lambda array: array[index], windows)
