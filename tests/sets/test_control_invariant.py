"""Laws of the maximal robust control invariant set: closed forms, and linear programs that know no
projection."""

import numpy as np
import pytest
from scipy.optimize import linprog
from tolerances import SET_RELATIVE

from sets.control_invariant import SETTLED, Limits, maximal_rci, predecessor
from sets.polytope import Polytope

CONTROL_INVARIANT = 1e-7
"""In m, rad and units of the inputs; linear programs of numbers below one."""


def decoupled(gain: float, disturbance: float):
    """Three copies of  e+ = gain e + u + w,  |u| <= 1, |w| <= disturbance, |e| <= 5."""
    limits = Limits(np.vstack([np.eye(3), -np.eye(3)]), np.zeros((6, 3)), np.ones(6))
    W = Polytope.box(np.full(3, -disturbance), np.full(3, disturbance))
    transitions = np.array([gain * np.eye(3)])
    inputs = np.array([np.eye(3)])
    E = Polytope.box(np.full(3, -5), np.full(3, 5))
    return transitions, inputs, E, limits, W


def test_a_decoupled_system_keeps_what_its_input_can_outweigh():
    A, B, E, limits, W = decoupled(2.0, 0.2)
    found = maximal_rci(A, B, E, limits, W)
    assert found.settled and found.polytope is not None
    reach = found.polytope.support(np.eye(3))
    assert np.all(reach >= 0.8) and np.all(reach <= 0.8 * (1 + 2 * SETTLED))


def test_a_disturbance_that_outweighs_the_input_leaves_nothing():
    A, B, E, limits, W = decoupled(2.0, 1.1)
    found = maximal_rci(A, B, E, limits, W.support)
    assert found.polytope is None and found.volumes[-1] == 0.0


@pytest.fixture(scope="module")
def switching():
    """Two pairs of a turning robot with a limit that couples error and input."""
    turns = (-0.06, 0.06)
    pairs = [np.array([[1.0, h, 0.0], [-h, 1.0, 0.12], [0.0, 0.0, 1.0]]) for h in turns]
    B = np.array([[0.1, 0.0], [0.0, 0.006], [0.0, 0.1]])
    E = Polytope.box(np.array([-0.3, -0.3, -0.3]), np.array([0.3, 0.3, 0.3]))
    inputs = np.array([[1.0, 0.0], [0.0, 1.0], [0.0, 1.0]])
    errors = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 0.0], [3.0, 0.0, 0.0]])
    limits = Limits(
        np.vstack([inputs, -inputs]), np.vstack([errors, -errors]), np.array([0.3, 1.0, 1.2] * 2)
    )
    W = Polytope.box(np.array([-0.01, -0.01, -0.03]), np.array([0.01, 0.01, 0.03]))
    return np.array(pairs), np.array([B, B]), E, limits, W


def shortfall(A, B, target: Polytope, limits: Limits, error) -> float:
    """Return by how much all rows must give way before an input exists, by a linear program."""
    rows = np.vstack([target.normals @ B, limits.inputs])
    at_target = target.offsets - target.normals @ A @ error
    room = np.concatenate([at_target, limits.offsets - limits.errors @ error])
    program = np.column_stack([rows, -np.ones(len(rows))])
    answer = linprog([0, 0, 1], program, room, bounds=[(None, None)] * 3)
    assert answer.status == 0
    return answer.x[-1]


def test_the_predecessor_holds_exactly_the_errors_that_have_an_input(switching):
    A, B, E, limits, _ = switching
    target = E.scale(0.6)
    found = predecessor(A[0], B[0], target, E, limits)
    points = np.random.default_rng(0).uniform(-0.3, 0.3, (150, 3))
    missing = np.array([shortfall(A[0], B[0], target, limits, point) for point in points])
    inside = found.margin(points) >= 0
    assert 20 < inside.sum() < 130
    assert np.all(missing[inside] <= CONTROL_INVARIANT)
    assert np.all(missing[~inside] >= -CONTROL_INVARIANT)


def test_the_settled_set_is_kept_under_every_pair_and_lies_in_the_limits(switching):
    A, B, E, limits, W = switching
    found = maximal_rci(A, B, E, limits, W.support)
    assert found.settled and found.polytope is not None
    assert np.all(np.diff(found.volumes) <= SET_RELATIVE * found.volumes[0])
    assert E.containment_margin(found.polytope) >= -CONTROL_INVARIANT
    target = found.polytope.scale(1 + SETTLED).pontryagin_difference(W)
    corners = found.polytope.vertices()
    for transition, inputs in zip(A, B, strict=True):
        missing = [shortfall(transition, inputs, target, limits, corner) for corner in corners]
        assert max(missing) <= CONTROL_INVARIANT
