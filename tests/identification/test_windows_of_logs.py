"""Laws of arcs and windows: exact on exact data, as uncertain as they say, a command a stretch."""

import dataclasses

import numpy as np
import pytest

from jaxtube.identification.arcs import find_noise, fit_arc
from jaxtube.identification.findings import inspect_log
from jaxtube.identification.simulated.drive import STEP, Truth, drive
from jaxtube.identification.simulated.log import Sensors, record

EXACT = 1e-9
VELOCITY = 0.004
"""m/s and rad/s, for poses of 5 mm and 3 mrad."""


def arc_poses(velocity, time, start=(1.0, -2.0, 0.4)):
    v, omega, lateral = velocity
    heading = start[2] + omega * time
    ahead = (np.sin(heading) - np.sin(start[2])) / omega
    aside = -(np.cos(heading) - np.cos(start[2])) / omega
    x = start[0] + v * ahead - lateral * aside
    y = start[1] + v * aside + lateral * ahead
    return np.column_stack([x, y, heading])


@pytest.mark.parametrize("velocity", [(0.8, 1.5, 0.05), (0.3, -0.2, -0.02), (1.2, 1e-5, 0.0)])
def test_an_arc_is_found_exactly(velocity):
    time = 100.0 + np.linspace(0.0, 2.0, 17)
    arc = fit_arc(time, arc_poses(velocity, time - 100.0))
    assert np.allclose(arc.velocity, velocity, atol=EXACT)


def test_velocities_are_as_uncertain_as_their_spread_says():
    draw = np.random.default_rng(3)
    time = np.linspace(0.0, 2.0, 21)
    exact = arc_poses((0.7, 0.9, 0.03), time)
    noise = np.array([0.01, 0.01, 0.004])
    arcs = [fit_arc(time, exact + noise * draw.normal(size=exact.shape)) for _ in range(600)]
    seen = np.std([arc.velocity for arc in arcs], axis=0)
    said = arcs[0].spread * [0.01, 0.004, 0.01]
    # Noise of the heading turns the arc as well, which the spread leaves out: v_y feels it.
    assert seen[:2] == pytest.approx(said[:2], rel=0.15)
    assert seen[2] < 1.3 * said[2]


def test_noise_is_found_beside_a_motion_that_wanders():
    draw = np.random.default_rng(3)
    time = np.linspace(0.0, 2.0, 21)
    wander = 0.01 * np.sin(2 * np.pi * time / 3.0)[:, None]
    exact = arc_poses((0.7, 0.9, 0.03), time) + wander
    noise = np.array([0.002, 0.002, 0.001])
    drawn = [find_noise(time, exact + noise * draw.normal(size=exact.shape)) for _ in range(600)]
    spread = np.sqrt(np.mean(np.concatenate(drawn) ** 2, axis=0))
    assert spread == pytest.approx(noise, rel=0.1)
    assert find_noise(time[:6], exact[:6]).shape == (0, 3)


@pytest.fixture(scope="module")
def found():
    truth = Truth(lever_arm=0.1, slip_wander=0.0005)
    simulated = record(drive(truth, 20, seed=21), Sensors(jumps=2), seed=21)
    return simulated, inspect_log(simulated.log, 2.0)


def test_windows_measure_the_mean_velocity_of_the_body(found):
    simulated, findings = found
    windows = findings.windows.windows
    used = windows.steady & ~windows.lost
    assert used.sum() > 30
    way = np.cumsum(simulated.drive.velocity, axis=0) * STEP
    first = np.round(findings.windows.start[used] / STEP).astype(int)
    mean = (way[first + round(2.0 / STEP)] - way[first]) / 2.0
    error = windows.velocity[used] - mean
    assert np.sqrt(np.mean(error**2, axis=0)).max() < VELOCITY


def test_windows_lie_in_one_command_and_end_with_it(found):
    simulated, findings = found
    log = simulated.log
    start = findings.windows.start
    first = np.searchsorted(log.time, start + 1e-9)
    last = np.searchsorted(log.time, start + 2.0 - 1e-9) - 1
    assert np.array_equal(log.step[first], log.step[last])
    command = findings.windows.windows.command
    assert len(np.unique(command[log.step[first] > 0])) == 20
    ends = [start[command == name].max() + 2.0 for name in np.unique(command)]
    changes = log.time[1:][np.diff(log.step) != 0]
    distance = np.abs(np.array(ends)[:, None] - [*changes, log.time[-1]]).min(axis=1)
    # Standing at either end, no command is known to end.
    assert distance[1:-1].max() < 0.03


def test_windows_that_touch_a_jump_are_lost(found):
    simulated, findings = found
    start = findings.windows.start + findings.clock.offset
    for time in simulated.jump_times:
        touching = (start < time) & (time < start + 2.0)
        assert np.all(findings.windows.windows.lost[touching])


def test_a_drive_by_hand_counts_runs_of_equal_wheels_as_commands(found):
    simulated, _ = found
    bare = dataclasses.replace(simulated.log, step=None, commands=None)
    findings = inspect_log(bare, 2.0)
    windows = findings.windows.windows
    used = windows.steady & ~windows.lost & (np.abs(windows.wheels).max(axis=1) > 0.05)
    names = np.unique(windows.command[used])
    assert 10 <= len(names) <= 21
    for name in names:
        wheels = windows.wheels[used & (windows.command == name)]
        assert np.ptp(wheels, axis=0).max() < 0.2
