"""The pose of a robot whose wheels lag, in the world frame: a witness for the bounds on its error
that shares nothing with them.

At an instant the committed pose has an extreme error against the reference. The pose itself is the
motion behind it that the commands given are expected to bring, and is compared with where the
reference was a latency before; a latency later it is where wheels and ground have really taken it,
and is compared with where the reference is at the instant. Wheels follow by superposition of steps,

    travel since a step of 1 m/s arrived:  t - tau (1 - e^{-t / tau}),

and the body's way, int (v + i v_y) e^{i phi} dt, is integrated by Gauss and Legendre between the
times that matter.

Source: new; Gonzalez, Fiacchini, Guzman, Alamo 2009, eqs. (1)-(8), for the robot.
"""

from __future__ import annotations

import itertools
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from jaxtube.synthesis.certificate.late_pasts import LatePasts, draw_pasts
from jaxtube.synthesis.certificate.late_period import LAYERS, NODES, WEIGHTS
from jaxtube.synthesis.certificate.period_cases import Numbers
from jaxtube.synthesis.certificate.poses import (
    Poses,
    arc,
    error_of,
    find_body,
    pose_of,
    run_out,
)
from jaxtube.synthesis.disturbance import bound_committed_errors, find_actuation
from jaxtube.synthesis.problem import Problem

AT_ONCE = 1e-300
"""Lag that stands for none, s."""
SIGNS = np.array(list(itertools.product((-1.0, 1.0), repeat=3)))


class PoseErrors(NamedTuple):
    """Errors of poses, (m, m, rad), at an instant and a latency later."""

    now: Float[np.ndarray, "n 3"]
    later: Float[np.ndarray, "n 3"]


def find_pose_errors(problem: Problem) -> PoseErrors:
    """Return errors that the pose has where the committed pose has errors at the corners of what
    the controller keeps, after extreme pasts."""
    pasts = draw_pasts(problem)
    latency = find_actuation(problem.scenario).nominal(problem.model.dt).latency
    count = len(pasts.lag)
    origin = Poses(np.zeros(count * len(SIGNS), complex), np.zeros(count * len(SIGNS)))
    corners = np.tile(SIGNS * bound_committed_errors(problem), (count, 1))
    ahead = _repeat(expect_ahead(problem, pasts))
    behind = _repeat(_follow_reference(problem, pasts, latency))
    driven = _repeat(drive(problem, pasts, latency))
    pose = pose_of(corners, origin).join(ahead.back())
    return PoseErrors(now=error_of(pose, behind.back()), later=error_of(pose.join(driven), origin))


def _repeat(poses: Poses) -> Poses:
    """Return poses once for each corner of the errors."""
    return Poses(*(np.repeat(part, len(SIGNS)) for part in poses))


def expect_ahead(problem: Problem, pasts: LatePasts) -> Poses:
    """Return the motions to the committed poses at the instant, by nominal lag and delay."""
    lag, delay = find_actuation(problem.scenario).nominal(problem.model.dt)
    arrived = np.maximum(-delay - pasts.begins[1:], 0.0)
    reached = -np.expm1(-arrived / max(lag, AT_ONCE))
    speeds = pasts.asked[:, 0] + np.einsum("p,npi->ni", reached, np.diff(pasts.asked, axis=1))
    motion = run_out(*find_body(speeds, problem.model.track_width), lag)
    return _drive_arcs(problem, motion, pasts, pasts.asked, delay)


def _follow_reference(problem: Problem, pasts: LatePasts, time: float) -> Poses:
    """Return the motions of the reference over a time before the instant."""
    none = np.zeros(len(pasts.lag))
    return _drive_arcs(problem, Poses(0j + none, none), pasts, pasts.wheels, time)


def _drive_arcs(
    problem: Problem,
    motion: Poses,
    pasts: LatePasts,
    wheels: Float[np.ndarray, "n periods 2"],
    time: float,
) -> Poses:
    """Return motions that go on at the wheel speeds of each period, over a time before the
    instant."""
    b = problem.model.track_width
    ends = np.clip(np.append(pasts.begins, pasts.begins[-1] + problem.model.dt), -time, 0.0)
    for period, duration in enumerate(np.diff(ends).tolist()):
        if duration > 0:
            motion = motion.join(arc(*find_body(wheels[:, period], b), duration))
    return motion


def drive(problem: Problem, pasts: LatePasts, time: float) -> Poses:
    """Return the motions of the body over a time after the instant."""
    b = problem.model.track_width
    rows = np.arange(len(pasts.lag))
    place = np.zeros(len(rows), complex)
    heading = np.zeros(len(rows))
    for begin, end in itertools.pairwise(_cut(problem, pasts, time)):
        half = (end - begin) / 2
        period = np.searchsorted(pasts.begins, begin + half, side="right") - 1
        grip = 1 - pasts.slip[rows, period]
        start, _ = _roll(pasts, begin)
        for node, weight in zip(NODES, WEIGHTS, strict=True):
            travel, speeds = _roll(pasts, begin + half * (1 + node))
            _, turned = find_body(grip * (travel - start), b)
            speed, turn = find_body(grip * speeds, b)
            sideways = pasts.sideslip[rows, period] * speed - problem.robot.lever_arm * turn
            place += half * weight * (speed + 1j * sideways) * np.exp(1j * (heading + turned))
        travel, _ = _roll(pasts, end)
        heading = heading + find_body(grip * (travel - start), b)[1]
    return Poses(place, heading)


def _cut(problem: Problem, pasts: LatePasts, time: float) -> list[Numbers]:
    """Return the times between which motions are smooth: where periods begin, and from the arrival
    of commands on."""
    arrivals = pasts.begins + pasts.delay
    settling = arrivals[..., None] + np.multiply.outer(pasts.lag, LAYERS)[:, None]
    begins = np.tile(np.append(pasts.begins, time), (len(pasts.lag), 1))
    times = np.concatenate([begins, settling.reshape(len(pasts.lag), -1)], axis=1)
    times = np.sort(np.clip(times, 0.0, time), axis=1)
    is_cut = np.append(True, np.any(np.diff(times, axis=1) > 0, axis=0))
    return list(times[:, is_cut].T)


def _roll(
    pasts: LatePasts, times: Numbers
) -> tuple[Float[np.ndarray, "n 2"], Float[np.ndarray, "n 2"]]:
    """Return (travel m, up to a constant, speeds m/s) of the wheels (right, left)."""
    first = pasts.told[:, 0]
    steps = np.diff(pasts.told, axis=1)
    after = np.maximum(times[:, None] - pasts.begins[1:] - pasts.delay[:, 1:], 0.0)
    lag = np.maximum(pasts.lag, AT_ONCE)[:, None]
    closed = -np.expm1(-after / lag)
    covered = after - lag * closed
    travel = first * times[:, None] + np.einsum("np,npi->ni", covered, steps)
    return travel, first + np.einsum("np,npi->ni", closed, steps)
