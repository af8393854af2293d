"""What noise of the pose makes of the measured error, in the world frame: a witness for the box
that this noise is given.

A pose is measured a little off, in the frame of the scenario's noise. The error that the controller
gets is that of the pose to which the commands given take the robot from there; of wheels that obey
at once, of the measured pose itself. Noise of that error is what it differs by from the one that an
exact measurement gives.

Source: new.
"""

from __future__ import annotations

import itertools

import numpy as np
from jaxtyping import Float

from jaxtube.scenario.error_box import error_vector
from jaxtube.synthesis.certificate.demands import DIRECTIONS, find_demands
from jaxtube.synthesis.certificate.poses import (
    Poses,
    arc,
    error_of,
    find_body,
    pose_of,
    run_out,
)
from jaxtube.synthesis.disturbance import find_actuation
from jaxtube.synthesis.problem import Problem

CORNERS = np.array(list(itertools.product((-1.0, 1.0), repeat=3)))
HEADINGS = np.exp(2j * np.pi * np.arange(24) / 24)
"""Of the reference in the world, where noise is given."""


def changes_noise(problem: Problem) -> bool:
    """Whether noise of the measured error is another than the scenario gives."""
    return problem.scenario.noise.frame == "world" or not problem.scenario.robot.obeys_at_once


def find_noise(problem: Problem) -> Float[np.ndarray, "3"]:
    """Return the greatest noise of the measured error, (m, m, rad), that is found at corners of the
    pose noise and of the error constraints, while extreme commands are on their way."""
    motions = _find_motions(problem)
    is_world = problem.scenario.noise.frame == "world"
    frames = HEADINGS if is_world else np.ones(1, complex)
    sizes = (len(CORNERS), len(CORNERS), len(frames), len(motions))
    noise, error, frame, motion = np.indices(sizes).reshape(4, -1)
    noise = error_vector(problem.scenario.noise) * CORNERS[noise]
    errors = error_vector(problem.scenario.constraints) * CORNERS[error]
    ahead, behind = _drive(problem, motions[motion])
    pose = pose_of(errors, behind)
    if is_world:
        shift = (noise[:, 0] + 1j * noise[:, 1]) * frames[frame].conj()
        measured = Poses(pose.place + shift, pose.heading + noise[:, 2])
    else:
        measured = pose_of(errors + noise, behind)
    origin = Poses(np.zeros(len(noise), complex), np.zeros(len(noise)))
    differences = error_of(measured.join(ahead), origin) - error_of(pose.join(ahead), origin)
    return np.abs(differences).max(axis=0)


def _find_motions(problem: Problem) -> Float[np.ndarray, "k 4"]:
    """Return what has been asked for, for long, along which reference, (speed m/s, yaw rate rad/s)
    of both, at extremes of the reference's speed and the yaw rate asked for."""
    demands = find_demands(problem)
    wheels = np.broadcast_to(demands.wheels[:, None], demands.asked.shape)
    b = problem.model.track_width
    bodies = [*find_body(demands.asked, b), *find_body(wheels, b)]
    motions = np.stack(bodies, axis=-1).reshape(-1, 4)
    plane = motions[:, [2, 1]]
    widths = np.maximum(np.ptp(plane, axis=0), np.finfo(float).tiny)
    return motions[np.unique(np.argmax((plane / widths) @ DIRECTIONS.T, axis=0))]


def _drive(problem: Problem, motions: Float[np.ndarray, "n 4"]) -> tuple[Poses, Poses]:
    """Return (the motions still to come, where the reference was a latency before it came to the
    origin)."""
    lag, delay = find_actuation(problem.scenario).nominal(problem.model.dt)
    speed, turn, reference_speed, reference_turn = motions.T
    ahead = run_out(speed, turn, lag).join(arc(speed, turn, delay))
    return ahead, arc(reference_speed, reference_turn, lag + delay).back()
