"""Laws of `certificate.json` and its checker: what is certified passes, what is changed is refused
or holds as well, and what is damaged is refused in one line."""

import json
import subprocess
import sys
from fractions import Fraction

import msgspec
import pytest
from certificate_mutants import change, is_accepted, survey_mutants
from certificate_oracle import holds_in_floats

import jaxtube as jt
from jaxtube.synthesis import disturbance
from jaxtube.synthesis.proof_file import FILE, describe_proof, write_certificate
from jaxtube.synthesis.proof_search import PROGRAMS, load_checker

SHORT = ["reference.certified_for=path", "reference.duration_s=12.5", "controller.horizon=2"]
"""Of `certified`: two pairs of speeds, three windows, small QPs."""
JUMPING = ["reference.shape=jumps", "reference.jump_seed=11"]
JUMPING += ["reference.duration_s=1.8", "controller.horizon=2"]
"""Of `certified_wide`: a few pairs of speeds, small QPs."""
SPEEDS = (1.0, 1.3)
"""Of wheels there, m/s: in the two fastest bands."""
LOOSE = 0.1
"""Relative gap of W: few cells prove it."""
FASTER = ["robot.wheel_speed_max_mps=3.2"]
"""Wheels that can do what a loose bound says they may be asked for."""


def write_loosely(scenario, folder, name):
    """Write the certificate of a scenario whose W are not the least; return its folder."""
    tight = disturbance.disturbance_bound
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(disturbance, "disturbance_bound", lambda *args: tight(*args, LOOSE))
        disturbance._answer.cache_clear()
        path = write_certificate(jt.design(scenario), folder, name)
    disturbance._answer.cache_clear()
    return path.parent


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A folder with a small certificate and the programs that check it."""
    scenario = jt.load("certified", [*SHORT, *FASTER])
    return write_loosely(scenario, tmp_path_factory.mktemp("proof"), "small")


@pytest.fixture(scope="module")
def banded(tmp_path_factory):
    """The certificate as JSON of a small design with two bands, from one into the other of which
    its reference jumps."""
    scenario = jt.load("certified_wide", [*JUMPING, *FASTER])
    change = msgspec.structs.replace
    low, high = SPEEDS
    slow, fast = scenario.operating.bands[4:]
    bands = (slow, change(fast, below_mps=high))
    scenario = change(
        scenario,
        operating=change(scenario.operating, bands=bands),
        reference=change(scenario.reference, wheel_speed_min_mps=low, wheel_speed_max_mps=high),
    )
    folder = write_loosely(scenario, tmp_path_factory.mktemp("banded"), "banded")
    return json.loads((folder / FILE).read_text())


@pytest.fixture(scope="module")
def written(folder):
    """The certificate as JSON."""
    return json.loads((folder / FILE).read_text())


def test_a_stranger_checks_what_was_written_without_this_project(folder):
    command = [sys.executable, "-I", PROGRAMS[0], FILE]
    program = f"import sys; sys.path.insert(0, '.'); sys.argv = {command[2:]!r}; "
    program += f"exec(open({PROGRAMS[0]!r}).read())"
    done = subprocess.run(
        [sys.executable, "-I", "-S", "-c", program], cwd=folder, capture_output=True, text=True
    )
    assert done.returncode == 0, done.stdout + done.stderr
    assert done.stdout.splitlines()[-1].startswith("CHECKED  small")
    for word in ("proved", "assumed"):
        assert sum(line.startswith(word) for line in done.stdout.splitlines()) >= 4


def test_the_oracle_agrees_with_what_was_written(written):
    assert holds_in_floats(written)


@pytest.mark.parametrize(
    "scenario",
    [
        "robust controller.observer_gain=[0.5,0.5,0.5]",
        "robust robot.wheel_lag_s=[0.02,0.02]",
        "robust controller.restart=false",
        "robust controller.input_map=cosine_free",
        "certified robot.wheel_acceleration_max_mps2=15",
    ],
)
def test_what_the_checker_knows_nothing_of_is_unchecked_and_refused(scenario, tmp_path, capsys):
    name, *overrides = scenario.split()

    class Certified:
        holds_for_robot = True

    class Stand:
        certificate = Certified()
        problem = type("Problem", (), {"scenario": jt.load(name, overrides)})

    described = describe_proof(Stand())  # type: ignore[arg-type]
    path = tmp_path / FILE
    path.write_text(json.dumps(described))
    assert load_checker(PROGRAMS[0]).main(str(path)) == 1
    assert "UNCHECKED" in capsys.readouterr().out


def test_what_is_changed_is_refused_or_holds_as_well(written, tmp_path, capsys):
    accepted = survey_mutants(written, range(8), tmp_path, capsys)
    assert len(accepted) < 5


@pytest.mark.slow
def test_a_thousand_changed_certificates_are_refused_or_hold_as_well(written, tmp_path, capsys):
    survey_mutants(written, range(30, 1030), tmp_path, capsys)


@pytest.mark.parametrize(
    ("path", "by"),
    [
        (("bands", 0, "disturbance", "yaw"), lambda yaw: yaw * 9 / 10),
        (("bands", 0, "disturbance", "box", 0), lambda width: width * 85 / 100),
        (("bands", 0, "disturbance", "box", 1), lambda width: width * 85 / 100),
        (("bands", 0, "disturbance", "box", 2), lambda width: width * 999999 / 1000000),
        (("bands", 0, "disturbance", "yaw"), lambda yaw: -yaw),
        (("bands", 0, "disturbance", "yaw"), lambda yaw: yaw * 101 / 100),
        (("noise", 2), lambda noise: noise * 1000001 / 1000000),
        (("slips", "right", 0, 1), lambda slip: slip * 11 / 10),
        (("sideslip",), lambda _: 1),
        (("wheel_speeds", 1), lambda speed: speed * 9 / 10),
        (("constraints", 1), lambda limit: limit * 4 / 5),
        (("bands", 0, "errors", 1), lambda cap: cap * 2),
        (("bands", 0, "u2", 1), lambda cap: cap * 999999 / 1000000),
        (("bands", 0, "gains", 1), lambda gain: gain / 2),
        (("sets", "invariant set", "offsets", 0), lambda offset: offset * 2),
        (("plans", "tolerance"), lambda tolerance: tolerance * 10000),
        (("plans", "windows", 0, "upper", 3), lambda bound: bound * 1000001 / 1000000),
        (("plans", "windows", 0, "norms", 0), lambda norm: -norm),
        (("plans", "order", 0, 1), lambda stage: stage * 11 / 10),
        (("plans", "sequence", 0), lambda window: window + 1 / Fraction(10)),
        (("cost", "P", 0, 0), lambda weight: weight / 2),
    ],
)
def test_a_promise_beyond_what_is_proved_is_refused(path, by, written, tmp_path, capsys):
    assert not is_accepted(change(written, *path, by=by), tmp_path, capsys)


def test_motions_whose_turns_are_not_coupled_with_x_are_cut_where_they_mirror_each_other(written):
    program = load_checker(PROGRAMS[0])
    changed = json.loads(json.dumps(written))
    band = changed["bands"][0]
    band["coupling"] = ["0", "0"]
    band["cells"] = {name: [] for name in band["cells"]}
    certificate = program.read(changed)
    motions = program.list_motions(certificate, certificate["bands"][0])
    assert all(cells for *_, cells in motions)
    with pytest.raises(program.Refused, match="0 trees"):
        program.check_motions(certificate, certificate["bands"][0])


def test_bands_are_checked_with_plans_that_lead_from_one_into_another(banded, tmp_path, capsys):
    bands = {tuple(window["bands"]) for window in banded["plans"]["windows"]}
    assert {("band 1", "band 2"), ("band 2", "band 1")} <= bands
    assert is_accepted(banded, tmp_path, capsys)


@pytest.mark.parametrize("band", [0, 1])
@pytest.mark.parametrize(
    ("path", "by"),
    [
        (("disturbance", "yaw"), lambda yaw: yaw * 9 / 10),
        (("disturbance", "yaw"), lambda yaw: yaw * 11 / 10),
        (("gains", 1), lambda gain: gain / 2),
        (("u2", 1), lambda cap: cap * 999999 / 1000000),
        (("regions", 0, 2), lambda slowest: slowest + Fraction(1, 10)),
        (("regions", 0, 3), lambda fastest: fastest - Fraction(1, 10)),
    ],
)
def test_a_promise_of_one_band_beyond_what_is_proved_is_refused(
    band, path, by, banded, tmp_path, capsys
):
    changed = change(banded, "bands", band, *path, by=by)
    assert not is_accepted(changed, tmp_path, capsys)


def test_a_period_that_is_said_to_be_in_another_band_is_refused(banded):
    program = load_checker(PROGRAMS[0])
    plans = load_checker("check_plans.py")
    other = {"band 1": "band 2", "band 2": "band 1"}
    for index, window in enumerate(banded["plans"]["windows"][:4]):
        for stage, name in enumerate(window["bands"]):
            changed = json.loads(json.dumps(banded))
            changed["plans"]["windows"][index]["bands"][stage] = other[name]
            with pytest.raises(program.Refused):
                plans.check_plans(program.read(changed))


@pytest.mark.slow
def test_the_oracle_agrees_with_what_was_written_of_bands(banded):
    assert holds_in_floats(banded)


def test_an_assumption_that_is_not_known_is_refused(written, tmp_path, capsys):
    assert not is_accepted({**written, "wheel_lag": "1/20"}, tmp_path, capsys)


@pytest.mark.parametrize(
    "text",
    [
        "",
        "{",
        "[]",
        "null",
        "7",
        '"text"',
        "[" * 100_000,
        "{}",
        '{"format": "jaxtube certificate 1"}',
    ],
)
def test_damaged_files_are_refused_in_one_line(text, tmp_path, capsys):
    path = tmp_path / FILE
    path.write_text(text)
    assert load_checker(PROGRAMS[0]).main(str(path)) == 1
    said = capsys.readouterr().out
    assert said.startswith("REFUSED") and said.count("\n") == 1


def test_a_cut_file_is_refused(written, tmp_path, capsys):
    text = json.dumps(written)
    path = tmp_path / FILE
    for share in (0.1, 0.5, 0.9, 0.999):
        path.write_text(text[: int(share * len(text))])
        assert load_checker(PROGRAMS[0]).main(str(path)) == 1
    assert load_checker(PROGRAMS[0]).main(str(tmp_path / "missing")) == 1
    assert capsys.readouterr().out.count("\n") == 5


def test_what_is_not_certified_has_no_proof(uncertified, tmp_path):
    with pytest.raises(ValueError, match="is not certified"):
        write_certificate(uncertified("certified", *SHORT), tmp_path)
    with pytest.raises(ValueError, match="give jt"):
        write_certificate("certified", tmp_path)  # type: ignore[arg-type]
