"""Whether the true errors stay in the error constraints: a bound on them can prove it, poses of
robots whose wheels lag can refute the bound.

Source: new.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from jaxtyping import Float

from jaxtube.coordinates import COORDINATES
from jaxtube.scenario.error_box import error_vector
from jaxtube.synthesis.certificate.late_poses import find_pose_errors
from jaxtube.synthesis.disturbance import bound_pose_errors
from jaxtube.synthesis.problem import Problem
from sets.certificate import ROUNDING, Condition, judge

NAME = "true_error_in_e"
TINY = np.finfo(float).tiny
MOMENTS = ("at the end of a period", "a latency after the end of a period")


def check_true_error(problem: Problem) -> Condition:
    """Check that the caps and the pose noise, or the error of the estimate, and what the latency
    adds leave the error constraints room."""
    try:
        promised = bound_pose_errors(problem)
    except ValueError as error:
        return Condition(NAME, -np.inf, f"No bound on true errors: {error}.", "robot")
    condition = _compare(problem, promised)
    if problem.scenario.robot.obeys_at_once or not condition.holds:
        return condition
    found = np.array([np.abs(errors).max(axis=0) for errors in find_pose_errors(problem)])
    if np.any(found > promised + ROUNDING):
        return _refute(promised, found)
    shares = found.max(axis=0) / np.maximum(promised, TINY)
    reach = f"Errors found reach {shares.min():.1%} to {shares.max():.1%} of the bound."
    return replace(condition, sentence=f"{condition.sentence} {reach}")


def _refute(promised: Float[np.ndarray, "3"], found: Float[np.ndarray, "2 3"]) -> Condition:
    """Return that a pose strays further than is promised, at either of MOMENTS."""
    excess = found / np.maximum(promised, TINY)
    moment, worst = np.unravel_index(np.argmax(excess), excess.shape)
    shown = COORDINATES[worst]
    return Condition(
        NAME,
        float(np.min(promised - found)),
        f"The bound of the true errors is refuted: {MOMENTS[moment]} a {shown.name} error of "
        f"{shown.say(found[moment, worst])}, where {shown.say(promised[worst])} is promised, is "
        "possible while the error of the committed pose keeps its limits.",
        "robot",
    )


def _compare(problem: Problem, promised: Float[np.ndarray, "3"]) -> Condition:
    """Compare the constraints with what is promised."""
    rooms = error_vector(problem.scenario.constraints) - promised
    worst = int(np.argmin(rooms))
    room = float(rooms[worst])
    kept = "measured error and the pose noise"
    added = "pose noise"
    when = ""
    if problem.scenario.controller.has_observer:
        kept = "estimated error and the error of the estimate"
        added = "error of the estimate"
    if not problem.scenario.robot.obeys_at_once:
        kept = f"{kept}, and how far the pose strays from where it was committed to be,"
        added = f"{added} and the latency"
        when = ", at the ends of periods and a latency later"
    return judge(
        NAME,
        room + ROUNDING,
        f"What the controller keeps of the {kept} together lie in the error constraints{when}.",
        f"With the {added} the true {COORDINATES[worst].name} error may pass its constraint by "
        f"{COORDINATES[worst].say(-room)}.",
        "robot",
    )
