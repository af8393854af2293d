"""Laws of a linear system: what it refuses, and what it is to a controller that does not know its
schedule."""

import numpy as np
import pytest
from linear_systems import mixtures, random_system, varying_mass

from jaxtube.scenario.refusal import ScenarioError
from sets.polytope import Polytope


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"A": np.ones((2, 3))}, ("system: A", "square")),
        ({"A": np.full((2, 2), np.nan)}, ("system: A", "finite")),
        ({"B": np.ones((3, 1))}, ("system: B", "give 2 rows")),
        ({"A": np.ones((3, 2, 2))}, ("system: B", "as many of both")),
        ({"E": np.array([1.0])}, ("system: E", "give (2,)")),
        ({"E": np.array([1.0, -1.0])}, ("system: E", "0 or more")),
        ({"E": Polytope(np.eye(2), np.ones(2))}, ("system: E", "not bounded", "add the rows")),
        ({"E": Polytope.box(np.array([0.1, -1]), np.ones(2))}, ("system: E", "origin", "shift")),
        ({"U": Polytope.box(np.array([0.5]), np.array([1.0]))}, ("system: U", "origin")),
        ({"W": Polytope.box(np.array([0.1, 0]), np.ones(2))}, ("system: W", "no disturbance")),
        ({"W": None}, ("system: W", "motion")),
        ({"Q": np.array([[1.0, 1.0], [0.0, 1.0]])}, ("system: Q", "symmetric")),
        ({"Q": -np.eye(2)}, ("system: Q", "semidefinite")),
        ({"R": np.zeros((1, 1))}, ("system: R", "positive definite")),
        ({"K": np.ones((2, 2))}, ("system: K", "give (1, 2)")),
        ({"schedule": None}, ("system: schedule", "without_schedule()")),
        ({"schedule": np.ones((4, 3))}, ("system: schedule", "give (periods, 2)")),
        ({"schedule": [[0.5, 0.5], [0.5, 0.6]]}, ("system: schedule[1]", "sum is 1")),
        ({"schedule": [[1.5, -0.5]]}, ("system: schedule[0]", ">= 0")),
        ({"horizon": 0}, ("system: horizon", "give 1 or more")),
        ({"tube": "hull"}, ("system: tube", "sequence, summed")),
        ({"objective": "best"}, ("system: objective", "trace_s")),
        ({"start": np.ones(3)}, ("system: start", "give (2,)")),
        ({"state_names": ("place",)}, ("system: state_names", "give 2")),
    ],
)
def test_what_cannot_be_used_is_refused_in_one_line(changes, words):
    with pytest.raises(ScenarioError) as refused:
        varying_mass(**changes)
    message = str(refused.value)
    assert "\n" not in message
    for word in words:
        assert word in message


def test_a_system_without_its_schedule_holds_every_motion_of_the_system():
    system = random_system(3, states=3, inputs=2, vertices=3)
    without = system.without_schedule()
    random = np.random.default_rng(1)
    assert len(without.A) == 1
    for A, B, _ in mixtures(system):
        x = system.E.vertices()[random.integers(8, size=20)]
        u = system.U.vertices()[random.integers(4, size=20)]
        w = system.disturbance_set.vertices()[random.integers(8, size=20)]
        following = x @ A.T + u @ B.T + w
        added = following - x @ without.A[0].T - u @ without.B[0].T
        assert np.min(without.disturbance_set.margin(added)) >= -1e-12


def test_a_system_without_its_schedule_takes_no_more_than_its_vertices_add():
    system = varying_mass(W=np.zeros(2))
    without = system.without_schedule()
    # The worst is a vertex at full input: half the difference of both B, times 2.
    worst = np.abs(system.B[0] - system.B[1])[:, 0] / 2 * 2.0
    np.testing.assert_allclose(without.disturbance_set.support(np.eye(2)), worst, atol=1e-12)
