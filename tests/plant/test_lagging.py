"""Wheels that lag and commands that come late, against an integration of whole laps in the world
frame, and the committed pose against what it means."""

from itertools import pairwise

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp
from tolerances import ROUNDING

from jaxtube.plant.error_dynamics import world_pose
from jaxtube.plant.forecast import Forecast
from jaxtube.plant.lagging import LaggingRobot
from jaxtube.plant.lagging_body import LaggingBody
from jaxtube.plant.protocol import Command
from jaxtube.scenario import load
from jaxtube.simulation.components import robot_of
from jaxtube.simulation.rollout import realisation_keys
from jaxtube.synthesis.problem import make_problem
from sets.robot.actuation import Actuation

T = 0.1
B = 0.8
STEPS = 7
BATCH = 2
LAP = 1e-9
"""Of poses after several periods, m and rad."""
SETTINGS = (
    f"robot.effective_track_m={B}",
    "robot.lever_arm_m=0.07",
    "robot.wheel_speed_max_mps=4.0",
    "reference.wheel_speed_min_mps=0.1",
    "reference.wheel_speed_max_mps=1.7",
    "slip.right=[-0.05, 0.3]",
    "slip.left=[0.0, 0.4]",
    "slip.sideslip=0.08",
)
ACTUATIONS = (
    Actuation(lag=(0.05, 0.05)),
    Actuation(lag=(0.03, 0.06), delay=(0.08, 0.17)),
    pytest.param(Actuation(lag=(0.002, 0.2)), marks=pytest.mark.slow),
    pytest.param(Actuation(delay=(0.03, 0.07)), marks=pytest.mark.slow),
    pytest.param(Actuation(lag=(0.04, 0.04), delay=(0.2, 0.2)), marks=pytest.mark.slow),
    pytest.param(Actuation(lag=(0.02, 0.02), delay=(0.23, 0.26)), marks=pytest.mark.slow),
)


def make_body(actuation, extra=()):
    ideal = robot_of(make_problem(load("paper", [*SETTINGS, *extra])), "iid")
    forecast = Forecast.of(*actuation.nominal(T), B, T)
    return LaggingBody.of(ideal, forecast, actuation.lag, actuation.delay)


def make_plant(body):
    return LaggingRobot(body, body.ideal)


def draw_script(seed=3, batch=BATCH):
    draw = np.random.default_rng(seed).uniform
    return {
        "true": draw(-1, 1, (STEPS, batch, 2)),
        "sideslip": draw(-1, 1, (STEPS, batch, 1)),
        "lag": draw(-1, 1, (1, batch, 1)),
        "delay": draw(-1, 1, (STEPS, batch, 1)),
    }


@jax.jit
def run_period(plant, keys, step, memory, errors, wheels):
    """Return the state at an instant, and errors and memory at the next one."""
    _, memory = plant.sense(keys, step, memory, errors)
    state = (plant.body.pose_errors(step, memory, errors), memory, errors)
    following, after, _ = plant.advance(keys, step, memory, errors, Command(wheels, wheels))
    return state, following, after


def run(plant, errors, wheels):
    """Return the errors of poses and the memories at every instant."""
    keys = realisation_keys(5, 0, len(errors))
    memory = plant.initial(keys, errors)
    states = []
    for step in range(len(wheels)):
        state, errors, memory = run_period(plant, keys, step, memory, errors, wheels[step])
        states.append(state)
    states.append((plant.body.pose_errors(len(wheels), memory, errors), memory, errors))
    return states


def reference_pose_before(body, step, latency):
    """Return where the reference is a latency before an instant, by an integration."""
    wheels = np.asarray(body.reference_wheels)

    def rates(back, pose):
        right, left = wheels[max(int(np.ceil(step - back / T - 1e-9)) - 1, 0)]
        speed = (right + left) / 2
        return [-speed * np.cos(pose[2]), -speed * np.sin(pose[2]), -(right - left) / B]

    start = np.asarray(body.ideal.reference_poses[step])
    if latency == 0:
        return start
    return solve_ivp(rates, (0, latency), start, rtol=1e-12, atol=1e-13, max_step=T / 4).y[:, -1]


def integrate_lap(body, script, wheels, case, pose):
    """Integrate one robot in the world frame from a pose, each piece between arrivals of commands
    and ends of periods by itself; return its poses at the instants."""
    lag, delay = (
        np.mean(ends) + np.diff(ends) / 2 * script[name][:, case]
        for name, ends in (("lag", np.asarray(body.lag)), ("delay", np.asarray(body.delay)))
    )
    arrival = T * np.arange(STEPS) + delay[:, 0]
    lag = lag[0, 0]
    slip = np.array([0.125, 0.2]) + np.array([0.175, 0.2]) * script["true"][:, case]
    speeds = np.asarray(body.ideal.reference_wheels[0]) / 0.8
    first = speeds
    state = np.array([*pose, *speeds])
    poses = [pose]
    for step in range(STEPS):
        ends = [T * step, T * (step + 1)]
        within = arrival[(arrival > ends[0]) & (arrival < ends[1])]
        cuts = np.unique([*ends, *within])
        grip = 1 - slip[step]
        share = 0.08 * script["sideslip"][step, case, 0]
        for begin, end in pairwise(cuts):
            arrived = (arrival <= (begin + end) / 2).sum()
            command = wheels[arrived - 1, case] if arrived else first
            is_ideal = lag == 0
            if is_ideal:
                state[3:] = command

            def rates(_, state, grip=grip, share=share, command=command, is_ideal=is_ideal):
                right, left = state[3:] * grip
                turn = (right - left) / B
                speed = (right + left) / 2
                moving = (speed + 1j * (share * speed - 0.07 * turn)) * np.exp(1j * state[2])
                gain = np.zeros(2) if is_ideal else (command - state[3:]) / lag
                return [moving.real, moving.imag, turn, *gain]

            solved = solve_ivp(rates, (begin, end), state, method="DOP853", rtol=1e-12, atol=1e-13)
            state = solved.y[:, -1]
        poses.append(state[:3])
    return np.array(poses)


@pytest.mark.parametrize("actuation", ACTUATIONS, ids=str)
def test_laps_are_the_integral_of_the_world_frame(actuation):
    body = make_body(actuation)
    script = draw_script()
    draw = np.random.default_rng(4).uniform
    wheels = draw(0.3, 2.5, (STEPS, BATCH, 2))
    plant = make_plant(body).under_script({name: jnp.asarray(s) for name, s in script.items()})
    states = run(plant, jnp.asarray(draw(-0.2, 0.2, (BATCH, 3))), jnp.asarray(wheels))
    latency = float(body.forecast.latency)
    behind = [reference_pose_before(body, step, latency) for step in range(STEPS + 1)]
    for case in range(BATCH):
        met = [
            np.asarray(world_pose(errors[case], jnp.asarray(behind[step])))
            for step, (errors, _, _) in enumerate(states)
        ]
        expected = integrate_lap(body, script, wheels, case, met[0])
        np.testing.assert_allclose(met, expected, atol=LAP)


def test_without_lag_and_delay_it_is_the_slipping_robot():
    body = make_body(Actuation())
    script = {name: jnp.asarray(values) for name, values in draw_script().items()}
    draw = np.random.default_rng(4).uniform
    wheels = jnp.asarray(draw(0.3, 2.5, (STEPS, BATCH, 2)))
    errors = jnp.asarray(draw(-0.2, 0.2, (BATCH, 3)))
    lagging = run(make_plant(body).under_script(script), errors, wheels)
    ideal = body.ideal.under_script(script)
    keys = realisation_keys(5, 0, BATCH)
    memory = ideal.initial(keys, errors)
    for step in range(STEPS):
        _, memory = ideal.sense(keys, step, memory, errors)
        command = Command(wheels[step], wheels[step])
        errors, memory, _ = ideal.advance(keys, step, memory, errors, command)
        np.testing.assert_allclose(lagging[step + 1][2], errors, atol=1e-11)


NO_SLIP = (
    "slip.right=[0.0, 0.0]",
    "slip.left=[0.0, 0.0]",
    "slip.nominal_right=0.0",
    "slip.nominal_left=0.0",
    "slip.sideslip=0.0",
    "robot.lever_arm_m=0.0",
)


def run_ideal(body, errors, wheels):
    keys = realisation_keys(5, 0, len(errors))
    memory = body.ideal.initial(keys, errors)
    for step in range(STEPS):
        _, memory = body.ideal.sense(keys, step, memory, errors)
        command = Command(wheels[step], wheels[step])
        errors, memory, _ = body.ideal.advance(keys, step, memory, errors, command)
    return errors


@pytest.mark.parametrize("delay", [0.27, pytest.param(0.2, marks=pytest.mark.slow)])
def test_under_a_known_delay_the_committed_pose_is_that_of_a_robot_that_obeys_at_once(delay):
    body = make_body(Actuation(delay=(delay, delay)), NO_SLIP)
    draw = np.random.default_rng(4).uniform
    wheels = jnp.asarray(draw(0.3, 2.5, (STEPS, BATCH, 2)))
    errors = jnp.asarray(draw(-0.2, 0.2, (BATCH, 3)))
    committed = run(make_plant(body), errors, wheels)[-1][2]
    np.testing.assert_allclose(committed, run_ideal(body, errors, wheels), atol=1e-11)


def test_under_a_known_lag_it_has_the_heading_and_nearly_the_place_of_one_that_obeys_at_once():
    body = make_body(Actuation(lag=(0.05, 0.05), delay=(0.13, 0.13)), NO_SLIP)
    draw = np.random.default_rng(4).uniform
    wheels = jnp.asarray(draw(0.9, 1.1, (STEPS, BATCH, 2)))
    errors = jnp.asarray(draw(-0.2, 0.2, (BATCH, 3)))
    committed = run(make_plant(body), errors, wheels)[-1][2]
    ideal = run_ideal(body, errors, wheels)
    np.testing.assert_allclose(committed[:, 2], ideal[:, 2], atol=1e-11)
    # A period may add (1.1^2 - 0.9^2) / B tau^2 / 2 sideways.
    assert 1e-6 < np.abs(committed - ideal)[:, :2].max() < STEPS * 0.5 * 0.05**2 / 2


@pytest.mark.parametrize("actuation", ACTUATIONS, ids=str)
def test_draws_are_within_the_script(actuation):
    plant = make_plant(make_body(actuation))
    keys = realisation_keys(5, 0, 40)
    errors = jnp.zeros((40, 3))
    memory = plant.initial(keys, errors)
    low, high = actuation.lag
    assert np.all((memory.lag >= low - ROUNDING) & (memory.lag <= high + ROUNDING))
    names = set(plant.uncertainties())
    assert ("lag" in names) == (low < high)
    assert ("delay" in names) == (actuation.delay[0] < actuation.delay[1])


FEW = 3
"""Periods over which derivatives are taken: a command of the first one has arrived by then."""


@pytest.fixture(scope="module")
def sensitive():
    """A robot whose lag may be nothing, its script, and a number made of its errors after a few
    periods, with its gradient, as functions of lag and delay of the script."""
    body = make_body(Actuation((0.0, 0.06), (0.02, 0.08)))
    script = {name: jnp.asarray(values) for name, values in draw_script().items()}
    draw = np.random.default_rng(4).uniform
    wheels = jnp.asarray(draw(0.3, 2.5, (FEW, BATCH, 2)))
    errors = jnp.asarray(draw(-0.2, 0.2, (BATCH, 3)))

    def last(given):
        plant = make_plant(body).under_script(script | given)
        return jnp.sum(run(plant, errors, wheels)[-1][2] * jnp.array([1.0, 2.0, 3.0]))

    return script, jax.jit(last), jax.jit(jax.grad(last))


@pytest.mark.parametrize("name", ["lag", "delay"])
def test_gradients_by_lag_and_delay_are_those_of_differences(sensitive, name):
    script, last, differentiate = sensitive
    given = {each: script[each] for each in ("lag", "delay")}
    gradient = differentiate(given)[name]
    assert np.all(np.isfinite(gradient)) and np.any(gradient != 0)
    along = jnp.asarray(np.random.default_rng(5).uniform(-1, 1, given[name].shape))
    step = 1e-5
    there = last(given | {name: given[name] + step * along})
    back = last(given | {name: given[name] - step * along})
    slope = jnp.sum(gradient * along)
    np.testing.assert_allclose(slope, (there - back) / (2 * step), rtol=1e-6, atol=1e-9)


def test_at_the_end_of_its_interval_a_lag_of_nothing_has_a_gradient(sensitive):
    script, _, differentiate = sensitive
    ideal = {"lag": -jnp.ones_like(script["lag"]), "delay": script["delay"]}
    assert np.all(np.isfinite(differentiate(ideal)["lag"]))
