"""Laws of the terminal cost of given gains, against a semidefinite program written down by another
modeller."""

import cvxpy
import numpy as np
import pytest
from tolerances import SCALED_COST

from sets.lyapunov import CENTRING, centring, cost_of_gains, stage_cost
from sets.semidefinite import symmetric_basis

LEAST_TRACE = 1e-6
"""Relative; what a semidefinite program's answer is known to."""
CENTRED_SLOPE = 1e-8
"""Newton decrement of the centred cost, whose objective is of order ten."""
CENTRED_CURVATURE = 1e-6
"""Relative; central differences with steps of a thousandth."""

SEEDS = range(4)


def loops_and_gains(seed, count=5, n=3, m=2):
    """Draw loops around one contraction, so that they share a quadratic cost, and gains."""
    rng = np.random.default_rng(seed)
    turn = np.linalg.qr(rng.normal(size=(n, n)))[0]
    skew = np.eye(n) + 0.3 * rng.normal(size=(n, n))
    centre = np.linalg.solve(skew, turn @ np.diag(rng.uniform(0.2, 0.8, n)) @ turn.T) @ skew
    return centre + 0.03 * rng.normal(size=(count, n, n)), rng.normal(size=(count, m, n))


def weights(seed, n=3, m=2):
    rng = np.random.default_rng([seed, 1])
    error_root = rng.normal(size=(n, n))
    input_root = rng.normal(size=(m, m))
    error_weight = error_root @ error_root.T + 0.1 * np.eye(n)
    return error_weight, input_root @ input_root.T + 0.1 * np.eye(m)


def decreases(P, loops, gains, Q, R):
    """Return the eigenvalues of every decrease beyond the stage cost, relative to the stage cost's
    largest."""
    relative = []
    for loop, K in zip(loops, gains, strict=True):
        stage = Q + K.T @ R @ K
        surplus = P - loop.T @ P @ loop - stage
        relative.append(np.linalg.eigvalsh(surplus) / np.linalg.eigvalsh(stage)[-1])
    return np.array(relative)


def least_trace(loops, gains, Q, R):
    """Solve  minimise trace P  subject to the decrease at every pair."""
    P = cvxpy.Variable((3, 3), symmetric=True)
    decrease = [
        P - loop.T @ P @ loop >> Q + K.T @ R @ K for loop, K in zip(loops, gains, strict=True)
    ]
    return cvxpy.Problem(cvxpy.Minimize(cvxpy.trace(P)), decrease).solve(solver=cvxpy.CLARABEL)


@pytest.mark.parametrize("seed", SEEDS)
def test_decreases_by_more_than_the_stage_cost_at_every_pair_and_every_joint_mixture(seed):
    loops, gains = loops_and_gains(seed)
    Q, R = weights(seed)
    P = cost_of_gains(loops, gains, Q, R)
    np.testing.assert_array_equal(P, P.T)
    # Centred: no inequality is met by less than CENTRING of what the trace weighs.
    assert decreases(P, loops, gains, Q, R).min() > CENTRING / 10
    shares = np.random.default_rng(seed).dirichlet(np.ones(len(loops)), 50)
    mixed = (np.tensordot(shares, loops, axes=1), np.tensordot(shares, gains, axes=1))
    assert decreases(P, *mixed, Q, R).min() > 0


@pytest.mark.parametrize("seed", SEEDS)
def test_its_trace_exceeds_the_least_one_by_what_the_barrier_promises(seed):
    loops, gains = loops_and_gains(seed)
    Q, R = weights(seed)
    least = least_trace(loops, gains, Q, R)
    found = np.trace(cost_of_gains(loops, gains, Q, R))
    promised = CENTRING * loops.shape[0] * 3 * np.trace(stage_cost(gains, Q, R).mean(axis=0))
    assert least * (1 - LEAST_TRACE) < found < least * (1 + LEAST_TRACE) + promised


@pytest.mark.parametrize("seed", SEEDS)
def test_is_the_minimum_of_trace_and_barrier(seed):
    loops, gains = loops_and_gains(seed)
    Q, R = weights(seed)
    P = cost_of_gains(loops, gains, Q, R)
    stage = stage_cost(gains, Q, R)

    def minimised(P):
        volumes = [
            np.linalg.slogdet(P - loop.T @ P @ loop - S)
            for loop, S in zip(loops, stage, strict=True)
        ]
        assert all(sign > 0 for sign, _ in volumes)
        return np.trace(P) / np.trace(stage.mean(axis=0)) - CENTRING * sum(
            volume for _, volume in volumes
        )

    slope, curvature = centring(P, loops, stage)
    assert np.sqrt(slope @ np.linalg.solve(curvature, slope)) < CENTRED_SLOPE
    assert np.linalg.eigvalsh(curvature).min() > 0
    least = minimised(P)
    for direction in np.random.default_rng(seed).normal(size=(20, 6)):
        size = np.sqrt(direction @ curvature @ direction)
        move = np.tensordot(1e-3 * direction / size, symmetric_basis(3), axes=1)
        assert minimised(P + move) > least and minimised(P - move) > least


def test_slope_and_curvature_are_those_of_what_is_minimised():
    loops, gains = loops_and_gains(0)
    stage = stage_cost(gains, *weights(0))
    P = 3 * cost_of_gains(loops, gains, *weights(0))
    basis = symmetric_basis(3)
    step = 1e-3
    slopes = [
        centring(P + sign * step * move, loops, stage)[0] for move in basis for sign in (1, -1)
    ]
    differences = (np.array(slopes[::2]) - np.array(slopes[1::2])) / (2 * step)
    curvature = centring(P, loops, stage)[1]
    np.testing.assert_allclose(
        curvature, differences, rtol=0, atol=CENTRED_CURVATURE * np.abs(differences).max()
    )


@pytest.mark.parametrize("factor", [1e-30, 1e-10, 1e-4, 7.0, 1e5, 1e10])
def test_scales_with_the_weights(factor):
    loops, gains = loops_and_gains(1)
    Q, R = weights(1)
    scaled = cost_of_gains(loops, gains, factor * Q, factor * R)
    np.testing.assert_allclose(scaled, factor * cost_of_gains(loops, gains, Q, R), rtol=SCALED_COST)


def test_one_loop_exceeds_the_lyapunov_equation_by_exactly_what_the_barrier_promises():
    loops, gains = loops_and_gains(2)
    loops = loops[:1]
    gains = gains[:1]
    Q, R = weights(2)
    stage = stage_cost(gains, Q, R)[0]
    P = np.zeros((3, 3))
    for _ in range(2000):
        P = stage + loops[0].T @ P @ loops[0]
    surplus = cost_of_gains(loops, gains, Q, R) - P
    assert np.linalg.eigvalsh(surplus).min() > 0
    assert np.trace(surplus) == pytest.approx(3 * CENTRING * np.trace(stage), rel=LEAST_TRACE)


@pytest.mark.parametrize("grown", [1.05, 3.0])
def test_refuses_an_unstable_loop_and_loops_that_share_no_cost(grown):
    loops, gains = loops_and_gains(3)
    unstable = loops * grown / np.abs(np.linalg.eigvals(loops[0])).max()
    with pytest.raises(RuntimeError, match="share no quadratic cost"):
        cost_of_gains(unstable, gains, *weights(3))
    # Each contracts, their product grows.
    shears = np.array([[[0.5, 2.0], [0.0, 0.5]], [[0.5, 0.0], [2.0, 0.5]]])
    assert np.abs(np.linalg.eigvals(shears[0] @ shears[1])).max() > 1
    with pytest.raises(RuntimeError, match="share no quadratic cost"):
        cost_of_gains(shears, np.zeros((2, 1, 2)), np.eye(2), np.eye(1))
