"""Laws of scenarios: an empty file is the paper's, writing and reading are inverse, a refusal is
one telling line."""

import math
import tomllib
from pathlib import Path

import msgspec
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from jaxtube.scenario import (
    Scenario,
    ScenarioError,
    check_reference_wheels,
    experiments_folder,
    load,
    names,
    replace,
    to_toml,
    weight_matrix,
)
from jaxtube.scenario.tree import RobotTable

# What the line of a refusal has to name: the key, the value as it was given, and the cure.
REFUSED_OVERRIDES = [
    (
        "controller.horizn=3",
        ["controller.horizn = 3", "unknown key", "did you mean controller.horizon?"],
    ),
    ("robot.horizon=3", ["robot.horizon = 3", "unknown key", "did you mean controller.horizon?"]),
    ("horizon=3", ["horizon = 3", "unknown section", "did you mean controller.horizon?"]),
    (
        "controler.horizon=3",
        ["controler.horizon = 3", "unknown section", "did you mean controller.horizon?"],
    ),
    ("zzzz.q=1", ["zzzz.q = 1", "unknown section", "the sections are robot, reference"]),
    ("controller=3", ["controller = 3", "must be a table", "[controller]"]),
    ("controller.horizon", ["controller.horizon", "no key and value", "controller.horizon=7"]),
    ("=3", ['"3"', "no key and value", "controller.horizon=7"]),
    ("controller.horizon=0", ["controller.horizon = 0", "whole number >= 1", "default is 5"]),
    (
        "controller.horizon=1000000",
        ["controller.horizon = 1000000", "whole number <= 200", "default is 5"],
    ),
    ("controller.horizon=5.0", ["controller.horizon = 5.0", "whole number", "default is 5"]),
    ("controller.horizon=true", ["controller.horizon = true", "whole number"]),
    ("controller.horizon=five", ['controller.horizon = "five"', "whole number"]),
    ("controller.horizon=", ['controller.horizon = ""', "whole number"]),
    ("controller.restart=1", ["controller.restart = 1", "true or false", "default is true"]),
    (
        "controller.tube=cone",
        ['controller.tube = "cone"', "choose one of paper, hull, summed, sequence"],
    ),
    ("controller.tube=3", ['controller.tube = "3"', "choose one of paper, hull, summed, sequence"]),
    ("controller.dt_s=0", ["controller.dt_s = 0", "> 0", "default is 0.1"]),
    ("controller.dt_s=1979-05-27", ["controller.dt_s = 1979-05-27", "a number"]),
    ("robot.track_width_m=-0.5", ["robot.track_width_m = -0.5", "> 0", "default is 0.5"]),
    (
        "robot.wheel_speed_min_mps=3",
        ["robot.wheel_speed_min_mps = 3", "not below", "robot.wheel_speed_max_mps"],
    ),
    (
        "reference.wheel_speed_min_mps=2",
        ["reference.wheel_speed_min_mps = 2", "not below", "lower the minimum"],
    ),
    ("reference.radius_m=0", ["reference.radius_m = 0", "> 0", "default is 2.5"]),
    ("reference.radius_m=nan", ["reference.radius_m = nan", "not finite", "finite number"]),
    ("reference.radius_m=1e999", ["reference.radius_m = inf", "not finite", "finite number"]),
    (f"reference.radius_m={10**400}", ["reference.radius_m = 1000", "out of range"]),
    ("reference.speed_mps=-1", ["reference.speed_mps = -1", "> 0"]),
    (
        "reference.speed_mps=1.45",
        ["reference.speed_mps = 1.45", "1.305 to 1.595 m/s", "[0.2, 1.5]", "widen the box"],
    ),
    (
        "reference.speed_mps=0.21",
        ["reference.speed_mps = 0.21", "0.189 to 0.231 m/s", "[0.2, 1.5]"],
    ),
    ("reference.duration_s=0", ["reference.duration_s = 0", "> 0"]),
    (
        "reference.duration_s=0.05",
        ["reference.duration_s = 0.05", "controller.dt_s = 0.1", "at least one step"],
    ),
    ("reference.shape=file", ['reference.file = ""', "is empty", "name the file"]),
    (
        "reference.file=poses.csv",
        ["reference.file = ", "is not read", "two_circles", 'set reference.shape = "file"'],
    ),
    (
        "reference.duration_s=1e9",
        ["reference.duration_s = 1000000000.0", "1e+10 steps", "1,000,000 steps", "100000 s"],
    ),
    (
        "reference.wheel_speed_min_mps=0",
        ["reference.wheel_speed_min_mps = 0", "reference stand", "above 0"],
    ),
    ("reference.duration_s=soon", ['reference.duration_s = "soon"', "a number or left out"]),
    ("slip.process=\udcff", ['slip.process = "\\udcff"', "not UTF-8", "write or rename"]),
    ("slip.\udcff=1", ["slip.\\udcff = 1", "not UTF-8"]),
    ("slip.nominal_right=1", ["slip.nominal_right = 1", "< 1", "default is 0.2"]),
    ("slip.nominal_left=-1.1", ["slip.nominal_left = -1.1", "> -1", "default is 0.2"]),
    ("slip.right=[0.1, 0.3]", ["slip.right = [0.1, 0.3]", "without slip.left", "both"]),
    ("slip.measurement_error=0.1", ["slip.measurement_error = 0.1", "intervals"]),
    ("slip.change_per_s=0.05", ["slip.change_per_s = 0.05", "interval is not given", "slip.right"]),
    ("slip.change_per_s=0", ["slip.change_per_s = 0", "> 0"]),
    ("slip.nominal_left=0.95", ["slip.nominal_left = 0.95", "1.045", "below 1"]),
    ("slip.relative_error=1", ["slip.relative_error = 1", "< 1", "default is 0.1"]),
    ("constraints.lateral_m=0", ["constraints.lateral_m = 0", "> 0", "default is 0.3"]),
    ("constraints.heading_deg=90", ["constraints.heading_deg = 90", "< 90", "default is 20"]),
    ("disturbance.lateral_m=-1e-3", ["disturbance.lateral_m = -0.001", ">= 0", "default is 0.005"]),
    ("noise.heading_deg=-1", ["noise.heading_deg = -1", ">= 0", "default is 0"]),
    ("initial.x_m=inf", ["initial.x_m = inf", "not finite"]),
    (
        "controller.error_weight=[1, 1]",
        ["controller.error_weight = [1.0, 1.0]", "shape", "3 diagonal entries"],
    ),
    (
        "controller.error_weight=[1, 1, [1]]",
        ["controller.error_weight", "shape", "3 diagonal entries"],
    ),
    ("controller.error_weight=[1, 1, nan]", ["controller.error_weight[2] = nan", "not finite"]),
    (
        "controller.error_weight=[1, 1, 'a']",
        ['controller.error_weight[2] = "a"', "a number", "default is [1.0, 1.0"],
    ),
    (
        "controller.error_weight=[1, 1, -0.5]",
        ["controller.error_weight", "semidefinite", "eigenvalue is -0.5", "raise"],
    ),
    (
        "controller.input_weight=[1, 0]",
        ["controller.input_weight", "positive definite", "eigenvalue is 0", "raise"],
    ),
    (
        "controller.input_weight=[[1, 2], [2, 1]]",
        ["controller.input_weight", "positive definite", "is -1", "raise"],
    ),
    (
        "controller.input_weight=[[1, 2], [0, 1]]",
        ["controller.input_weight", "not symmetric", "symmetric matrix"],
    ),
]

REFUSED_FILES = [
    ("[controller]\nhorizon =\n", ["line 2", "not TOML", "correct this line"]),
    ("[controller]\nhorizon = 5\nhorizon = 6\n", ["line 3", "not TOML", "correct this line"]),
    ("[controller\n", ["line 1", "not TOML", "correct this line"]),
    (f"x = {'9' * 5000}", ["line 1", "not TOML"]),
    (f"x = {'[' * 5000}", ["line 1", "not TOML"]),
    ("controller = 3", ["controller = 3", "must be a table"]),
    ("[controller]\nhorizon = 'five'", ['controller.horizon = "five"', "must be a whole number"]),
    ("[slip]\nrandom = true", ["slip.random = true", "must be text", 'default is "true"']),
    ("[[controller]]\nhorizon = 5", ["controller = [{horizon = 5}]", "must be a table"]),
    (
        '[controller]\n"hor\\nizon" = 5',
        ["controller.hor izon = 5", "unknown key", "did you mean controller.horizon?"],
    ),
    (
        "[reference]\nshape = 'file'\nfile = 'no-such.csv'",
        [
            "reference.file",
            "No such file",
            "name a readable file",
            "the folder of the scenario file, in an override at the current folder",
        ],
    ),
]


def refusal_of(*arguments) -> str:
    with pytest.raises(ScenarioError) as caught:
        load(*arguments)
    return str(caught.value)


SCENARIOS = st.builds(
    lambda width, position, weight, text, flag: Scenario(
        robot=msgspec.structs.replace(Scenario().robot, track_width_m=width),
        initial=msgspec.structs.replace(Scenario().initial, x_m=position, heading_deg=-position),
        controller=msgspec.structs.replace(
            Scenario().controller, error_weight=weight, restart=flag
        ),
        reference=msgspec.structs.replace(Scenario().reference, file="/" + text),
    ),
    st.floats(0, 0.5, exclude_min=True),
    st.floats(allow_nan=False, allow_infinity=False),
    st.sampled_from([(1.0, 2.0, 3.0), ((2.0, 1.0, 0.0), (1.0, 2.0, 0.0), (0.0, 0.0, 1e-30))]),
    st.text(st.characters(blacklist_categories=["Cs"], blacklist_characters="/\\\0"), min_size=3),
    st.booleans(),
)


def test_an_empty_file_is_the_experiment_of_the_paper(tmp_path):
    (tmp_path / "empty.toml").write_text("")
    assert load(tmp_path / "empty.toml") == load("paper") == Scenario()


def test_the_file_of_the_paper_spells_every_key_and_comments_it():
    text = (experiments_folder() / "paper" / "scenario.toml").read_text()
    written = [
        line.split("  # ")
        for line in text.splitlines()
        if " = " in line and not line.startswith("#")
    ]
    expected = [line for line in to_toml(Scenario()).splitlines() if " = " in line]
    assert [line[0] for line in written] == expected
    assert all(len(line) == 2 for line in written)


@given(scenario=SCENARIOS)
def test_writing_and_reading_are_inverse(scenario, tmp_path_factory):
    path = tmp_path_factory.getbasetemp() / "round-trip.toml"
    path.write_text(to_toml(scenario), encoding="utf-8")
    with path.open("rb") as file:
        assert msgspec.convert(tomllib.load(file), Scenario) == scenario
    named = msgspec.structs.replace(scenario.reference, file="")
    scenario = msgspec.structs.replace(scenario, reference=named)
    path.write_text(to_toml(scenario), encoding="utf-8")
    assert load(path) == scenario


@pytest.mark.parametrize("name", names())
def test_every_scenario_of_the_project_is_valid(name):
    assert isinstance(load(name), Scenario)


def test_overrides_replace_single_keys():
    scenario = load(
        "paper",
        [
            "controller.horizon=7",
            "controller.tube=hull",
            'reference.shape="lemniscate"',
            "slip.random=true",
        ],
    )
    assert (scenario.controller.horizon, scenario.controller.tube) == (7, "hull")
    assert (scenario.reference.shape, scenario.slip.random) == ("lemniscate", "true")
    assert scenario.robot == Scenario().robot


def test_a_byte_order_mark_is_skipped(tmp_path):
    text = to_toml(Scenario())
    (tmp_path / "marked.toml").write_text(text, encoding="utf-8-sig")
    assert load(tmp_path / "marked.toml") == Scenario()


def test_refusals_can_be_printed_whatever_the_name():
    for name in ("\udcff", "\udcff.toml"):
        line = refusal_of(name)
        line.encode("utf-8")
        assert "\\udcff" in line


def test_periods_too_many_are_refused_by_their_number():
    line = refusal_of("paper", ["controller.dt_s=1e-9"])
    assert "reference.duration_s = 30.0" in line and "1,000,000 steps at most, 0.001 s" in line


def test_a_recording_runs_for_as_long_as_it_is_unless_a_duration_is_given(tmp_path):
    file = tmp_path / "poses.csv"
    file.write_text("")
    overrides = ["reference.shape=file", f"reference.file={file}"]
    assert load("paper", overrides).reference.duration_s is None
    assert load("paper", [*overrides, "reference.duration_s=20"]).reference.duration_s == 20.0
    own = tmp_path / "own.toml"
    own.write_text('[reference]\nshape = "file"\nfile = "poses.csv"\nduration_s = 30.0\n')
    assert load(own).reference.duration_s == 30.0
    recorded = replace(Scenario(), {"reference.shape": "file", "reference.file": str(file)})
    assert recorded.reference.duration_s is None
    (tmp_path / "again.toml").write_text(to_toml(recorded))
    assert load(tmp_path / "again.toml") == recorded


def test_values_are_replaced_by_dotted_keys_and_validated():
    values = {
        "controller.horizon": 7,
        "controller.error_weight": np.diag([1.0, 2.0, 3.0]),
        "slip.relative_error": np.float64(0.3),
        "noise": load("certified").noise,
        "operating.heading_deg": None,
    }
    scenario = replace(Scenario(), values)
    assert scenario.controller.horizon == 7
    assert scenario.controller.error_weight == ((1.0, 0.0, 0.0), (0.0, 2.0, 0.0), (0.0, 0.0, 3.0))
    assert scenario.slip.relative_error == 0.3
    assert scenario.noise == load("certified").noise
    assert scenario.robot == Scenario().robot
    assert replace(scenario, {}) == scenario
    assert Scenario().controller.horizon == 5


@pytest.mark.parametrize(
    "values, fragments",
    [
        ({"controller.horizn": 7}, ["override: controller.horizn = 7", "did you mean"]),
        ({"slip.nominal_left": 0.95}, ["override: slip.nominal_left = 0.95", "below 1"]),
        ({"slip.process": 3}, ["override: slip.process = 3", "text"]),
    ],
)
def test_replaced_values_are_refused_as_those_of_files(values, fragments):
    with pytest.raises(ScenarioError) as caught:
        replace(Scenario(), values)
    assert [fragment for fragment in fragments if fragment not in str(caught.value)] == []


def test_the_later_override_wins():
    assert load("paper", ["controller.horizon=7", "controller.horizon=8"]).controller.horizon == 8


@pytest.mark.parametrize(("override", "fragments"), REFUSED_OVERRIDES)
def test_refused_overrides_name_key_value_and_cure_in_one_line(override, fragments):
    line = refusal_of("paper", [override])
    source = "paper" if override == "reference.shape=file" else "override"
    assert line.startswith(f"{source}: ")
    assert "\n" not in line and "; " in line
    assert [fragment for fragment in fragments if fragment not in line] == []


@pytest.mark.parametrize(("text", "fragments"), REFUSED_FILES)
def test_refused_files_name_file_key_value_and_cure_in_one_line(text, fragments, tmp_path):
    path = tmp_path / "wrong.toml"
    path.write_text(text)
    line = refusal_of(path)
    assert line.startswith(f"{path}: ")
    assert "\n" not in line and "; " in line
    assert [fragment for fragment in fragments if fragment not in line] == []


def test_files_that_cannot_be_read_are_refused(tmp_path):
    (tmp_path / "latin.toml").write_bytes(b"# \xe9\n")
    (tmp_path / "folder.toml").mkdir()
    assert "not UTF-8" in refusal_of(tmp_path / "latin.toml")
    assert "Is a directory" in refusal_of(tmp_path / "folder.toml")
    assert "No such file" in refusal_of(tmp_path / "missing.toml")
    assert "choose one of" in refusal_of("no-such-scenario")


def test_a_path_starts_at_the_scenario_file_and_in_an_override_at_the_current_folder(
    tmp_path, monkeypatch
):
    (tmp_path / "poses.csv").write_text("")
    (tmp_path / "mine.toml").write_text('[reference]\nshape = "file"\nfile = "poses.csv"\n')
    assert Path(load(tmp_path / "mine.toml").reference.file) == tmp_path / "poses.csv"
    monkeypatch.chdir(tmp_path)
    overridden = load("paper", ["reference.shape=file", "reference.file=poses.csv"])
    assert Path(overridden.reference.file) == tmp_path / "poses.csv"


def test_reference_wheels_on_the_edge_of_the_box_are_inside():
    assert load("paper", [f"reference.speed_mps={1.5 / 1.1!r}"])
    check_reference_wheels(Scenario(), 0.2, 1.5)
    check_reference_wheels(Scenario(), 0.2 - 1e-10, 1.5 + 1e-10)


@pytest.mark.parametrize(
    ("slowest", "fastest"), [(0.19, 1.0), (0.3, 1.51), (math.nan, 1.0), (0.3, math.nan)]
)
def test_reference_wheels_outside_the_box_are_refused(slowest, fastest):
    with pytest.raises(
        ScenarioError,
        match=r"^scenario: reference.speed_mps = 1.36: .*outside .*; change the speed",
    ):
        check_reference_wheels(Scenario(), slowest, fastest)


def test_a_weight_is_its_diagonal_or_its_rows():
    np.testing.assert_array_equal(weight_matrix((1.0, 2.0)), [[1, 0], [0, 2]])
    np.testing.assert_array_equal(weight_matrix(((1.0, 2.0), (2.0, 5.0))), [[1, 2], [2, 5]])


def test_singular_error_weights_are_allowed():
    assert load("paper", ["controller.error_weight=[[1, 1, 0], [1, 1, 0], [0, 0, 0]]"])
    assert load("paper", ["controller.error_weight=[0, 0, 0]"])


@pytest.mark.parametrize("name", names())
def test_a_scenario_shows_what_differs_from_the_defaults(name, tmp_path):
    scenario = load(name, "reference.duration_s=6")
    path = tmp_path / "shown.toml"
    path.write_text(str(scenario))
    assert load(path) == scenario
    assert "duration_s = 6.0" in repr(scenario)
    assert "null" not in repr(scenario)
    is_usual = scenario.robot.track_width_m == RobotTable().track_width_m
    assert ("track_width_m" in repr(scenario)) != is_usual


def test_the_defaults_show_as_one_line():
    assert repr(Scenario()) == "# a scenario; keys left out have the defaults"


def test_a_single_override_is_a_text():
    assert load("paper", "controller.horizon=7") == load("paper", ["controller.horizon=7"])


def test_an_unknown_name_is_refused_with_the_names_there_are():
    with pytest.raises(ScenarioError, match='scenario: name = "papr": no scenario has') as told:
        load("papr")
    assert all(name in str(told.value) for name in names())
