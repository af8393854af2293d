"""How far commands change: bounds against the slopes of the maps that the controller uses, and
against pairs of periods."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxtube.plant.input_maps import acting_input
from jaxtube.scenario import load
from jaxtube.synthesis.disturbance import kinematics, operation
from jaxtube.synthesis.problem import make_problem
from sets.robot.command_steps import bound_map_slopes, bound_mapped_steps, enclose_model

MAPS = ("paper", "cosine_free", "x_exact")
ROUNDING = 1e-9
NEAR = 0.75
"""Share of a bound that the largest slope found reaches at least."""
SAMPLES = 20_000


@functools.cache
def make_case(input_map):
    problem = make_problem(load("certified", [f"controller.input_map={input_map}"]))
    where = operation(problem)
    return problem, where, bound_map_slopes(where, kinematics(problem))


def add(problem):
    """Return N of one point (errors, inputs, reference wheels), by the map that runs."""

    def added(point):
        asked = acting_input(
            problem.scenario.controller.input_map,
            point[3:5],
            point[:3],
            point[5:],
            problem.model.track_width,
            problem.model.dt,
        )
        return asked[0] - point[3]

    return added


def draw_points(where, generator, count=SAMPLES):
    lower, upper = where.box[:, :7]
    shares = generator.uniform(-0.1, 1.1, (count, 7)).clip(0, 1)
    return lower + shares * (upper - lower)


@pytest.mark.parametrize("input_map", MAPS)
def test_slopes_of_the_map_lie_within_their_bounds_and_come_near(input_map):
    problem, where, slopes = make_case(input_map)
    points = draw_points(where, np.random.default_rng(1))
    with jax.enable_x64(True):
        found = jax.vmap(jax.grad(add(problem)))(jnp.asarray(points))
        largest = np.abs(np.asarray(found)).max(axis=0)
    bounds = np.concatenate(slopes)
    assert np.all(largest <= bounds + ROUNDING)
    felt = bounds > 0.01
    assert np.all(largest[felt] >= NEAR * bounds[felt])
    if input_map == "paper":
        assert np.all(bounds <= ROUNDING)


@pytest.mark.parametrize("input_map", MAPS)
def test_commands_of_two_periods_differ_by_no_more_than_the_bound(input_map):
    problem, where, slopes = make_case(input_map)
    generator = np.random.default_rng(2)
    now = draw_points(where, generator)
    after = now + (draw_points(where, generator) - now) * generator.uniform(0, 1, (SAMPLES, 1))
    with jax.enable_x64(True):
        map_of = jax.vmap(add(problem))
        mapped = np.asarray(map_of(jnp.asarray(after)) - map_of(jnp.asarray(now)))
    steps = after - now
    half = problem.model.track_width / 2
    lever = half + slopes.inputs[1]
    of_inputs = np.abs(steps[:, 3:4] + np.array([lever, -lever]) * steps[:, 4:5]).max(axis=1)
    of_rest = [
        bound_mapped_steps(slopes, where, np.abs(step[:3]), np.abs(step[5:])) for step in steps
    ]
    for wheel, side in ((0, half), (1, -half)):
        change = steps[:, 5 + wheel] - steps[:, 3] - side * steps[:, 4] - mapped
        bound = np.abs(steps[:, 5 + wheel]) + of_inputs + of_rest
        assert np.all(np.abs(change) <= bound + ROUNDING)


@pytest.mark.parametrize("model", ["paper", "consistent", "exact_jacobian"])
@pytest.mark.parametrize("regions", ["box", "path"])
def test_the_model_lies_within_its_range_at_every_certified_wheel_speed(model, regions):
    settings = (f"controller.model={model}", f"reference.certified_for={regions}")
    problem = make_problem(load("certified", settings))
    found = enclose_model(operation(problem), kinematics(problem))
    generator = np.random.default_rng(3)
    wheels = [
        low + generator.uniform(-0.2, 1.2, (200, 2)).clip(0, 1) * (high - low)
        for low, high in problem.regions
    ]
    matrices = np.concatenate(problem.model.matrices(np.concatenate(wheels)), axis=2)
    strays = np.abs(matrices - found.middle).max(axis=0)
    assert np.all(strays <= found.radius + 1e-15)
    felt = (found.radius > 0.01) & (regions == "box")
    assert np.all(strays[felt] >= 0.9 * found.radius[felt])
