"""Laws of `--scenario FOLDER`: a saved design is used as it is, a run stands for its scenario, and
what was changed there is refused in one line."""

import dataclasses
import shutil

import pytest

from jaxtube.experiments.cli import main
from jaxtube.experiments.options import DesignOptions, MontecarloOptions, title
from jaxtube.experiments.run import designing
from jaxtube.experiments.run.designing import identify_restored, make_design
from jaxtube.experiments.run.folder import create
from jaxtube.scenario import load

SHORT = "reference.duration_s=1"


@pytest.fixture(scope="module")
def saved(uncertified, tmp_path_factory):
    return uncertified("certified", SHORT).save(tmp_path_factory.mktemp("saved") / "design")


@pytest.fixture
def origins(monkeypatch):
    """Tell instead of designing whether a design is read or made."""
    monkeypatch.setattr(designing, "design", lambda scenario: "made")
    monkeypatch.setattr(designing, "read", lambda folder: restored)
    restored = object.__new__(designing.Design)
    return {"read": restored, "made": "made"}


def test_a_saved_design_is_read_where_nothing_is_overridden(saved, origins):
    options = DesignOptions(scenario=str(saved))
    scenario = load(saved)
    assert make_design(scenario, options) is origins["read"]
    assert make_design(scenario) == origins["made"]
    overridden = dataclasses.replace(options, overrides=("controller.horizon=4",))
    assert make_design(scenario, overridden) == origins["made"]
    assert make_design(scenario, DesignOptions(scenario="certified")) == origins["made"]


def test_a_scenario_of_the_project_goes_before_a_folder_of_its_name(
    saved, origins, tmp_path, monkeypatch
):
    shutil.copytree(saved, tmp_path / "paper")
    monkeypatch.chdir(tmp_path)
    options = DesignOptions(scenario="paper")
    assert make_design(load("paper"), options) == origins["made"]
    assert make_design(load("./paper/"), DesignOptions(scenario="./paper/")) is origins["read"]


def test_a_run_stands_for_its_scenario_unless_it_was_changed(tmp_path, capsys):
    scenario = load("certified", SHORT)
    folder = create(scenario, DesignOptions(out=str(tmp_path / "run")))
    folder.save_metrics({})
    assert load(folder.path) == scenario
    assert main(["list", "--scenario", str(folder.path)]) == 0
    assert capsys.readouterr().out.startswith(str(folder.path))
    text = (folder.path / "scenario.toml").read_text()
    (folder.path / "scenario.toml").write_text(text.replace("horizon = 5", "horizon = 6"))
    assert "scenario.toml was changed" in refuse(capsys, folder.path)
    (folder.path / "scenario.toml").unlink()
    assert "cannot be read" in refuse(capsys, folder.path)
    for content in (b"{", b"[]", b"{}", b"[" * 100_000, b'{"scenario_sha256": 3}', b"\xff"):
        (folder.path / "scenario.toml").write_text(text)
        (folder.path / "manifest.json").write_bytes(content)
        refuse(capsys, folder.path)


def test_a_folder_without_a_scenario_is_refused_with_the_cure(tmp_path, capsys):
    assert "name a saved result, the folder of a run" in refuse(capsys, tmp_path)


def test_a_damaged_design_is_refused_by_commands(saved, tmp_path, capsys):
    folder = shutil.copytree(saved, tmp_path / "design")
    data = (folder / "arrays.npz").read_bytes()
    (folder / "arrays.npz").write_bytes(data[:-1])
    assert "arrays.npz differs from what was written" in refuse(capsys, folder)


def refuse(capsys, folder) -> str:
    """Return the one line with which a command refuses a folder."""
    assert main(["list", "--scenario", str(folder)]) == 2
    output = capsys.readouterr()
    assert output.out == "" and output.err.count("\n") == 1
    return output.err


@pytest.mark.parametrize(
    ("scenario", "name"),
    [
        ("runs/design-certified/design", "design-certified"),
        ("runs/design-certified", "design-certified"),
        ("my_design", "my_design"),
        ("../elsewhere/my_design/", "my_design"),
        ("certified", "certified"),
        ("a/b.toml", "b"),
    ],
)
def test_a_folder_of_runs_is_named_after_the_folder_that_is_given(scenario, name):
    assert title(scenario) == name
    folder = MontecarloOptions(scenario=scenario).folder
    assert folder.parts == ("runs", f"montecarlo-{name}")


def test_laps_of_a_restored_design_are_not_mixed_with_those_of_its_scenario(uncertified):
    made = uncertified("certified", SHORT)
    arrays = made.arrays()
    restored = made.with_arrays(arrays)
    known = identify_restored(restored)
    assert identify_restored(made) == {} and known.keys() == {"saved_design_sha256"}
    assert identify_restored(made.with_arrays(arrays)) == known
    other = {**arrays, "tube_qps/lower": arrays["tube_qps/lower"] * (1 + 1e-15)}
    assert identify_restored(made.with_arrays(other)) != known


def test_the_report_of_a_design_names_its_folder(tmp_path):
    from jaxtube.experiments.design.command import describe_saved

    said = describe_saved(tmp_path / "a b")
    assert f"--scenario '{tmp_path / 'a b'}'" in said
