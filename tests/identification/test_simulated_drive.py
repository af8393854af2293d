"""Laws of simulated drives and logs: the plant against an ODE solver, files against the reader."""

import dataclasses

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from jaxtube.identification.simulated.drive import (
    STEP,
    Truth,
    command_wheels,
    drive,
    follow,
    integrate,
)
from jaxtube.identification.simulated.log import Sensors, record, write_log
from jaxtube.recordings.reading import read_log

MIDPOINT = 1e-5
"""m and rad, of the midpoint rule with 2 ms over some seconds at 1 m/s."""
CSV_DIGITS = 1e-4
"""m/s and s, of what the file keeps."""

TRUTH = Truth(lever_arm=0.1, wheel_lag=0.08, sideslip=0.05)


def test_the_pose_is_that_of_an_ode_solver():
    time = STEP * np.arange(2500)

    def velocity(t):
        return np.array([0.8 + 0.2 * np.sin(t), 1.2 * np.cos(0.7 * t), 0.05 * np.sin(2 * t)])

    def rate(t, pose):
        v, omega, lateral = velocity(t)
        heading = pose[2]
        x_rate = v * np.cos(heading) - lateral * np.sin(heading)
        return [x_rate, v * np.sin(heading) + lateral * np.cos(heading), omega]

    exact = solve_ivp(rate, (0.0, time[-1]), np.zeros(3), t_eval=time, rtol=1e-10, atol=1e-10)
    poses = integrate(np.array([velocity(t) for t in time]))
    assert np.abs(poses - exact.y.T).max() < MIDPOINT


def test_wheels_follow_a_step_as_the_closed_form_does():
    commanded = np.ones((500, 1))
    elapsed = STEP * np.arange(500)
    assert np.allclose(follow(commanded, 0.1)[:, 0], -np.expm1(-elapsed / 0.1), atol=1e-12)
    assert np.array_equal(follow(commanded, 0.0), commanded)


def test_slips_stay_in_their_intervals_and_bodies_obey_them():
    driven = drive(TRUTH, 12, seed=3)
    least, greatest = np.array(TRUTH.slip).T
    moving = driven.command > 0
    assert np.all(driven.slips[moving] >= least - 1e-12)
    assert np.all(driven.slips[moving] <= greatest + 1e-12)
    ground = driven.wheels * (1.0 - driven.slips)
    turn = (ground[:, 0] - ground[:, 1]) / TRUTH.effective_track
    assert np.allclose(driven.velocity[:, 1], turn)
    aside = driven.velocity[:, 2] + TRUTH.lever_arm * turn
    assert np.all(np.abs(aside) <= TRUTH.sideslip * np.abs(driven.velocity[:, 0]) + 1e-12)


def test_wheels_settle_at_what_the_command_asks_for():
    driven = drive(TRUTH, 6, seed=1)
    last = np.flatnonzero(np.diff(driven.command))
    asked = command_wheels(driven.commands.velocity[driven.command[last]], TRUTH.track_width)
    assert np.abs(driven.wheels[last] - asked).max() < 1e-6


def test_a_seed_alone_decides_a_log():
    first = record(drive(TRUTH, 4, seed=5), Sensors(jumps=2), seed=7)
    again = record(drive(TRUTH, 4, seed=5), Sensors(jumps=2), seed=7)
    other = record(drive(TRUTH, 4, seed=5), Sensors(jumps=2), seed=8)
    assert np.array_equal(first.log.poses, again.log.poses)
    assert not np.array_equal(first.log.poses, other.log.poses)


def test_rows_hold_a_pose_until_the_next_one_has_arrived():
    sensors = Sensors(wheel_rate=50.0, pose_rate=5.0, pose_delay=0.1)
    log = record(drive(TRUTH, 3, seed=2), sensors, seed=2).log
    is_new = np.any(np.diff(log.poses, axis=0) != 0.0, axis=1)
    assert np.mean(is_new) == pytest.approx(0.1, abs=0.01)
    first = log.time[1:][is_new][0]
    assert first == pytest.approx(1 / 5.0 + 0.1, abs=1 / 50.0)


def test_without_noise_and_delay_a_log_shows_the_true_poses():
    sensors = Sensors(50.0, 0.0, 50.0, 0.0, 0.0, 0.0)
    driven = drive(TRUTH, 3, seed=4)
    log = record(driven, sensors, seed=4).log
    rows = np.round(log.time / STEP).astype(int)
    assert np.allclose(log.poses, driven.poses[rows])
    assert np.allclose(log.wheels, driven.wheels[rows])


def test_the_file_of_a_log_reads_back_as_the_log(tmp_path):
    log = record(drive(TRUTH, 3, seed=6), Sensors(), seed=6).log
    write_log(log, tmp_path / "log.csv")
    back = read_log(tmp_path / "log.csv")
    assert np.abs(back.time - log.time).max() <= CSV_DIGITS
    assert np.abs(back.wheels - log.wheels).max() <= CSV_DIGITS
    assert np.abs(back.poses - log.poses).max() <= CSV_DIGITS
    assert np.abs(back.commands - log.commands).max() <= CSV_DIGITS
    assert np.array_equal(back.step, log.step)


def test_a_slip_that_wanders_further_than_its_interval_is_refused():
    with pytest.raises(ValueError, match=r"slip_wander = 0.1: .* give at most 0.04"):
        dataclasses.replace(TRUTH, slip_wander=0.1)
