"""W of robots whose wheels lag: it holds what the plant does from anywhere in the operating set,
whatever was commanded before, and what an independent period in the world frame does."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxtube.plant.lagging import LaggingRobot
from jaxtube.scenario import load
from jaxtube.simulation.components import bare_robot, make_wheel_map, robot_of
from jaxtube.simulation.rollout import realisation_keys
from jaxtube.synthesis.certificate.period import find_disturbances, noise_reach
from jaxtube.synthesis.certificate.true_error import check_true_error
from jaxtube.synthesis.disturbance import complete_problem, kinematics, operation
from sets.robot.disturbance import disturbance_parts

OUTSIDE = 1e-12
PERIODS = 12
BATCH = 60
LATE = {
    "lag": ("robot.wheel_lag_s=[0.05, 0.05]",),
    "delay": ("robot.command_delay_s=[0.13, 0.13]",),
    "both unknown": ("robot.wheel_lag_s=[0.04, 0.06]", "robot.command_delay_s=[0.0, 0.02]"),
    "sideways": (
        "robot.wheel_lag_s=[0.05, 0.05]",
        "robot.lever_arm_m=0.05",
        "slip.sideslip=0.04",
    ),
    "measured": (
        "robot.wheel_lag_s=[0.03, 0.03]",
        "slip.right=[0.1, 0.2]",
        "slip.left=[0.1, 0.2]",
        "slip.nominal_right=0.15",
        "slip.nominal_left=0.15",
        "slip.measurement_error=0.01",
    ),
}


QUICK = ("lag", "both unknown")
NAMES = [name if name in QUICK else pytest.param(name, marks=pytest.mark.slow) for name in LATE]


@functools.cache
def make_problem_of(name):
    return complete_problem(load("certified", LATE[name]))


def draw_inputs(problem, generator):
    """Return errors and inputs that meet the caps and their coupling, at extremes mostly."""

    def extreme(shape):
        signs = generator.choice([-1.0, 1.0], shape)
        return np.where(generator.random(shape) < 0.7, signs, generator.uniform(-1, 1, shape))

    room = problem.operating_set.offsets[:3] - problem.noise
    errors = room * extreme((BATCH, 3))
    vertices = problem.input_set.vertices()
    low = vertices.min(axis=0)
    high = vertices.max(axis=0)
    inputs = (low + high) / 2 + (high - low) / 2 * extreme((BATCH, 2))
    rows = problem.input_rows
    coupled = rows.is_coupled
    left = rows.offsets[coupled] - inputs @ rows.inputs[coupled].T
    most = np.min(left / np.abs(rows.errors[coupled, 0]), axis=1) - problem.noise[0]
    errors[:, 0] = np.clip(errors[:, 0], -np.maximum(most, 0), np.maximum(most, 0))
    inputs[most < 0, 1] = 0.0
    return jnp.asarray(errors), jnp.asarray(inputs)


def run_anywhere(problem, process):
    """Return the disturbances of periods whose errors and inputs are anywhere, wheels and commands
    going on from one period to the next."""
    plant = robot_of(problem, process)
    wheel_map = make_wheel_map(problem)
    keys = realisation_keys(3, 0, BATCH)
    generator = np.random.default_rng(7)
    memory = plant.initial(keys, jnp.zeros((BATCH, 3)))
    advance = jax.jit(plant.advance)
    sense = jax.jit(plant.sense)
    transitions, input_matrices = problem.model.matrices(problem.schedule[:PERIODS])
    met = []
    for step in range(PERIODS):
        errors, inputs = draw_inputs(problem, generator)
        measurement, memory = sense(keys, step, memory, errors)
        command = wheel_map.command(inputs, measurement, plant.reference_wheels[step])
        following, memory, wheels = advance(keys, step, memory, errors, command)
        np.testing.assert_allclose(wheels, command.wheels)
        after, _ = sense(keys, step + 1, memory, following)
        predicted = measurement.errors @ transitions[step].T + inputs @ input_matrices[step].T
        met.append(np.asarray(after.errors - predicted))
    return np.concatenate(met)


@pytest.mark.parametrize("process", ["vertex", pytest.param("iid", marks=pytest.mark.slow)])
@pytest.mark.parametrize("name", NAMES)
def test_w_holds_what_the_plant_does_from_anywhere(name, process):
    problem = make_problem_of(name)
    assert isinstance(robot_of(problem, process), LaggingRobot)
    W = problem.disturbance_set
    usage = np.max(run_anywhere(problem, process) @ W.normals.T / W.offsets, axis=0)
    assert np.all(usage <= 1 + OUTSIDE)
    assert usage.max() > 0.4


@pytest.mark.parametrize("name", NAMES)
def test_w_holds_an_independent_period_and_is_not_far_from_it(name):
    problem = make_problem_of(name)
    W = problem.disturbance_set
    reach = np.max(find_disturbances(problem) @ W.normals.T, axis=0)
    usage = (reach + noise_reach(problem, W.normals)) / W.offsets
    assert np.all(usage <= 1 + OUTSIDE)
    # The period of the witness compensates one slip only.
    assert usage.max() > {"both unknown": 0.5, "measured": 0.3}.get(name, 0.9)


def test_lag_is_a_cause_of_its_own_that_vanishes_with_it():
    problem = make_problem_of("lag")
    parts = disturbance_parts(operation(problem), kinematics(problem))
    assert np.all(parts["lag"][1:3] > 0)
    at_once = complete_problem(load("certified"))
    parts = disturbance_parts(operation(at_once), kinematics(at_once))
    np.testing.assert_array_equal(parts["lag"], 0.0)


def test_what_the_pose_strays_from_where_it_was_committed_to_be_counts_as_an_error():
    wide = make_problem_of("lag")
    assert not check_true_error(wide).holds
    narrow = complete_problem(load("certified", [*LATE["lag"], "operating.heading_deg=15.5"]))
    assert check_true_error(narrow).holds


def test_a_robot_without_lag_stays_the_slipping_robot():
    problem = complete_problem(load("certified"))
    assert type(robot_of(problem)) is type(bare_robot(problem))
