"""Laws of the limit of the wheels' acceleration: whatever the plans may do within their rows, no
command changes by more; and who loosens the rows is found out."""

import dataclasses
import functools
import itertools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxtube.control.protocol import WheelMap
from jaxtube.paths.reference import limits_of
from jaxtube.plant.protocol import Measurement
from jaxtube.scenario import ScenarioError, load
from jaxtube.synthesis.acceleration import find_command_steps, find_reference_steps
from jaxtube.synthesis.certificate.acceleration import check_acceleration, find_largest_change
from jaxtube.synthesis.certificate.assumptions import assumptions
from jaxtube.synthesis.certificate.period import find_disturbances, noise_reach
from jaxtube.synthesis.certificate.robot import check_robot
from jaxtube.synthesis.design import design, refuse_infeasible_start
from jaxtube.synthesis.disturbance import complete_problem, with_computed_bound
from jaxtube.synthesis.limits import InputRows
from jaxtube.synthesis.problem import make_problem
from jaxtube.synthesis.tightening import input_names
from sets.certificate import ROUNDING

LIMIT = "robot.wheel_acceleration_max_mps2"
LAG = "robot.wheel_lag_s=[0.04, 0.06]"
CASES = {
    "certified": ("certified", f"{LIMIT}=18"),
    "estimated": ("certified", f"{LIMIT}=18", "controller.observer_gain=[0.8, 0.8, 0.8]"),
    "cosine_free": ("certified", f"{LIMIT}=18", "controller.input_map=cosine_free"),
    # One pair of wheel speeds, and a map that adds nothing: nothing is lost on bounds.
    "plain": (
        "certified",
        f"{LIMIT}=6",
        "controller.input_map=paper",
        "controller.tracking_gains=[4.0, 4.0, 4.0]",
        "reference.certified_for=path",
        "reference.duration_s=5",
        "disturbance.bound=assumed",
        "disturbance.longitudinal_m=0.004",
        "disturbance.lateral_m=0.004",
        "disturbance.heading_deg=0.5",
    ),
}
QUICK = ("certified", "plain")
NAMES = [name if name in QUICK else pytest.param(name, marks=pytest.mark.slow) for name in CASES]
STEPS = 20
LAPS = 150


@functools.cache
def make_case(name):
    base, *settings = CASES[name]
    return complete_problem(load(base, settings))


def with_rows_times(problem, factor):
    """Return the problem whose rows of the acceleration are looser."""
    rows = problem.input_rows
    half = len(rows.offsets) // 2
    first = len(problem.cap_rows.offsets) // 2
    offsets = rows.offsets.copy()
    for part in (slice(first, half), slice(half + first, 2 * half)):
        offsets[part] *= factor
    return dataclasses.replace(problem, input_rows=InputRows(rows.inputs, rows.errors, offsets))


def admit(rows, error):
    """Return the corners of the inputs that the rows admit at an error, none where nothing is."""
    offsets = rows.offsets - rows.errors @ error
    pairs = np.array(list(itertools.combinations(range(len(offsets)), 2)))
    crossing = pairs[np.abs(np.linalg.det(rows.inputs[pairs])) > 1e-6]
    points = np.linalg.solve(rows.inputs[crossing], offsets[crossing][..., None])[..., 0]
    return points[np.all(points @ rows.inputs.T <= offsets + 1e-9, axis=1)]


def drive(problem, generator):
    """Return the states (error, input, reference wheels) of the model from anywhere in the caps,
    under any inputs that the rows admit, any disturbances of W, and a reference that steps as it
    may; until an error leaves its caps, or no input is left."""
    W = problem.disturbance_set.vertices()
    steps = find_reference_steps(problem)
    corners = problem.corners
    wheels = corners[generator.integers(len(corners))]
    error = problem.operating_set.support(np.eye(3)) * generator.uniform(-1, 1, 3)
    states = []
    for _ in range(STEPS):
        inputs = admit(problem.input_rows, error)
        if not len(inputs) or problem.operating_set.margin(error[None])[0] < 0:
            break
        states.append((error, inputs[generator.integers(len(inputs))], wheels))
        A, B = problem.model.matrices(wheels)
        error = A @ error + B @ states[-1][1] + W[generator.integers(len(W))]
        target = corners[generator.integers(len(corners))]
        after = np.clip(target, wheels - steps, wheels + steps)
        is_certified = [np.all((after >= low) & (after <= high)) for low, high in problem.regions]
        wheels = after if any(is_certified) else wheels
    return states


def command(problem, states):
    """Return what the controller tells the wheels, m/s."""
    settings = problem.scenario.controller
    nominal = np.array(problem.scenario.slip.nominal)
    wheel_map = WheelMap(problem.model.track_width, problem.model.dt, settings.input_map)
    with jax.enable_x64(True):
        errors, inputs, wheels = (jnp.array(part) for part in zip(*states, strict=True))
        slips = jnp.broadcast_to(nominal, wheels.shape)
        return np.asarray(wheel_map.command(inputs, Measurement(errors, slips), wheels).wheels)


@pytest.mark.parametrize("name", NAMES)
def test_no_command_changes_by_more_whatever_the_rows_admit(name):
    problem = make_case(name)
    most = problem.scenario.robot.wheel_acceleration_max_mps2 * problem.model.dt
    generator = np.random.default_rng(5)
    laps = [drive(problem, generator) for _ in range(LAPS)]
    last = np.cumsum([len(lap) for lap in laps])[:-1]
    told = np.split(command(problem, [state for lap in laps for state in lap]), last)
    largest = max(np.abs(np.diff(lap, axis=0)).max(initial=0.0) for lap in told)
    assert 0.4 * most < largest <= most * (1 + 1e-6)


@pytest.mark.parametrize("name", NAMES)
def test_the_certificate_proves_it_and_its_search_comes_near(name):
    problem = make_case(name)
    condition = check_acceleration(problem)
    assert condition.holds and condition.scope == "robot"
    share = find_largest_change(problem)
    assert 0.7 < share <= 1 + ROUNDING
    if name == "plain":
        assert share > 1 - 1e-6


@pytest.mark.parametrize("factor", [1.001, 1.1])
def test_looser_rows_are_refuted_by_two_periods(factor):
    condition = check_acceleration(with_rows_times(make_case("plain"), factor))
    assert not condition.holds
    assert condition.sentence.startswith("A command may change by 6.")


@pytest.mark.slow
@pytest.mark.parametrize("name", CASES)
def test_looser_rows_are_never_certified(name):
    assert not check_acceleration(with_rows_times(make_case(name), 1.1)).holds


def test_a_limit_that_no_row_keeps_is_not_promised():
    problem = make_case("certified")
    loose = dataclasses.replace(problem, input_rows=problem.cap_rows, first_command=None)
    conditions = {condition.name: condition for condition in check_robot(loose)}
    assert not conditions["wheel_acceleration"].holds
    assert "m/s^2 from one period to the next" in conditions["wheel_acceleration"].sentence


@pytest.mark.slow
def test_a_design_keeps_it_and_says_what_it_assumes():
    made = design(load("certified", [f"{LIMIT}=18"]))
    assert made.certificate.holds_for_robot
    assert "wheel_acceleration" in made.certificate.conditions
    said = " ".join(assumptions(made.problem, any_order=True))
    assert "changing by at most 0.272 and 0.272 m/s (right, left)" in said
    assert "promised from the second command on" in said


def test_without_the_key_nothing_is_added():
    problem = complete_problem(load("certified"))
    assert problem.first_command is None
    assert problem.cap_rows is problem.input_rows
    assert find_command_steps(problem) is None
    assert "wheel_acceleration" not in {condition.name for condition in check_robot(problem)}
    limited = make_case("certified")
    names = input_names(limited)
    assert names[: len(input_names(problem))] == input_names(problem)
    assert len(names) == len(input_names(problem)) + 4 == len(limited.input_rows.offsets) // 2
    for part in ("inputs", "errors", "offsets"):
        caps = getattr(limited.cap_rows, part)
        assert np.array_equal(caps, getattr(problem.input_rows, part))


# ------------------------------------------------------------------------------- the first command


def test_the_first_command_keeps_its_bound_from_where_the_reference_begins():
    problem = make_case("certified")
    first = problem.first_command
    generator = np.random.default_rng(6)
    caps = problem.operating_set.support(np.eye(3))
    wheels = problem.schedule[0]
    states = [
        (error, one, wheels)
        for error in caps * generator.uniform(-1, 1, (300, 3))
        for one in admit(problem.input_rows, error)
    ]
    grip = 1 - np.array(problem.scenario.slip.nominal)
    change = np.abs(grip * command(problem, states) - wheels).max(axis=1)
    bound = first.use(np.array([error for error, _, _ in states])) * first.most
    assert np.all(change <= bound + 1e-6)
    assert np.max(change / bound) > 0.6
    points = first.shrink(caps * generator.normal(size=(50, 3)))
    assert np.all(first.use(points) <= 1 + ROUNDING)


@pytest.mark.slow
def test_wheels_that_lag_must_start_so_near_that_their_first_command_keeps_it():
    gentle = (
        "controller.tracking_gains=[4.0, 4.0, 5.0]",
        f"{LIMIT}=21",
        LAG,
        "slip.relative_error=0.02",
    )
    far = design(load("certified", [*gentle, "initial.x_m=0.1", "initial.y_m=0.1"]))
    first = far.problem.first_command
    error = far.problem.initial_error
    tight = dataclasses.replace(first, most=first.most * 0.99 * first.use(error[None])[0])
    limited = dataclasses.replace(
        far, problem=dataclasses.replace(far.problem, first_command=tight)
    )
    with pytest.raises(ScenarioError, match=r"the first command may change by more than.*% as far"):
        refuse_infeasible_start(limited)
    near = dataclasses.replace(first, most=first.most * 2)
    refuse_infeasible_start(
        dataclasses.replace(far, problem=dataclasses.replace(far.problem, first_command=near))
    )
    said = " ".join(assumptions(far.problem, any_order=True))
    assert "whose first command keeps the wheels' acceleration from where the reference" in said


# ------------------------------------------------------------------------------------ unknown lag


@pytest.mark.slow
def test_the_limit_narrows_what_an_unknown_lag_does():
    widths = []
    for limit in ("3", "10", None):
        settings = [LAG, *([f"{LIMIT}={limit}"] if limit else [])]
        problem = with_computed_bound(make_problem(load("certified_lag", settings)))
        widths.append(problem.disturbance_set.support(np.eye(3)))
        W = problem.disturbance_set
        reach = find_disturbances(problem) @ W.normals.T
        assert np.all(reach.max(axis=0) + noise_reach(problem, W.normals) <= W.offsets + ROUNDING)
    assert np.all(widths[0] < 0.85 * widths[2]) and np.all(widths[0] < widths[1])
    assert np.all(widths[1] < widths[2])


def test_steps_beyond_the_limit_leave_the_w_that_counts_on_it():
    problem = with_computed_bound(make_problem(load("certified_lag", [LAG, f"{LIMIT}=3"])))
    free = load("certified_lag", [LAG])
    W = problem.disturbance_set
    reach = find_disturbances(dataclasses.replace(problem, scenario=free)) @ W.normals.T
    assert np.any(reach.max(axis=0) > W.offsets + 1e-4)


# -------------------------------------------------------------------------------------- refusals


@pytest.mark.parametrize(
    ("settings", "cure"),
    [
        (("slip.random=both",), "leave out slip.random, or the limit"),
        (("slip.random=measured",), "leave out slip.random, or the limit"),
        (
            ("slip.right=[0.1, 0.3]", "slip.left=[0.1, 0.3]", "slip.measurement_error=0.01"),
            "leave out the measurement errors of",
        ),
        (("controller.restart=false",), "set controller.restart = true, or leave out the limit"),
    ],
)
def test_what_does_not_go_with_the_limit_is_refused_in_one_line(settings, cure):
    with pytest.raises(ScenarioError) as refused:
        load("certified", [f"{LIMIT}=20", *settings])
    message = str(refused.value)
    assert LIMIT in message and cure in message and "\n" not in message


@pytest.mark.parametrize("limit", ["0.0", "-1.0"])
def test_the_limit_is_positive(limit):
    with pytest.raises(ScenarioError, match="wheel_acceleration_max_mps2"):
        load("certified", [f"{LIMIT}={limit}"])


@pytest.mark.slow
def test_a_limit_that_the_law_passes_is_refused_with_the_least_that_it_needs():
    with pytest.raises(ScenarioError, match=r"a few per cent above (\S+), or lower") as refused:
        complete_problem(load("certified", [f"{LIMIT}=5"]))
    needed = float(str(refused.value).split("above ")[1].split(",")[0])
    complete_problem(load("certified", [f"{LIMIT}={needed * 1.001}"]))
    with pytest.raises(ScenarioError):
        complete_problem(load("certified", [f"{LIMIT}={needed * 0.999}"]))


def test_paths_keep_the_limit_over_ground():
    scenario = load("certified", [f"{LIMIT}=5", "slip.nominal_right=0.1"])
    assert limits_of(scenario).acceleration == pytest.approx(0.8 * 5)
    assert limits_of(load("certified")).acceleration is None


def test_angles_beyond_a_quarter_turn_are_refused_in_one_line():
    settings = ("controller.input_map=x_exact", "controller.dt_s=0.5", f"{LIMIT}=50")
    with pytest.raises(ScenarioError, match=r"wheel_acceleration_max_mps2: .*shrink") as refused:
        complete_problem(load("paper", settings))
    assert "\n" not in str(refused.value)
