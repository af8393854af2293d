"""Laws of designs whose slips are learnt: their disturbance sets follow what is known of the slips,
and hold what the robot does."""

import dataclasses
import itertools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxtube as jt
from jaxtube.plant.learning import LearningRobot, find_missed
from jaxtube.plant.slip_observer import SlipObserver
from jaxtube.scenario import ScenarioError
from jaxtube.simulation import components
from jaxtube.simulation.learnt import find_slip_intervals
from jaxtube.simulation.rollout import begin, realisation_keys, rollout, run_period
from jaxtube.simulation.usage import play
from jaxtube.synthesis.certificate.learning import check_learnt_slips
from jaxtube.synthesis.certificate.period import find_disturbances, noise_reach
from jaxtube.synthesis.certificate.robot import check_disturbance_set
from jaxtube.synthesis.disturbance import (
    find_learnt_slips,
    find_wheel_error_sizes,
    operation,
)
from jaxtube.synthesis.learnt_slips import count_learnt_periods, make_slip_observer
from jaxtube.tuning.tuner import make_tuner

update = jax.jit(SlipObserver.update)
CALM = (
    "reference.duration_s=3",
    "reference.certified_for=path",
    "controller.horizon=3",
    "slip.right=[0.1,0.3]",
    "slip.left=[0.0,0.2]",
    "initial.x_m=0.02",
    "initial.y_m=0.02",
)
"""The robot along one path, with narrower intervals, which differ from wheel to wheel: quick to
design."""


@pytest.fixture(scope="module")
def design(uncertified):
    return uncertified("certified_learning", *CALM)


def test_every_period_has_the_w_of_what_is_known_by_then(design):
    problem = design.problem
    assert [regime.periods_learnt for regime in problem.every_regime] == [0, 1, 2, None]
    assert problem.period_regimes[:5].tolist() == [0, 1, 2, 3, 3]
    sizes = [find_wheel_error_sizes(regime) for regime in problem.every_regime]
    np.testing.assert_array_equal(sizes, find_learnt_slips(problem).wheel_errors)
    for regime, size in zip(problem.every_regime, sizes, strict=True):
        np.testing.assert_array_equal(operation(regime).wheel_errors, [-size, size])


def test_a_smaller_interval_leaves_a_smaller_w(design):
    directions = np.random.default_rng(0).normal(size=(200, 3))
    supports = [one.support(directions) for one in design.problem.disturbances.sets]
    for wider, narrower in itertools.pairwise(supports):
        assert np.all(narrower <= wider * (1 + 1e-2))


def test_each_w_is_proved_and_the_disturbances_of_a_narrower_one_are_refuted(design):
    first, *_, last = design.problem.every_regime
    assert check_disturbance_set(last).holds
    met = find_disturbances(first)
    W = last.disturbance_set
    assert np.max(met @ W.normals.T + noise_reach(first, W.normals) - W.offsets) > 0


def test_what_is_said_of_learnt_slips_is_witnessed_and_refuted(design, monkeypatch):
    found = check_learnt_slips(design.problem)
    assert found.holds
    assert "drives tried reach" in found.sentence
    proved = find_learnt_slips(design.problem)
    narrow = proved._replace(radius=proved.radius / 4)
    name = "jaxtube.synthesis.certificate.learning.find_learnt_slips"
    monkeypatch.setattr(name, lambda problem: narrow)
    assert not check_learnt_slips(design.problem).holds


@pytest.mark.slow
def test_laps_keep_the_w_of_each_period_and_every_slip_its_interval(design):
    """Of the local gain: that of the tube needs no QP."""
    problem = design.problem
    plant = components.slipping_robot(design, "adversarial")
    assert isinstance(plant, LearningRobot)
    controller = components.controller_makers(design)["local_gain"]()
    keys = realisation_keys(0, 0, 256)
    start = jnp.tile(jnp.asarray(problem.initial_error), (256, 1))

    @jax.jit
    def run(keys, start):
        def period(state, step):
            memory = state.plant_memory
            missed = find_missed(plant.plant.true_slip(memory.plant), memory.knowledge)
            told = (missed, memory.is_missed, memory.knowledge.radius, state.measured)
            following, happened = run_period(controller, plant, keys, step, state)
            return following, (*told, happened.inputs, following.measured)

        steps = jnp.arange(problem.reference.steps, dtype=jnp.int32)
        return jax.lax.scan(period, begin(controller, plant, keys, start), steps)[1]

    told = jax.tree.map(np.asarray, run(keys, start))
    missed, is_missed, radius, measured, inputs, following = told
    assert not missed.any() and not is_missed.any()
    proved = find_learnt_slips(problem).radius
    ages = np.minimum(np.arange(len(radius)), len(proved) - 1)
    assert np.all(radius <= proved[ages][:, None] + 1e-12)
    transitions, input_matrices = problem.model.matrices(problem.schedule[: len(radius)])
    predicted = np.einsum("kij,knj->kni", transitions, measured)
    predicted += np.einsum("kij,knj->kni", input_matrices, inputs)
    regimes = problem.period_regimes[: len(radius)]
    margins = problem.disturbances.margin(regimes, following - predicted)
    assert np.all(margins >= -1e-12)


def test_a_stepper_learns_from_call_to_call(design):
    """Against the observer, told what the stepper was and asked for."""
    problem = design.problem
    observer = make_slip_observer(problem)
    noise = problem.noise * np.random.default_rng(0).uniform(-1, 1, (8, 3))
    stepper = jt.Stepper(design, "local_gain")
    nothing = stepper.learnt_slip
    assert nothing is not None
    np.testing.assert_allclose(nothing.lower, [0.1, 0.0])
    np.testing.assert_allclose(nothing.upper, [0.3, 0.2])
    known = observer.initial(jnp.zeros((1, 3)))
    wheels = np.zeros((1, 2))
    reference = np.zeros(2)
    for k, measured in enumerate(noise):
        step = stepper(measured)
        known = update(observer, known, *map(jnp.asarray, (measured[None], wheels, reference)))
        learnt = stepper.learnt_slip
        assert learnt is not None and learnt.contradicted == bool(known.contradicted[0])
        np.testing.assert_allclose(learnt.lower, known.lower[0], atol=1e-12)
        np.testing.assert_allclose(learnt.upper, known.upper[0], atol=1e-12)
        # The wheels of a robot that is to go with the reference make up for the slip learnt.
        grip = step.wheels * (1 - np.asarray(known.centre[0]))
        np.testing.assert_allclose(grip, problem.schedule[k], atol=0.1)
        wheels = step.wheels[None]
        reference = problem.schedule[k]
    assert np.all(learnt.upper - learnt.lower < 0.05)
    with pytest.raises(ValueError, match="is learnt here"):
        stepper(np.zeros(3), np.zeros(2))


@pytest.mark.slow
def test_a_stepper_learns_what_a_batch_of_one_does(design):
    laps = jt.simulate(design, "local_gain", laps=1)
    known = find_slip_intervals(laps)
    stepper = jt.Stepper(design, "local_gain")
    for k in range(12):
        step = stepper(np.asarray(laps.trajectory.measured)[k, 0])
        np.testing.assert_allclose(step.wheels, laps.trajectory.demanded[k, 0], atol=1e-12)
        learnt = stepper.learnt_slip
        assert learnt is not None and not learnt.contradicted
        np.testing.assert_allclose(learnt.lower, known.lower[k, 0], atol=1e-12)
        np.testing.assert_allclose(learnt.upper, known.upper[k, 0], atol=1e-12)


def find_true_slips(plant, steps):
    """Return the slips of a robot under a script, (steps, 2)."""
    errors = jnp.zeros((1, 3))
    keys = realisation_keys(0, 0, 1)
    memory = plant.initial(keys, errors)
    slips = []
    for step in range(steps):
        _, memory = plant.sense(keys, step, memory, errors)
        slips.append(np.asarray(plant.true_slip(memory))[0])
    return np.array(slips)


def test_scripts_of_slips_are_followed_no_faster_than_slips_change(design):
    """What a search tries, it tries within what is promised; every corner of it is in reach."""
    plant = components.slipping_robot(design, "iid")
    assert isinstance(plant, LearningRobot)
    shapes = {name: entry.by_time.shape for name, entry in plant.uncertainties().items()}
    steps = design.problem.reference.steps
    assert shapes["true"] == (1, 4, 2)
    assert shapes["change"] == (steps, 4, 2)
    start = jnp.array([[[-1.0, 0.0]]])
    up = jnp.ones((steps, 1, 2))
    slips = find_true_slips(plant.under_script({"true": start, "change": up}).plant, steps)
    change = design.problem.scenario.slip.change_per_s * design.problem.model.dt
    lower = np.array([0.1, 0.1])
    upper = np.array([0.3, 0.2])
    expected = np.minimum(lower + change * np.arange(steps)[:, None], upper)
    np.testing.assert_allclose(slips, expected, atol=1e-12)
    with pytest.raises(ValueError, match="script: `true` has 30 entries"):
        plant.under_script({"true": up})


def test_laps_that_a_search_judges_are_those_of_their_replay(design):
    """Slips whose changes are limited remember, so that a script of one period is not enough."""
    controller = components.controllers(design)["equal_gain"]
    plant = components.slipping_robot(design, "iid")
    assert isinstance(plant, LearningRobot)
    generator = np.random.default_rng(1)
    script = {
        name: jnp.asarray(generator.uniform(-1, 1, (entry.times, 3, entry.vertices.shape[-1])))
        for name, entry in plant.uncertainties().items()
    }
    keys = realisation_keys(0, 0, 3)
    errors = jnp.zeros((3, 3))
    judged = play(controller, plant, keys, errors, script)
    replayed = rollout(controller, plant.under_script(script), keys, errors)
    np.testing.assert_allclose(judged["error"], replayed.errors[1:], atol=1e-12)
    assert np.max(np.abs(judged["error"])) > 0.005


def test_an_observer_looks_back_no_further_than_a_plan_looks_ahead(design):
    scenario = design.problem.scenario
    assert count_learnt_periods(scenario) == scenario.controller.horizon
    long = jt.load("certified_learning", ["controller.horizon=20"])
    assert count_learnt_periods(long) < 20
    unlearnt = dataclasses.replace(design.problem, scenario=jt.load("certified"))
    with pytest.raises(ValueError, match=r"slip\.change_per_s: is not given"):
        make_slip_observer(unlearnt)


@pytest.mark.parametrize(
    ("override", "fragment"),
    [
        ("slip.measurement_error=0.01", "measured"),
        ("slip.sideslip=0.02", "slip.sideslip"),
        ("robot.wheel_lag_s=[0.0, 0.05]", "obey at once"),
        ("controller.observer_gain=[0.5, 0.5, 0.5]", "estimate"),
        ("robot.wheel_acceleration_max_mps2=20.0", "slip.change_per_s"),
    ],
)
def test_what_does_not_go_with_learning_is_refused_in_one_line(override, fragment):
    with pytest.raises(ScenarioError) as refusal:
        jt.load("certified_learning", [override])
    line = str(refusal.value)
    assert fragment in line and "\n" not in line and "leave out" in line


def test_tuning_which_knows_one_w_refuses_in_one_line():
    with pytest.raises(
        ScenarioError, match=r"slip\.change_per_s = 0\.05: tuning knows one"
    ) as line:
        make_tuner(jt.load("certified_learning"))
    assert "\n" not in str(line.value)


def test_an_exported_controller_would_not_learn_and_is_refused(design, tmp_path):
    with pytest.raises(ScenarioError, match="does not learn slips"):
        jt.export(design, tmp_path / "controller")


@pytest.mark.slow
def test_certified_learning_is_certified_for_the_robot():
    made = jt.design(jt.load("certified_learning"))
    assert made.certificate.failing == []
    assert {"learnt_slips_hold", "disturbance_bound_proved"} <= set(made.certificate.conditions)
