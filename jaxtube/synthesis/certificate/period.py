"""One period of the slipping robot in the world frame: a witness for W that shares nothing with the
bound on it.

With poses as complex positions and headings, a robot that drives at v and turns at w for a period T
from position z and heading phi ends at

    z + T (v + i v_y) sinc(w T / 2) e^{i (phi + w T / 2)},    phi + w T,    v_y = zeta v - r w

and has the tracking error  e^{-i phi} (z_ref - z), phi_ref - phi.  Wheels are commanded by the
measured slip, and grip by the true one. w = e+ - A e - B u is what this leaves of the model.

A controller may act on an estimate p = e + n in the place of the measured error: it predicts p-,
the error of a robot that stands at p and grips as the measured slip says, and takes over the share
L of what that misses. Then w = p- + L (e+ - p-) - A p - B u, and n becomes (I - L) (p- - e+), what
the next measurement adds left out of both.

Source: Gonzalez, Fiacchini, Guzman, Alamo 2009, eqs. (1)-(8).
"""

from __future__ import annotations

import itertools
from dataclasses import replace

import numpy as np
from jaxtyping import Complex, Float

from jaxtube.plant.slip_bounds import compensated_slips, slip_bounds
from jaxtube.scenario.error_box import error_vector
from jaxtube.synthesis.acceleration import find_command_steps
from jaxtube.synthesis.certificate.late_period import find_pasts, next_late_errors
from jaxtube.synthesis.certificate.period_cases import Numbers, PeriodCases
from jaxtube.synthesis.disturbance import find_wheel_error_sizes
from jaxtube.synthesis.problem import Problem, region_corners
from sets.polytope import hull_vertices

ALONG = (-1.0, -0.5, 0.0, 0.5, 1.0)
"""Shares of the longitudinal cap that are tried: with a coupling its edge lies at other inputs for
each."""


def find_disturbances(problem: Problem) -> Float[np.ndarray, "n 3"]:
    """Return disturbances (m, m, rad) that are possible at extremes of the certified errors,
    inputs, wheel speeds, slips and noise, the cases of `extreme_cases` once or several times. The
    noise of the next measurement is left out: that may be added anywhere in its box."""
    cases = extreme_cases(problem)
    transitions, inputs = problem.model.matrices(cases.wheels)
    predicted = np.einsum("nij,nj->ni", transitions, cases.errors)
    predicted += np.einsum("nij,nj->ni", inputs, cases.inputs)
    every_true = next_true_errors(problem, cases)
    return np.concatenate([next_estimates(problem, cases, true) - predicted for true in every_true])


def find_estimate_errors(problem: Problem) -> Float[np.ndarray, "n 3"]:
    """Return how far estimates (m, m, rad) can be off at the end of the same periods, the noise of
    the next measurement left out."""
    cases = extreme_cases(problem)
    every_true = next_true_errors(problem, cases)
    return np.concatenate([next_estimates(problem, cases, true) - true for true in every_true])


def next_true_errors(problem: Problem, cases: PeriodCases) -> list[Float[np.ndarray, "n 3"]]:
    """Return the true errors a period later, (m, m, rad): of wheels that lag once for each of some
    pasts."""
    if problem.scenario.robot.obeys_at_once:
        return [next_errors(problem, cases)]
    speed, turn = map_inputs(problem, cases)
    pasts = find_pasts(problem, speed, turn)
    steps = find_command_steps(problem)
    if steps is not None:
        pasts = [past.near(speed, turn, steps, problem.model.track_width) for past in pasts]
    return [next_late_errors(problem, cases, speed, turn, past) for past in pasts]


def next_estimates(
    problem: Problem, cases: PeriodCases, true: Float[np.ndarray, "n 3"]
) -> Float[np.ndarray, "n 3"]:
    """Return the estimated errors a period later, of an exact measurement of the true ones, (m, m,
    rad); those themselves where the controller acts on the measured ones."""
    settings = problem.scenario.controller
    if not settings.has_observer:
        return true
    unmoved = np.zeros_like(cases.noise)
    known = replace(cases, slip=cases.measured_slip, sideslip=unmoved[:, 0], noise=unmoved)
    predicted = _end_errors(problem, known, lever_arm=0.0)
    return predicted + settings.observer_gain * (true - predicted)


def find_wheel_commands(problem: Problem) -> Float[np.ndarray, "n 2"]:
    """Return the wheel speeds (right, left), m/s, that the same extremes ask for."""
    return command_wheels(problem, extreme_cases(problem))


def extreme_cases(problem: Problem) -> PeriodCases:
    """Return corners of the operating set, of U, of the regions, and of slip and noise, together.

    Where input and error are coupled the longitudinal error is shrunk until their row is met.
    """
    errors, inputs = pair_errors_and_inputs(problem)
    wheels = find_extreme_speeds(problem)
    slip_pairs = pair_slips(problem)
    sideslips = np.unique(problem.scenario.slip.sideslip * np.array([-1.0, 1.0]))
    has_observer = problem.scenario.controller.has_observer
    noise = _extreme_estimate_errors(problem) if has_observer else _extreme_noise(problem)
    sizes = [len(part) for part in (errors, wheels, slip_pairs, sideslips, noise)]
    pair, wheel, slip, sideslip, shift = np.indices(sizes).reshape(len(sizes), -1)
    true, measured = np.swapaxes(slip_pairs[slip], 0, 1)
    errors = errors[pair]
    return PeriodCases(
        errors=errors,
        inputs=inputs[pair],
        wheels=wheels[wheel],
        slip=true,
        measured_slip=measured,
        sideslip=sideslips[sideslip],
        noise=noise[shift] if has_observer else _in_robot_frame(problem, noise[shift], errors),
    )


def find_extreme_speeds(problem: Problem) -> Float[np.ndarray, "k 2"]:
    """Return the corners of the certified wheel speeds (right, left), m/s: of boxes that cover a
    band those of their hull."""
    corners = np.unique(region_corners(problem.regions), axis=0)
    is_cover = problem.scenario.reference.certified_for == "box" and len(problem.regions) > 1
    return hull_vertices(corners) if is_cover else corners


def pair_errors_and_inputs(
    problem: Problem,
) -> tuple[Float[np.ndarray, "n 3"], Float[np.ndarray, "n 2"]]:
    """Return corners of the operating set, (m, m, rad), with those of U, (m/s, rad/s)."""
    half_widths = problem.operating_set.offsets[:3]
    errors = half_widths * np.array(list(itertools.product(ALONG, (-1, 1), (-1, 0, 1))))
    vertices = problem.input_set.vertices()
    inputs = np.concatenate([vertices, (vertices + np.roll(vertices, 1, axis=0)) / 2])
    error, asked = np.indices((len(errors), len(inputs))).reshape(2, -1)
    inputs = inputs[asked]
    return _meet_coupling(problem, errors[error], inputs), inputs


def _extreme_estimate_errors(problem: Problem) -> Float[np.ndarray, "k 3"]:
    """Return corners of S, the errors that an estimate may have, (m, m, rad)."""
    return np.unique(problem.estimate_error * list(itertools.product((-1, 1), repeat=3)), axis=0)


def _extreme_noise(problem: Problem) -> Float[np.ndarray, "k 3"]:
    """Return extremes of the pose noise along the axes of the robot, (m, m, rad)."""
    noise = error_vector(problem.scenario.noise)
    if problem.scenario.noise.frame == "robot":
        return np.unique(noise * list(itertools.product((-1, 1), repeat=3)), axis=0)
    # A corner of a box in the world may lie in any direction from the robot.
    reach = np.hypot(noise[0], noise[1])
    corners = np.array([[1, 0, 1], [0, 1, 1], [1, 0, -1], [0, 1, -1]])
    return np.unique(np.vstack([corners, -corners]) * [reach, reach, noise[2]], axis=0)


def _in_robot_frame(
    problem: Problem, noise: Float[np.ndarray, "n 3"], errors: Float[np.ndarray, "n 3"]
) -> Float[np.ndarray, "n 3"]:
    """Return noise of measured errors from that of the pose: a heading that is wrong turns the
    position error, too, where noise is one of the pose in the world."""
    if problem.scenario.noise.frame == "robot":
        return noise
    position = errors[:, 0] + 1j * errors[:, 1]
    turned = position * (1 - np.exp(-1j * noise[:, 2]))
    return noise + np.stack([turned.real, turned.imag, np.zeros(len(noise))], axis=1)


def noise_reach(problem: Problem, normals: Float[np.ndarray, "k 3"]) -> Float[np.ndarray, " k"]:
    """Return how far the noise of the next measurement may take w along each normal."""
    taken_over = problem.scenario.controller.observer_gain * _extreme_noise(problem)
    return np.max(taken_over @ normals.T, axis=0)


def _meet_coupling(
    problem: Problem, errors: Float[np.ndarray, "n 3"], inputs: Float[np.ndarray, "n 2"]
) -> Float[np.ndarray, "n 3"]:
    """Return the errors with as much of e_x as the rows that couple it with the inputs allow."""
    rows = problem.cap_rows
    is_coupled = rows.is_coupled
    left = rows.offsets[is_coupled] - inputs @ rows.inputs[is_coupled].T
    most = np.min(left / np.abs(rows.errors[is_coupled, 0]), axis=1, initial=np.inf)
    along = np.clip(errors[:, 0], -np.maximum(most, 0), np.maximum(most, 0))
    return np.column_stack([along, errors[:, 1:]])


def pair_slips(problem: Problem) -> Float[np.ndarray, "k 2 2"]:
    """Return pairs of true and measured slip (right, left) at their extremes: near nominal ones
    either of the two is nominal, unless the scenario lets both vary."""
    if problem.scenario.slip.is_learnt:
        return _pair_learnt_slips(problem)
    slips = slip_bounds(problem.scenario.slip)
    pairs = slips.extremes()
    if problem.scenario.slip.has_intervals or slips.uncertain_slip == "both":
        return pairs
    # A bound on either slip's error is one on both readings: the other slip may vary instead.
    return np.concatenate([pairs, pairs[:, ::-1]])


def _pair_learnt_slips(problem: Problem) -> Float[np.ndarray, "k 2 2"]:
    """Return pairs of slips that leave the greatest errors of the ground speeds, with either end of
    the intervals compensated; how far off what is learnt may be is proved elsewhere."""
    sizes = find_wheel_error_sizes(problem)
    ends = compensated_slips(problem.scenario.slip)
    sides = np.array(list(itertools.product((0, 1), repeat=2)))
    signs = np.array(list(itertools.product((-1.0, 1.0), repeat=2)))
    compensated = ends[sides, [0, 1]]
    pairs = [
        np.stack([one + sign * sizes * (1 - one), one]) for one in compensated for sign in signs
    ]
    return np.array(pairs)


def next_errors(problem: Problem, cases: PeriodCases) -> Float[np.ndarray, "n 3"]:
    """Return the true errors a period later, (m, m, rad)."""
    return _end_errors(problem, cases, problem.robot.lever_arm)


def errors_within_period(
    problem: Problem, cases: PeriodCases, share: float
) -> Float[np.ndarray, "n 3"]:
    """Return the true errors, (m, m, rad), after a share of the period, in [0, 1]."""
    return _end_errors(problem, cases, problem.robot.lever_arm, share)


def _end_errors(
    problem: Problem, cases: PeriodCases, lever_arm: float, share: float = 1.0
) -> Float[np.ndarray, "n 3"]:
    """Return the errors, (m, m, rad), of robots with a lever arm, m, a share of the period
    later."""
    T = share * problem.model.dt
    b = problem.model.track_width
    reference_speed = cases.wheels.mean(axis=1)
    reference_turn = (cases.wheels[:, 0] - cases.wheels[:, 1]) / b
    right, left = ((1 - cases.slip) * command_wheels(problem, cases)).T
    # The reference is at the origin of the world frame, heading along its x axis.
    true = cases.errors - cases.noise
    heading = -true[:, 2]
    place = -(true[:, 0] + 1j * true[:, 1]) * np.exp(1j * heading)
    reference_step = _step(reference_speed, reference_turn, np.zeros_like(heading), T)
    speed = (right + left) / 2
    turn = (right - left) / b
    sideways = cases.sideslip * speed - lever_arm * turn
    place = place + _step(speed, turn, heading, T) + 1j * _step(sideways, turn, heading, T)
    heading = heading + T * turn
    offset = np.exp(-1j * heading) * (reference_step - place)
    return np.stack([offset.real, offset.imag, T * reference_turn - heading], axis=1)


def command_wheels(problem: Problem, cases: PeriodCases) -> Float[np.ndarray, "n 2"]:
    """Return the wheel speeds (right, left), m/s, that are commanded: the measured slip is
    compensated."""
    speed, turn = map_inputs(problem, cases)
    half_track = problem.model.track_width / 2
    ground = np.stack([speed + half_track * turn, speed - half_track * turn], axis=1)
    return ground / (1 - cases.measured_slip)


def map_inputs(problem: Problem, cases: PeriodCases) -> tuple[Numbers, Numbers]:
    """Return the speed, m/s, and yaw rate, rad/s, that the input map commands.

    `x_exact` is solved for the speed by what it means: without slip and noise the longitudinal
    error would become e_x + T Om e_y + T u1.
    """
    T = problem.model.dt
    x, y, heading_error = cases.errors.T
    u1, u2 = cases.inputs.T
    reference_speed = cases.wheels.mean(axis=1)
    reference_turn = (cases.wheels[:, 0] - cases.wheels[:, 1]) / problem.model.track_width
    turn = reference_turn - u2
    input_map = problem.scenario.controller.input_map
    if input_map == "paper":
        return reference_speed - u1, turn
    if input_map == "cosine_free":
        return reference_speed * np.cos(heading_error) - u1, turn
    heading = -heading_error
    into_frame = np.exp(-1j * (heading + T * turn))
    place = -(x + 1j * y) * np.exp(1j * heading)
    reference_step = _step(reference_speed, reference_turn, np.zeros_like(heading), T)
    unmoved = (into_frame * (reference_step - place)).real
    per_speed = (into_frame * _step(np.ones_like(turn), turn, heading, T)).real
    wanted = x + T * reference_turn * y + T * u1
    return (unmoved - wanted) / per_speed, turn


def _step(speed: Numbers, turn: Numbers, heading: Numbers, T: float) -> Complex[np.ndarray, " n"]:
    """Return the way of a period along an arc, in the world frame, m."""
    half = T * turn / 2
    return T * speed * np.sinc(half / np.pi) * np.exp(1j * (heading + half))
