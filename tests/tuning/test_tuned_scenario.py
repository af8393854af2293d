"""Laws of the shipped result of tuning: it is certified, and its tube is narrower than that of
usual gains."""

import numpy as np
import pytest

from jaxtube.scenario import load
from jaxtube.synthesis.certificate.fill import widest_tube
from jaxtube.synthesis.design import design
from jaxtube.synthesis.gains import vertex_gain
from sets.lmi import terminal_cost

LATERAL = np.array([[0.0, 1.0, 0.0]])


@pytest.fixture(scope="module")
def found():
    return design(load("tuned"))


def test_the_tuned_scenario_is_certified(found):
    assert found.certificate.failing == []


def test_the_minimal_invariant_set_is_a_fifth_narrower_than_that_of_lmi_gains(found):
    problem = found.problem
    model = found.problem.model
    tuned = widest_tube(problem, found.terminal.gains).support(LATERAL)[0]
    cost = terminal_cost(
        *model.matrices(model.vertices), np.diag([1.0, 3.0, 1.0]), 0.3 * np.eye(2), "trace_s"
    )
    usual = widest_tube(problem, vertex_gain(problem, cost.gains)).support(LATERAL)[0]
    assert tuned <= 0.8 * usual
