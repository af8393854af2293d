"""Laws of the set S of an estimate's error, and of W where a controller acts on the estimate."""

import dataclasses
import functools

import numpy as np
import pytest
from test_disturbance import EIGHT, SLIDING, operation

from sets.robot.disturbance import (
    disturbance_bound,
    disturbance_parts,
    evaluate_disturbance,
)
from sets.robot.observer import MARGIN, bound_next_error, find_estimate_error
from sets.robot.operation import Operation
from sets.robot.plant import Kinematics, split_disturbance

GAIN = (0.5, 0.25, 0.8)
NOISY = dataclasses.replace(
    operation(noise=(5e-3, 4e-3, np.deg2rad(0.2))), gain=GAIN, estimate_error=None
)
SLIDING_NOISY = dataclasses.replace(SLIDING, gain=(0.7, 0.4, 0.5), estimate_error=None)
WIDE = Operation(
    errors=np.array([[-1.0], [1.0]]) * [0.016, 0.117, 0.305],
    inputs=np.array([[-0.217, -1.035], [0.236, 1.035]]),
    schedules=np.array([[[0.565, 0.565], [0.869, 0.869]]]),
    wheel_errors=np.array([[-1.0], [1.0]]) * [0.0148, 0.0347],
    noise=np.array([1.55e-3, 1.24e-3, 7.17e-4]),
    dt=0.15,
    track_width=0.318,
    gain=(0.897, 0.372, 0.9999),
    estimate_error=np.array([2.4e-3, 5.6e-3, 7.2e-4]),
)
"""A robot of one third of a metre that turns by up to 0.3 rad in a period."""
WHERE = [NOISY, pytest.param(SLIDING_NOISY, marks=pytest.mark.slow)]
MODEL = Kinematics()


@functools.cache
def error_of(where: Operation) -> np.ndarray:
    return find_estimate_error(where, MODEL)


def observed(where: Operation) -> Operation:
    return dataclasses.replace(where, estimate_error=error_of(where))


def draw(where: Operation, count: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Draw the thirteen variables and the noise of the next measurement, often at their ends."""
    rng = np.random.default_rng(seed)
    low, high = np.hstack([where.box, [-where.noise, where.noise]])
    inside, side = rng.random((2, count, 16))
    share = rng.choice([0.0, 0.5, 1.0], size=(count, 1))
    ends = np.where(side < 0.5, low, high)
    points = np.where(rng.random((count, 16)) < share, low + inside * (high - low), ends)
    return points[:, :13], points[:, 13:]


def drive(where: Operation, pose, speed, turn, sideways=0.0):
    """Return complex position and heading after a period along an arc, in the world frame."""
    position, heading = pose
    T = where.dt
    half = T * turn / 2
    chord = T * np.sinc(half / np.pi) * np.exp(1j * (heading + half))
    return position + (speed + 1j * sideways) * chord, heading + T * turn


def tracking_error(pose, reference):
    offset = np.exp(-1j * pose[1]) * (reference[0] - pose[0])
    return np.stack([offset.real, offset.imag, reference[1] - pose[1]], axis=-1)


def stand(errors):
    """Return the pose of a robot with tracking errors whose reference is at the origin."""
    heading = -errors[:, 2]
    return -(errors[:, 0] + 1j * errors[:, 1]) * np.exp(1j * heading), heading


def play_period(where: Operation, points, next_noise):
    """Return (estimates, true errors, what the model predicts of the estimates) a period later,
    from the definitions of robot and observer in the world frame."""
    parts = split_disturbance(MODEL, where.period, points.T)
    estimates = points[:, :3]
    inputs = points[:, 3:5]
    wheels = points[:, 5:7]
    zeta = points[:, 9]
    b = where.track_width
    V = wheels.mean(axis=1)
    Om = (wheels[:, 0] - wheels[:, 1]) / b
    reference = drive(where, (np.zeros(len(V), complex), np.zeros(len(V))), V, Om)
    commanded = np.stack([parts.right, parts.left], axis=1)
    acting = commanded * (1 - points[:, 7:9])
    speed = acting.mean(axis=1)
    turn = (acting[:, 0] - acting[:, 1]) / b
    sideways = zeta * speed - where.lever_arm * turn
    true = tracking_error(
        drive(where, stand(estimates - points[:, 10:]), speed, turn, sideways), reference
    )
    known_turn = (commanded[:, 0] - commanded[:, 1]) / b
    predicted = tracking_error(
        drive(where, stand(estimates), commanded.mean(axis=1), known_turn), reference
    )
    following = predicted + where.gain * (true + next_noise - predicted)
    half = np.tan(where.dt * Om / 2)
    reach = where.dt * V * np.sinc(where.dt * Om / 2 / np.pi) / np.cos(where.dt * Om / 2)
    x, y, heading = estimates.T
    u1, u2 = inputs.T
    T = where.dt
    model = np.stack(
        [
            x + T * Om * y + T * u1,
            y - half * (2 * x + T * Om * y + T * u1) + reach * (heading + T * u2 / 2),
            heading + T * u2,
        ],
        axis=1,
    )
    return following, true, model


@pytest.mark.parametrize("where", WHERE)
def test_estimates_evaluated_are_those_of_a_robot_in_the_world_frame(where):
    points, next_noise = draw(observed(where), 4000, seed=1)
    following, _, model = play_period(where, points, next_noise)
    w, _, _ = evaluate_disturbance(where, MODEL, points, next_noise)
    np.testing.assert_allclose(w, following - model, rtol=0, atol=1e-13)


@pytest.mark.parametrize("where", WHERE)
def test_no_error_leaves_its_set_and_no_disturbance_leaves_w(where):
    inside = observed(where)
    points, next_noise = draw(inside, 200_000, seed=2)
    following, true, model = play_period(inside, points, next_noise)
    errors = np.abs(following - true).max(axis=0) / error_of(where)
    assert (errors <= 1).all()
    assert (errors > 0.7).all()
    bound = disturbance_bound(inside, MODEL, 0.03)
    normals = bound.polytope().normals
    assert ((following - model) @ normals.T <= bound.polytope().offsets).all()


def test_the_set_is_invariant_and_hardly_more():
    image = bound_next_error(observed(NOISY), MODEL)
    size = error_of(NOISY)
    assert (image <= size).all()
    assert (image >= size * (1 - 2 * MARGIN)).all()
    assert (size >= NOISY.noise).all()


def climb(where: Operation, coordinate: int, seed: int) -> float:
    """Return the greatest error a period later that is found by moving one variable after the
    other to either end, or between them, from drawn points."""
    low, high = np.hstack([where.box, [-where.noise, where.noise]])
    points = np.hstack(draw(where, 64, seed))
    for variable in [*range(16)] * 3:
        tried = np.repeat(points[None], 4, axis=0)
        tried[1:, :, variable] = np.linspace(low[variable], high[variable], 3)[:, None]
        after = [play_period(where, each[:, :13], each[:, 13:]) for each in tried]
        errors = np.abs([following - true for following, true, _ in after])[..., coordinate]
        points = tried[errors.argmax(axis=0), np.arange(64)]
    return float(errors.max())


def test_what_is_proved_of_the_next_error_is_attained():
    proved = bound_next_error(WIDE, MODEL)
    for coordinate in range(3):
        attained = climb(WIDE, coordinate, seed=4)
        assert attained <= proved[coordinate] <= attained * 1.002


def test_in_heading_the_set_has_a_closed_form():
    speeds = [disturbance_bound(EIGHT, MODEL, 1e-3).yaw, NOISY.noise[2]]
    kick, noise = speeds
    closed = noise + (1 / GAIN[2] - 1) * kick
    assert error_of(NOISY)[2] == pytest.approx(closed, rel=2 * MARGIN)


def test_a_gain_of_one_is_the_measured_error_to_the_last_bit():
    same = dataclasses.replace(EIGHT, gain=(1.0, 1.0, 1.0))
    np.testing.assert_array_equal(find_estimate_error(same, MODEL), EIGHT.noise)
    assert min(NOISY.gain) < 1
    plain = disturbance_bound(EIGHT, MODEL, 0.1)
    found = disturbance_bound(same, MODEL, 0.1)
    assert found.yaw == plain.yaw
    np.testing.assert_array_equal(found.box, plain.box)
    assert found.lateral_per_yaw == plain.lateral_per_yaw == EIGHT.period.lateral_per_yaw


def test_noise_enters_w_less_and_kicks_as_much():
    """In heading: l kappa along the kick, l S + l nu beside it, S = nu + (1 / l - 1) kappa."""
    measured = disturbance_bound(dataclasses.replace(NOISY, gain=(1, 1, 1)), MODEL, 0.03)
    estimated = disturbance_bound(observed(NOISY), MODEL, 0.03)
    share = GAIN[2]
    assert estimated.yaw == pytest.approx(share * measured.yaw, rel=1e-9)
    whole = estimated.yaw + estimated.box[2]
    assert whole == pytest.approx(measured.yaw + 2 * share * NOISY.noise[2], rel=2 * MARGIN)
    assert estimated.lateral_per_yaw * share == pytest.approx(
        GAIN[1] * measured.lateral_per_yaw, rel=1e-14
    )


def test_the_table_of_causes_adds_up_to_w():
    where = observed(NOISY)
    bound = disturbance_bound(where, MODEL, 1e-2)
    parts = disturbance_parts(where, MODEL)
    together = np.sum(list(parts.values()), axis=0)
    widths = np.array([bound.yaw, *bound.box])
    assert (together >= widths * 0.97).all()
    assert parts["slip"][0] == pytest.approx(bound.yaw, rel=0.02)
    assert parts["noise"][3] == pytest.approx(bound.box[2], rel=1e-12)


def test_a_gain_that_lets_errors_grow_is_refused():
    with pytest.raises(ValueError, match="lets errors grow by turning"):
        find_estimate_error(dataclasses.replace(NOISY, gain=(0.01, 0.01, 0.5)), MODEL)
    for gain in ((0.0, 1.0, 1.0), (1.0, 1.1, 1.0), (1.0, 1.0), (1.0, np.nan, 1.0)):
        with pytest.raises(ValueError, match="gain: "):
            dataclasses.replace(NOISY, gain=gain)
