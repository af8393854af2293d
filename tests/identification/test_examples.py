"""The logs that come with the project are what the simulator writes, of robots of known truth."""

import numpy as np
import pytest

from jaxtube.identification.examples import EXAMPLES, FILE, record_example
from jaxtube.recordings.reading import read_log
from jaxtube.scenario.reading import experiments_folder

ROUNDED = 1e-4
"""Of numbers in the file, which has four decimals at least."""


@pytest.mark.parametrize("name", EXAMPLES)
def test_the_log_beside_a_scenario_is_what_its_robot_drives(name):
    made = record_example(name).log
    read = read_log(experiments_folder() / name / FILE)
    np.testing.assert_allclose(read.time, made.time, atol=ROUNDED)
    np.testing.assert_allclose(read.wheels, made.wheels, atol=ROUNDED)
    np.testing.assert_allclose(read.poses[:, :2], made.poses[:, :2], atol=ROUNDED)
    assert np.array_equal(read.step, made.step)
    np.testing.assert_allclose(read.commands, made.commands, atol=ROUNDED)
