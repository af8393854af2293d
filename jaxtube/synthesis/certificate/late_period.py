"""One period of a robot whose wheels lag and whose commands come late, in the world frame: a
witness for W that shares nothing with the bound on it.

Until the instant the robot has been asked for one pair of speeds for ever, so that its wheels run
at them and all commands on their way are the same; what it is asked for then is another pair. With
poses as pairs (complex position, heading) the body goes

    int (v + i v_y) e^{i phi} dt,    each wheel at c + (c_0 - c) e^{-(t - D) / tau} from D on

which is integrated by Gauss and Legendre between the times that matter. The error after the period
is that of the pose to which the commands given by then take the robot, by nominal lag and delay.

Source: new; Gonzalez, Fiacchini, Guzman, Alamo 2009, eqs. (1)-(8), for the robot.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from jaxtube.synthesis.certificate.period_cases import Numbers, PeriodCases
from jaxtube.synthesis.certificate.poses import Poses, arc, error_of, pose_of, run_out
from jaxtube.synthesis.disturbance import find_actuation
from jaxtube.synthesis.problem import Problem

NODES, WEIGHTS = np.polynomial.legendre.leggauss(10)
LAYERS = (0.0, 4.0, 16.0)
"""Time constants after the arrival of a command at which pieces of the integral begin."""


class Past(NamedTuple):
    """What a robot was asked for until the instant, and how late its wheels are.

    Attributes:
        speed: of the body, m/s.
        turn: rad/s.
        lag: of the wheels, s.
        delay: of the command of the instant, s.
    """

    speed: float | Numbers
    turn: float | Numbers
    lag: float
    delay: float

    def near(
        self, speed: Numbers, turn: Numbers, steps: Float[np.ndarray, "2"], track_width: float
    ) -> Past:
        """Return this past, or as much of it as the next command allows.

        Args:
            speed, turn: of the next command, m/s and rad/s.
            steps: greatest change of what the wheels (right, left) are told, m/s.
            track_width: m.
        """
        ends = []
        for side, step in zip((track_width / 2, -track_width / 2), steps, strict=True):
            told = speed + side * turn
            ends.append(np.clip(self.speed + side * self.turn, told - step, told + step))
        right, left = ends
        return self._replace(speed=(right + left) / 2, turn=(right - left) / track_width)


def find_pasts(problem: Problem, speed: Numbers, turn: Numbers) -> Iterator[Past]:
    """Yield extreme pasts: the pairs of speeds at the ends of all that is asked for, each with one
    of the extremes of lag and delay."""
    actuation = find_actuation(problem.scenario)
    half_track = problem.model.track_width / 2
    asked = (turn, speed + half_track * turn, speed - half_track * turn, speed)
    extremes = itertools.cycle(itertools.product(actuation.lag, actuation.delay))
    for values in asked:
        for index in (int(np.argmin(values)), int(np.argmax(values))):
            lag, delay = next(extremes)
            yield Past(float(speed[index]), float(turn[index]), lag, delay)


def next_late_errors(
    problem: Problem, cases: PeriodCases, speed: Numbers, turn: Numbers, past: Past
) -> Float[np.ndarray, "n 3"]:
    """Return the true errors of the committed poses a period later, (m, m, rad).

    Args:
        problem: with the robot.
        cases: `errors` are the measured ones of the committed poses, or the estimated ones; `noise`
            is that of the pose itself, or the error of the estimate.
        speed, turn: of the body that the commands of the period ask for, m/s and rad/s.
        past: what the robot was asked for before.
    """
    T = problem.model.dt
    lag, delay = find_actuation(problem.scenario).nominal(T)
    none = np.zeros_like(speed)
    reference_speed = cases.wheels.mean(axis=1)
    reference_turn = (cases.wheels[:, 0] - cases.wheels[:, 1]) / problem.model.track_width
    # The reference is at the origin of the world frame, heading along its x axis.
    origin = Poses(0j + none, none)
    ahead = run_out(past.speed + none, past.turn + none, lag)
    ahead = ahead.join(arc(past.speed + none, past.turn + none, delay))
    if problem.scenario.controller.has_observer:
        pose = pose_of(cases.errors - cases.noise, origin).join(ahead.back())
    else:
        behind = arc(reference_speed, reference_turn, lag + delay).back()
        measured = pose_of(cases.errors, origin).join(ahead.back())
        pose = pose_of(error_of(measured, behind) - cases.noise, behind)
    pose = pose.join(_drive(problem, cases, speed, turn, past))
    left = np.exp(-max(T - delay, 0.0) / lag) if lag > 0 else float(delay >= T)
    coast_speed = speed + (past.speed - speed) * left
    coast_turn = turn + (past.turn - turn) * left
    committed = pose.join(run_out(coast_speed, coast_turn, lag))
    committed = committed.join(arc(past.speed + none, past.turn + none, max(delay - T, 0.0)))
    committed = committed.join(arc(speed, turn, min(delay, T)))
    return error_of(committed, arc(reference_speed, reference_turn, T))


def _drive(
    problem: Problem, cases: PeriodCases, speed: Numbers, turn: Numbers, past: Past
) -> Poses:
    """Return the motion of the body in a period."""
    T = problem.model.dt
    half_track = problem.model.track_width / 2
    grip = (1 - cases.slip) / (1 - cases.measured_slip)
    signs = (1.0, -1.0)
    asked = [grip[:, i] * (speed + signs[i] * half_track * turn) for i in (0, 1)]
    before = [grip[:, i] * (past.speed + signs[i] * half_track * past.turn) for i in (0, 1)]
    starts = [past.delay + layer * past.lag for layer in LAYERS]
    cuts = np.unique(np.clip([0.0, *starts, T], 0.0, T))
    place = np.zeros(len(speed), complex)
    for begin, end in itertools.pairwise(cuts):
        half = (end - begin) / 2
        for node, weight in zip(NODES, WEIGHTS, strict=True):
            time = (begin + end) / 2 + half * node
            travel, speeds = _follow(before, asked, past, time)
            v = (speeds[0] + speeds[1]) / 2
            w = (speeds[0] - speeds[1]) / (2 * half_track)
            heading = (travel[0] - travel[1]) / (2 * half_track)
            sideways = cases.sideslip * v - problem.robot.lever_arm * w
            place += half * weight * (v + 1j * sideways) * np.exp(1j * heading)
    travel, _ = _follow(before, asked, past, T)
    return Poses(place, (travel[0] - travel[1]) / (2 * half_track))


def _follow(before, asked, past: Past, time: float) -> tuple[list[Numbers], list[Numbers]]:
    """Return (travel m, speeds m/s) of both wheels since the instant."""
    after = max(time - past.delay, 0.0)
    closed = 1 - np.exp(-after / past.lag) if past.lag > 0 else float(after > 0)
    covered = after - past.lag * closed
    wheels = list(zip(before, asked, strict=True))
    travel = [old * time + (new - old) * covered for old, new in wheels]
    speeds = [old + (new - old) * closed for old, new in wheels]
    return travel, speeds
