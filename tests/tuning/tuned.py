"""What the tests of tuning share: problems whose scenario gives its gains, and points around them."""

import dataclasses
from functools import cache

import jax.numpy as jnp
import msgspec
import numpy as np

from jaxtube.control import mpc
from jaxtube.scenario import load
from jaxtube.synthesis.disturbance import complete_problem
from jaxtube.synthesis.problem import with_controller
from jaxtube.tuning.loop import Weights
from jaxtube.tuning.parameters import parameters

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


def random_kappa(problem, rng, size=0.2):
    """Draw gains around the given ones, by log-normal factors."""
    return problem.given_gains * np.exp(size * rng.standard_normal(len(problem.given_gains)))


def random_point(problem, rng, weights=0.5, gains=0.1):
    """Draw the vector of all parameters: diagonals and gains by log-normal factors, and what is off
    the diagonals."""
    start = parameters(problem).vector
    sizes = np.concatenate([np.full(9, weights), np.full(len(start) - 9, gains)])
    return start + sizes * rng.standard_normal(len(start))


def entries(weights: Weights):
    """Return the entries of Q and R on and below the diagonal, then those of the gains."""
    of_errors, of_inputs = (np.asarray(part)[np.tril_indices(len(part))] for part in weights[:2])
    return np.concatenate([of_errors, of_inputs, np.asarray(weights.kappa)])


def weights_of(numbers) -> Weights:
    """Return weights and gains of their entries."""
    return Weights(
        _symmetric(numbers[:6], 3), _symmetric(numbers[6:9], 2), jnp.asarray(numbers[9:])
    )


def problem_with(problem, weights: Weights):
    """Return the problem with these weights and gains."""
    error, inputs = (tuple(map(tuple, np.asarray(part).tolist())) for part in weights[:2])
    kappa = np.asarray(weights.kappa)
    gains = (
        {"tracking_gains": tuple(kappa.tolist())}
        if len(kappa) == 3
        else {"vertex_gains": tuple(map(tuple, kappa.reshape(4, 6).tolist()))}
    )
    settings = msgspec.structs.replace(
        problem.scenario.controller, error_weight=error, input_weight=inputs, **gains
    )
    return with_controller(problem, msgspec.structs.replace(problem.scenario, controller=settings))


def _symmetric(lower, n):
    matrix = jnp.zeros((n, n)).at[np.tril_indices(n)].set(jnp.asarray(lower))
    return matrix + jnp.tril(matrix, -1).T


def slope_of_entries(slope: Weights):
    """Return the derivatives along the entries: those off the diagonal stand in two places."""
    both = [np.asarray(part) + np.asarray(part).T - np.diag(np.diag(part)) for part in slope[:2]]
    return entries(Weights(*both, slope.kappa))


def shortened(plant, steps: int):
    """Return the robot with the first steps of its reference."""
    wheels, poses = plant.reference_wheels[:steps], plant.reference_poses[: steps + 1]
    return dataclasses.replace(plant, reference_wheels=wheels, reference_poses=poses)


def active_rows(window: mpc.Window, errors, inputs, slack: float):
    """Return which rows of each plan meet a bound, (batch, m)."""
    rows = window.factors.rows * window.factors.row_norms[:, None]
    values = errors @ window.row_errors.T + inputs.reshape(len(errors), -1) @ rows.T
    return (values < window.lower + slack) | (values > window.upper - slack)


def fourth_order(function, at, direction, step: float):
    """Return the central difference of fourth order, and what the function says at all points."""
    ends = {k: function(at + k * step * direction) for k in (-2, -1, 1, 2)}
    value = {k: end[0] for k, end in ends.items()}
    slope = (8 * (value[1] - value[-1]) - (value[2] - value[-2])) / (12 * step)
    return slope, list(ends.values())
