"""Input maps: what they promise of one period, checked on the exact plant."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from tolerances import RESIDUAL_ROUNDING, ROUNDING

from jaxtube.plant.error_dynamics import advance
from jaxtube.plant.input_maps import INPUT_MAPS, acting_input
from jaxtube.plant.robot import wheel_commands

TRACK_WIDTH = 0.5
DT = 0.1


@pytest.fixture(scope="module")
def draws():
    generator = np.random.default_rng(3)
    errors = generator.uniform(-0.4, 0.4, (10_000, 3))
    inputs = generator.uniform(-1.0, 1.0, (10_000, 2))
    wheels = generator.uniform(0.2, 1.5, (10_000, 2))
    return jnp.array(inputs), jnp.array(errors), jnp.array(wheels)


def after_a_period(input_map, inputs, errors, wheels):
    acting = acting_input(input_map, inputs, errors, wheels, TRACK_WIDTH, DT)
    commands = wheel_commands(acting, wheels, 0.2, TRACK_WIDTH)
    return np.asarray(advance(errors, commands, jnp.full(2, 0.2), wheels, TRACK_WIDTH, DT))


def test_x_exact_leaves_one_nonlinear_row(draws):
    u1, u2 = np.asarray(draws[0]).T
    e_x, e_y, e_th = np.asarray(draws[1]).T
    V = np.asarray(draws[2]).mean(axis=1)
    Om = np.asarray(draws[2]) @ [1.0, -1.0] / TRACK_WIDTH
    following = after_a_period("x_exact", *draws)
    np.testing.assert_allclose(following[:, 0], e_x + DT * Om * e_y + DT * u1, atol=ROUNDING)
    np.testing.assert_allclose(following[:, 2], e_th + DT * u2, atol=ROUNDING)
    a = DT * (Om - u2)
    s = np.sinc(DT * Om / 2 / np.pi)
    lateral = e_y - np.tan(a / 2) * (e_x + following[:, 0])
    lateral += DT * V * s * np.sin(e_th + DT * u2 / 2) / np.cos(a / 2)
    np.testing.assert_allclose(following[:, 1], lateral, atol=ROUNDING)


def test_cosine_free_counts_from_the_speed_along_the_robot(draws):
    inputs, errors, wheels = draws
    acting = acting_input("cosine_free", *draws, TRACK_WIDTH, DT)
    V = wheels.mean(axis=1)
    np.testing.assert_allclose(
        V * jnp.cos(errors[:, 2]) - (V - acting[:, 0]), inputs[:, 0], atol=ROUNDING
    )
    np.testing.assert_array_equal(acting[:, 1], inputs[:, 1])


def test_the_papers_map_is_the_identity(draws):
    np.testing.assert_array_equal(acting_input("paper", *draws, TRACK_WIDTH, DT), draws[0])


@pytest.mark.parametrize("input_map", INPUT_MAPS)
def test_maps_agree_at_rest_broadcast_and_stay_finite(input_map):
    still = acting_input(input_map, jnp.zeros(2), jnp.zeros((4, 3)), jnp.ones(2), TRACK_WIDTH, DT)
    assert still.shape == (4, 2)
    np.testing.assert_allclose(still, 0.0, atol=ROUNDING)
    turned = jnp.array([0.0, 1.0]) * jnp.linspace(-100.0, 100.0, 201)[:, None]
    found = acting_input(input_map, turned, jnp.full((201, 3), 0.3), jnp.ones(2), TRACK_WIDTH, DT)
    assert bool(jnp.all(jnp.isfinite(found)))


@pytest.mark.parametrize("dtype", [jnp.float32, jnp.float64])
@pytest.mark.parametrize("input_map", INPUT_MAPS)
def test_maps_keep_the_dtype_inside_jit(input_map, dtype):
    mapped = jax.jit(acting_input, static_argnums=0)
    found = mapped(
        input_map,
        jnp.ones((3, 2), dtype),
        jnp.ones((3, 3), dtype),
        jnp.ones((3, 2), dtype),
        0.5,
        0.1,
    )
    assert found.dtype == dtype


def test_x_exact_keeps_its_promise_in_the_world_frame(draws):
    """The promised rows against poses integrated in the world frame, 100 Runge-Kutta steps a
    period."""
    inputs, errors, wheels = map(np.asarray, draws)
    acting = acting_input("x_exact", *draws, TRACK_WIDTH, DT)
    ground = np.asarray(wheel_commands(acting, draws[2], 0.2, TRACK_WIDTH)) * 0.8

    def driven(pose, speeds):
        v = speeds.mean(axis=1)
        om = speeds @ [1.0, -1.0] / TRACK_WIDTH
        h = DT / 100
        for _ in range(100):
            x, y, phi = pose.T
            # The heading turns evenly, so Runge and Kutta's four slopes are two and a midpoint:
            # Simpson's rule.
            way = (
                sum(k * np.exp(1j * (phi + om * h * s)) for k, s in ((1, 0.0), (4, 0.5), (1, 1.0)))
                * v
                * h
                / 6
            )
            pose = np.stack([x + way.real, y + way.imag, phi + om * h], axis=1)
        return pose

    e_x, e_y, e_th = errors.T
    robot = np.stack(
        [
            -(np.cos(-e_th) * e_x - np.sin(-e_th) * e_y),
            -(np.sin(-e_th) * e_x + np.cos(-e_th) * e_y),
            -e_th,
        ]
    )
    robot = driven(robot.T, ground)
    reference = driven(np.zeros_like(errors), wheels)
    gap = reference - robot
    phi = robot[:, 2]
    along = np.cos(phi) * gap[:, 0] + np.sin(phi) * gap[:, 1]
    Om = wheels @ [1.0, -1.0] / TRACK_WIDTH
    np.testing.assert_allclose(
        along, e_x + DT * Om * e_y + DT * inputs[:, 0], rtol=0, atol=RESIDUAL_ROUNDING
    )
    np.testing.assert_allclose(gap[:, 2], e_th + DT * inputs[:, 1], rtol=0, atol=RESIDUAL_ROUNDING)
    a = DT * (Om - inputs[:, 1])
    s = np.sinc(DT * Om / 2 / np.pi)
    across = gap[:, 1] * np.cos(phi)
    lateral = e_y - np.tan(a / 2) * (e_x + along)
    lateral += DT * wheels.mean(axis=1) * s * np.sin(e_th + DT * inputs[:, 1] / 2) / np.cos(a / 2)
    np.testing.assert_allclose(
        across - np.sin(phi) * gap[:, 0], lateral, rtol=0, atol=RESIDUAL_ROUNDING
    )
