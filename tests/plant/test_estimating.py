"""Laws of the estimate that a controller may act on, against poses in the world frame."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxtube.plant.error_dynamics import tracking_error, world_pose
from jaxtube.plant.estimating import EstimatingRobot
from jaxtube.plant.observed import robot_behind
from jaxtube.plant.protocol import Command
from jaxtube.plant.robot import Robot
from jaxtube.plant.slip_bounds import near_nominal
from jaxtube.plant.slipping import SlippingRobot
from jaxtube.simulation.rollout import realisation_keys

STEPS = 40
LAPS = 5
DT = 0.1
TRACK = 0.5
GAIN = np.array([0.6, 0.3, 0.8])
NOISE = np.array([0.01, 0.02, 0.01])


def make_robot(
    noise: np.ndarray | None = NOISE, relative_error=0.1, noise_frame="robot", lever_arm=0.0
) -> SlippingRobot:
    turns = np.linspace(0, 3, STEPS)
    wheels = np.stack([1.2 + 0.2 * np.sin(turns), 1.2 - 0.2 * np.sin(turns)], axis=1)
    poses = [np.zeros(3)]
    for right, left in wheels:
        x, y, heading = poses[-1]
        speed = (right + left) / 2
        turn = (right - left) / TRACK
        step = DT * speed * np.sinc(DT * turn / 2 / np.pi) * np.exp(1j * (heading + DT * turn / 2))
        poses.append(np.array([x + step.real, y + step.imag, heading + DT * turn]))
    return SlippingRobot(
        robot=Robot(TRACK, -3.0, 2.0, lever_arm),
        dt=DT,
        reference_wheels=jnp.asarray(wheels),
        reference_poses=jnp.asarray(np.array(poses)),
        slips=near_nominal(np.array([0.2, 0.15]), relative_error, "both"),
        noise=None if noise is None else jnp.asarray(noise),
        sideslip=0.05 if relative_error else None,
        noise_frame=noise_frame,
    )


def estimating(plant, gain=GAIN) -> EstimatingRobot:
    return EstimatingRobot(plant, jnp.asarray(gain), TRACK, DT)


def drive(plant, seed=3):
    """Run periods under wheel commands that saturate now and then; return true errors, what is
    sensed and the wheels, time first."""
    keys = realisation_keys(seed, 0, LAPS)
    rng = np.random.default_rng(seed)
    errors = jnp.asarray(rng.uniform(-0.1, 0.1, (LAPS, 3)))
    commands = jnp.asarray(rng.uniform(0.8, 2.3, (STEPS, LAPS, 2)))
    measured, memory = plant.sense(keys, 0, plant.initial(keys, errors), errors)
    seen = [(errors, measured, None)]
    step_once = jax.jit(
        lambda step, memory, errors, wheels: plant.advance(
            keys, step, memory, errors, Command(wheels, wheels)
        )
    )
    sense = jax.jit(lambda step, memory, errors: plant.sense(keys, step, memory, errors))
    for step in range(STEPS):
        moved = step_once(step, memory, errors, commands[step])
        errors = moved.errors
        measured, memory = sense(step + 1, moved.memory, errors)
        seen.append((errors, measured, moved.wheels))
    true = np.array([entry[0] for entry in seen])
    estimates = np.array([entry[1].errors for entry in seen])
    slips = np.array([entry[1].slip for entry in seen])
    wheels = np.array([entry[2] for entry in seen[1:]])
    return true, estimates, slips, wheels


@pytest.mark.parametrize("frame", ["robot", "world"])
def test_an_estimate_is_the_motion_commanded_corrected_by_its_share(frame):
    """The same observer written with poses in the world frame; truth and measurements do not
    depend on it."""
    plant = make_robot(noise_frame=frame, lever_arm=0.03)
    true, estimates, slips, wheels = drive(estimating(plant))
    true_too, measured, slips_too, _ = drive(plant)
    np.testing.assert_array_equal(true, true_too)
    np.testing.assert_array_equal(slips, slips_too)
    np.testing.assert_array_equal(estimates[0], measured[0])
    poses = np.asarray(plant.reference_poses)
    for step in range(STEPS):
        pose = np.asarray(world_pose(jnp.asarray(estimates[step]), jnp.asarray(poses[step])))
        ground = wheels[step] * (1 - slips[step])
        half = DT * (ground[:, 0] - ground[:, 1]) / TRACK / 2
        way = DT * ground.mean(axis=1) * np.sinc(half / np.pi) * np.exp(1j * (pose[:, 2] + half))
        moved = pose + np.stack([way.real, way.imag, 2 * half], axis=1)
        predicted = np.asarray(tracking_error(jnp.asarray(moved), jnp.asarray(poses[step + 1])))
        expected = predicted + GAIN * (measured[step + 1] - predicted)
        np.testing.assert_allclose(estimates[step + 1], expected, rtol=0, atol=1e-12)


def test_a_gain_of_one_is_the_measurement():
    plant = make_robot()
    _, estimates, _, _ = drive(estimating(plant, np.ones(3)))
    np.testing.assert_allclose(estimates, drive(plant)[1], rtol=0, atol=1e-15)


def test_without_slip_error_and_noise_the_estimate_is_the_truth():
    true, estimates, _, _ = drive(estimating(make_robot(None, 0.0)))
    np.testing.assert_allclose(estimates, true, rtol=0, atol=1e-13)


def test_a_script_takes_the_place_of_draws_and_the_estimate_stays():
    robot = estimating(make_robot())
    assert robot.uncertainties().keys() == make_robot().uncertainties().keys()
    assert isinstance(robot_behind(robot), SlippingRobot)
    none = {"noise": jnp.zeros((1, LAPS, 3)), "true": jnp.zeros((1, LAPS, 2))}
    scripted = robot.under_script(none)
    assert isinstance(scripted, EstimatingRobot)
    true, estimates, _, _ = drive(scripted)
    still = make_robot(None, 0.0)
    np.testing.assert_allclose(true, drive(still)[0], rtol=0, atol=1e-12)
    np.testing.assert_allclose(estimates, true, rtol=0, atol=1e-12)
    pushed = robot.under_script(none | {"noise": jnp.ones((1, LAPS, 3))})
    true, estimates, _, _ = drive(pushed)
    # A constant noise is no noise that an observer can know: the estimate goes there in the end.
    np.testing.assert_allclose(estimates[-1] - true[-1], np.tile(NOISE, (LAPS, 1)), atol=2e-2)
    np.testing.assert_allclose((estimates - true)[:, :, 2], NOISE[2], atol=1e-12)
