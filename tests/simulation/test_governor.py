"""Laws of the governor of one robot: its reference is a certified one whatever is asked for and
wherever the robot is, there is a plan in every period, and what is asked for is reached."""

import dataclasses
import itertools

import jax
import numpy as np
import pytest
import wishes
from figure_checks import assert_presentable
from governed_robot import Robot, find_start

import jaxtube as jt
from jaxtube import qp
from jaxtube.figures.recovery import recovery
from jaxtube.plant.reference import drive, two_circles
from jaxtube.scenario import ScenarioError
from jaxtube.simulation import governor as governors
from jaxtube.simulation.backup import Backup
from jaxtube.simulation.governing import SHARES, LivePlanner, accept_all
from jaxtube.simulation.governor import find_errors
from jaxtube.synthesis import live as live_windows
from jaxtube.synthesis.feasible import spread_starts, true_starts
from jaxtube.synthesis.live import LiveWindows
from jaxtube.synthesis.regimes import RegimesByAge

DURATION = "reference.duration_s=40"
SAME = 1e-9
"""Distance in m and rad that is none."""
FAR = 3.0
"""Times the caps that starts are away, with any heading."""


@pytest.fixture(scope="module")
def design():
    return jt.design(jt.load("certified", [DURATION]))


@pytest.fixture(scope="module")
def governor(design):
    return jt.Governor(design)


@pytest.fixture
def fresh(governor):
    governor.restart()
    return governor


def draw_far_starts(design, count, seed):
    """Poses up to three times the caps away from where the path begins, with any heading."""
    generator = np.random.default_rng(seed)
    caps = design.problem.operating_set.support(np.eye(3))
    errors = FAR * caps * generator.uniform(-1.0, 1.0, (count, 3))
    errors[:, 2] = generator.uniform(-np.pi, np.pi, count)
    return [find_start(error, design.problem.reference.poses[0]) for error in errors]


@pytest.fixture(scope="module")
def edge_starts_of_path(design):
    """Poses from which there is just a plan."""
    corners = true_starts(design.tube_qps, design.first_window, design.problem)
    errors = spread_starts(corners, 40, 0, edge_share=1.0)
    return [find_start(error, design.problem.reference.poses[0]) for error in errors]


def jump(design, seed, until, then=None):
    """Windows of corners drawn anew in every period, up to one from which all is steady."""
    box = design.problem.regions[0]
    steady = box.mean(axis=0) if then is None else then

    def wish(period):
        generator = np.random.default_rng([seed, period])
        drawn = wishes.draw_corners(generator, box, 1, design.problem.horizon)[0]
        return drawn if period < until else steady

    return wish


def require_certified(design, steps):
    """Plans in every period, errors and inputs within their caps, disturbances in W, wheels in
    their limits, and a reference whose wheel speeds lie in the box and lead along it."""
    problem = design.problem
    box = problem.regions[0]
    errors = np.array([step.errors for step in steps])
    inputs = np.array([step.inputs for step in steps])
    wheels = np.array([step.reference_wheels for step in steps])
    rows = problem.input_rows
    assert all(step.is_solved for step in steps)
    assert np.all(np.abs(errors) <= problem.operating_set.support(np.eye(3)))
    assert np.all(inputs @ rows.inputs.T + errors @ rows.errors.T <= rows.offsets + SAME)
    assert np.all((wheels >= box[0]) & (wheels <= box[1]))
    asked = np.array([step.wheels for step in steps])
    assert np.all(np.abs(asked) <= problem.robot.wheel_speed_max)


def require_one_reference(design, steps, renewals=()):
    """The reference drives its wheel speeds along exact arcs, and W holds every disturbance, but
    where it begins anew."""
    problem = design.problem
    W = problem.disturbance_set
    for period, (step, following) in enumerate(itertools.pairwise(steps)):
        if period + 1 in renewals:
            continue
        dt = problem.reference.dt
        moved = drive(step.reference_pose, step.reference_wheels, dt, problem.robot.track_width)
        np.testing.assert_allclose(following.reference_pose, moved, rtol=0, atol=SAME)
        A, B = problem.model.matrices(step.reference_wheels)
        w = following.errors - A @ step.errors - B @ step.inputs
        assert np.all(W.normals @ w <= W.offsets + SAME)


def test_windows_of_the_design_get_the_qps_of_the_design(design):
    live = LiveWindows(design).condense(design.windows.schedules).qps
    for ours, expected in zip(jax.tree.leaves(live), jax.tree.leaves(design.tube_qps), strict=True):
        np.testing.assert_allclose(ours, expected, rtol=1e-9, atol=1e-9)


def test_a_start_with_a_plan_follows_the_path_at_once(design, fresh):
    steps = Robot(design, [-0.1, -0.1, 0.0], 0).run(fresh, 20)
    require_certified(design, steps)
    require_one_reference(design, steps)
    assert {step.state for step in steps} == {"followed"}
    assert max(step.distance for step in steps) <= SAME


@pytest.mark.parametrize("seed", [0, pytest.param(1, marks=pytest.mark.slow)])
def test_any_start_ends_on_the_path_and_every_period_is_certified(design, fresh, seed):
    start = draw_far_starts(design, 1, seed)[0]
    steps = Robot(design, start, seed).run(fresh, 180)
    require_certified(design, steps)
    require_one_reference(design, steps)
    states = [step.state for step in steps]
    joined = states.index("followed")
    assert set(states[:joined]) == {"joining"}
    assert set(states[joined:]) == {"followed"}
    assert max(step.distance for step in steps[joined:]) <= 1e-6
    poses = design.problem.reference.poses
    late = steps[-1].late
    for period, step in list(enumerate(steps))[joined:]:
        np.testing.assert_allclose(
            np.exp(1j * step.reference_pose[2]), np.exp(1j * poses[period - late, 2]), atol=1e-6
        )
        np.testing.assert_allclose(step.reference_pose[:2], poses[period - late, :2], atol=1e-6)


def test_a_robot_that_is_pushed_away_comes_back(design, fresh):
    kicks = {50: np.array([0.5, -0.4, 1.5])}
    steps = Robot(design, [0.0, 0.0, 0.0], 1).run(fresh, 240, kicks=kicks)
    require_certified(design, steps)
    require_one_reference(design, steps, renewals=kicks)
    assert steps[50].state == "joining"
    assert steps[-1].state == "followed"
    assert_presentable(recovery(design, steps))
    assert steps[-1].distance <= 1e-6


def test_a_robot_that_was_stopped_is_waited_for(design, fresh):
    robot = Robot(design, [0.0, 0.0, 0.0], 4)
    steps = robot.run(fresh, 30)
    late = 6
    robot.pose = steps[-late].reference_pose.copy()
    steps += robot.run(fresh, 30)
    require_certified(design, steps)
    require_one_reference(design, steps, renewals={30})
    assert {step.state for step in steps} == {"followed"}
    assert 0 < steps[-1].late <= late
    assert steps[-1].distance <= SAME


@pytest.fixture(scope="module")
def held_back(design, governor, edge_starts_of_path):
    """Of runs from the edge, under wishes that jump and then are steady, one held back at first."""
    for seed, start in enumerate(edge_starts_of_path):
        governor.restart()
        robot = Robot(design, start, seed)
        steps = robot.run(governor, 2, wish=jump(design, seed, until=3))
        if steps[0].state == "held back" and steps[1].distance > SAME:
            return steps + robot.run(governor, 80, wish=jump(design, seed, until=1))
    raise AssertionError("no wish was held back")


def test_a_revision_without_a_plan_is_held_back_and_caught_up_with(design, held_back):
    require_certified(design, held_back)
    require_one_reference(design, held_back)
    assert held_back[0].share in (*SHARES[1:], 0.0)
    assert held_back[-1].state == "followed"
    assert held_back[-1].distance <= 1e-6


def test_a_governor_that_accepts_always_loses_its_plan(
    design, fresh, edge_starts_of_path, monkeypatch
):
    monkeypatch.setattr(governors, "govern", accept_all)
    begun = []
    monkeypatch.setattr(fresh, "_begin_anew", lambda pose, errors: begun.append(pose) or errors)
    for seed, start in enumerate(edge_starts_of_path):
        fresh.restart()
        step = fresh(start, jump(design, seed, until=1)(0))
        if begun:
            break
    assert step.state == "lost"
    assert not step.is_solved


def test_another_path_is_joined_from_what_is_committed(design, fresh):
    robot = Robot(design, [0.0, 0.0, 0.0], 2)
    steps = robot.run(fresh, 20)
    reference = design.problem.reference
    other = two_circles(2.7, 1.36, 30.0, 0.1, 6, design.problem.robot.track_width)
    fresh.follow(other)
    steps += robot.run(fresh, 400)
    assert fresh.has_ended
    require_certified(design, steps)
    require_one_reference(design, steps)
    committed = [step.reference_wheels for step in steps[20 : 20 + design.problem.horizon]]
    np.testing.assert_array_equal(committed, reference.wheels[20 : 20 + design.problem.horizon])
    assert steps[-1].state == "followed"
    end = drive(steps[-1].reference_pose, steps[-1].reference_wheels, 0.1, 0.5)
    np.testing.assert_allclose(end[:2], other.poses[other.steps, :2], atol=1e-6)


def test_a_missing_pose_is_where_the_last_plan_has_the_robot(design, fresh):
    robot = Robot(design, [0.0, 0.0, 0.0], 3)
    robot.run(fresh, 10)
    step = fresh(np.full(3, np.nan))
    assert np.all(np.isfinite(step.wheels))
    assert step.is_solved


def test_what_cannot_be_governed_is_refused_in_one_line(fresh, certified_paper_design):
    with pytest.raises(ValueError, match="give three numbers"):
        fresh([np.nan, 0.0, 0.0])
    with pytest.raises(ValueError, match="wish: is of shape"):
        fresh(np.zeros(3), wish=np.zeros((2, 2)))
    quick = two_circles(2.5, 2.0, 10.0, 0.1, 6, 0.5)
    with pytest.raises(ValueError, match="leave the certified"):
        fresh.follow(quick)
    with pytest.raises(jt.ScenarioError, match="in any order"):
        jt.Governor(certified_paper_design)


@pytest.mark.slow
def test_the_backup_of_many_robots_is_that_of_the_tube_mpc(design, edge_starts_of_path):
    """Along the reference, from a start without a plan."""
    problem = design.problem
    start = 1.3 * find_errors(edge_starts_of_path[0], problem.reference.poses[0])
    laps = jt.simulate(design, starts=start[None], laps=1)
    measured = np.asarray(laps.trajectory.measured)[:12]
    backup = Backup(design, measured[0])
    planner = LivePlanner(design)
    statuses = set()
    for period, errors in enumerate(measured):
        window = problem.schedule[period : period + problem.horizon]
        plans = planner.plan(window[None], errors)
        has_plan = np.asarray(laps.trajectory.diagnostics.status)[period] == qp.SOLVED
        statuses.add(bool(has_plan[0]))
        inputs = backup.act(plans, has_plan, errors, window[:1])
        np.testing.assert_allclose(inputs, laps.trajectory.inputs[period], atol=1e-8)
    assert statuses == {True, False}


@pytest.mark.slow
def test_a_thousand_starts_without_a_plan_all_end_on_the_path(design, governor, capsys):
    periods = []
    lates = []
    omega = design.terminal.invariant
    for seed, start in enumerate(draw_far_starts(design, 1000, 99)):
        governor.restart()
        steps = Robot(design, start, seed).run(governor, 260)
        require_certified(design, steps)
        require_one_reference(design, steps)
        assert steps[-1].state == "followed"
        assert steps[-1].distance <= 1e-6
        assert np.all(omega.normals @ steps[-1].errors <= omega.offsets)
        periods.append([step.state for step in steps].index("followed"))
        lates.append(steps[-1].late)
    with capsys.disabled():
        for name, values in (("joined after", periods), ("late by", lates)):
            print(name, np.percentile(values, [0, 5, 50, 95, 100]), "periods")


def test_windows_whose_rows_a_solver_may_miss_count_as_without_a_plan(design, monkeypatch):
    monkeypatch.setattr(live_windows, "find_back_off", lambda problem: 0.0)
    plans = LivePlanner(design).plan(design.windows.schedules[:1], np.zeros((1, 3)))
    assert plans.status.tolist() == [qp.UNSOLVED]


def test_slip_that_is_learnt_is_refused_for_its_first_windows_differ(design):
    learning = dataclasses.replace(design.problem, rule=RegimesByAge(1))
    with pytest.raises(ScenarioError, match="change_per_s"):
        LiveWindows(dataclasses.replace(design, problem=learning))
