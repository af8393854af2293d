"""Shared by the tests of tuning: problems whose scenario gives its gains, points around them."""

import dataclasses
from functools import cache

import jax
import jax.numpy as jnp
import msgspec
import numpy as np

from jaxtube.control import planning
from jaxtube.scenario import load
from jaxtube.synthesis.disturbance import complete_problem
from jaxtube.synthesis.gains import given_gain
from jaxtube.synthesis.problem import with_controller
from jaxtube.synthesis.windows import make_windows
from jaxtube.tuning.gains import make_gain_maps
from jaxtube.tuning.loop import Weights
from jaxtube.tuning.parameters import make_parameters

AIM = ("tuning.heading_deg=1", "tuning.effort_mps=0.1")
VERTEX_GAINS = [
    [-1.9, 0.35, -0.1, -0.1, -1.7, -2.3],
    [-1.9, 0.05, 0.05, 0.05, -1.7, -2.2],
    [-1.9, -0.35, 0.1, 0.1, -1.7, -2.3],
    [-1.9, 0.05, 0.05, 0.05, -1.8, -2.4],
]
VERTICES = (
    'controller.terminal="T-A"',
    'controller.tube="sequence"',
    f"controller.vertex_gains={VERTEX_GAINS}",
    "controller.terminal_facets=300",
)
SCENARIOS = {
    "decoupled": ("certified", AIM),
    "vertices": ("robust", (*VERTICES, *AIM)),
}

FIRM = {"firm": ("tuned", AIM)}
"""Gains whose terminal set has predecessors of its limits among its rows."""


@cache
def problem_of(kind: str):
    """Complete the problem of three decoupled gains, or of 24 vertex gains."""
    name, overrides = (SCENARIOS | FIRM)[kind]
    return complete_problem(load(name, overrides))


@cache
def gain_maps_of(problem):
    """Return all gains and loops of a problem as functions of the tuned numbers."""
    windows = make_windows(problem, given_gain(problem, problem.given_gains))
    return make_gain_maps(problem, windows.schedules)


def random_kappa(problem, rng, size=0.2):
    """Draw gains around the given ones, by log-normal factors."""
    return problem.given_gains * np.exp(size * rng.standard_normal(len(problem.given_gains)))


def random_point(problem, rng, weights=0.5, gains=0.1):
    """Draw the vector of all parameters: diagonals and gains by log-normal factors, and what is off
    the diagonals."""
    start = make_parameters(problem).vector
    sizes = np.full(len(start), weights)
    sizes[9:] = gains
    return start + sizes * rng.standard_normal(len(start))


def entries(weights: Weights):
    """Return the entries of Q and R on and below the diagonal, then those of the gains."""
    of_errors = np.asarray(weights.error_weight)[np.tril_indices(3)]
    of_inputs = np.asarray(weights.input_weight)[np.tril_indices(2)]
    return np.concatenate([of_errors, of_inputs, np.asarray(weights.kappa)])


@jax.jit
def weights_of(numbers) -> Weights:
    """Return weights and gains of their entries."""
    error_weight = _symmetric(numbers[:6], 3)
    input_weight = _symmetric(numbers[6:9], 2)
    return Weights(error_weight, input_weight, jnp.asarray(numbers[9:]))


def problem_with(problem, weights: Weights):
    """Return the problem with these weights and gains."""
    kappa = np.asarray(weights.kappa)
    if len(kappa) == 3:
        gains = {"tracking_gains": tuple(kappa.tolist())}
    else:
        gains = {"vertex_gains": _rows(kappa.reshape(4, 6))}
    controller = msgspec.structs.replace(
        problem.scenario.controller,
        error_weight=_rows(weights.error_weight),
        input_weight=_rows(weights.input_weight),
        **gains,
    )
    scenario = msgspec.structs.replace(problem.scenario, controller=controller)
    return with_controller(problem, scenario)


def _rows(matrix):
    return tuple(map(tuple, np.asarray(matrix).tolist()))


def _symmetric(lower, n):
    matrix = jnp.zeros((n, n)).at[np.tril_indices(n)].set(jnp.asarray(lower))
    return matrix + jnp.tril(matrix, -1).T


def slope_of_entries(slope: Weights):
    """Return the derivatives along the entries: those off the diagonal stand in two places."""

    def add_mirror(part):
        part = np.asarray(part)
        return part + part.T - np.diag(np.diag(part))

    of_errors = add_mirror(slope.error_weight)
    of_inputs = add_mirror(slope.input_weight)
    return entries(Weights(of_errors, of_inputs, slope.kappa))


def shortened(plant, steps: int):
    """Return the robot with the first steps of its reference."""
    return dataclasses.replace(
        plant,
        reference_wheels=plant.reference_wheels[:steps],
        reference_poses=plant.reference_poses[: steps + 1],
    )


def active_rows(window: planning.CondensedQp, errors, inputs, slack: float):
    """Return which rows of each plan meet a bound, (batch, m)."""
    rows = window.factors.rows * window.factors.row_norms[:, None]
    values = errors @ window.row_errors.T + inputs.reshape(len(errors), -1) @ rows.T
    return (values < window.lower + slack) | (values > window.upper - slack)


def fourth_order(function, at, direction, step: float):
    """Return the central difference of fourth order of a function's first answer, and its answers
    at all four points."""
    ends = [function(at + k * step * direction) for k in (-2, -1, 1, 2)]
    far_below, below, above, far_above = next(zip(*ends, strict=True))
    slope = (8 * (above - below) - (far_above - far_below)) / (12 * step)
    return slope, ends
