"""Laws of the regulator: a fixed point of policy iteration, whatever the weights."""

import numpy as np
import pytest
import scipy.linalg
from tolerances import RICCATI_GAIN, SCALED_COST

from sets.riccati import lqr_gain, solve_riccati

LQR_REFERENCE = 1e-6
"""The reference gain is printed to six decimals."""

PAPER = (np.diag([1.0, 1.0, 0.01]), np.eye(2))
LATERAL = (np.diag([1.0, 3.0, 1.0]), 0.3 * np.eye(2))
COUPLED = (
    np.array([[1.0, 0.2, 0.0], [0.2, 1.0, 0.1], [0.0, 0.1, 0.5]]),
    np.array([[1.0, 0.6], [0.6, 0.8]]),
)
INPUT = np.array([[0.1, 0.0], [0.0, 0.0], [0.0, 0.1]])


def model(right: float, left: float) -> np.ndarray:
    """Return matrix A of the paper's error model (Euler, 0.1 s) at wheel references in m/s."""
    turn = 0.1 * (1 - 0.2) / 0.5 * (right - left)
    drift = 0.1 / 2 * (right + left)
    return np.array([[1.0, turn, 0.0], [-turn, 1.0, drift], [0.0, 0.0, 1.0]])


def test_lqr_gain_equals_the_reference_numbers():
    expected = [[-0.951249, 0, 0], [0, -0.936687, -1.305797]]
    np.testing.assert_allclose(
        lqr_gain(model(0.85, 0.85), INPUT, *PAPER), expected, atol=LQR_REFERENCE
    )


def test_lqr_gain_is_a_fixed_point_of_policy_iteration():
    A = model(1.2, 0.6)
    B = INPUT
    Q, R = COUPLED
    gain = lqr_gain(A, B, Q, R)
    P = scipy.linalg.solve_discrete_lyapunov((A + B @ gain).T, Q + gain.T @ R @ gain)
    np.testing.assert_allclose((R + B.T @ P @ B) @ gain, -B.T @ P @ A, atol=LQR_REFERENCE)


@pytest.mark.parametrize("exponent", [-30, -10, 0, 6, 8, 12])
def test_the_regulator_satisfies_its_riccati_equation_whatever_the_weights(exponent):
    A = model(1.2, 0.6)
    Q, R = COUPLED
    R = 10.0**exponent * R
    gain = lqr_gain(A, INPUT, Q, R)
    loop = A + INPUT @ gain
    assert np.abs(np.linalg.eigvals(loop)).max() < 1
    P = scipy.linalg.solve_discrete_lyapunov(loop.T, Q + gain.T @ R @ gain)
    best = -np.linalg.solve(R + INPUT.T @ P @ INPUT, INPUT.T @ P @ A)
    np.testing.assert_allclose(gain, best, rtol=0, atol=RICCATI_GAIN * np.abs(gain).max())


def test_the_regulator_depends_on_the_ratio_of_the_weights_alone():
    A = model(1.2, 0.6)
    Q, R = COUPLED
    expected = lqr_gain(A, INPUT, Q, R)
    for unit in (1e-30, 1e-10, 1e10):
        found = lqr_gain(A, INPUT, unit * Q, unit * R)
        np.testing.assert_allclose(found, expected, rtol=SCALED_COST)


def test_the_riccati_cost_is_that_of_an_ordered_schur_form():
    for weights in (PAPER, LATERAL, COUPLED):
        A = model(1.2, 0.6)
        expected = scipy.linalg.solve_discrete_are(A, INPUT, *weights)
        found = solve_riccati(A, INPUT, *weights)
        np.testing.assert_allclose(found, expected, atol=SCALED_COST * np.abs(expected).max())


@pytest.mark.parametrize("grown", [1.0, 1.2])
def test_a_pair_that_no_gain_stabilises_is_refused_in_one_line(grown):
    with pytest.raises(ValueError, match=r"^A = [^\n]* no stabilising gain: [^\n]*$"):
        lqr_gain(grown * np.eye(3), np.zeros((3, 2)), *PAPER)
