"""Laws of how a report names E where wheels lag."""

import numpy as np

from jaxtube.coordinates import describe_half_widths
from jaxtube.experiments.run.limits import describe_error_set
from jaxtube.scenario.reading import load
from jaxtube.synthesis.certificate.assumptions import assumptions
from jaxtube.synthesis.disturbance import bound_pose_errors, complete_problem


def test_limits_of_a_committed_pose_and_of_the_pose_are_both_named():
    problem = complete_problem(load("certified_lag"))
    words = describe_error_set(problem)
    committed = problem.error_set.support(np.eye(3))
    pose = bound_pose_errors(problem)
    assert np.all(pose > committed)
    assert describe_half_widths(committed) in words
    assert describe_half_widths(pose) in words
    told = " ".join(assumptions(problem, True))
    assert "for that of the pose itself, then and 0.05 s later" in told
