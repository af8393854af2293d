"""Laws of the linear tracking law."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from continuous_time import error_rate
from tolerances import ROUNDING

from jaxtube.control import tracking as baselines
from jaxtube.plant import robot

TRACK_WIDTH = 0.5


def closed_loop_rate(error, reference_wheels, compensated_slip, slip):
    deficits = baselines.tracking_input(error, reference_wheels, TRACK_WIDTH)
    wheels = robot.wheel_commands(deficits, reference_wheels, compensated_slip, TRACK_WIDTH)
    return error_rate(error, wheels, slip, reference_wheels, TRACK_WIDTH)


@pytest.mark.parametrize("reference_wheels", [(1.496, 1.224), (1.0, 1.0), (0.3, 1.2), (-0.8, -1.0)])
def test_frozen_loop_with_slip_compensation_has_the_designed_poles(reference_wheels):
    damping = 1.0
    bandwidth = 0.6
    slip = jnp.array([0.2, 0.15])
    matrix = jax.jacobian(closed_loop_rate)(jnp.zeros(3), jnp.array(reference_wheels), slip, slip)
    designed = np.polymul(
        [1.0, 2 * damping * bandwidth], [1.0, 2 * damping * bandwidth, bandwidth**2]
    )
    np.testing.assert_allclose(np.poly(np.asarray(matrix)), designed, atol=1e2 * ROUNDING)


def test_without_compensation_the_robot_falls_behind():
    wheels = jnp.array([1.5, 1.2])
    slip = jnp.array([0.2, 0.2])
    speed = robot.body_velocity(wheels, 0.0, TRACK_WIDTH)[0]
    compensated = closed_loop_rate(jnp.zeros(3), wheels, slip, slip)
    uncompensated = closed_loop_rate(jnp.zeros(3), wheels, 0.0, slip)
    np.testing.assert_allclose(compensated, 0.0, atol=ROUNDING)
    assert float(uncompensated[0]) == pytest.approx(0.2 * float(speed))


@pytest.mark.parametrize("speed", [0.0, -0.0, 1e-300, -1e-9, 1e-3])
def test_a_standing_reference_gives_finite_inputs_and_gradients(speed):
    wheels = jnp.array([speed + 0.1, speed - 0.1])
    error = jnp.array([0.1, 0.2, 0.3])
    inputs = baselines.tracking_input(error, wheels, TRACK_WIDTH)
    slopes = jax.jacobian(baselines.tracking_input, argnums=(0, 1))(error, wheels, TRACK_WIDTH)
    # The gain is at most that at the slowest reference speed: 0.2 / 0.01 on 0.2 m, plus 1.2 on 0.3
    # rad.
    assert np.all(np.abs(inputs) < 4.5)
    assert all(np.all(np.isfinite(slope)) for slope in slopes)


@pytest.mark.parametrize("dtype", [jnp.float32, jnp.float64])
def test_dtype_and_leading_axes_are_kept(dtype):
    inputs = jax.jit(baselines.tracking_input)(
        jnp.ones((4, 1, 3), dtype), jnp.ones((5, 2), dtype), TRACK_WIDTH
    )
    assert inputs.shape == (4, 5, 2) and inputs.dtype == dtype
