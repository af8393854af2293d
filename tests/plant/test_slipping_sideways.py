"""A body that slips sideways, and poses measured with noise in the world, against integrations and
complex numbers in the world frame."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp
from tolerances import EXACT_ARCS, ROUNDING

from jaxtube.plant.error_dynamics import tracking_error, world_pose
from jaxtube.plant.protocol import Command
from jaxtube.plant.slip_processes import PROCESSES
from jaxtube.scenario import load
from jaxtube.simulation.components import robot_of
from jaxtube.simulation.rollout import realisation_keys
from jaxtube.synthesis.problem import make_problem

BATCH = 6
SETTINGS = (
    "robot.effective_track_m=0.8",
    "robot.lever_arm_m=0.07",
    "reference.wheel_speed_min_mps=0.1",
    "reference.wheel_speed_max_mps=1.6",
    "slip.right=[-0.05, 0.3]",
    "slip.left=[0.0, 0.4]",
    "slip.measurement_error=0.02",
    "robot.wheel_speed_max_mps=4.0",
    "slip.nominal_right=0.1",
    "slip.sideslip=0.08",
)


def make_robot(process="iid", extra=()):
    return robot_of(make_problem(load("paper", [*SETTINGS, *extra])), process)


@jax.jit
def begin(robot, keys, errors):
    """Return what the robot remembers once it was sensed first."""
    return robot.sense(keys, 0, robot.initial(keys, errors), errors)[1]


@jax.jit
def advance(robot, keys, memory, errors, wheels):
    """Return the errors after the first period."""
    return robot.advance(keys, 0, memory, errors, Command(wheels, wheels)).errors


@pytest.mark.parametrize("process", PROCESSES)
def test_a_period_is_the_integral_of_the_world_frame(process):
    robot = make_robot(process)
    keys = realisation_keys(5, 0, BATCH)
    errors = jnp.asarray(np.random.default_rng(1).uniform(-0.2, 0.2, (BATCH, 3)))
    memory = begin(robot, keys, errors)
    wheels = jnp.asarray(np.random.default_rng(2).uniform(0.5, 2.5, (BATCH, 2)))
    following = advance(robot, keys, memory, errors, wheels)
    middle = np.array([0.125, 0.2])
    half = np.array([0.175, 0.2])
    assert np.abs(memory.sideslip).max() <= 1.0
    for case in range(BATCH):
        slip = middle + half * np.asarray(memory.true[case])
        right, left = np.asarray(wheels[case]) * (1 - slip)
        turn = (right - left) / 0.8
        speed = (right + left) / 2
        sideways = 0.08 * float(memory.sideslip[case]) * speed - 0.07 * turn

        def rates(_, pose, turn=turn, velocity=speed + 1j * sideways):
            moving = velocity * np.exp(1j * pose[2])
            return [moving.real, moving.imag, turn]

        start = np.asarray(world_pose(errors[case], robot.reference_poses[0]))
        end = solve_ivp(rates, (0, 0.1), start, method="DOP853", rtol=1e-13, atol=1e-14).y[:, -1]
        expected = tracking_error(jnp.asarray(end), robot.reference_poses[1])
        np.testing.assert_allclose(following[case], expected, atol=EXACT_ARCS)


def test_sideslip_of_an_adversary_pushes_the_lateral_error_as_its_wheels_turn_it():
    robot = make_robot("adversarial", ["slip.measurement_error=0.0"])
    keys = realisation_keys(5, 0, 60)
    errors = jnp.zeros((60, 3))
    memory = begin(robot, keys, errors)
    right, left = np.asarray(memory.true - memory.measured).clip(-1, 1).T
    np.testing.assert_allclose(memory.sideslip, (left - right) / 2, atol=ROUNDING)


@pytest.mark.parametrize("frame", ["robot", "world"])
def test_what_is_measured_is_the_error_of_a_pose_with_noise(frame):
    noise = ("noise.longitudinal_m=0.02", "noise.lateral_m=0.01", "noise.heading_deg=2.0")
    robot = make_robot(extra=[*noise, f"noise.frame={frame}"])
    errors = jnp.asarray(np.random.default_rng(1).uniform(-0.2, 0.2, (BATCH, 3)))
    drawn = jnp.asarray(np.random.default_rng(2).uniform(-0.02, 0.02, (BATCH, 3)))
    measured = np.asarray(jax.jit(robot.add_noise)(3, errors, drawn))
    if frame == "robot":
        np.testing.assert_allclose(measured, errors + drawn, atol=ROUNDING)
        return
    reference = np.asarray(robot.reference_poses[3])
    heading = reference[2] - np.asarray(errors[:, 2])
    seen = (np.asarray(errors) @ [1.0, 1j, 0.0]) * np.exp(1j * heading)
    place = reference[0] + 1j * reference[1] - seen
    shift = np.asarray(drawn) @ [1.0, 1j, 0.0]
    turned = heading + np.asarray(drawn[:, 2])
    position = (reference[0] + 1j * reference[1] - place - shift) * np.exp(-1j * turned)
    expected = np.stack([position.real, position.imag, reference[2] - turned], axis=1)
    np.testing.assert_allclose(measured, expected, atol=ROUNDING)


def test_noise_in_the_world_stays_within_its_bound_in_the_robots_frame():
    noise = ("noise.longitudinal_m=0.02", "noise.lateral_m=0.01", "noise.heading_deg=2.0")
    problem = make_problem(load("paper", [*SETTINGS, *noise, "noise.frame=world"]))
    robot = robot_of(problem)
    random = np.random.default_rng(0)
    errors = random.choice([-1, 1], (100_000, 3)) * [0.3, 0.3, np.deg2rad(20)]
    errors = errors * random.choice([0.5, 1.0], (100_000, 3))
    half_widths = np.array([0.02, 0.01, np.deg2rad(2.0)])
    drawn = random.choice([-1, 1], (100_000, 3)) * half_widths
    step = random.integers(0, 300, 100_000)
    add = jax.jit(jax.vmap(lambda k, e, n: robot.add_noise(k, e[None], n[None])[0]))
    off = np.abs(add(jnp.asarray(step), jnp.asarray(errors), jnp.asarray(drawn)) - errors)
    assert np.all(off <= problem.noise + ROUNDING)
    assert np.all(off.max(axis=0) >= 0.98 * problem.noise)
