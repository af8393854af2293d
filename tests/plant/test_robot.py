"""Laws of wheel commands, body velocity and virtual inputs."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from tolerances import ROUNDING

from jaxtube.plant import robot

TRACK_WIDTH = 0.5
ROBOT = robot.Robot(TRACK_WIDTH, -3.0, 3.0)


@pytest.fixture
def draws():
    """Random wheels, reference wheels and slips, (500, 2) each."""
    generator = np.random.default_rng(1)
    wheels, reference_wheels = generator.uniform(-3.0, 3.0, (2, 500, 2))
    return (
        jnp.array(wheels),
        jnp.array(reference_wheels),
        jnp.array(generator.uniform(-0.5, 0.9, (500, 2))),
    )


def test_body_velocity_follows_the_ground_speeds_of_the_wheels(draws):
    wheels, _, slip = draws
    speed, yaw_rate = np.asarray(robot.body_velocity(wheels, slip, TRACK_WIDTH)).T
    right, left = np.asarray(wheels * (1.0 - slip)).T
    # A rigid body: the contact points, half a track width beside the centre, move at the ground
    # speeds.
    np.testing.assert_allclose(speed + yaw_rate * TRACK_WIDTH / 2, right, atol=ROUNDING)
    np.testing.assert_allclose(speed - yaw_rate * TRACK_WIDTH / 2, left, atol=ROUNDING)


def find_deficits(wheels, reference_wheels, slip):
    """(speed, yaw rate) by which the body falls short of the reference's velocity, eq. (5)."""
    reference = robot.body_velocity(reference_wheels, 0.0, TRACK_WIDTH)
    return reference - robot.body_velocity(wheels, slip, TRACK_WIDTH)


def test_faster_right_wheel_turns_left():
    assert robot.body_velocity(jnp.array([1.0, 0.5]), 0.0, TRACK_WIDTH)[1] > 0.0


def test_wheel_commands_undo_the_deficits_of_the_body(draws):
    wheels, reference_wheels, slip = draws
    deficits = find_deficits(wheels, reference_wheels, slip)
    commands = robot.wheel_commands(deficits, reference_wheels, slip, TRACK_WIDTH)
    np.testing.assert_allclose(commands, wheels, atol=ROUNDING)


def test_commands_realise_the_deficits_they_are_asked_for(draws):
    deficits, reference_wheels, slip = draws
    commands = robot.wheel_commands(deficits, reference_wheels, slip, TRACK_WIDTH)
    speed, yaw_rate = np.asarray(robot.body_velocity(commands, slip, TRACK_WIDTH)).T
    right, left = np.asarray(reference_wheels).T
    np.testing.assert_allclose((right + left) / 2 - speed, deficits[:, 0], atol=ROUNDING)
    np.testing.assert_allclose(
        (right - left) / TRACK_WIDTH - yaw_rate, deficits[:, 1], atol=1e2 * ROUNDING
    )


def test_a_wrong_slip_acts_as_the_closed_form_says(draws):
    _, reference_wheels, slip = draws
    measured = slip * 0.9
    u1 = 0.2
    u2 = -0.4
    deficits = jnp.full_like(slip, 1.0) * jnp.array([u1, u2])
    commands = robot.wheel_commands(deficits, reference_wheels, measured, TRACK_WIDTH)
    acting = find_deficits(commands, reference_wheels, slip)
    d_r, d_l = np.asarray((slip - measured) / (1.0 - measured)).T
    p = u1 + TRACK_WIDTH / 2 * u2
    q = u1 - TRACK_WIDTH / 2 * u2
    V_r, V_l = np.asarray(reference_wheels).T
    np.testing.assert_allclose(
        acting[:, 0], u1 + ((V_r - p) * d_r + (V_l - q) * d_l) / 2, atol=1e2 * ROUNDING
    )
    np.testing.assert_allclose(
        acting[:, 1], u2 + ((V_r - p) * d_r - (V_l - q) * d_l) / TRACK_WIDTH, atol=1e2 * ROUNDING
    )


def test_saturation_clips_each_wheel_alone():
    saturated = robot.saturate(jnp.array([[4.0, 1.0], [-5.0, 3.0], [jnp.inf, -jnp.inf]]), ROBOT)
    np.testing.assert_array_equal(saturated, [[3.0, 1.0], [-3.0, 3.0], [3.0, -3.0]])


def test_wheels_stand_half_a_track_width_beside_the_robot():
    generator = np.random.default_rng(2)
    pose = generator.uniform(-5.0, 5.0, (50, 3))
    right, left = np.moveaxis(
        np.asarray(robot.wheel_positions(jnp.array(pose), TRACK_WIDTH)), -2, 0
    )
    np.testing.assert_allclose((right + left) / 2, pose[:, :2], atol=ROUNDING)
    to_the_left = (left - right) @ np.array([1.0, 1.0j]) / TRACK_WIDTH
    np.testing.assert_allclose(to_the_left, 1.0j * np.exp(1.0j * pose[:, 2]), atol=ROUNDING)


def test_leading_axes_broadcast():
    one = jnp.ones(2)
    four = jnp.ones((4, 2))
    for deficits, reference_wheels in ((one, four), (four, one)):
        assert robot.wheel_commands(deficits, reference_wheels, 0.1, TRACK_WIDTH).shape == (4, 2)


@pytest.mark.parametrize("dtype", [jnp.float32, jnp.float64])
def test_functions_keep_the_dtype_they_are_given_inside_jit(dtype):
    pair = jnp.full((3, 2), 0.5, dtype)
    pose = jnp.ones((3, 3), dtype)

    @jax.jit
    def everything(robot_):
        b = robot_.track_width
        commands = robot.wheel_commands(pair, pair, pair, b)
        return (
            robot.saturate(commands, robot_),
            robot.body_velocity(pair, pair, b),
            robot.wheel_positions(pose, b),
        )

    assert all(array.dtype == dtype for array in everything(ROBOT))


def test_a_wheel_saturates_where_it_is_denied_more_than_rounding():
    limit = 1.7
    demanded = np.array([[0.3, limit], [limit * (1 + 1e-9), 0.1], [-np.inf, 1.0], [np.nan, 0.0]])
    wheels = np.clip(demanded, -limit, limit)
    made_again = np.nextafter(wheels, np.inf)
    for given in (wheels, made_again):
        for array in (np.asarray, jnp.asarray):
            found = robot.is_saturated(array(demanded), array(given))
            np.testing.assert_array_equal(found, [False, True, True, False])
