"""What helps where a design fails: the cures that have an effect, and which cause makes W wide."""

from __future__ import annotations

import numpy as np

from jaxtube.synthesis.control_problem import ControlProblem
from jaxtube.synthesis.disturbance import kinematics, operation
from jaxtube.synthesis.problem import Problem
from sets.robot.disturbance import disturbance_parts

SMALLEST = 1e-3
"""Share of the widest cause of W below which a cause is not told."""


def say_what_proves_w() -> str:
    """Return the way from a W that is assumed to one that holds for the robot, in words."""
    return (
        'set disturbance.bound = "computed": an assumed W proves nothing about the robot; that '
        "takes caps, gains and the exact model, so start from a copy of "
        "experiments/certified/scenario.toml with your robot, path and limits, and run `design "
        "--optimise` on it"
    )


def say_what_helps(problem: ControlProblem) -> str:
    """Return the cures of a tube that is too wide, in words."""
    if not isinstance(problem, Problem):
        return "give other gains K, or shrink W"
    if problem.scenario.disturbance.bound == "assumed":
        return "shrink [disturbance] or widen the limits"
    return (
        "let `design --optimise` choose caps and gains, or lower what W is computed from: "
        "slip.relative_error, [noise] or the range of reference wheel speeds"
    )


def say_what_widens(problem: Problem) -> str:
    """Return by cause what makes W wide sideways, the largest first; "" where it has no bound."""
    try:
        parts = disturbance_parts(operation(problem), kinematics(problem))
    except ValueError:
        return ""
    lateral = {cause: float(widths[2]) for cause, widths in parts.items() if widths.any()}
    counted = [cause for cause in lateral if lateral[cause] > SMALLEST * max(lateral.values())]
    causes = sorted(counted, key=lambda cause: -lateral[cause])
    listed = ", ".join(f"{cause} {1e3 * lateral[cause]:.3g} mm" for cause in causes)
    kick = np.rad2deg(parts["slip"][0])
    return f"W is made of {listed} sideways, and of yaw kicks of {kick:.3g} deg by slip"
