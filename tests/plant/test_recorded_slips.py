"""Slips taken from a log: blocks of rows as recorded, drawn by index, true to the file."""

import pickle
import re

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.stats import chisquare
from tolerances import LEAST_P_VALUE, ROUNDING

import jaxtube as jt
from jaxtube.plant import slip
from jaxtube.plant.recorded_slips import (
    BLOCK_S,
    describe_recording,
    make_recorded,
    read_slips,
    write_slips,
)
from jaxtube.scenario import load
from jaxtube.simulation.components import robot_of
from jaxtube.simulation.rollout import realisation_keys
from jaxtube.synthesis.problem import make_problem

ROWS = 37
PERIOD = 0.8
SETTINGS = (
    "slip.right=[0.1, 0.3]",
    "slip.left=[-0.1, 0.2]",
    "slip.sideslip=0.05",
    "slip.process=recorded",
)


@pytest.fixture
def recording(tmp_path):
    generator = np.random.default_rng(3)
    low = np.array([0.1, -0.1, -0.05])
    high = np.array([0.3, 0.2, 0.05])
    values = generator.uniform(low, high, (ROWS, 3)).round(6)
    path = tmp_path / "slips.csv"
    path.write_text(write_slips(PERIOD * np.arange(ROWS), values))
    return path, values


def load_recorded(path, *more):
    return load("paper", [*SETTINGS, f"slip.recording={path}", *more])


def draw_runs(scenario, count, steps, first=0):
    """Slips of wheels and sideslip (runs, steps, 3), and deviations measured (runs, steps, 2)."""
    robot = robot_of(make_problem(scenario))
    keys = realisation_keys(11, first, count)
    errors = jnp.zeros((count, 3))

    def body(memory, step):
        memory = robot.draw_slips(keys, step, memory, errors)
        sideways = (scenario.slip.sideslip * memory.sideslip)[:, None]
        slips = jnp.concatenate([robot.slips.true_slip(memory.true), sideways], axis=1)
        return memory, (slips, memory.measured)

    _, drawn = jax.lax.scan(body, robot.initial(keys, errors), jnp.arange(steps))
    return [np.moveaxis(np.asarray(each), 0, 1) for each in drawn]


def find_rows(slips, values):
    """The row of the file that each drawn triple is; fails where it is none."""
    gaps = np.abs(slips[..., None, :] - values).max(axis=-1)
    assert gaps.min(axis=-1).max() < ROUNDING
    return gaps.argmin(axis=-1)


def test_a_file_comes_back_as_it_was_written(recording):
    path, values = recording
    read = read_slips(path)
    np.testing.assert_array_equal(read.values, values)
    assert read.period == pytest.approx(PERIOD, abs=1e-9)


def test_blocks_are_rows_in_the_order_of_the_file_of_both_wheels_and_the_sideslip(recording):
    path, values = recording
    slips, _ = draw_runs(load_recorded(path), 40, 130)
    rows = find_rows(slips, values)
    steps = round(BLOCK_S / 0.1)
    for start in range(0, 130, steps):
        block = rows[:, start : start + steps]
        held = (np.arange(block.shape[1]) * 0.1 / PERIOD + 1e-9).astype(int)
        np.testing.assert_array_equal(block, (block[:, :1] + held) % ROWS)


def test_blocks_begin_at_every_row_alike_and_on_their_own(recording):
    path, values = recording
    slips, _ = draw_runs(load_recorded(path), 3000, 51)
    first, second = find_rows(slips, values)[:, [0, 50]].T
    for starts in (first, second):
        assert chisquare(np.bincount(starts, minlength=ROWS)).pvalue > LEAST_P_VALUE
    assert abs(np.corrcoef(first, second)[0, 1]) < 0.08
    assert abs(np.corrcoef(first[1:], first[:-1])[0, 1]) < 0.08


def test_draws_depend_on_the_index_of_a_realisation_alone(recording):
    path, _ = recording
    scenario = load_recorded(path)
    together, _ = draw_runs(scenario, 16, 60)
    alone, _ = draw_runs(scenario, 1, 60, first=9)
    np.testing.assert_array_equal(together[9], alone[0])


def test_what_is_measured_of_the_slips_is_drawn_on_its_own(recording):
    path, values = recording
    slips, measured = draw_runs(load_recorded(path, "slip.measurement_error=0.02"), 500, 60)
    assert np.abs(measured).max() <= 1.0
    assert np.abs(np.diff(measured, axis=1)).min() > 0.0
    assert abs(np.corrcoef(slips[:, 7, 0], measured[:, 7, 0])[0, 1]) < 0.2
    assert find_rows(slips, values).shape == (500, 60)


def test_slips_that_are_not_allowed_are_replayed_and_counted(recording):
    path, values = recording
    narrow = load_recorded(path, "slip.right=[0.15, 0.25]", "slip.sideslip=0.04")
    process = make_recorded(narrow)
    beyond = (values[:, 0] < 0.15) | (values[:, 0] > 0.25) | (np.abs(values[:, 2]) > 0.04)
    np.testing.assert_array_equal(process.is_outside, beyond)
    assert 0 < beyond.sum() < ROWS
    assert f"{beyond.sum()} of them OUTSIDE" in describe_recording(narrow)
    slips, _ = draw_runs(narrow, 200, 40)
    assert beyond[find_rows(slips, values)].any()
    assert "none of them outside" in describe_recording(load_recorded(path))


def test_slips_near_a_nominal_one_are_replayed_too(recording):
    path, values = recording
    near = [f"slip.recording={path}", "slip.process=recorded", "slip.sideslip=0.05"]
    slips, _ = draw_runs(load("paper", near), 20, 60)
    find_rows(slips, values)


def test_equal_recordings_share_one_compilation(recording):
    path, _ = recording
    process = make_recorded(load_recorded(path))
    copy = pickle.loads(pickle.dumps(process))
    assert copy == process and hash(copy) == hash(process)
    assert isinstance(process, slip.JointProcess)
    assert process.sideslip != process


def test_a_relative_file_starts_at_the_folder_of_its_scenario(recording, monkeypatch):
    path, _ = recording
    toml = path.parent / "mine.toml"
    toml.write_text('[slip]\nprocess = "recorded"\nrecording = "slips.csv"\nsideslip = 0.1\n')
    assert load(toml).slip.recording == str(path)
    monkeypatch.chdir(path.parent)
    overridden = load("paper", ["slip.process=recorded", "slip.recording=slips.csv"])
    assert overridden.slip.recording == str(path)


HEADER = "time_s,right_slip,left_slip,sideslip\n"


@pytest.mark.parametrize(
    ("text", "more", "fragment"),
    [
        ("time_s,right_slip,left_slip\n0,0.1,0.1\n1,0.1,0.1\n", (), "has no column sideslip"),
        (f"{HEADER}0,0.1,0.1,0\n", (), "has a single row"),
        (f"{HEADER}0,0.1,0.1,0\n1,,0.1,0\n", (), "lacks a number in line 3"),
        (f"{HEADER}0,0.1,0.1,0\n2,0.1,0.1,0\n1,0.1,0.1,0\n", (), "goes back in time in line 4"),
        (f"{HEADER}0,0.1,0.1,0\n1,1.2,0.1,0\n", (), "a slip of 1 or more in line 3"),
        (f"{HEADER}0,0.1,0.1,0\n1,x,0.1,0\n", (), "'x' is no finite number"),
        (f"{HEADER}0,0.1,0.1,0\n1,0.1,0.1,0.01\n", ("slip.sideslip=0",), "give slip.sideslip a"),
        (f"{HEADER}0,0.1,0.1,0\n1,0.2,0.1,0\n", ("slip.right=[0.2, 0.2]",), "give slip.right an"),
    ],
)
def test_what_is_no_recording_is_refused_in_one_line(tmp_path, text, more, fragment):
    path = tmp_path / "slips.csv"
    path.write_text(text)
    with pytest.raises(ValueError, match=re.escape(fragment)) as refused:
        make_problem(load_recorded(path, *more))
    assert "\n" not in str(refused.value) and "slip.recording" in str(refused.value)
    assert str(refused.value).count(path.parent.name) <= 1


@pytest.mark.parametrize(
    ("more", "fragment"),
    [
        ("slip.recording=", 'is empty, and slip.process is "recorded"'),
        ("slip.recording=nowhere.csv", "cannot be read (No such file"),
        ("slip.random=measured", 'set slip.random = "true"'),
    ],
)
def test_keys_that_do_not_go_together_are_refused(recording, more, fragment):
    path, _ = recording
    near = [f"slip.recording={path}", "slip.process=recorded", more]
    with pytest.raises(ValueError, match=re.escape(fragment)):
        load("paper", near)


def test_recorded_slips_are_not_searched(recording):
    path, _ = recording
    robot = robot_of(make_problem(load_recorded(path)))
    with pytest.raises(ValueError, match='"Recorded": is not searched; choose "iid"'):
        robot.uncertainties()


@pytest.mark.slow
def test_laps_of_a_design_meet_recorded_slips(recording):
    path, _ = recording
    design = jt.design(load_recorded(path, "reference.duration_s=1"))
    few = jt.simulate(design, "local_gain", laps=3)
    many = jt.simulate(design, "local_gain", laps=40)
    np.testing.assert_array_equal(few.errors, many.errors[:, :3])
    assert np.isfinite(many.errors).all()
