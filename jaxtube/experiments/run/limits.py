"""The error constraints of a design in words: which E a report means."""

from __future__ import annotations

import numpy as np

from jaxtube.coordinates import describe_half_widths
from jaxtube.scenario.error_box import error_vector
from jaxtube.synthesis.disturbance import bound_pose_errors, find_actuation
from jaxtube.synthesis.problem import Problem


def describe_error_set(problem: Problem) -> str:
    """Return the limits of E, and where they come from if not from [constraints]."""
    if not problem.scenario.robot.obeys_at_once:
        return _describe_committed(problem)
    limits = problem.error_set.support(np.eye(3))
    constraints = error_vector(problem.scenario.constraints)
    words = f"E, limits of the true error: {describe_half_widths(limits)}"
    if np.allclose(limits, constraints, rtol=1e-9, atol=0.0):
        return words
    has_noise = np.any(limits > problem.operating_set.support(np.eye(3)))
    source = "caps"
    if has_noise:
        has_observer = problem.scenario.controller.has_observer
        source = "caps and the error of the estimate" if has_observer else "caps and pose noise"
    return f"{words}\n  {source}; [constraints] are {describe_half_widths(constraints)}"


def describe_pose(problem: Problem) -> str:
    """Return in a sentence which pose errors are of, "" where it is simply the robot's."""
    if problem.scenario.robot.obeys_at_once:
        return ""
    return (
        "Wheels lag or commands arrive late: errors and poses are those of the committed pose, to "
        "which the commands given will take the robot."
    )


def _describe_committed(problem: Problem) -> str:
    """Return E where wheels lag, which is of the committed pose, and what follows for the pose."""
    limits = problem.error_set.support(np.eye(3))
    words = (
        "E, limits of the true error of the committed pose, to which the commands given will take "
        f"the robot:\n  {describe_half_widths(limits)}"
    )
    try:
        pose = bound_pose_errors(problem)
    except ValueError:
        return words
    latency = find_actuation(problem.scenario).nominal(problem.model.dt).latency
    constraints = error_vector(problem.scenario.constraints)
    return (
        f"{words}\n  of the pose itself, then and {latency:.3g} s later: "
        f"{describe_half_widths(pose)}\n"
        f"  [constraints] are {describe_half_widths(constraints)}"
    )
