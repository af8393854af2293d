"""The logs that come with the project are what the simulator writes, of robots of known truth."""

import dataclasses

import numpy as np
import pytest

from jaxtube.identification.findings import inspect_log
from jaxtube.identification.identify import Choices, identify_log
from jaxtube.identification.scenario_text import write_scenario
from jaxtube.identification.simulated.drive import drive
from jaxtube.identification.simulated.log import record
from jaxtube.identification.simulated.robots import (
    EXAMPLES,
    FILE,
    HOLD_S,
    SECOND_FILE,
    record_example,
    record_second,
)
from jaxtube.recordings.reading import read_log
from jaxtube.scenario.reading import experiments_folder
from jaxtube.scenario.refusal import ScenarioError
from jaxtube.witness.shares import find_promise, is_own_log

WHEEL_RADIUS = 0.15875
CHOICES = Choices(least_wheel=0.1, box="alike")
ROUNDED = 1e-4
"""Of numbers in the file, which has four decimals at least."""


@pytest.mark.parametrize(
    ("name", "file", "simulated"),
    [*((name, FILE, record_example) for name in EXAMPLES), ("husky", SECOND_FILE, record_second)],
)
def test_the_log_beside_a_scenario_is_what_its_robot_drives(name, file, simulated):
    made = simulated(name).log
    read = read_log(experiments_folder() / name / file)
    np.testing.assert_allclose(read.time, made.time, atol=ROUNDED)
    np.testing.assert_allclose(read.wheels, made.wheels, atol=ROUNDED)
    np.testing.assert_allclose(read.poses[:, :2], made.poses[:, :2], atol=ROUNDED)
    assert np.array_equal(read.step, made.step)
    np.testing.assert_allclose(read.commands, made.commands, atol=ROUNDED)


def test_a_log_is_no_witness_of_the_scenario_made_of_it(tmp_path):
    own = experiments_folder() / "husky" / FILE
    findings = inspect_log(read_log(own), 2.0)
    text = write_scenario(identify_log(findings, CHOICES), findings, None)
    promise = find_promise(text)
    other = tmp_path / FILE
    other.write_text(own.read_text() + "\n")
    assert is_own_log(promise, str(own))
    assert not is_own_log(promise, str(other))
    assert not is_own_log(None, str(own))


def test_wheels_in_other_units_than_they_are_taken_for_are_no_slip():
    log = record_example("husky").log
    in_radians = dataclasses.replace(log, wheels=log.wheels / WHEEL_RADIUS)
    with pytest.raises(ScenarioError, match=r"wheels = 6\.\d+: .* --units left=rad/s"):
        identify_log(inspect_log(in_radians, 2.0), Choices(box="alike"))


def test_a_pose_that_does_not_hold_is_no_slip():
    example = EXAMPLES["husky"]
    noisy = dataclasses.replace(example.sensors, pose_noise=0.25, jumps=0)
    log = record(drive(example.truth, 64, 7, HOLD_S), noisy, 7).log
    with pytest.raises(ScenarioError, match=r"slip|lost"):
        identify_log(inspect_log(log, 2.0), CHOICES)
