"""Laws of results in folders: what is saved is what is read, and damage is told in one line."""

import json

import numpy as np
import pytest

import jaxtube as jt
from jaxtube import results, sealed, storage
from jaxtube.storage import writing

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

    def restore(scenario, arrays):
        storage.refuse_differences(arrays, design.arrays())
        return make(scenario).with_arrays(arrays)

    monkeypatch.setattr(results, "design", make)
    monkeypatch.setattr(results, "restore_design", restore)


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
    again = jt.read(jt.save(design, tmp_path))
    assert again.arrays().keys() == design.arrays().keys()
    for name, array in design.arrays().items():
        assert again.arrays()[name].tobytes() == array.tobytes(), name


def rewrite(folder, **changed):
    """Put other arrays or facts into a result as one who knows the format does: hashes fit."""
    facts = sealed.unseal((folder / "result.json").read_bytes())
    with np.load(folder / "arrays.npz") as file:
        arrays = dict(file) | changed.pop("arrays", {})
    np.savez(folder / "arrays.npz", **arrays)
    digest = sealed.hash_bytes((folder / "arrays.npz").read_bytes())
    files = {**facts["files"], "arrays.npz": digest}
    (folder / "result.json").write_bytes(sealed.seal({**facts, "files": files, **changed}))


@pytest.mark.parametrize("change", [1e-3, 1e-8, np.nan])
def test_arrays_that_are_not_those_of_the_scenario_are_refused(
    tmp_path, design, quick_designs, change
):
    design.save(tmp_path)
    for name, array in design.arrays().items():
        if array.dtype.kind == "f" and array.size:
            other = array.copy()
            other.flat[0] += change * max(abs(float(array.flat[0])), 1.0) * 10
            rewrite(tmp_path, arrays={name: other})
            if np.isfinite(array.flat[0]):
                told = refuse(jt.read, tmp_path)
                assert "differs from that of the scenario designed again" in told, name
            rewrite(tmp_path, arrays={name: array})
    assert jt.read(tmp_path).arrays().keys() == design.arrays().keys()


def refuse(function, *arguments) -> str:
    """Return the one line with which a folder is refused."""
    with pytest.raises(jt.ScenarioError) as told:
        function(*arguments)
    assert "\n" not in str(told.value)
    return str(told.value)


def test_damaged_and_foreign_folders_are_refused_in_one_line(tmp_path, laps, quick_designs):
    assert "does not exist" in refuse(jt.read, tmp_path / "nowhere")
    assert "holds no result.json" in refuse(jt.read, tmp_path)
    laps.save(tmp_path)
    assert "is a file" in refuse(jt.read, tmp_path / "result.json")
    facts = sealed.unseal((tmp_path / "result.json").read_bytes())
    (tmp_path / "result.json").write_bytes(sealed.seal({**facts, "schema": 99}))
    assert "of another version" in refuse(jt.read, tmp_path)
    (tmp_path / "result.json").write_bytes(sealed.seal({**facts, "kind": "cake"}))
    assert "'cake', which is unknown" in refuse(jt.read, tmp_path)
    (tmp_path / "result.json").write_text(json.dumps(facts))
    assert "is damaged: result.json differs from what was written" in refuse(jt.read, tmp_path)
    for text in ("{", "3", "{}", "[" * 100_000):
        (tmp_path / "result.json").write_text(text)
        assert "is damaged: result.json" in refuse(jt.read, tmp_path)
    del facts["seed"]
    (tmp_path / "result.json").write_bytes(sealed.seal(facts))
    assert "is damaged: it lacks a part" in refuse(jt.read, tmp_path)
    (tmp_path / "arrays.npz").write_bytes(b"no archive")
    assert "is damaged: arrays.npz differs from what was written" in refuse(jt.read, tmp_path)
    digest = sealed.hash_bytes(b"no archive")
    forged = {**facts, "files": {**facts["files"], "arrays.npz": digest}}
    (tmp_path / "result.json").write_bytes(sealed.seal(forged))
    assert "is damaged: arrays.npz is no archive of arrays" in refuse(jt.read, tmp_path)
    (tmp_path / "arrays.npz").unlink()
    assert "is damaged: arrays.npz cannot be read" in refuse(jt.read, tmp_path)


def test_a_run_folder_of_the_command_line_is_named_with_what_to_do(tmp_path):
    for name in ("manifest.json", "scenario.toml"):
        (tmp_path / name).touch()
    told = refuse(jt.read, tmp_path)
    assert "is a run folder of the command line; give jt.design(jt.load(" in told


def test_a_save_replaces_a_result_of_its_kind_alone(tmp_path, design, laps, quick_designs):
    laps.save(tmp_path)
    (tmp_path / ".arrays.npz.1234").touch()  # left by a process that was killed
    fewer = jt.Laps(design, "other", "robot", 0, laps.trajectory)
    assert jt.read(fewer.save(tmp_path)).controller == "other"
    assert "holds 'laps', another kind" in refuse(design.save, tmp_path)
    assert jt.read(tmp_path).controller == "other"


@pytest.mark.parametrize("name", ["notes.txt", "scenario.toml"])
def test_a_save_overwrites_no_files_of_the_user(tmp_path, design, name):
    (tmp_path / name).write_text("mine")
    told = refuse(design.save, tmp_path)
    assert f"holds files that no result has saved ({name}); name a new or an empty folder" in told
    assert "cannot be written" in refuse(design.save, tmp_path / name)
    assert (tmp_path / name).read_text() == "mine"
    assert [path.name for path in tmp_path.iterdir()] == [name]


@pytest.mark.parametrize("name", ["scenario.toml", "arrays.npz", "result.json"])
def test_a_save_that_is_broken_off_is_told_and_can_be_made_again(
    tmp_path, design, laps, quick_designs, monkeypatch, name
):
    laps.save(tmp_path)
    write = writing.write_atomically
    written = []

    def break_off(path, write_content):
        if path.name == name and len(written) > 0:
            raise KeyboardInterrupt
        written.append(path.name)
        write(path, write_content)

    other = jt.Laps(design, "other", "robot", 0, laps.trajectory)
    monkeypatch.setattr(writing, "write_atomically", break_off)
    with pytest.raises(KeyboardInterrupt):
        other.save(tmp_path)
    assert "holds a 'laps' whose saving was broken off" in refuse(jt.read, tmp_path)
    monkeypatch.undo()
    other.save(tmp_path)
    assert storage.read_result(tmp_path).facts["controller"] == "other"


def test_results_draw_themselves(design, laps):
    assert design.plot("certified").axes
    other = jt.Laps(design, "own", "robot", 0, laps.trajectory)
    assert laps.plot(other).axes
    with pytest.raises(ValueError, match="one name"):
        laps.plot(laps)
