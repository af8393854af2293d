"""Laws of certificates of a model alone, of slips that are measured and of slips that are learnt:
they pass, and what promises more is refused."""

import json
from fractions import Fraction

import pytest
from certificate_mutants import change, is_accepted, survey_mutants
from certificate_oracle import holds_in_floats

import jaxtube as jt
from jaxtube.synthesis.proof_file import write_certificate
from jaxtube.synthesis.proof_search import PROGRAMS, load_checker

SHORT = ["reference.certified_for=path", "reference.duration_s=1.2", "controller.horizon=2"]
MIXED = ["controller.model=consistent", "controller.tracking_gains=[]", "slip.relative_error=0.05"]
MEASURED = [*SHORT, "slip.right=[0.1,0.3]", "slip.left=[0.1,0.3]", "robot.wheel_speed_max_mps=3.6"]
MEASURED += ["slip.measurement_error=0.005", "slip.measurement_error_relative=0.05"]


def write(name, overrides, folder):
    """Return the certificate of a scenario as JSON."""
    design = jt.design(jt.load(name, overrides))
    return json.loads(write_certificate(design, folder, name).read_text())


@pytest.fixture(scope="module")
def modelled(tmp_path_factory):
    overrides = ["reference.duration_s=1.2", "controller.horizon=2"]
    return write("robust", overrides, tmp_path_factory.mktemp("modelled"))


@pytest.fixture(scope="module")
def measured(tmp_path_factory):
    return write("certified", MEASURED, tmp_path_factory.mktemp("measured"))


@pytest.fixture(scope="module")
def learnt(tmp_path_factory):
    return write("certified_learning", SHORT, tmp_path_factory.mktemp("learnt"))


def test_gains_of_an_lmi_are_checked_for_the_model_alone(modelled, tmp_path, capsys):
    assert modelled["model"] and "sets" not in modelled
    assert is_accepted(modelled, tmp_path, capsys)
    assert holds_in_floats(modelled)


def test_what_is_proved_of_a_model_alone_says_that_w_is_assumed(modelled, tmp_path, capsys):
    program = load_checker(PROGRAMS[0])
    said = [*program.list_assumptions(program.read(modelled))]
    assert any("w lies in W" in sentence for sentence in said)
    assert not any("w lies in W" in sentence for sentence in program.check(program.read(modelled)))
    path = tmp_path / "certificate.json"
    path.write_text(json.dumps(modelled))
    assert program.main(str(path)) == 0
    assert "for its linear model alone" in capsys.readouterr().out.splitlines()[-1]


@pytest.mark.parametrize(
    ("path", "by"),
    [
        (("model", "turning", 0), lambda share: share * 1001 / 1000),
        (("bands", 0, "disturbance", "box", 1), lambda width: width * 10001 / 10000),
        (("bands", 0, "disturbance", "yaw"), lambda _: Fraction(1, 100)),
        (("bands", 0, "disturbance", "yaw"), lambda _: Fraction(-1, 100)),
        (("bands", 0, "errors", 1), lambda cap: cap * 1000001 / 1000000),
        (("bands", 0, "errors", 1), lambda cap: cap * 999999 / 1000000),
        (("bands", 0, "inputs", 0, "high"), lambda cap: cap * 999999 / 1000000),
        (("bands", 0, "inputs", 1, "low"), lambda cap: cap * 1000001 / 1000000),
        (("bands", 0, "inputs", 0, "on_u2"), lambda half: half * 1000001 / 1000000),
        (("bands", 0, "gains", 0, "K", 3, 1, 1), lambda gain: 30 * gain),
        (("bands", 0, "gains", 0, "G", 0, 1, 1), lambda gain: gain * 9 / 10),
        (("bands", 0, "regions", 0, 0), lambda speed: speed + Fraction(1, 10)),
        (("wheel_speeds", 1), lambda speed: speed * 999999 / 1000000),
        (("slips", "left", 1, 3), lambda slip: slip * 1000001 / 1000000),
        (("cost", "P", 1, 1), lambda weight: weight * 9 / 10),
        (("plans", "tolerance"), lambda tolerance: tolerance * 10000),
        (("plans", "windows", 0, "upper", 3), lambda bound: bound * 1000001 / 1000000),
        (("plans", "windows", 0, "speeds", 0, 0), lambda speed: speed * 1000001 / 1000000),
    ],
)
def test_more_than_is_proved_of_a_model_is_refused(path, by, modelled, tmp_path, capsys):
    assert not is_accepted(change(modelled, *path, by=by), tmp_path, capsys)


def test_slips_that_are_measured_are_checked(measured, tmp_path, capsys):
    assert is_accepted(measured, tmp_path, capsys)
    for index in (0, 1):
        wider = change(measured, "measured", "right", index, by=lambda error: error * 11 / 10)
        assert not is_accepted(wider, tmp_path, capsys)


@pytest.mark.slow
def test_gains_of_an_lmi_are_checked_for_the_robot(tmp_path, capsys):
    mixed = write("certified", [*MIXED, "reference.duration_s=1.2"], tmp_path)
    assert is_accepted(mixed, tmp_path, capsys)
    for key, by in (("yaw", Fraction(9, 10)), ("yaw", Fraction(11, 10)), ("lean", Fraction(2))):
        changed = change(mixed, "bands", 0, "disturbance", key, by=lambda width, by=by: width * by)
        assert not is_accepted(changed, tmp_path, capsys)
    for width in (0, 1):
        changed = change(mixed, "bands", 0, "disturbance", "box", width, by=lambda w: w * 9 / 10)
        assert not is_accepted(changed, tmp_path, capsys)
    changed = change(mixed, "model", "turning", 0, by=lambda share: share * 9 / 10)
    assert not is_accepted(changed, tmp_path, capsys)
    del mixed["bands"][0]["cells"]
    assert not is_accepted(mixed, tmp_path, capsys)


@pytest.mark.slow
def test_slips_that_are_learnt_are_checked(learnt, tmp_path, capsys):
    assert [band["age"] for band in learnt["bands"]] == ["0", "1", "2"]
    assert is_accepted(learnt, tmp_path, capsys)
    assert holds_in_floats(learnt)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("path", "by"),
    [
        (("bands", 2, "losses", 0), lambda loss: loss * 99 / 100),
        (("bands", 1, "losses", 1), lambda loss: loss * 11 / 10),
        (("bands", 0, "losses", 0), lambda loss: loss * 999999 / 1000000),
        (("bands", 1, "age"), lambda age: age + 1),
        (("bands", 2, "disturbance", "yaw"), lambda yaw: yaw * 99 / 100),
        (("learning", "change"), lambda change: change * 11 / 10),
        (("learning", "change"), lambda change: -change),
        (("learning", "periods"), lambda periods: periods + 1),
        (("learning", "periods"), lambda periods: periods - 1),
        (("learning", "speeds", "right", 0), lambda speed: speed * 11 / 10),
        (("learning", "speeds", "right", 0), lambda speed: -speed),
        (("learning", "speeds", "left", 1), lambda speed: speed * 99 / 100),
        (("noise", 0), lambda noise: noise * 11 / 10),
        (("noise", 2), lambda noise: noise * 11 / 10),
        (("slips", "right", 0, 1), lambda slip: slip * 1000001 / 1000000),
    ],
)
def test_more_than_is_proved_of_what_is_learnt_is_refused(path, by, learnt, tmp_path, capsys):
    assert not is_accepted(change(learnt, *path, by=by), tmp_path, capsys)


@pytest.mark.slow
def test_plans_that_skip_the_first_periods_of_learning_are_refused(learnt, tmp_path, capsys):
    changed = json.loads(json.dumps(learnt))
    del changed["plans"]["sequence"][0]
    assert not is_accepted(changed, tmp_path, capsys)
    del changed["plans"]
    assert not is_accepted(changed, tmp_path, capsys)


@pytest.mark.slow
def test_changed_certificates_of_other_kinds_are_refused_or_hold_as_well(
    modelled, learnt, tmp_path, capsys
):
    survey_mutants(modelled, range(150), tmp_path, capsys)
    survey_mutants(learnt, range(150), tmp_path, capsys)
