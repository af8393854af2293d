"""Laws of the maps from numbers to gains and loops, and of the terminal cost that follows them."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import tolerances as tol
import tuned

from jaxtube.synthesis.gains import given_gain
from jaxtube.synthesis.windows import make_windows
from jaxtube.tuning.gains import gain_maps, terminal_cost
from sets.lyapunov import cost_of_gains

STEP = 3e-4


def follow(numbers, found, maps):
    error_weight, input_weight, kappa = tuned.weights_of(numbers)
    loops, gains = maps.vertex_loops.at(kappa), maps.vertex_gains.at(kappa)
    cost = terminal_cost(found, loops, gains, error_weight, input_weight)
    return cost, cost


cost_and_slope = jax.jit(jax.jacfwd(follow, has_aux=True))


@pytest.fixture(scope="module", params=list(tuned.SCENARIOS))
def problem(request):
    return tuned.problem_of(request.param)


@pytest.fixture(scope="module")
def maps(problem):
    return gain_maps(
        problem, make_windows(problem, given_gain(problem, problem.given_gains)).schedules
    )


@pytest.mark.parametrize("seed", range(3))
def test_gains_and_loops_are_those_of_the_design(problem, maps, seed):
    kappa = tuned.random_kappa(problem, np.random.default_rng(seed), size=0.5)
    gain = given_gain(problem, kappa)
    windows = make_windows(problem, gain)
    loops, gains = gain.pairs
    expected = windows.gains, windows.loops, gain.corner_gains, loops, gains
    for found, wanted in zip(maps, expected, strict=True):
        found = found.at(jnp.asarray(kappa))
        assert found.shape == wanted.shape
        np.testing.assert_allclose(found, wanted, rtol=0, atol=tol.GAIN_MAPS)


def test_vertex_gains_are_read_row_by_row():
    problem = tuned.problem_of("vertices")
    kappa = np.arange(24.0)
    np.testing.assert_array_equal(
        given_gain(problem, kappa).vertices[2], [[12, 13, 14], [15, 16, 17]]
    )
    at_corners = gain_maps(
        problem, make_windows(problem, given_gain(problem, kappa)).schedules
    ).corner_gains
    np.testing.assert_allclose(
        at_corners.at(jnp.asarray(kappa)), kappa.reshape(4, 2, 3), atol=tol.GAIN_MAPS * 24
    )


def cost_at(maps, numbers):
    """Solve the terminal cost of Q, R and gains from their entries anew."""
    error_weight, input_weight, kappa = tuned.weights_of(numbers)
    loops, gains = (np.asarray(part.at(kappa)) for part in (maps.vertex_loops, maps.vertex_gains))
    return loops, gains, np.asarray(error_weight), np.asarray(input_weight)


@pytest.mark.parametrize(
    "seed", [0, *(pytest.param(seed, marks=pytest.mark.slow) for seed in (1, 2))]
)
def test_the_terminal_costs_slope_is_that_of_solving_it_again(problem, maps, seed):
    rng = np.random.default_rng(seed)
    roots = rng.normal(size=(3, 3)), rng.normal(size=(2, 2))
    weights = [root @ root.T + 0.3 * np.eye(len(root)) for root in roots]
    numbers = tuned.entries(
        tuned.Weights(*weights, jnp.asarray(tuned.random_kappa(problem, rng, size=0.1)))
    )
    sizes = np.maximum(np.abs(numbers), 0.1)
    found = cost_of_gains(*cost_at(maps, numbers))

    slope, cost = cost_and_slope(jnp.asarray(numbers), jnp.asarray(found), maps)
    np.testing.assert_allclose(cost, found, rtol=tol.SCALED_COST)
    for k, direction in enumerate(np.diag(sizes)):
        solved = lambda at: (cost_of_gains(*cost_at(maps, at)),)  # noqa: E731
        expected, _ = tuned.fourth_order(solved, numbers, direction, STEP)
        wrong = np.abs(sizes[k] * slope[:, :, k] - expected).max()
        assert wrong <= tol.OBJECTIVE_SLOPE * np.abs(expected).max()
