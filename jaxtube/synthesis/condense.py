"""Condensed QPs along the reference: states eliminated, one set of matrices a window, shared by
every realisation.

    1/2 g^T H g + (F e)^T g,      H = 2 (sum_j Theta_j^T Q_j Theta_j + R),
                                  F = 2 sum_j Theta_j^T Q_j Psi_j,   Q_N = P

or, where a plan costs its deviation sum_j |g_j - K_j e_j|_R^2 from the tube's gains, with rows
D_j = (row j of the identity) - K_j Theta_j,

                                  H = 2 sum_j D_j^T R D_j,   F = -2 sum_j D_j^T R K_j Psi_j

    lower <= row_errors e + rows g <= upper

Psi_j, Theta_j and the rows are those of `prediction`. Constraints are backed off by what a solver
may miss them by.

Off line `condense` computes all windows at once in numpy; `tuning` differentiates the same formulas
in jax.
"""

from __future__ import annotations

from dataclasses import dataclass
from types import ModuleType
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from jaxtube import qp
from jaxtube.control.planning import CondensedQp
from jaxtube.qp.regions import AnyArray
from jaxtube.scenario.refusal import ScenarioError
from jaxtube.synthesis.control_problem import ControlProblem
from jaxtube.synthesis.prediction import Prediction, predict
from jaxtube.synthesis.terminal import Terminal
from jaxtube.synthesis.tightening import Tightening, find_back_off, reach_of_limits
from jaxtube.synthesis.windows import Windows


@dataclass(frozen=True, eq=False)
class Bounds:
    """Offsets of the sets the controller really uses, window by window (rows of E, U and the
    terminal constraint)."""

    errors: Float[AnyArray, "windows horizon 6"]  # E_j, j = 0..N-1
    inputs: Float[AnyArray, "windows horizon k"]  # U_j and the coupling's rows, j = 0..N-1
    terminal_normals: Float[AnyArray, "facets 3"]
    terminal: Float[AnyArray, "windows facets"]


def tube_bounds(
    problem: ControlProblem,
    windows: Windows,
    tightening: Tightening,
    terminal: Terminal,
    once: float | None = None,
) -> Bounds:
    """Return the tightened sets, backed off for the solver's slack.

    Args:
        problem: of the design.
        windows: its windows.
        tightening: by its tube.
        terminal: its terminal set.
        once: what a stage is backed off more than the one before, as a share of each limit; that
            of `find_back_off` unless given.
    """
    N = problem.horizon
    normals = terminal.constraint_normals
    once = find_back_off(problem) if once is None else once
    left = 1 - once * np.arange(1, N + 1)[:, None]
    last_back_off = (N + 1) * once * reach_of_limits(problem, normals)
    return Bounds(
        errors=left * problem.operating_set.offsets - tightening.error_reach[:, :N],
        inputs=left * problem.rows_of(windows.regimes).offsets - tightening.input_reach,
        terminal_normals=normals,
        terminal=terminal.constraint_offsets - last_back_off,
    )


def draw_in(problem: ControlProblem, windows: Windows, bounds: Bounds, share: float) -> Bounds:
    """Return bounds drawn in by a share of each limit."""
    return Bounds(
        errors=bounds.errors - share * problem.operating_set.offsets,
        inputs=bounds.inputs - share * problem.rows_of(windows.regimes).offsets,
        terminal_normals=bounds.terminal_normals,
        terminal=bounds.terminal - share * reach_of_limits(problem, bounds.terminal_normals),
    )


def plain_bounds(problem: ControlProblem, windows: Windows, terminal: Terminal) -> Bounds:
    """Return E and U untightened and no terminal set: what MPC without a tube uses.

    The terminal rows stay, unbounded, so that both controllers share their shapes and one
    compilation.
    """
    stages = (len(windows.schedules), problem.horizon)
    errors = problem.operating_set.offsets
    return Bounds(
        errors=np.broadcast_to(errors, (*stages, len(errors))),
        inputs=problem.rows_of(windows.regimes).offsets,
        terminal_normals=terminal.constraint_normals,
        terminal=np.full(terminal.constraint_offsets.shape, np.inf),
    )


class RowBounds(NamedTuple):
    """Lower and upper bounds of the rows, and of those that no input reaches."""

    lower: Float[AnyArray, "windows m"]
    upper: Float[AnyArray, "windows m"]
    check_lower: Float[AnyArray, "windows c"]
    check_upper: Float[AnyArray, "windows c"]


class Cost(NamedTuple):
    """Weights of errors and inputs, and the terminal cost; and the gains of each window that inputs
    should not deviate from, where that is all a plan costs."""

    error_weight: Float[AnyArray, "3 3"]
    input_weight: Float[AnyArray, "2 2"]
    terminal: Float[AnyArray, "3 3"]
    kept_gains: Float[AnyArray, "windows horizon 2 3"] | None = None


class Gains(NamedTuple):
    """Gains of the tube and of the terminal controller at the first step of each window."""

    tube: Float[AnyArray, "windows 2 3"]
    terminal: Float[AnyArray, "windows 2 3"]


def condense(
    problem: ControlProblem,
    windows: Windows,
    terminal: Terminal,
    terminal_cost: Float[np.ndarray, "3 3"],
    bounds: Bounds,
) -> CondensedQp:
    """Return the condensed QPs of all windows, numpy float64 (cast them for the device).

    Raises:
        ScenarioError: where float64 does not resolve the weights.
    """
    ahead = predict(problem, windows, bounds.terminal_normals)
    gains = Gains(windows.gains[:, 0], terminal.gains.along(windows.schedules[:, 0]))
    has_gains = problem.settings.cost == "deviation"
    kept_gains = windows.gains if has_gains else None
    cost = Cost(problem.error_weight, problem.input_weight, terminal_cost, kept_gains)
    try:
        return weigh(ahead, row_bounds(bounds, ahead, np), gains, cost, widths(problem), np)
    except np.linalg.LinAlgError:
        raise ScenarioError(
            f"scenario: controller.input_weight = {problem.input_weight.tolist()}: beside "
            f"error_weight = {problem.error_weight.tolist()} the cost of a plan is not positive "
            "definite in float64; bring the weights closer together"
        ) from None


def widths(problem: ControlProblem) -> Float[np.ndarray, "3"]:
    """Return the half widths of the errors that plans start from, (m, m, rad)."""
    return problem.operating_set.support(np.eye(problem.operating_set.dimension))


def row_bounds(bounds: Bounds, ahead: Prediction, xp: ModuleType = jnp) -> RowBounds:
    """Return the bounds in the order of the rows, in numpy or jax: opposite rows of E and U are one
    row with two bounds."""
    count, _, both = bounds.inputs.shape
    k = both // 2
    half = bounds.errors.shape[2] // 2
    below = (
        -bounds.errors[:, 1:, half:],
        -bounds.inputs[:, :, k:],
        -xp.full_like(bounds.terminal, xp.inf),
    )
    above = (bounds.errors[:, 1:, :half], bounds.inputs[:, :, :k], bounds.terminal)
    lower = xp.concatenate([part.reshape(count, -1) for part in below], axis=1)
    upper = xp.concatenate([part.reshape(count, -1) for part in above], axis=1)
    return RowBounds(
        lower=lower[:, ahead.reached],
        upper=upper[:, ahead.reached],
        check_lower=lower[:, ahead.unreached],
        check_upper=upper[:, ahead.unreached],
    )


def weigh(
    ahead: Prediction,
    bounds: RowBounds,
    gains: Gains,
    cost: Cost,
    largest_errors: Float[AnyArray, "3"],
    xp: ModuleType = jnp,
) -> CondensedQp:
    """Return the condensed QPs of a cost and of bounds.

    In jax they are differentiable in both and in the gains; numpy needs no compilation. Only the
    ratio of the weights matters to the plan. Their size is chosen so that the gradient at g = 0 is
    1 at most, and attains it, for errors up to `largest_errors`: to that the solver's tolerance is
    relative.
    """
    hessian, linear = condense_cost(ahead, cost, xp)
    unit = cost_unit(linear, largest_errors, xp)
    hessian = hessian / unit
    linear = linear / unit
    factors = qp.factorise(hessian, xp.asarray(ahead.rows), xp)
    free_inputs = solve_free(hessian, linear, factors.optimum)
    scale = xp.abs(hessian) @ xp.abs(free_inputs) + xp.abs(linear)
    return CondensedQp(
        factors=factors,
        linear=linear,
        cost_unit=xp.full(len(linear), unit),
        row_errors=ahead.row_errors,
        lower=bounds.lower,
        upper=bounds.upper,
        check_errors=ahead.check_errors,
        check_lower=bounds.check_lower,
        check_upper=bounds.check_upper,
        free_inputs=free_inputs,
        free_rows=ahead.row_errors + ahead.rows @ free_inputs,
        free_scale=xp.max(xp.sum(scale, axis=2), axis=1),
        tube_gain=gains.tube,
        terminal_gain=gains.terminal,
        transition=ahead.transition,
        input_matrix=ahead.input_matrix,
    )


def condense_cost(
    ahead: Prediction, cost: Cost, xp: ModuleType
) -> tuple[Float[AnyArray, "windows n n"], Float[AnyArray, "windows n 3"]]:
    """Return H and F."""
    if cost.kept_gains is not None:
        return _condense_deviation(ahead, cost.kept_gains, cost.input_weight, xp)
    N = ahead.free.shape[1] - 1
    stages = xp.broadcast_to(cost.error_weight, (N, *cost.error_weight.shape))
    weights = xp.concatenate([stages, cost.terminal[None]])  # Q_0 .. Q_N
    weighted = xp.einsum("wjxa,jxy->wjay", ahead.forced, weights)
    of_errors = xp.einsum("wjay,wjyb->wab", weighted, ahead.forced)
    of_inputs = xp.kron(xp.eye(N), cost.input_weight)
    linear = 2 * xp.einsum("wjay,wjye->wae", weighted, ahead.free)
    return 2 * (of_errors + of_inputs), linear


def _condense_deviation(
    ahead: Prediction,
    gains: Float[AnyArray, "windows horizon 2 3"],
    input_weight: Float[AnyArray, "2 2"],
    xp: ModuleType,
) -> tuple[Float[AnyArray, "windows n n"], Float[AnyArray, "windows n 3"]]:
    """Return H and F of the deviation from gains."""
    N = gains.shape[1]
    own = xp.eye(2 * N).reshape(N, 2, 2 * N)
    deviation = own - gains @ ahead.forced[:, :N]
    weighted = xp.einsum("wjua,uv->wjav", deviation, input_weight)
    hessian = 2 * xp.einsum("wjav,wjvb->wab", weighted, deviation)
    linear = -2 * xp.einsum("wjav,wjve->wae", weighted, gains @ ahead.free[:, :N])
    return hessian, linear


def cost_unit(
    linear: Float[AnyArray, "windows n 3"], largest_errors: Float[AnyArray, "3"], xp: ModuleType
) -> Float[AnyArray, ""]:
    """Return what the cost of all windows is divided by; no plan depends on it, so that it has no
    derivative."""
    largest = xp.max(xp.abs(linear) @ largest_errors)
    unit = xp.where(largest > 0, largest, 1.0)
    return unit if xp is np else jax.lax.stop_gradient(unit)


def solve_free(
    hessian: Float[AnyArray, "windows n n"],
    linear: Float[AnyArray, "windows n 3"],
    optimum: Float[AnyArray, "windows n n"],
) -> Float[AnyArray, "windows n 3"]:
    """Return G = -H^-1 F, `optimum` being -H^-1 to rounding and without derivative.

    The second of two products refines the first, and has the derivative of the answer.
    """
    rough = optimum @ linear
    return rough + optimum @ (hessian @ rough + linear)


def bound_solver_slack(
    problem: ControlProblem, windows: Windows, bounds: Bounds, qps: CondensedQp
) -> Float[np.ndarray, " windows"]:
    """Return by what share of its limit an accepted answer may miss a constraint of each window,
    from any error in E."""
    each = np.eye(problem.input_set.dimension)
    directions = np.concatenate([each, -each])
    largest_input = float(np.max(problem.input_set.support(directions)))
    reached = predict(problem, windows, bounds.terminal_normals).reached
    limits = row_limits(problem, windows, bounds.terminal_normals)[:, reached]
    return qp.bound_tolerance(largest_input) * np.max(qps.factors.row_norms / limits, axis=1)


def row_limits(
    problem: ControlProblem, windows: Windows, terminal_normals: Float[np.ndarray, "facets n"]
) -> Float[np.ndarray, "windows m"]:
    """Return the limit of every row, untightened, to which back-off and slack are relative: of
    opposite rows that of the narrower one, of terminal rows the reach of E."""
    count, N = windows.regimes.shape
    offsets = problem.rows_of(windows.regimes).offsets
    pairs = offsets.reshape(count, N, 2, -1).min(axis=2).reshape(count, -1)
    errors = np.tile(problem.operating_set.offsets.reshape(2, -1).min(axis=0), (count, N - 1))
    terminal = np.tile(reach_of_limits(problem, terminal_normals), (count, 1))
    return np.concatenate([errors, pairs, terminal], axis=1)
