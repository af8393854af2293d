"""Laws of the tracking error, against a simulation of robot and reference in the world frame."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from continuous_time import error_rate
from scipy.integrate import solve_ivp
from tolerances import EXACT_ARCS, ROUNDING

from jaxtube.plant import error_dynamics

TRACK_WIDTH = 0.5
CASES = 300
TURN_PERIOD = 0.1
TURN_SPEED = 1.3

advance = jax.jit(error_dynamics.advance)
tracking_error = jax.jit(error_dynamics.tracking_error)
world_pose = jax.jit(error_dynamics.world_pose)


def error_in_world_terms(pose, reference_pose):
    """Tracking error, written with complex numbers."""
    difference = reference_pose - pose
    position = (difference[:, 0] + 1j * difference[:, 1]) * np.exp(-1j * pose[:, 2])
    return np.stack([position.real, position.imag, difference[:, 2]], axis=-1)


def pose_rates(pose, wheels, slip):
    """Kinematics of a slipping robot in the world frame, eq. (2)."""
    right, left = (wheels * (1.0 - slip)).T
    speed = (right + left) / 2
    yaw_rate = (right - left) / TRACK_WIDTH
    return np.stack([speed * np.cos(pose[:, 2]), speed * np.sin(pose[:, 2]), yaw_rate], axis=-1)


def simulate(error, wheels, slip, reference_wheels, dt):
    """Integrate robot and reference in the world frame, then take their difference."""
    count = len(error)
    reference_start = np.random.default_rng(4).uniform(-3.0, 3.0, (count, 3))
    heading = reference_start[:, 2] - error[:, 2]
    offset = (error[:, 0] + 1j * error[:, 1]) * np.exp(1j * heading)
    start = np.stack(
        [reference_start[:, 0] - offset.real, reference_start[:, 1] - offset.imag, heading], axis=-1
    )

    def rates(_, flat):
        pose, reference_pose = flat.reshape(2, count, 3)
        moving = [pose_rates(pose, wheels, slip), pose_rates(reference_pose, reference_wheels, 0.0)]
        return np.stack(moving).ravel()

    both = np.stack([start, reference_start]).ravel()
    end = solve_ivp(rates, (0.0, dt), both, method="DOP853", rtol=1e-12, atol=1e-13).y[:, -1]
    return error_in_world_terms(*end.reshape(2, count, 3))


@pytest.fixture(scope="module")
def cases():
    """Errors, wheels, slips and references, with straight lines, standstill and near-straight lines
    among them."""
    generator = np.random.default_rng(3)
    error = generator.uniform([-1.0, -1.0, -3.0], [1.0, 1.0, 3.0], (CASES, 3))
    wheels, reference_wheels = generator.uniform(-3.0, 3.0, (2, CASES, 2))
    slip = generator.uniform(-0.3, 0.9, (CASES, 2))
    slip[:40] = 0.2
    wheels[:40, 1] = wheels[:40, 0]
    reference_wheels[20:60, 1] = reference_wheels[20:60, 0]
    wheels[60:70] = 0.0
    reference_wheels[65:75] = 0.0
    slip[75:90] = 0.2
    wheels[75:90, 1] = wheels[75:90, 0] + 10.0 ** -np.arange(1, 16)
    return error, wheels, slip, reference_wheels


@pytest.mark.parametrize("dt", [0.1, 1.0])
def test_advance_equals_the_world_frame_simulation(cases, dt):
    error, wheels, slip, reference_wheels = cases
    advanced = advance(*map(jnp.array, cases), TRACK_WIDTH, dt)
    np.testing.assert_allclose(
        advanced, simulate(error, wheels, slip, reference_wheels, dt), atol=EXACT_ARCS
    )


def test_advance_composes(cases):
    error, *held = map(jnp.array, cases)
    twice = advance(advance(error, *held, TRACK_WIDTH, 0.03), *held, TRACK_WIDTH, 0.07)
    np.testing.assert_allclose(twice, advance(error, *held, TRACK_WIDTH, 0.1), atol=10 * ROUNDING)


def test_error_rate_is_the_derivative_of_advance_at_its_start(cases):
    arguments = tuple(map(jnp.array, cases))
    start, rate = jax.jvp(
        lambda dt: advance(*arguments, TRACK_WIDTH, dt),
        (jnp.float64(0.0),),
        (jnp.float64(1.0),),
    )
    np.testing.assert_allclose(start, arguments[0], atol=ROUNDING)
    np.testing.assert_allclose(rate, error_rate(*arguments, TRACK_WIDTH), atol=10 * ROUNDING)


def test_error_rate_is_the_derivative_of_advance_at_its_end(cases):
    # Held inputs: the flow satisfies the differential equation at every time, not only at the
    # start.
    error, *held = map(jnp.array, cases)
    end, rate = jax.jvp(
        lambda dt: advance(error, *held, TRACK_WIDTH, dt),
        (jnp.float64(0.4),),
        (jnp.float64(1.0),),
    )
    np.testing.assert_allclose(rate, error_rate(end, *held, TRACK_WIDTH), atol=1e2 * ROUNDING)


def lateral_error(yaw_rate):
    """Return the lateral error after a period of turning at a yaw rate from rest at e = 0."""
    turn = yaw_rate * TRACK_WIDTH / 2
    wheels = jnp.stack([TURN_SPEED + turn, TURN_SPEED - turn])
    return advance(jnp.zeros(3), wheels, 0.0, jnp.zeros(2), TRACK_WIDTH, TURN_PERIOD)[1]


slope = jax.jit(jax.grad(lateral_error))
curvature = jax.jit(jax.grad(jax.grad(lateral_error)))


@pytest.mark.parametrize("yaw_rate", [0.0, 1e-12, 1e-7, 1e-3, 5.9999, 6.0, 6.0001, 17.0])
def test_derivatives_by_wheel_speed_are_exact_at_and_near_straight_lines(yaw_rate):
    # Oracle: turning by w from rest at e = 0 for T ends at e = Rot(-T w) (-chord); d/dw by
    # quadrature of the path.
    dt = TURN_PERIOD
    speed = TURN_SPEED
    nodes, weights = np.polynomial.legendre.leggauss(20)
    times = dt * (nodes + 1) / 2
    integral = weights * dt / 2
    # Seen from the end, the start lies at minus the integral of (cos, sin)(w (t - T)), laterally +
    # sin(w (T - t)).
    first = speed * integral @ ((dt - times) * np.cos(yaw_rate * (dt - times)))
    second = -speed * integral @ ((dt - times) ** 2 * np.sin(yaw_rate * (dt - times)))
    assert slope(yaw_rate) == pytest.approx(first, abs=10 * ROUNDING)
    assert curvature(yaw_rate) == pytest.approx(second, abs=10 * ROUNDING)


def test_tracking_error_is_the_reference_seen_from_the_robot():
    generator = np.random.default_rng(5)
    pose, reference_pose = generator.uniform(-9.0, 9.0, (2, 200, 3))
    error = tracking_error(jnp.array(pose), jnp.array(reference_pose))
    np.testing.assert_allclose(
        error, error_in_world_terms(pose, reference_pose), atol=10 * ROUNDING
    )


def test_tracking_error_and_world_pose_are_inverse():
    generator = np.random.default_rng(6)
    pose, reference_pose = map(jnp.array, generator.uniform(-9.0, 9.0, (2, 200, 3)))
    error = tracking_error(pose, reference_pose)
    np.testing.assert_allclose(world_pose(error, reference_pose), pose, atol=10 * ROUNDING)


def test_a_robot_left_behind_has_a_positive_longitudinal_error():
    error = tracking_error(jnp.zeros(3), jnp.array([1.0, 0.5, 0.1]))
    assert np.all(np.asarray(error) > 0.0)


def test_leading_axes_broadcast(cases):
    error, wheels, slip, reference_wheels = map(jnp.array, cases)
    table = advance(error[:4, None], wheels[:5], slip[0], reference_wheels[1], TRACK_WIDTH, 0.1)
    assert table.shape == (4, 5, 3)
    single = advance(error[2], wheels[3], slip[0], reference_wheels[1], TRACK_WIDTH, 0.1)
    np.testing.assert_allclose(table[2, 3], single, atol=ROUNDING)


@pytest.mark.parametrize("dtype", [jnp.float32, jnp.float64])
def test_dtype_is_kept_inside_jit(dtype, cases):
    arguments = [jnp.array(case, dtype) for case in cases]
    advanced = advance(*arguments, TRACK_WIDTH, 0.1)
    assert advanced.dtype == dtype
    assert world_pose(arguments[0], arguments[0]).dtype == dtype
    exact = advance(*[array.astype(float) for array in arguments], TRACK_WIDTH, 0.1)
    np.testing.assert_allclose(advanced, exact, atol=20 * float(jnp.finfo(dtype).eps))
