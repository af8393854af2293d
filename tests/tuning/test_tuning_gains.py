"""Laws of the maps from numbers to gains and loops, and of the terminal cost that follows them."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import tolerances as tol
import tuned

from jaxtube.synthesis.gains import given_gain
from jaxtube.synthesis.windows import make_windows
from jaxtube.tuning.gains import differentiate_terminal_cost
from sets.lyapunov import cost_of_gains

GAIN_MAPS = 1e-13
"""Entries of order one to ten, by differences of the same."""

STEP = 3e-4


@pytest.fixture(scope="module", params=list(tuned.SCENARIOS))
def problem(request):
    return tuned.problem_of(request.param)


@pytest.fixture(scope="module")
def maps(problem):
    return tuned.gain_maps_of(problem)


@pytest.mark.parametrize("seed", range(3))
def test_gains_and_loops_are_those_of_the_design(problem, maps, seed):
    kappa = tuned.random_kappa(problem, np.random.default_rng(seed), size=0.5)
    gain = given_gain(problem, kappa)
    windows = make_windows(problem, gain)
    expected = (windows.gains, windows.loops, gain.corner_gains, *gain.pairs)
    for affine, wanted in zip(maps, expected, strict=True):
        value = affine.at(jnp.asarray(kappa))
        assert value.shape == wanted.shape
        np.testing.assert_allclose(value, wanted, rtol=0, atol=GAIN_MAPS)


def test_vertex_gains_are_read_row_by_row():
    problem = tuned.problem_of("vertices")
    kappa = np.arange(24.0)
    third = given_gain(problem, kappa).vertices[2]
    np.testing.assert_array_equal(third, [[12, 13, 14], [15, 16, 17]])
    corner_gains = tuned.gain_maps_of(problem).corner_gains.at(jnp.asarray(kappa))
    np.testing.assert_allclose(corner_gains, kappa.reshape(4, 2, 3), atol=GAIN_MAPS * 24)


def terminal_data(maps, numbers):
    """Return vertex loops, gains, Q and R of their entries, as numpy arrays."""
    weights = tuned.weights_of(numbers)
    loops = maps.vertex_loops.at(weights.kappa)
    gains = maps.vertex_gains.at(weights.kappa)
    return [np.asarray(p) for p in (loops, gains, weights.error_weight, weights.input_weight)]


def solve_again(maps, numbers):
    """Solve the terminal cost of Q, R and gains from their entries anew."""
    return cost_of_gains(*terminal_data(maps, numbers))


@jax.jit
def cost_and_slope(numbers, cost, maps):
    """Return the terminal cost about an answer, and its derivative along the entries."""

    def follow(numbers):
        weights = tuned.weights_of(numbers)
        value = differentiate_terminal_cost(
            cost,
            maps.vertex_loops.at(weights.kappa),
            maps.vertex_gains.at(weights.kappa),
            weights.error_weight,
            weights.input_weight,
        )
        return value, value

    slope, value = jax.jacfwd(follow, has_aux=True)(numbers)
    return value, slope


@pytest.mark.parametrize(
    "seed", [0, *(pytest.param(seed, marks=pytest.mark.slow) for seed in (1, 2))]
)
def test_the_terminal_costs_slope_is_that_of_solving_it_again(problem, maps, seed):
    rng = np.random.default_rng(seed)
    error_root = rng.normal(size=(3, 3))
    input_root = rng.normal(size=(2, 2))
    weights = tuned.Weights(
        error_root @ error_root.T + 0.3 * np.eye(3),
        input_root @ input_root.T + 0.3 * np.eye(2),
        jnp.asarray(tuned.random_kappa(problem, rng, size=0.1)),
    )
    numbers = tuned.entries(weights)
    sizes = np.maximum(np.abs(numbers), 0.1)
    solved = solve_again(maps, numbers)
    cost, slope = cost_and_slope(jnp.asarray(numbers), jnp.asarray(solved), maps)
    np.testing.assert_allclose(cost, solved, rtol=tol.SCALED_COST)
    for k, direction in enumerate(np.diag(sizes)):
        expected, _ = tuned.fourth_order(
            lambda at: (solve_again(maps, at),), numbers, direction, STEP
        )
        wrong = np.abs(sizes[k] * slope[:, :, k] - expected).max()
        assert wrong <= tol.OBJECTIVE_SLOPE * np.abs(expected).max()
