"""Laws of results in folders: what is saved is what is read, and damage is told in one line."""

import json

import numpy as np
import pytest

import jaxtube as jt
from jaxtube import results

SHORT = "reference.duration_s=1"


@pytest.fixture(scope="module")
def design(uncertified):
    return uncertified("certified", SHORT)


@pytest.fixture
def quick_designs(monkeypatch, design):
    """Hand out the design of these tests where a scenario is designed again."""

    def make(scenario):
        assert scenario == design.problem.scenario
        return design

    monkeypatch.setattr(results, "design", make)


@pytest.fixture(scope="module")
def laps(design):
    return jt.simulate(design, "local_gain", laps=3)


def test_laps_are_read_as_they_were_saved(tmp_path, laps, quick_designs):
    again = jt.read(laps.save(tmp_path / "laps"))
    assert repr(again) == repr(laps)
    for name, values in laps.trajectory._asdict().items():
        if name != "diagnostics":
            np.testing.assert_array_equal(getattr(again.trajectory, name), values)
    for name, values in laps.trajectory.diagnostics._asdict().items():
        np.testing.assert_array_equal(getattr(again.trajectory.diagnostics, name), values)


def test_a_design_is_read_as_it_was_saved(tmp_path, design, quick_designs):
    again = jt.read(design.save(tmp_path))
    assert again.arrays().keys() == design.arrays().keys()


def test_a_design_that_comes_out_differently_is_refused(tmp_path, design, quick_designs):
    design.save(tmp_path)
    with np.load(tmp_path / "arrays.npz") as file:
        arrays = dict(file)
    name = max(arrays, key=lambda key: arrays[key].size)
    arrays[name] = arrays[name] + 1e-3
    np.savez(tmp_path / "arrays.npz", **arrays)
    with pytest.raises(jt.ScenarioError, match="differs from that of the scenario designed again"):
        jt.read(tmp_path)


def test_damaged_and_foreign_folders_are_refused_in_one_line(tmp_path, laps, quick_designs):
    def refusal() -> str:
        with pytest.raises(jt.ScenarioError) as told:
            jt.read(tmp_path)
        assert "\n" not in str(told.value)
        return str(told.value)

    assert "cannot be read" in refusal()
    laps.save(tmp_path)
    facts = json.loads((tmp_path / "result.json").read_text())
    (tmp_path / "result.json").write_text(json.dumps({**facts, "schema": 99}))
    assert "of another version" in refusal()
    (tmp_path / "result.json").write_text(json.dumps({**facts, "kind": "cake"}))
    assert "'cake', which is unknown" in refusal()
    (tmp_path / "result.json").write_text("{")
    assert "is damaged" in refusal()
    laps.save(tmp_path)
    (tmp_path / "arrays.npz").write_bytes(b"no archive")
    assert "is damaged" in refusal()


def test_results_draw_themselves(design, laps):
    assert design.plot("certified").axes
    other = jt.Laps(design, "own", "robot", 0, laps.trajectory)
    assert laps.plot(other).axes
    with pytest.raises(ValueError, match="one name"):
        laps.plot(laps)
