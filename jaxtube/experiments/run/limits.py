"""The error constraints of a design in words: which E a report means."""

from __future__ import annotations

import numpy as np

from jaxtube.coordinates import describe_half_widths
from jaxtube.scenario.error_box import error_vector
from jaxtube.synthesis.problem import Problem


def describe_error_set(problem: Problem) -> str:
    """Return the limits of E, and where they come from if not from [constraints]."""
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
