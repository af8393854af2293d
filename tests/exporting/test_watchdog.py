"""Late, missing, wrong and impossible input gives the documented fallback and says so; no input
raises, and none gives a command that is not a number. C does what NumPy does."""

import math

import numpy as np
import pytest
from c_controller import Step, needs_compiler

from jaxtube.exporting.replay import load_controller

SOLVED, INFEASIBLE, _, BLIND, HALTED, FINISHED = range(6)
USED, MISSING, LATE, INVALID = range(4)
SAME = 1e-9


@pytest.fixture(params=["numpy", pytest.param("c", marks=needs_compiler)])
def either(request):
    """The controller in NumPy, then in C."""
    name = {"numpy": "controller", "c": "c_controller"}[request.param]
    return request.getfixturevalue(name)


@pytest.fixture(scope="module")
def poses(certified):
    """Poses of the reference."""
    return certified.problem.reference.poses


@pytest.fixture(scope="module")
def dt(certified):
    return certified.problem.reference.dt


def begin(controller, poses, dt: float, periods: int):
    """Drive on the reference for some periods; return the last output."""
    for period in range(periods):
        output = controller.step(poses[period], period * dt, period * dt)
        assert (output.status, output.pose, output.in_time) == (SOLVED, USED, True)
        assert output.guaranteed
    return output


def require_fallback(output: Step, pose: int, status: int = BLIND) -> None:
    assert (output.status, output.pose) == (status, pose)
    assert not output.guaranteed
    assert np.all(np.isfinite(output.wheels))


def test_a_missing_pose_lets_the_last_plan_go_on(either, poses, dt):
    last = begin(either, poses, dt, 3)
    output = either.step(None, None, 3 * dt)
    require_fallback(output, MISSING)
    assert output.plan_left == last.plan_left - 1


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf, 1e300])
@pytest.mark.parametrize("place", [0, 1, 2])
def test_a_pose_that_is_no_place_is_invalid(either, poses, dt, bad, place):
    begin(either, poses, dt, 3)
    pose = poses[3].copy()
    pose[place] = bad
    require_fallback(either.step(pose, 3 * dt, 3 * dt), INVALID)


def test_an_old_pose_is_late(either, poses, dt):
    begin(either, poses, dt, 3)
    require_fallback(either.step(poses[3], 2.8 * dt, 3 * dt), LATE)


def test_a_pose_that_came_before_is_missing(either, poses, dt):
    begin(either, poses, dt, 3)
    require_fallback(either.step(poses[2], 2 * dt, 3 * dt), MISSING)


@pytest.mark.parametrize("stamp", [3.5, math.nan, math.inf])
def test_a_pose_from_the_future_is_invalid(either, poses, dt, stamp):
    begin(either, poses, dt, 3)
    require_fallback(either.step(poses[3], stamp * dt, 3 * dt), INVALID)


@pytest.mark.parametrize("late", [0.05, -0.05])
def test_a_call_or_a_pose_that_is_nearly_in_time_is_used_but_not_covered(either, poses, dt, late):
    # The certificate knows no jitter: what a tenth of a period moves the robot is no part of W.
    begin(either, poses, dt, 3)
    now = (3 + late) * dt
    output = either.step(poses[3], now, now)
    assert (output.status, output.pose, output.in_time) == (SOLVED, USED, True)
    assert not output.guaranteed
    either.restart()
    begin(either, poses, dt, 3)
    output = either.step(poses[3], (3 - abs(late)) * dt, 3 * dt)
    assert (output.status, output.pose) == (SOLVED, USED)
    assert not output.guaranteed


def test_lateness_adds_up(either, poses, dt):
    # Each call is nearly a period after the last one; the tenth is a third of a period early.
    for period in range(10):
        now = period * 0.97 * dt
        output = either.step(poses[period], now, now)
    assert not output.in_time


@pytest.mark.parametrize("clock", [(0.0, None, 100.0), (None, 1.0, 2.0)])
def test_times_are_given_always_or_never(either, poses, clock):
    outputs = [either.step(pose, now, now) for pose, now in zip(poses[:3], clock, strict=True)]
    assert outputs[0].guaranteed
    assert not any(output.in_time or output.guaranteed for output in outputs[1:])


@pytest.mark.parametrize("now", [math.nan, math.inf])
def test_a_clock_that_is_no_number_is_not_in_time(either, poses, now):
    output = either.step(poses[0], 0.0, now)
    assert not output.in_time
    assert not output.guaranteed
    assert np.all(np.isfinite(output.wheels))


@pytest.mark.parametrize("now", [3.5, 2.5, 9.0])
def test_a_call_at_another_time_ends_the_guarantee_but_not_the_control(either, poses, dt, now):
    begin(either, poses, dt, 3)
    output = either.step(poses[3], now * dt, now * dt)
    assert (output.status, output.pose, output.in_time) == (SOLVED, USED, False)
    assert not output.guaranteed


def test_a_pose_outside_the_feasible_set_has_no_plan(either, poses, dt):
    last = begin(either, poses, dt, 3)
    output = either.step(poses[3] + [0.0, 3.0, 0.0], 3 * dt, 3 * dt)
    require_fallback(output, USED, INFEASIBLE)
    assert output.margins.min() < 0
    assert output.plan_left == last.plan_left - 1


def test_a_lost_guarantee_stays_lost_until_the_restart(either, poses, dt):
    begin(either, poses, dt, 3)
    either.step(None, None, 3 * dt)
    for period in range(4, 8):
        output = either.step(poses[period], period * dt, period * dt)
        assert output.status == SOLVED
        assert not output.guaranteed
    either.restart()
    assert either.step(poses[0], 0.0, 0.0).guaranteed


def test_without_poses_for_longer_than_a_plan_the_robot_stands_still(either, certified, poses, dt):
    begin(either, poses, dt, 3)
    horizon = certified.problem.horizon
    for period in range(3, 3 + horizon):
        require_fallback(either.step(None, None, period * dt), MISSING)
    halted = either.step(None, None, (3 + horizon) * dt)
    assert halted.status == HALTED
    assert np.array_equal(halted.wheels, [0.0, 0.0])
    again = either.step(poses[4 + horizon], (4 + horizon) * dt, (4 + horizon) * dt)
    assert again.status == HALTED, "a halt lasts until the restart"


def test_blind_periods_follow_the_reference(either, certified, poses, dt):
    # From the reference the plan is to drive as the reference does.
    begin(either, poses, dt, 3)
    for period in range(3, 6):
        output = either.step(None, None, period * dt)
        nominal = certified.problem.schedule[period]
        slip = certified.problem.scenario.slip.nominal
        np.testing.assert_allclose(output.wheels * (1 - np.array(slip)), nominal, atol=1e-9)


def test_without_any_pose_the_robot_does_not_start(either):
    output = either.step(None, None, 0.0)
    assert (output.status, output.pose) == (HALTED, MISSING)
    assert np.array_equal(output.wheels, [0.0, 0.0])


def test_beyond_the_reference_the_robot_stands_still(either, certified, poses, dt):
    steps = certified.problem.reference.steps
    begin(either, poses, dt, steps)
    output = either.step(poses[steps], steps * dt, steps * dt)
    assert output.status == FINISHED
    assert np.array_equal(output.wheels, [0.0, 0.0])


@pytest.mark.parametrize("slip", [(math.nan, 0.2), (0.2, 5.0), (-3.0, 0.2)])
def test_impossible_slips_are_replaced_by_the_nominal_ones(either, certified, poses, dt, slip):
    usual = either.step(poses[0], 0.0, 0.0)
    either.restart()
    output = either.step(poses[0], 0.0, 0.0, slip)
    np.testing.assert_array_equal(output.wheels, usual.wheels)
    assert not output.guaranteed


def test_without_times_none_is_judged(either, poses):
    for period in range(3):
        output = either.step(poses[period])
        assert (output.status, output.pose, output.in_time) == (SOLVED, USED, True)


def abuse(generator: np.random.Generator, poses, dt: float, period: int) -> dict:
    """Return arguments of a call that something may be wrong with."""
    now = dt * (period + generator.choice([0.0, 0.0, 0.05, 0.4]))
    stamp = now - dt * generator.choice([0.0, 0.0, 0.05, 0.5, -0.5, 2.0])
    spread = generator.choice([0.001, 0.05, 0.3, 5.0])
    pose = poses[min(period, len(poses) - 1)] + generator.normal(0.0, spread, 3)
    if generator.random() < 0.1:
        pose[generator.integers(3)] = generator.choice([math.nan, math.inf, 1e30])
    slip = generator.uniform(0.15, 0.25, 2) if generator.random() < 0.5 else None
    is_given = generator.random() < 0.9
    return {"pose": pose if is_given else None, "stamp": stamp, "now": now, "slip": slip}


@needs_compiler
def test_c_does_under_abuse_what_numpy_does(controller, c_controller, poses, dt):
    generator = np.random.default_rng(1)
    seen = set()
    for _ in range(25):
        controller.restart()
        c_controller.restart()
        for period in range(30 if generator.random() < 0.9 else 165):
            given = abuse(generator, poses, dt, period)
            ours = controller.step(**given)
            theirs = c_controller.step(**given)
            seen.add((ours.status, ours.pose))
            assert ours[4:9] == theirs[4:9]
            for name in ("wheels", "inputs", "errors", "margins"):
                ours_and_theirs = (getattr(ours, name), getattr(theirs, name))
                assert np.all(np.isfinite(ours_and_theirs))
                np.testing.assert_allclose(*ours_and_theirs, rtol=0, atol=SAME)
    statuses = {status for status, _ in seen}
    assert statuses == {SOLVED, INFEASIBLE, BLIND, HALTED}


def test_numbers_of_status_and_pose_are_those_of_the_file(exported):
    module = load_controller(exported.folder)
    assert (module.SOLVED, module.INFEASIBLE, module.BLIND) == (SOLVED, INFEASIBLE, BLIND)
    assert (module.HALTED, module.FINISHED) == (HALTED, FINISHED)
    assert (module.USED, module.MISSING, module.LATE, module.INVALID) == (0, 1, 2, 3)
