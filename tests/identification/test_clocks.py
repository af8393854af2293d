"""Laws of what is found of clocks, cuts, wheels that lag and noise, in logs of known truth."""

import dataclasses
from functools import cache

import numpy as np
import pytest

from jaxtube.identification.clocks import align
from jaxtube.identification.cuts import find_cuts
from jaxtube.identification.findings import inspect_log
from jaxtube.identification.response import find_response, follow_commands
from jaxtube.identification.samples import drop_held_poses, measure_steps, measure_travel
from jaxtube.identification.simulated.drive import Truth, drive
from jaxtube.identification.simulated.log import Sensors, record
from jaxtube.recordings.log import Log
from jaxtube.scenario import ScenarioError

OFFSET_S = 0.02
"""Of an offset, beside the time between two rows, which it may hold or not."""
LAG_S = 0.02
NARROW = 0.3
"""Of the time between two rows."""
NEAR_S = 0.006
SUPERPOSED = 1e-12

TRUTH = Truth(wheel_lag=0.12, lever_arm=0.05)
SENSORS = Sensors(pose_delay=0.1, pose_noise=0.01, jumps=2, lost=((60.0, 66.0),))


@cache
def simulate():
    return record(drive(TRUTH, 20, seed=11), SENSORS, seed=11)


def find(log):
    poses = drop_held_poses(log)
    travel = measure_travel(log)
    return poses, travel, align(log.path, travel, poses)


def shift_poses(log, by):
    return dataclasses.replace(log, pose_time=log.pose_time + by)


@pytest.mark.parametrize("by", [0.0, -0.4, 2.5])
def test_the_offset_is_that_of_the_poses_whatever_its_sign(by):
    _, _, clock = find(shift_poses(simulate().log, by))
    row = 1.0 / SENSORS.wheel_rate
    assert -OFFSET_S <= clock.offset - by - SENSORS.pose_delay <= row + OFFSET_S
    assert clock.correlation > 0.95


def test_wheels_and_poses_of_two_drives_are_refused():
    log = simulate().log
    other = record(drive(TRUTH, 20, seed=99), Sensors(), seed=99).log
    rows = min(len(log.time), len(other.time))
    mixed = dataclasses.replace(
        log, pose_time=other.pose_time[:rows], poses=other.poses[:rows, [1, 0, 2]] * [1, 1, -1]
    )
    with pytest.raises(
        ScenarioError, match=r"correlation = .*; give wheels and poses of one drive"
    ):
        find(mixed)


def test_a_robot_that_never_moves_is_refused():
    log = dataclasses.replace(simulate().log, wheels=np.zeros_like(simulate().log.wheels))
    with pytest.raises(ScenarioError, match=r"wheels = 0.0: are m rolled in the whole log; record"):
        find(log)


def test_held_poses_are_dropped_and_counted():
    poses = drop_held_poses(simulate().log)
    assert poses.period == pytest.approx(1.0 / SENSORS.pose_rate, rel=0.05)
    assert poses.held_share == pytest.approx(1 - SENSORS.pose_rate / SENSORS.wheel_rate, abs=0.02)


def test_steps_along_an_arc_are_as_long_as_the_arc():
    heading = np.linspace(0.0, 3.0, 61)
    circle = np.column_stack([np.sin(heading), 1.0 - np.cos(heading), heading])
    poses = dataclasses.replace(
        drop_held_poses(simulate().log), time=np.linspace(0.0, 6.0, 61), pose=circle
    )
    steps = measure_steps(poses, 1.0)
    assert np.allclose(steps.forward, steps.turn)


def test_jumps_and_the_lost_stretch_are_cut_where_they_are():
    simulated = simulate()
    poses, travel, clock = find(simulated.log)
    cuts = find_cuts(travel, poses, clock)
    late = SENSORS.pose_delay + 2.0 / SENSORS.pose_rate
    (lost,) = cuts.of_kind("lost")
    assert abs(lost.start - 60.0) <= late
    assert abs(lost.end - 66.0) <= late
    jumps = cuts.of_kind("jump")
    apart = [time for time in simulated.jump_times if not 58.0 < time < 68.0]
    assert len(jumps) == len(apart)
    for cut, time in zip(jumps, apart, strict=True):
        assert cut.start <= time + late
        assert cut.end >= time


def test_a_clean_log_has_no_cuts():
    poses, travel, clock = find(record(drive(TRUTH, 20, seed=12), Sensors(), seed=12).log)
    assert find_cuts(travel, poses, clock).cuts == ()


def test_a_log_without_poses_for_seconds_has_a_gap():
    log = record(drive(TRUTH, 20, seed=12), Sensors(), seed=12).log
    kept = (log.pose_time < 40.0) | (log.pose_time > 43.0)
    holed = dataclasses.replace(log, pose_time=log.pose_time[kept], poses=log.poses[kept])
    poses, travel, clock = find(holed)
    (gap,) = find_cuts(travel, poses, clock).of_kind("gap")
    assert gap.start == pytest.approx(40.0, abs=0.2)
    assert gap.end == pytest.approx(43.0, abs=0.2)


def test_commands_are_followed_as_the_sum_of_their_steps():
    time = np.cumsum(np.random.default_rng(0).uniform(0.02, 0.08, 120))
    commands = np.repeat([[0.2], [1.0], [-0.5], [0.3]], 30, axis=0)
    for delay, lag in ((0.07, 0.15), (-0.03, 0.05), (0.2, 0.0)):
        expected = np.full(len(time), 0.2)
        for row in (30, 60, 90):
            elapsed = np.maximum(time - delay - time[row], 0.0)
            share = -np.expm1(-elapsed / lag) if lag else (time - delay >= time[row]).astype(float)
            expected += (commands[row, 0] - commands[row - 1, 0]) * share
        followed = follow_commands(time, commands, delay, lag)[:, 0]
        assert np.abs(followed - expected).max() < SUPERPOSED


@pytest.mark.parametrize("lag", [0.0, 0.05, 0.2])
def test_lag_and_dead_time_of_the_wheels_are_told_apart(lag):
    truth = dataclasses.replace(TRUTH, wheel_lag=lag)
    log = record(drive(truth, 16, seed=5), Sensors(), seed=5).log
    late = dataclasses.replace(log, commands=np.roll(log.commands, -10, axis=0))
    response = find_response(late)
    assert response is not None
    row = 1.0 / Sensors().wheel_rate
    assert abs(response.lag - lag) < LAG_S
    assert abs(response.delay - 10 * row) <= row + 1e-3
    assert response.lag_interval[0] <= response.lag <= response.lag_interval[1]
    assert response.track_width == pytest.approx(truth.track_width, rel=0.01)
    assert response.explained > 0.95


@pytest.mark.parametrize(("lag", "rate"), [(0.03, 20.0), (0.08, 10.0), (0.2, 20.0)])
def test_rows_that_show_commands_late_do_not_widen_the_interval_of_the_lag(lag, rate):
    truth = dataclasses.replace(TRUTH, wheel_lag=lag)
    sensors = Sensors(wheel_rate=rate)
    response = find_response(record(drive(truth, 16, seed=5), sensors, seed=5).log)
    assert response is not None
    least, greatest = response.lag_interval
    assert least <= lag <= greatest
    assert greatest - least < NARROW / rate


def test_the_interval_of_the_lag_holds_lags_that_differ_from_change_to_change():
    lags = [0.06, 0.1]
    time = 0.02 * np.arange(4000)
    held = np.arange(4000) // 200
    steps = np.random.default_rng(8).uniform(0.3, 1.0, (20, 2))
    wheels = np.empty((4000, 2))
    state = steps[0]
    for command, target in enumerate(steps):
        rows = np.flatnonzero(held == command)
        decay = np.exp(-(time[rows] - time[rows[0]]) / lags[command % 2])
        wheels[rows] = target + (state - target) * decay[:, None]
        state = target
    noise = np.random.default_rng(9).normal(0.0, 0.003, wheels.shape)
    commands = np.column_stack([steps.mean(axis=1), steps[:, 0] - steps[:, 1]])[held]
    log = Log("made", time, wheels + noise, time, np.zeros((4000, 3)), held, commands)
    response = find_response(log)
    assert response is not None
    least, greatest = response.lag_interval
    assert least < lags[0] + NEAR_S
    assert greatest > lags[1] - NEAR_S


def test_without_commands_nothing_is_said_of_their_lag():
    assert find_response(dataclasses.replace(simulate().log, commands=None)) is None


def test_pose_noise_comes_out_as_it_went_in():
    findings = inspect_log(simulate().log, 1.5)
    assert findings.moving is not None
    assert findings.standing is not None
    for noise in (findings.moving, findings.standing):
        assert noise.deviation[0] == pytest.approx(SENSORS.pose_noise, rel=0.3)
        assert noise.bound[0] > 2 * noise.deviation[0]
    assert findings.standing.deviation[1] == pytest.approx(SENSORS.heading_noise, rel=0.3)
